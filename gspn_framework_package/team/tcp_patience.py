"""Makes the operating system close a silent TCP connection after some seconds.

Zenoh closes a connection only once its last data is sent. Over a broken link, or a NAT that dropped
the connection, TCP may take a quarter of an hour to give up; a router does not readmit the robot
before that. Zenoh has no setting for this, so this module sets ``TCP_USER_TIMEOUT`` on the sockets.
It does nothing where ``/proc`` is missing.
"""

from __future__ import annotations

import contextlib
import socket
from typing import Iterable, Set

from gspn_framework_package.team.own_sockets import LISTENS, OwnSockets

GIVES_UP = 6.0
"""Seconds for which sent data may stay unacknowledged. On a bad link, TCP retransmits five times in
that time."""


class SilenceLimit:
    """Sets the option on the sockets of this process that listen at one of the ports (accepted
    sockets inherit it) or are connected to one.

    :param listens: local ports.
    :param connects: remote ports.
    """

    def __init__(self, listens: Iterable[int] = (), connects: Iterable[int] = ()) -> None:
        here, there = set(listens), set(connects)
        self._sockets = OwnSockets(
            lambda state, local, remote: (state == LISTENS and local in here) or remote in there
        )

    def apply(self) -> int:
        """Set the option; call this repeatedly, because connections are replaced. Returns how many
        sockets have the option."""
        done = 0
        for _, same in self._sockets:
            with contextlib.suppress(OSError):  # closed in the meantime
                same.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * GIVES_UP))
                done += 1
        return done


def ports_of(endpoints: Iterable[str]) -> Set[int]:
    """The ports in endpoints such as ``tls/HOST:7447``."""
    ends = (endpoint.rsplit(":", 1)[-1] for endpoint in endpoints)
    return {int(end) for end in ends if end.isdigit()}
