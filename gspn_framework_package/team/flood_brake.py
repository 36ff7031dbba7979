"""Slows down a connection that delivers far more than a robot sends.

A router drops most of a flood (:mod:`~gspn_framework_package.team.lanes`), but each message that it
still forwards wakes every robot, which costs a team most of its speed. Zenoh cannot give a flooding
sender less bandwidth than the others. The operating system can: with ``SO_RCVLOWAT`` it delivers
the data of a connection in large chunks. All messages of a chunk arrive at the same moment, so the
router forwards only one per lane. Other connections are not affected. Does nothing where ``/proc``
is missing.
"""

from __future__ import annotations

import collections
import contextlib
import socket
import struct
import threading
import time
from typing import Deque, Dict, Iterable, List, Mapping, NamedTuple, Set, Tuple

from gspn_framework_package.team.own_sockets import CONNECTED, OwnSockets

MOST_SEGMENTS = 3000.0
"""Limit of TCP segments per second of a connection; a segment holds about one message. A robot
sends at most 800 messages per second in each of its two channels; in the fastest team measured,
each robot sent 500."""

MOST_BYTES = 4e6
"""Limit of bytes per second of a connection; in the fastest team measured, each robot sent 0.2
MB."""

LOOK = 0.5
"""Seconds between two checks. A connection that is too fast in two consecutive checks is slowed
down."""

HOLDS = 2.0
"""Seconds for which a connection stays slow after the last check at which it was too fast."""

PIECE = 1_000_000
"""Bytes that a slowed connection delivers at once; at each check it also delivers whatever has
arrived."""

_LETS_IN = 0.02
"""Seconds per check during which a slowed connection delivers whatever has arrived."""

_NEWS = 100
_BYTES_AT, _SEGMENTS_AT = 128, 152  # tcpi_bytes_received and tcpi_data_segs_in in linux/tcp.h
_INFO_SIZE = 160


class Brought(NamedTuple):
    """What a connection has delivered so far."""

    bytes: int
    segments: int


class FloodWatch:
    """Decides which connections to slow down. Knows nothing of sockets."""

    def __init__(self) -> None:
        self._before: Dict[str, Brought] = {}
        self._looked = 0.0
        self._fast: Set[str] = set()
        self._until: Dict[str, float] = {}

    def look(self, now: float, received: Mapping[str, Brought]) -> Set[str]:
        """The connections to slow down until the next check.

        :param now: a monotonic clock, in seconds.
        :param received: what each open connection has delivered.
        """
        passed = now - self._looked
        fast = {
            name
            for name, have in received.items()
            if name in self._before and _too_fast(self._before[name], have, passed)
        }
        for name in fast:
            if name in self._fast or name in self._until:
                self._until[name] = now + HOLDS
        self._before, self._looked, self._fast = dict(received), now, fast
        self._until = {
            name: end for name, end in self._until.items() if name in received and now < end
        }
        return set(self._until)


def _too_fast(before: Brought, now: Brought, seconds: float) -> bool:
    return (
        now.bytes - before.bytes > MOST_BYTES * seconds
        or now.segments - before.segments > MOST_SEGMENTS * seconds
    )


class FloodBrake:
    """Checks the connections to some ports of this process on its own thread.

    :param ports: the ports, at which this process listens.
    """

    def __init__(self, ports: Iterable[int]) -> None:
        at = set(ports)
        self._sockets = OwnSockets(lambda state, here, there: state == CONNECTED and here in at)
        self._watch = FloodWatch()
        self._braked: Dict[str, str] = {}  # socket number -> address of its peer
        self._news: Deque[str] = collections.deque(maxlen=_NEWS)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, name="flood brake", daemon=True)
        self._thread.start()

    def news(self) -> List[str]:
        """Messages for the operator about what was done since the last call; at most the last
        hundred."""
        found = []
        with contextlib.suppress(IndexError):
            while True:
                found.append(self._news.popleft())
        return found

    def close(self) -> None:
        """End the thread. Connections that are still open are read normally again."""
        self._over.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._over.wait(LOOK):
            self.look()
        self._set(set(self._braked), 1)

    def look(self) -> None:
        """Slow down connections that flood, and release those that no longer do; the thread calls
        this twice a second."""
        received, ends = self._received()
        flooding = self._watch.look(time.monotonic(), received)
        for number in flooding - set(self._braked):
            self._braked[number] = ends[number]
            self._news.append(
                "%s sends more than a robot should; reading from it more slowly"
                % self._braked[number]
            )
        freed = set(self._braked) - flooding
        self._set(set(self._braked), 1)  # wakes readers that wait for the rest of a chunk
        for number in freed:
            self._news.append(
                "%s has slowed down or disconnected; no longer limited" % self._braked.pop(number)
            )
        if self._braked:
            self._over.wait(_LETS_IN)
            self._set(set(self._braked), PIECE)

    def _received(self) -> Tuple[Dict[str, Brought], Dict[str, str]]:
        """What the connections have delivered, and the addresses of their peers."""
        received: Dict[str, Brought] = {}
        ends: Dict[str, str] = {}
        for number, same in self._sockets:
            with contextlib.suppress(OSError):  # closed in the meantime
                info = same.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO_SIZE)
                if len(info) == _INFO_SIZE:
                    ends[number] = "%s:%d" % same.getpeername()[:2]
                    received[number] = Brought(
                        struct.unpack_from("=Q", info, _BYTES_AT)[0],
                        struct.unpack_from("=I", info, _SEGMENTS_AT)[0],
                    )
        return received, ends

    def _set(self, numbers: Set[str], least: int) -> None:
        """Set the number of bytes from which on the connections deliver data."""
        if numbers:
            for number, same in self._sockets:
                if number in numbers:
                    with contextlib.suppress(OSError):
                        same.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, least)
