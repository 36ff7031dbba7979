"""Makes the operating system close a silent TCP connection after some seconds.

Zenoh closes a connection only once its last data is sent. Over a cut link, or a NAT that dropped
the connection, TCP gives up after as much as a quarter of an hour; until then a router does not let
the robot in again. Zenoh has no setting for this, so this module sets ``TCP_USER_TIMEOUT`` on the
sockets. It does nothing where there is no ``/proc``.
"""

from __future__ import annotations

import contextlib
import socket
from typing import Iterable, Set

from gspn_framework_package.team.own_sockets import LISTENS, OwnSockets

GIVES_UP = 6.0
"""Seconds for which sent data may stay unacknowledged. On a bad link TCP repeats itself five times
in that time."""


class SilenceLimit:
    """Sets the option for this process's sockets that listen at one of these ports, which those
    that they accept inherit, or that connect or are connected to one.

    :param listens: ports here.
    :param connects: ports elsewhere.
    """

    def __init__(self, listens: Iterable[int] = (), connects: Iterable[int] = ()) -> None:
        here, there = set(listens), set(connects)
        self._sockets = OwnSockets(
            lambda state, local, remote: (state == LISTENS and local in here) or remote in there
        )

    def apply(self) -> int:
        """Set it; again and again, because connections are made anew. Returns how many sockets have
        it."""
        done = 0
        for _, same in self._sockets:
            with contextlib.suppress(OSError):  # closed meanwhile
                same.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * GIVES_UP))
                done += 1
        return done


def ports_of(endpoints: Iterable[str]) -> Set[int]:
    """The ports in endpoints such as ``tls/HOST:7447``."""
    ends = (endpoint.rsplit(":", 1)[-1] for endpoint in endpoints)
    return {int(end) for end in ends if end.isdigit()}
