"""Brakes a connection that brings far more than a robot sends.

A router drops most of a flood (:mod:`~gspn_framework_package.team.lanes`), but what it passes on
wakes every robot for each message, which costs a team most of its speed. Zenoh cannot give a sender
who floods less than the others. The operating system can: with ``SO_RCVLOWAT`` it hands the data of
a connection over in large pieces, whose messages come at the same moment, so that the router passes
on one for each lane. Other connections are not touched. Does nothing where there is no ``/proc``.
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
"""TCP segments a second that a connection may bring, about as many as messages. A robot sends at
most 800 messages a second in each of its two channels, and a team at its fastest 500 a robot."""

MOST_BYTES = 4e6
"""Bytes a second that a connection may bring; a team at its fastest sends 0.2 MB a robot."""

LOOK = 0.5
"""Seconds between two looks. Who is too fast in two of them is braked."""

HOLDS = 2.0
"""Seconds for which a connection stays braked after the last look at which it was too fast."""

PIECE = 1_000_000
"""Bytes that are handed over together while a connection is braked; at each look, what is there."""

_LETS_IN = 0.02
"""Seconds at each look in which a braked connection hands over what is there."""

_NEWS = 100
_BYTES_AT, _SEGMENTS_AT = 128, 152  # tcpi_bytes_received and tcpi_data_segs_in in linux/tcp.h
_INFO_SIZE = 160


class Brought(NamedTuple):
    """What a connection has brought so far."""

    bytes: int
    segments: int


class FloodWatch:
    """Says which connections to brake. It knows no sockets."""

    def __init__(self) -> None:
        self._before: Dict[str, Brought] = {}
        self._looked = 0.0
        self._fast: Set[str] = set()
        self._until: Dict[str, float] = {}

    def look(self, now: float, received: Mapping[str, Brought]) -> Set[str]:
        """Which connections are to be braked until the next look.

        :param now: a monotonic clock, in seconds.
        :param received: what each open connection has brought.
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
    """Looks at the connections to some ports of this process, on a thread of its own.

    :param ports: at which this process listens.
    """

    def __init__(self, ports: Iterable[int]) -> None:
        at = set(ports)
        self._sockets = OwnSockets(lambda state, here, there: state == CONNECTED and here in at)
        self._watch = FloodWatch()
        self._braked: Dict[str, str] = {}  # number of the socket -> who is at its other end
        self._news: Deque[str] = collections.deque(maxlen=_NEWS)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, name="flood brake", daemon=True)
        self._thread.start()

    def news(self) -> List[str]:
        """What was done since the last call, for people; at most the last hundred."""
        found = []
        with contextlib.suppress(IndexError):
            while True:
                found.append(self._news.popleft())
        return found

    def close(self) -> None:
        """End the thread. Connections that are still open are read as they come."""
        self._over.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._over.wait(LOOK):
            self.look()
        self._set(set(self._braked), 1)

    def look(self) -> None:
        """Brake who floods, and let go who does so no longer; the thread does it twice a second."""
        received, ends = self._received()
        flooding = self._watch.look(time.monotonic(), received)
        for number in flooding - set(self._braked):
            self._braked[number] = ends[number]
            self._news.append(
                "%s sends more than a robot does: it is read more slowly" % self._braked[number]
            )
        freed = set(self._braked) - flooding
        self._set(set(self._braked), 1)  # who waits for the rest of a piece waits no longer
        for number in freed:
            self._news.append(
                "%s is read at full speed again, or has disconnected" % self._braked.pop(number)
            )
        if self._braked:
            self._over.wait(_LETS_IN)
            self._set(set(self._braked), PIECE)

    def _received(self) -> Tuple[Dict[str, Brought], Dict[str, str]]:
        """What the connections have brought, and who is at their other ends."""
        received: Dict[str, Brought] = {}
        ends: Dict[str, str] = {}
        for number, same in self._sockets:
            with contextlib.suppress(OSError):  # closed meanwhile
                info = same.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO_SIZE)
                if len(info) == _INFO_SIZE:
                    ends[number] = "%s:%d" % same.getpeername()[:2]
                    received[number] = Brought(
                        struct.unpack_from("=Q", info, _BYTES_AT)[0],
                        struct.unpack_from("=I", info, _SEGMENTS_AT)[0],
                    )
        return received, ends

    def _set(self, numbers: Set[str], least: int) -> None:
        """Have connections handed over from so many bytes on."""
        if numbers:
            for number, same in self._sockets:
                if number in numbers:
                    with contextlib.suppress(OSError):
                        same.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, least)
