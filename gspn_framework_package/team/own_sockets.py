"""Finds the TCP sockets of this process that Zenoh has opened but does not expose. Finds none where
``/proc`` is missing."""

from __future__ import annotations

import contextlib
import os
import socket
from typing import Callable, Dict, Iterator, Optional, Set, Tuple

LISTENS, CONNECTED = "0A", "01"
"""States of a socket in ``/proc/net/tcp``."""


class OwnSockets:
    """An iterable of the matching sockets, which may be iterated repeatedly.

    The table of all sockets of the network namespace may be long, so it is read only after this
    process has opened or closed a socket, and once more after that, because a new socket may not be
    in the table yet.

    :param wanted: says whether a socket matches, given its state (see :data:`LISTENS`), local port
        and remote port.
    """

    def __init__(self, wanted: Callable[[str, int, int], bool]) -> None:
        self._wanted = wanted
        self._open: Set[str] = set()
        self._is_known = False
        self._numbers: Dict[str, str] = {}

    def __iter__(self) -> Iterator[Tuple[str, socket.socket]]:
        """Yield the number of each socket and a duplicate descriptor, which is closed before the
        next iteration."""
        descriptors = _descriptors()
        if not self._is_known or self._open != set(descriptors):
            self._is_known = self._open == set(descriptors)
            self._open = set(descriptors)
            self._numbers = _numbers(self._wanted)
        for link, descriptor in descriptors.items():
            if link in self._numbers:
                same = _duplicate(link, descriptor)
                if same is not None:
                    with same:
                        yield self._numbers[link], same


def _duplicate(link: str, descriptor: int) -> Optional[socket.socket]:
    """Duplicate a socket's descriptor; None if the socket was closed in the meantime. Its number
    may belong to another file by now, which must not stay open here, since it may be a lock."""
    try:
        copy = os.dup(descriptor)
    except OSError:
        return None
    try:
        if os.readlink("/proc/self/fd/%d" % copy) == link:
            return socket.socket(fileno=copy)
    except OSError:
        pass
    os.close(copy)
    return None


def _descriptors() -> Dict[str, int]:
    """The sockets of this process: link target of a descriptor -> the descriptor."""
    found: Dict[str, int] = {}
    with contextlib.suppress(OSError):
        for name in os.listdir("/proc/self/fd"):
            with contextlib.suppress(OSError):  # closed in the meantime
                link = os.readlink("/proc/self/fd/" + name)
                if link.startswith("socket:"):
                    found[link] = int(name)
    return found


def _numbers(wanted: Callable[[str, int, int], bool]) -> Dict[str, str]:
    """The numbers of the matching sockets of this network namespace, by the link target of a
    descriptor."""
    found: Dict[str, str] = {}
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError), open("/proc/self/net/" + table) as file:
            next(file, "")
            for line in file:
                _, local, remote, state, *_, number = line.split()[:10]
                here, there = (int(end.rsplit(":", 1)[1], 16) for end in (local, remote))
                if wanted(state, here, there):
                    found["socket:[%s]" % number] = number
    return found
