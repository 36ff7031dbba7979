"""Finds the TCP sockets of this process, which Zenoh opens and does not hand out. Finds none where
there is no ``/proc``."""

from __future__ import annotations

import contextlib
import os
import socket
from typing import Callable, Dict, Iterator, Tuple

LISTENS, CONNECTED = "0A", "01"
"""States of a socket in ``/proc/net/tcp``."""


def own_sockets(wanted: Callable[[str, int, int], bool]) -> Iterator[Tuple[str, socket.socket]]:
    """The sockets that are wanted: the number of each, and another descriptor of it, which is
    closed before the next one comes.

    :param wanted: says so of a state (see :data:`LISTENS`), the port here and the one elsewhere.
    """
    numbers = _numbers(wanted)
    if not numbers:
        return
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError, ValueError):  # closed meanwhile
            number = numbers.pop(os.readlink("/proc/self/fd/" + name), "")
            if number:
                with socket.socket(fileno=os.dup(int(name))) as same:
                    yield number, same


def _numbers(wanted: Callable[[str, int, int], bool]) -> Dict[str, str]:
    """The numbers of the sockets of this network namespace that are wanted, by what a descriptor
    links to."""
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
