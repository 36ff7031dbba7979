"""The phases of a robot or an agent.

The log gives each robot a phase (:attr:`RobotState.phase`). The phase reported to people and
programs also reflects a pause, the end of the run, and changes that are not in the log yet
(:func:`.team_state.reported_phase`). The members of :class:`Phase` form a table: the name of each
phase in logs, in reports, in the thesis and on the page, and flags for its properties. No other
code in the package compares these names.
"""

from __future__ import annotations

import enum
from typing import Any, Dict, NamedTuple


class PhaseReport(NamedTuple):
    """How a phase is reported, and its properties."""

    state: str
    """Its name in what a robot reports of itself (thesis 4.3.3)."""
    agent: str
    """Its name for an agent that is a thread (thesis 4.1.2, Figure 4.5)."""
    word: str
    """Its name for people, on the page."""
    tone: str
    """Its style on the page: "good", "warn", "bad" or ""."""
    acts: bool = False
    """Whether the robot's action runs, or is about to start."""
    waits: bool = False
    """Whether the robot has ended its action and waits for a transition, or is paused."""
    gone: bool = False
    """Whether the robot's token is no longer in the net."""
    failed: bool = False
    """Whether the robot's action failed for good; the operator can have it tried again."""
    needs_operator: bool = False
    """Whether the robot needs the operator to continue."""
    at_rest: bool = False
    """Whether the robot is finished or stopped, so that it takes no orders."""
    outlasts: bool = False
    """Whether this phase is still reported when the run is over."""
    shown: bool = True
    """Whether the drawing of the net shows the robot in its place."""


class Phase(enum.Enum):
    """The phase of a robot or an agent; the value is its name in logs and in the page's JSON.

    The log contains DOING, DONE, FAILED, INACTIVE, LOST and LEFT. The others are only reported.
    """

    report: PhaseReport
    gone: bool

    def __new__(cls, value: str, report: PhaseReport) -> Phase:
        """Create a member from a row of the table below."""
        phase = object.__new__(cls)
        phase._value_ = value
        phase.report = report
        phase.gone = report.gone  # an attribute, because it is read very often
        return phase

    UNHEARD = "", PhaseReport("", "", "not heard yet", "")
    """Nothing has been heard from the robot yet."""
    FREE = "free", PhaseReport("Doing", "Free", "acts", "good", acts=True)
    """It has arrived in a place and is about to start."""
    DOING = "doing", PhaseReport("Doing", "Occupied", "acts", "good", acts=True)
    """Its action runs."""
    DONE = "done", PhaseReport("Done", "Done", "waits", "warn", waits=True)
    """Its action is over. In the log, this means that it asks for a transition; when reported, that
    its request is not in the log yet."""
    WAITING = "waiting", PhaseReport("Waiting", "Waiting", "waits", "warn", waits=True)
    """It asks for a transition that did not fire at once."""
    PAUSED = "paused", PhaseReport("Paused", "Waiting", "paused", "warn", waits=True)
    """The operator paused it or the team; it joins no firing."""
    FAILED = (
        "failed",
        PhaseReport(
            "Failed", "Failed", "failed", "bad", failed=True, needs_operator=True, outlasts=True
        ),
    )
    """Its action failed for good; the operator has to decide."""
    INACTIVE = "inactive", PhaseReport("Inactive", "Inactive", "has finished", "", at_rest=True)
    """It is in a place without output arcs, and has finished there."""
    STOPPED = "stopped", PhaseReport("Inactive", "Inactive", "stopped", "", at_rest=True)
    """The run is over, and this robot had not finished."""
    LOST = (
        "lost",
        PhaseReport("Lost", "Void", "lost", "bad", gone=True, needs_operator=True, outlasts=True),
    )
    """It was evicted; its token is counted as lost."""
    LEFT = (
        "left",
        PhaseReport("Left", "Void", "has left", "", gone=True, outlasts=True, shown=False),
    )
    """It left the team voluntarily."""
    VOID = (
        "void",
        PhaseReport("Left", "Void", "has ended", "", gone=True, outlasts=True, shown=False),
    )
    """An agent destroyed by a transition that consumed more agents than it produced."""

    @classmethod
    def of_state(cls, state: str) -> Phase:
        """The phase that reports name so; UNHEARD if there is none."""
        return _BY_STATE.get(state, cls.UNHEARD)

    @classmethod
    def of_log(cls, value: str) -> Phase:
        """The phase with this name in logs. :raises ValueError: logs contain no such phase."""
        phase = cls.of_value(value)
        if phase not in _IN_LOGS:
            raise ValueError("'%s' is not a phase of a robot" % value)
        return phase

    @classmethod
    def of_value(cls, value: str) -> Phase:
        """The phase with this value; UNHEARD if there is none."""
        return _BY_VALUE.get(value, cls.UNHEARD)

    @property
    def logged(self) -> Phase:
        """The phase in the log of a robot that is reported to be in this phase; UNHEARD if it
        cannot be inferred."""
        return _LOGGED.get(self, self)


_IN_LOGS = (Phase.DOING, Phase.DONE, Phase.FAILED, Phase.INACTIVE, Phase.LOST, Phase.LEFT)

_BY_VALUE: Dict[str, Phase] = {phase.value: phase for phase in Phase}

_BY_STATE = {phase.report.state: phase for phase in (*_IN_LOGS, Phase.WAITING, Phase.PAUSED)}

_LOGGED = {Phase.FREE: Phase.DOING, Phase.WAITING: Phase.DONE, Phase.PAUSED: Phase.UNHEARD}


ENTERED = Phase.DOING
"""The phase of a robot that a firing has moved into a place."""


def phases_to_json() -> Dict[str, Any]:
    """The phases as a JSON object for the page: ``table`` maps values to reports, and ``named``
    lists the phases that the page refers to by name."""
    left_out = ("state", "agent")
    return {
        "table": {
            phase.value: {k: v for k, v in phase.report._asdict().items() if k not in left_out}
            for phase in Phase
        },
        "named": {
            "entered": ENTERED.value,
            "paused": Phase.PAUSED.value,
            "waiting": Phase.WAITING.value,
            "stopped": Phase.STOPPED.value,
        },
    }
