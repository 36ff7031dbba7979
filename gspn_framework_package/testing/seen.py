"""The view that a test has of a run, and the results that it sets for actions."""

from __future__ import annotations

from typing import Any, Callable, Mapping, NamedTuple, Optional, Tuple, Union

from gspn_framework_package.execution.firing import Firing, Move, TaskMove
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.outcome import Outcome


class ActionAttempt(NamedTuple):
    """An attempt at an action: when it began (``at``, s), whose it is, and what it may read."""

    at: float
    robot: str
    place: str
    visit: int
    attempt: int
    data: Mapping[str, Any]
    resumed_from: int


class FiredAt(NamedTuple):
    """A firing: when (``at``, s), which transition, the robot that asked for it ("" if none did),
    the ``cause`` of its event, and how robots and tasks moved."""

    at: float
    transition: str
    robot: str
    cause: Mapping[str, Any]
    moves: Tuple[Move, ...]
    tasks: Tuple[TaskMove, ...]

    def __str__(self) -> str:
        moves = ["%s: %s -> %s" % (m.robot, m.source, m.target) for m in self.moves]
        moves += ["task %s: %s -> %s" % (m.id, m.source or "in", m.target) for m in self.tasks]
        return "%10.3f s  %s  %s" % (self.at, self.transition, ", ".join(moves))


Act = Callable[[ActionAttempt], Any]
"""An action of a test: returns what a Python action returns."""


class Rule(NamedTuple):
    """The results that a test sets for the next attempts in a place."""

    place: str
    robot: str
    seconds: Union[None, float, Duration]
    result: Optional[str]
    data: Mapping[str, Any]
    fails: Optional[Outcome]
    act: Optional[Act]


def fired_at(now: float, firing: Firing) -> FiredAt:
    """A firing as a test sees it. ``now``: in seconds."""
    return FiredAt(now, firing.transition, firing.robot, firing.cause, firing.moves, firing.tasks)
