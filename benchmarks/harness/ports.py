"""Ports for servers that a benchmark or a test starts, kills and restarts."""

from __future__ import annotations

import random
import socket

_PORTS = range(20_000, 32_000)
"""Ports below those that Linux assigns automatically (``net.ipv4.ip_local_port_range``, from
32768). One of those could go to a client while the server is down, and a client that calls a server
on such a port can even connect to itself."""


def free_port() -> int:
    """A port of this machine on which nothing listens.

    :raises OSError: there is none.
    """
    for port in random.SystemRandom().sample(_PORTS, 1000):
        with socket.socket() as probe:
            # old connections must not block the port
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("", port))
            except OSError:
                continue
            return port
    raise OSError("no free port between %d and %d" % (_PORTS.start, _PORTS.stop))
