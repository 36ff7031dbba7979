"""Waits for a router that is started later than its robots."""

from __future__ import annotations

import socket
from typing import Callable, Sequence

_PERIOD = 0.5
_ANSWERS_WITHIN = 3.0
_STREAMS = ("tcp", "tls")


def await_router(
    endpoints: Sequence[str], say: Callable[[str], None], wait: Callable[[float], object]
) -> None:
    """Return when somebody takes a connection at one of the endpoints, and say it once if that is
    not so at first. Whether it is a router of the team is found out by the session.

    :param endpoints: of the routers; returns at once if one is reached by other means than TCP.
    :param say: prints a line for people.
    :param wait: waits so many seconds; something true ends the waiting.
    """
    told = False
    while True:
        reasons = []
        for endpoint in endpoints:
            why = _why_not(endpoint)
            if not why:
                return
            reasons.append("%s: %s" % (endpoint, why))
        if not reasons:
            return
        if not told:
            say("waits for a router (%s)" % "; ".join(reasons))
        told = True
        if wait(_PERIOD):
            return


def _why_not(endpoint: str) -> str:
    """Why nobody takes a connection; "" if somebody does, or that cannot be tried."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol not in _STREAMS or not port.isdigit():
        return ""
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ANSWERS_WITHIN).close()
    except (OSError, OverflowError) as error:
        return getattr(error, "strerror", None) or str(error)
    return ""
