"""The web server's connections, protected against exhaustion by deliberately slow peers.

Waitress passes a request to a thread once it has arrived completely. This module adds checks
before and after that. When the header has arrived, the guard and the limit on the length decide
whether the body is read at all, so an unauthorised peer cannot make the server store anything. Each
request has a deadline. When there are too many connections, a new one replaces one that waits for
its peer: the longest silent one of the peer with the most connections. A peer that does not read
its answer is disconnected so that it does not block a thread for long.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from typing import Any, Callable, Dict, List, Optional

from waitress.buffers import OverflowableBuffer
from waitress.channel import HTTPChannel
from waitress.parser import HTTPRequestParser
from waitress.server import TcpWSGIServer
from waitress.task import ErrorTask
from werkzeug.http import parse_cookie

from gspn_framework_package.visualizer.guard import HEADER, TOKEN_HEADER, Guard

MOST_WAITING_CONNECTIONS = 150
"""Number of connections in addition to those of the viewers."""

HEADER_SECONDS = 10.0
"""Time allowed for the header of a request, and for the first byte of a new connection."""

BODY_SECONDS = 10.0
"""Time allowed for the body of a request, plus one second for every :data:`SLOWEST` bytes."""

SLOWEST = 20_000

IDLE_SECONDS = 60.0
"""Time for which an idle connection is kept open."""

STALLED_SECONDS = 30.0
"""Time after which a peer that does not read its answer is disconnected."""

DISCARDED = 64_000_000
"""A request that is too large is read and discarded up to this many bytes, because its peer reads
the answer only after sending everything."""

_ASKED = ("Host", "Origin", "Sec-Fetch-Site", HEADER, TOKEN_HEADER)


class Refused:
    """Why a request is refused, in the form of waitress's own errors."""

    def __init__(self, code: int, text: str) -> None:
        self.code, self.text = code, text

    def to_response(self, *ident: Any) -> Any:
        """Return the status, the headers and the body."""
        headers = [
            ("Content-Type", "application/json"),
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
        ]
        return "%d Refused" % self.code, headers, json.dumps({"error": self.text}).encode()


class _RefusalTask(ErrorTask):
    """Answers with a :class:`Refused`, whether waitress writes text (1.4) or bytes (2.0)."""

    def execute(self) -> None:
        """Send the answer."""
        error = self.request.error
        if not isinstance(error, Refused):
            super().execute()
            return
        self.status, headers, body = error.to_response()
        self.response_headers.extend(headers)
        self.response_headers.append(("Connection", "close"))
        self.close_on_finish = True
        self.content_length = len(body)
        self.write(body)


class _Discard:
    """Reads a body and discards it."""

    error = None

    def __init__(self, length: int) -> None:
        self._left = length
        self.completed = False
        self._buffer = OverflowableBuffer(1)

    def received(self, data: bytes) -> int:
        """Process data; return how many bytes of it belong to the body."""
        taken = min(self._left, len(data))
        self._left -= taken
        self.completed = self._left <= 0
        return taken

    def getbuf(self) -> Any:
        """An empty buffer."""
        return self._buffer

    def getfile(self) -> Any:
        """An empty file."""
        return self._buffer.getfile()

    def __len__(self) -> int:
        return 0


class _Parser(HTTPRequestParser):
    """Parses an incoming request, and checks its header before it reads the body."""

    error: Any
    completed: bool
    body_rcv: Any

    def __init__(self, adj: Any, channel: PeerConnection) -> None:
        super().__init__(adj)
        self._channel = channel
        self._refused: Optional[Refused] = None
        self._limit = 0
        self.began = time.monotonic()

    def received(self, data: bytes) -> int:
        in_header = not self.headers_finished
        consumed = int(super().received(data))
        if in_header and self.headers_finished and not self.empty and self.error is None:
            self._look()
        elif self.chunked and self.error is None and self.body_bytes_received > self._limit:
            self._end(Refused(413, self._channel.rules.too_large(self.path)))
        if self.completed and self._refused is not None and self.error is None:
            self.error = self._refused
        return consumed

    def _look(self) -> None:
        if self.body_rcv is None:
            return
        rules = self._channel.rules
        self._limit = rules.body_limit(self.path)
        if self.content_length > DISCARDED:
            self._end(Refused(413, rules.too_large(self.path)))
            return
        asked = (self.command, self.path, self._fields(), self._cookies(), self._channel.peer)
        refusal = rules.guard.check(*asked).refusal
        if refusal is not None:
            self._end(Refused(refusal.status, refusal.reason))
        elif self.content_length > self._limit:
            self._refused = Refused(413, rules.too_large(self.path))
            self.body_rcv = _Discard(self.content_length)
            self.completed = False

    def _end(self, refused: Refused) -> None:
        self.error = refused
        self.completed = True
        self.expect_continue = False

    def _fields(self) -> Dict[str, str]:
        found = {name: self.headers.get(name.upper().replace("-", "_")) for name in _ASKED}
        return {name: value for name, value in found.items() if value is not None}

    def _cookies(self) -> Dict[str, str]:
        return dict(parse_cookie(self.headers.get("COOKIE", "")))

    def deadline(self) -> float:
        """The time by which the request must be complete, in monotonic seconds."""
        if not self.headers_finished:
            return self.began + HEADER_SECONDS
        length = self.content_length if not self.chunked else self._limit
        return self.began + HEADER_SECONDS + BODY_SECONDS + length / SLOWEST


