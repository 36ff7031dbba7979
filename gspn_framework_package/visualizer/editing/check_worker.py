"""The process that reads and checks edited documents: a request on each line of stdin, an answer
on each line of stdout, all JSON. The arguments are the modules that plans may use.

A request is ``{"id", "what", "document", "path", ...}``; ``{"cancel": id}`` cancels one.
An answer is ``{"id", "answer"}``, ``{"id", "cancelled"}`` or ``{"id", "error"}``; the first line is
``{"ready": true}``. The process ends when its stdin closes, that is, when the server is stopping
for whatever reason.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import resource
import sys
import threading
import traceback
from typing import Any, Dict, Optional, Set, Tuple

from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.formats.difference import document_difference
from gspn_framework_package.formats.edited_document import (
    EditedDocument,
    document_from_json,
    plan_of_document,
)
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.errors import CancelledError, GspnError
from gspn_framework_package.visualizer.editing.choices import choices
from gspn_framework_package.visualizer.editing.findings import findings

CHECK_MEMORY = 3 << 30

_Request = Dict[str, Any]


class CheckingProcess:
    """Answers one request after the other; a thread reads them meanwhile."""

    def __init__(self) -> None:
        self._requests: queue.SimpleQueue[_Request] = queue.SimpleQueue()
        self._cancelled: Set[int] = set()
        self._out = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)  # anything else that prints must not get between the answers

    def run(self) -> None:
        """Answer until stdin ends."""
        threading.Thread(target=self._read, name="requests", daemon=True).start()
        self._say({"ready": True})
        while True:
            request = self._requests.get()
            self._say({"id": request["id"], **self._answer(request)})
            self._cancelled.discard(request["id"])

    def _read(self) -> None:
        for line in sys.stdin:
            message = json.loads(line)
            if "cancel" in message:
                self._cancelled.add(message["cancel"])
            else:
                self._requests.put(message)
        os._exit(0)

    def _say(self, message: Dict[str, Any]) -> None:
        try:
            self._out.write(json.dumps(message, separators=(",", ":")) + "\n")
            self._out.flush()
        except BrokenPipeError:
            os._exit(0)

    def _answer(self, request: _Request) -> Dict[str, Any]:
        def cancel() -> bool:
            return request["id"] in self._cancelled

        try:
            if cancel():
                raise CancelledError("a newer request has arrived")
            return {"answer": _WHAT[request["what"]](request, cancel)}
        except CancelledError:
            return {"cancelled": True}
        except GspnError as error:
            return {"error": str(error)}
        except MemoryError:
            return {"error": "it needs more than %d GB of memory" % (CHECK_MEMORY >> 30)}
        except Exception as error:
            traceback.print_exc()
            return {"error": "internal error: %s" % type(error).__name__}


def _check(request: _Request, cancel: Any) -> Dict[str, Any]:
    return findings(
        *_document(request),
        cancel,
        limit=request["limit"],
        seconds=request["seconds"],
        standalone=request["standalone"],
    )


def _choices(request: _Request, cancel: Any) -> Dict[str, Any]:
    return choices(*_document(request), request["marking"])


def _against_running(request: _Request, cancel: Any) -> Dict[str, Any]:
    """The differences between the running plan and the document, both with their subnets
    expanded."""
    plan = plan_of_document(*_document(request))
    running = plan_from_json(request["running"])
    old, new = (document_from_json(plan_to_json(each)) for each in (running, plan))
    changes = document_difference(old, new, positions=False)
    return {"changes": [change.to_json() for change in changes]}


def _document(request: _Request) -> Tuple[EditedDocument, str, str]:
    return request["document"], request["path"], request["root"]


_WHAT = {"check": _check, "choices": _choices, "running": _against_running}


def _import_ros() -> Optional[str]:
    """Import the check's ROS modules now rather than during the first check, if ROS is
    installed."""
    with contextlib.suppress(ImportError):
        from gspn_framework_package.ros import action_kinds, event_sources

        return action_kinds.__name__ + event_sources.__name__
    return None


def main() -> None:
    """Answer until stdin ends."""
    allow_modules(sys.argv[1:])
    resource.setrlimit(resource.RLIMIT_AS, (CHECK_MEMORY, CHECK_MEMORY))
    worker = CheckingProcess()
    _import_ros()
    worker.run()


if __name__ == "__main__":
    main()
