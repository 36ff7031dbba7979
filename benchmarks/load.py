"""The actions of the benchmarks: the load of the thesis's scaling experiments (6.1), a brief one,
and none at all."""

from __future__ import annotations

import random
from typing import Any, Dict, Mapping, Tuple

ROUNDS = 4
"""Rounds of the loop in one action."""

PAUSE = 0.2
"""Seconds that each round sleeps (thesis 6.1.1)."""


def loop(is_cancelled) -> str:  # type: ignore[no-untyped-def]
    """A loop with an addition and a sleep (thesis 6.1.1)."""
    total = 0
    for number in range(ROUNDS):
        total += number
        if is_cancelled.wait(PAUSE):
            break
    return ""


def brief(is_cancelled) -> str:  # type: ignore[no-untyped-def]
    """Take about a tenth of a second: the team is busy but not overloaded."""
    is_cancelled.wait(random.uniform(0.05, 0.15))
    return ""


def noting(is_cancelled: Any, data: Mapping[str, Any]) -> Tuple[str, Dict[str, Any]]:
    """Take as long as :func:`brief`, and count the robot's actions, in its data and the team's."""
    brief(is_cancelled)
    count = int(data.get("robot.count", 0)) + 1
    return "", {"robot.count": count, "team.count": count}


def short(is_cancelled) -> str:  # type: ignore[no-untyped-def]
    """Take a twentieth of a second."""
    is_cancelled.wait(0.05)
    return ""


def instant() -> str:
    """Return at once, which leaves the cost of the framework itself."""
    return ""
