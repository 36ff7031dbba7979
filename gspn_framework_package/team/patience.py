"""How long the steps of an action may take."""

from __future__ import annotations

from typing import NamedTuple, Optional


class Patience(NamedTuple):
    """How long each step of an action may take, in seconds."""

    server: float = 10.0
    """Time until the server's topics are connected."""
    acknowledgement: float = 3.0
    """Time until the server's status lists the goal; after each third of it, the goal is sent
    again."""
    status: float = 5.0
    """Time between two status messages of the server while the goal is active."""
    result: float = 3.0
    """Time until the result arrives, once a goal has ended or the server no longer knows it."""


DEFAULT_PATIENCE = Patience()


def earliest(*times: Optional[float]) -> Optional[float]:
    """The earliest of some times, ignoring those that are None; None if all are."""
    return min((time for time in times if time is not None), default=None)
