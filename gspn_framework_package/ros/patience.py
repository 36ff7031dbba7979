"""How long the steps of an action may take."""

from __future__ import annotations

from typing import NamedTuple


class Patience(NamedTuple):
    """How long each step of an action may take, in seconds."""

    server: float = 10.0
    """Until the server's topics are connected."""
    acknowledgement: float = 3.0
    """Until the server's status lists the goal; the goal is sent again every third of it."""
    status: float = 5.0
    """Between two statuses of the server while the goal is under way."""
    result: float = 3.0
    """Until the result of a goal comes that has ended, or that the server no longer knows."""


DEFAULT_PATIENCE = Patience()