class PeerConnection(HTTPChannel):
    """A connection of a peer."""

    error_task_class = _RefusalTask

    def __init__(self, server: Server, sock: Any, addr: Any, adj: Any, map: Any = None) -> None:
        super().__init__(server, sock, addr, adj, map=map)
        self.peer = str(addr[0])
        self.rules = server.rules
        self.parser_class = lambda adjustments: _Parser(adjustments, self)
        self._gone = False
        self._opened = time.monotonic()

    @property
    def waited_for(self) -> bool:
        """Whether the server waits for the peer: a complete request has not arrived yet."""
        return not self.requests and not self.total_outbufs_len

    def late(self, now: float) -> bool:
        """Whether its deadline has passed.

        :param now: seconds since 1970, as waitress counts.
        """
        if self.total_outbufs_len:
            return bool(self.last_activity < now - STALLED_SECONDS)
        if self.requests:
            return False
        request = self.request
        if request is not None:
            return bool(time.monotonic() > request.deadline())
        if self.last_activity <= self.creation_time:
            return time.monotonic() > self._opened + HEADER_SECONDS
        return bool(self.last_activity < now - IDLE_SECONDS)

    def cut_off(self) -> None:
        """Close the connection. Must be called on the server's own thread."""
        self._gone = self.will_close = True
        self.handle_close()

    def readable(self) -> bool:
        """Whether more may be read from it."""
        return not self._gone and bool(super().readable())

    def writable(self) -> bool:
        """Whether there is something to be written to it."""
        return not self._gone and bool(super().writable())


class RequestRules:
    """The checks made before the body of a request is read.

    :param guard: decides which requests are allowed.
    :param body_limit: returns the largest body of a request to a path, in bytes.
    :param too_large: returns the message for a larger one.
    """

    def __init__(
        self, guard: Guard, body_limit: Callable[[str], int], too_large: Callable[[str], str]
    ) -> None:
        self.guard, self.body_limit, self.too_large = guard, body_limit, too_large


class Server(TcpWSGIServer):
    """A waitress server with these connections.

    :param limit: the largest number of connections.
    """

    channel_class = PeerConnection
    rules: RequestRules
    """Must be set before the server runs."""

    def __init__(self, application: Any, limit: int, **options: Any) -> None:
        self._limit = limit
        super().__init__(
            application,
            # never reached: at this limit, waitress would not accept new connections
            connection_limit=limit + 50,
            cleanup_interval=1,
            asyncore_use_poll=True,  # select() cannot watch more than 1024 files
            max_request_body_size=1 << 62,  # RequestRules limits each path
            **options,
        )

    def maintenance(self, now: float) -> None:
        """Close the connections whose time is up. Called by waitress every ``cleanup_interval``."""
        for connection in list(self.active_channels.values()):
            if connection.late(now):
                connection.cut_off()

    def handle_accept(self) -> None:
        """Accept a connection. If there are too many, close another one, or this one if none can be
        closed."""
        known = set(self.active_channels)
        super().handle_accept()
        if len(self.active_channels) <= self._limit:
            return
        held = Counter(connection.peer for connection in self.active_channels.values())
        waited_for: List[PeerConnection] = [
            c for n, c in self.active_channels.items() if n in known and c.waited_for
        ]
        if waited_for:
            most = max(held[c.peer] for c in waited_for)
            min(
                (c for c in waited_for if held[c.peer] == most), key=lambda c: c.last_activity
            ).cut_off()
        else:
            for new in set(self.active_channels) - known:
                self.active_channels[new].cut_off()
