"""Waits for a router that starts later than its robots."""

from __future__ import annotations

import socket
from typing import Callable, Sequence

_PERIOD = 0.5
_ANSWERS_WITHIN = 3.0
_STREAMS = ("tcp", "tls")


def await_router(
    endpoints: Sequence[str], say: Callable[[str], None], wait: Callable[[float], object]
) -> None:
    """Wait until one of the endpoints accepts a connection, and report the wait once. The session
    finds out whether it is a router of the team.

    :param endpoints: the endpoints of the routers; returns at once if one of them does not use TCP.
    :param say: prints a line for people.
    :param wait: waits for some seconds; a true result ends the waiting.
    """
    reported = False
    while True:
        reasons = []
        for endpoint in endpoints:
            why = _why_not(endpoint)
            if not why:
                return
            reasons.append("%s: %s" % (endpoint, why))
        if not reasons:
            return
        if not reported:
            say("waits for a router (%s)" % "; ".join(reasons))
        reported = True
        if wait(_PERIOD):
            return


def _why_not(endpoint: str) -> str:
    """Why no endpoint accepts a connection; "" if one does, or if that cannot be tried."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol not in _STREAMS or not port.isdigit():
        return ""
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ANSWERS_WITHIN).close()
    except (OSError, OverflowError) as error:
        return getattr(error, "strerror", None) or str(error)
    return ""
