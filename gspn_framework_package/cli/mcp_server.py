"""The Model Context Protocol on two streams: JSON-RPC 2.0, one message on each line.

The official library needs Python 3.10, a newer jsonschema than Debian 12 has, and some forty
packages. This package also supports 3.8, and needs only the few methods of a server that offers
tools and resources; with the library there would be two servers.
"""

from __future__ import annotations

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import IO, Any, Dict, Optional, Union

from gspn_framework_package import __version__
from gspn_framework_package.cli.mcp_resources import Resources
from gspn_framework_package.cli.mcp_tools import Json, PlanTools
from gspn_framework_package.model.errors import CancelledError, GspnError

VERSIONS = ("2025-11-25", "2025-06-18", "2025-03-26", "2024-11-05")
"""The versions of the protocol, the newest first; they do not differ in the methods used here."""

LINE_BYTES = 4_000_000
"""Maximum size of a message in bytes."""

AT_ONCE = 2
"""Maximum number of calls processed at the same time; further calls wait."""

PARSE_ERROR, INVALID_REQUEST, NO_SUCH_METHOD, INVALID_PARAMS = -32700, -32600, -32601, -32602
NO_SUCH_RESOURCE = -32002


class ModelContextServer:
    """Answers the requests of one client.

    :param tools: the tools that it offers.
    :param resources: what it lets the client read.
    :param requests: the messages of the client.
    :param answers: the messages to the client.
    """

    def __init__(
        self, tools: PlanTools, resources: Resources, requests: IO[bytes], answers: IO[bytes]
    ) -> None:
        self._tools, self._resources = tools, resources
        self._requests, self._answers = requests, answers
        self._names = {tool["name"] for tool in tools.listed()}
        self._lock = threading.Lock()
        self._calls: Dict[Union[str, int], threading.Event] = {}
        """The calls in progress: whether each was cancelled."""

    def run(self) -> None:
        """Serve until the client closes its stream; then cancel calls in progress."""
        with ThreadPoolExecutor(AT_ONCE) as pool:
            try:
                for line in iter(lambda: self._requests.readline(LINE_BYTES + 1), b""):
                    if len(line) > LINE_BYTES:
                        self._error(None, INVALID_REQUEST, "the message is too long")
                        return  # the start of the next message is unknown
                    if line.strip():
                        self._read(line, pool)
            finally:
                with self._lock:
                    for cancelled in self._calls.values():
                        cancelled.set()

    def _read(self, line: bytes, pool: ThreadPoolExecutor) -> None:
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            self._error(None, PARSE_ERROR, "the message is not JSON")
            return
        if not isinstance(message, dict) or not isinstance(message.get("method"), str):
            if not (isinstance(message, dict) and ("result" in message or "error" in message)):
                self._error(None, INVALID_REQUEST, "the message is not a request")
            return
        method, params = message["method"], message.get("params", {})
        if not isinstance(params, dict):
            params = {}
        key = message.get("id")
        if "id" not in message:
            if method == "notifications/cancelled":
                self._cancel(params.get("requestId"))
        elif not isinstance(key, (str, int)) or isinstance(key, bool):
            self._error(None, INVALID_REQUEST, "the id is neither a string nor a whole number")
        elif method == "initialize":
            self._result(key, self._greeting(params))
        elif method == "ping":
            self._result(key, {})
        elif method == "tools/list":
            self._result(key, {"tools": self._tools.listed()})
        elif method == "tools/call":
            self._begin(key, params, pool)
        elif method == "resources/list":
            self._result(key, {"resources": self._resources.listed()})
        elif method == "resources/templates/list":
            self._result(key, {"resourceTemplates": []})
        elif method == "resources/read":
            self._read_resource(key, params)
        else:
            self._error(key, NO_SUCH_METHOD, "there is no method '%.80s'" % method)

    def _greeting(self, params: Json) -> Json:
        asked = params.get("protocolVersion")
        return {
            "protocolVersion": asked if asked in VERSIONS else VERSIONS[0],
            "capabilities": {"tools": {}, "resources": {}},
            "serverInfo": {"name": "gspn", "version": __version__},
            "instructions": self._tools.instructions,
        }

    def _read_resource(self, key: Union[str, int], params: Json) -> None:
        try:
            self._result(key, self._resources.read(str(params.get("uri"))))
        except (GspnError, OSError) as error:
            self._error(key, NO_SUCH_RESOURCE, str(error))

    def _begin(self, key: Union[str, int], params: Json, pool: ThreadPoolExecutor) -> None:
        name, arguments = params.get("name"), params.get("arguments") or {}
        if name not in self._names or not isinstance(arguments, dict):
            self._error(key, INVALID_PARAMS, "there is no tool '%.80s'" % name)
            return
        meta = params.get("_meta")
        token = meta.get("progressToken") if isinstance(meta, dict) else None
        cancelled = threading.Event()
        with self._lock:
            self._calls[key] = cancelled
        pool.submit(self._answer, key, cancelled, str(name), arguments, token)

    def _answer(
        self,
        key: Union[str, int],
        cancelled: threading.Event,
        name: str,
        arguments: Json,
        token: Any,
    ) -> None:
        def tick(seconds: float) -> bool:
            if token is not None:
                progress = {"progressToken": token, "progress": round(seconds, 1)}
                self._send({"method": "notifications/progress", "params": progress})
            return cancelled.is_set()

        failed = True
        answer: Json = {}
        try:
            if tick(0.0):
                raise CancelledError("the call was cancelled")
            text = self._tools.call(name, arguments, tick)
            answer["structuredContent"] = json.loads(text)
            failed = False
        except GspnError as error:
            text = "error: %s" % error
        except Exception as error:  # a bug in this program: the client gets an answer all the same
            text = "internal error: %s: %s" % (type(error).__name__, error)
        with self._lock:
            self._calls.pop(key, None)
        if not cancelled.is_set():
            answer.update(content=[{"type": "text", "text": text}], isError=failed)
            self._result(key, answer)

    def _cancel(self, key: Any) -> None:
        with self._lock:
            cancelled = self._calls.get(key) if isinstance(key, (str, int)) else None
        if cancelled is not None:
            cancelled.set()

    def _result(self, key: Union[str, int], result: Json) -> None:
        self._send({"id": key, "result": result})

    def _error(self, key: Optional[Union[str, int]], code: int, text: str) -> None:
        self._send({"id": key, "error": {"code": code, "message": text}})

    def _send(self, message: Json) -> None:
        line = json.dumps({"jsonrpc": "2.0", **message}, ensure_ascii=True).encode() + b"\n"
        with self._lock:
            try:
                self._answers.write(line)
                self._answers.flush()
            except (OSError, ValueError):
                pass  # the client is gone, and its stream of requests ends too
