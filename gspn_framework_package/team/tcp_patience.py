"""Has the operating system give a silent TCP connection up after some seconds.

Zenoh closes a connection only when what it has sent last is out. Over a link that is cut, or a NAT
that has forgotten the connection, that takes TCP up to a quarter of an hour, and meanwhile a router
does not let the robot in again. Zenoh has no setting for it, so the sockets get the option
``TCP_USER_TIMEOUT`` from here. Does nothing where there is no ``/proc``.
"""

from __future__ import annotations

import contextlib
import os
import socket
from typing import Iterable, Set

GIVES_UP = 6.0
"""Seconds for which sent data may stay unacknowledged. On a bad link TCP repeats itself five times
in that time."""

_LISTENS = "0A"


def limit_silence(listens: Iterable[int] = (), connects: Iterable[int] = ()) -> int:
    """Set the option for this process's sockets that listen at one of these ports, which those that
    they accept inherit, or that connect or are connected to one. Returns how many there are.

    :param listens: ports here.
    :param connects: ports elsewhere.
    """
    wanted = _inodes(set(listens), set(connects))
    if not wanted:
        return 0
    done = 0
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError, ValueError):  # closed meanwhile
            target = os.readlink("/proc/self/fd/" + name)
            if target.startswith("socket:[") and target[8:-1] in wanted:
                with socket.socket(fileno=os.dup(int(name))) as same:
                    option = socket.TCP_USER_TIMEOUT
                    same.setsockopt(socket.IPPROTO_TCP, option, int(1000 * GIVES_UP))
                done += 1
    return done


def ports_of(endpoints: Iterable[str]) -> Set[int]:
    """The ports in endpoints such as ``tls/HOST:7447``."""
    ends = (endpoint.rsplit(":", 1)[-1] for endpoint in endpoints)
    return {int(end) for end in ends if end.isdigit()}


def _inodes(listens: Set[int], connects: Set[int]) -> Set[str]:
    """The sockets of this network namespace that are meant, by their number."""
    found: Set[str] = set()
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError), open("/proc/self/net/" + table) as file:
            next(file, "")
            for line in file:
                _, local, remote, state, *_, inode = line.split()[:10]
                ours, theirs = (int(end.rsplit(":", 1)[1], 16) for end in (local, remote))
                if (state == _LISTENS and ours in listens) or theirs in connects:
                    found.add(inode)
    return found
