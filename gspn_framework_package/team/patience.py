"""How long the steps of an action may take."""

from __future__ import annotations

from typing import NamedTuple, Optional


class Patience(NamedTuple):
    """How long each step of an action may take, in seconds."""

    server: float = 10.0
    """Until the server's topics are connected."""
    acknowledgement: float = 3.0
    """Until the server's status lists the goal; after each third of this time, the goal is sent
    again."""
    status: float = 5.0
    """Between two status messages of the server while the goal is active."""
    result: float = 3.0
    """Until the result arrives of a goal that has ended or that the server no longer knows."""


DEFAULT_PATIENCE = Patience()


def earliest(*times: Optional[float]) -> Optional[float]:
    """The first of some times; None stands for one that is not set, and is returned if none is."""
    return min((time for time in times if time is not None), default=None)
