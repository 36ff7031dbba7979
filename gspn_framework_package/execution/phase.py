"""What a robot or an agent is up to: the one vocabulary for it.

The log gives each robot one (:attr:`RobotState.phase`). People and programs are told one that also
takes account of a pause, of the end of the run and of what is not in the log yet
(:func:`.team_state.told_phase`). The members of :class:`Phase` are a table: the name of each phase
in logs, on ROS, in the thesis and on the page, and flags for what follows from it. Nothing else in
the package compares these names.
"""

from __future__ import annotations

import enum
from typing import Any, Dict, NamedTuple


class Told(NamedTuple):
    """How a phase is told, and what follows from it."""

    state: str
    """On ROS: ``GetState``, ``activity``, the command ``status`` (thesis 4.3.3)."""
    agent: str
    """Of an agent that is a thread (thesis 4.1.2, Figure 4.5)."""
    word: str
    """To people, on the page."""
    tone: str
    """How the page marks it: "good", "warn", "bad" or ""."""
    acts: bool = False
    """Whether an action of it runs, or is about to."""
    waits: bool = False
    """Whether it has ended its action and waits for a transition, or for the operator's leave."""
    gone: bool = False
    """Whether its token is no longer in the net."""
    failed: bool = False
    """Whether its action failed for good, and can be tried again."""
    needs_operator: bool = False
    """Whether it does not go on by itself."""
    at_rest: bool = False
    """Whether it has come to its own end: nothing can be ordered of it."""
    outlasts: bool = False
    """Whether this is still told of it when the run is over."""
    shown: bool = True
    """Whether the net shows it, in its place."""


class Phase(enum.Enum):
    """The value is what logs and the page's JSON call it.

    The log knows DOING, DONE, FAILED, INACTIVE, LOST and LEFT. The others are only told.
    """

    told: Told
    gone: bool

    def __new__(cls, value: str, told: Told) -> Phase:
        """A member of the table below."""
        phase = object.__new__(cls)
        phase._value_ = value
        phase.told = told
        phase.gone = told.gone  # asked so often that one look-up less counts
        return phase

    UNHEARD = "", Told("", "", "not heard yet", "")
    """Nothing has been heard of what it does."""
    FREE = "free", Told("Doing", "Free", "acts", "good", acts=True)
    """It has come to a new place and is about to start."""
    DOING = "doing", Told("Doing", "Occupied", "acts", "good", acts=True)
    """Its action runs."""
    DONE = "done", Told("Done", "Done", "waits", "warn", waits=True)
    """Its action is over. In the log: it asks for a transition. Told of a robot: what it asks for
    is not in the log yet."""
    WAITING = "waiting", Told("Waiting", "Waiting", "waits", "warn", waits=True)
    """It asks for a transition that did not fire at once."""
    PAUSED = "paused", Told("Paused", "Waiting", "paused", "warn", waits=True)
    """The operator paused it, or the team: it joins no firing."""
    FAILED = (
        "failed",
        Told("Failed", "Failed", "failed", "bad", failed=True, needs_operator=True, outlasts=True),
    )
    """Its action failed for good; the operator decides."""
    INACTIVE = "inactive", Told("Inactive", "Inactive", "has finished", "", at_rest=True)
    """It is in a place without output arcs, and has finished there."""
    STOPPED = "stopped", Told("Inactive", "Inactive", "stopped", "", at_rest=True)
    """The run is over, and this robot had not finished."""
    LOST = (
        "lost",
        Told("Lost", "Void", "lost", "bad", gone=True, needs_operator=True, outlasts=True),
    )
    """It was evicted; its token is in the account of the lost."""
    LEFT = "left", Told("Left", "Void", "has left", "", gone=True, outlasts=True, shown=False)
    """It left the team of its own will."""
    VOID = "void", Told("Left", "Void", "has ended", "", gone=True, outlasts=True, shown=False)
    """An agent that a transition destroyed: it consumed more than it produced."""

    @classmethod
    def of_state(cls, state: str) -> Phase:
        """The phase that ROS calls so; UNHEARD where none is."""
        return _BY_STATE.get(state, cls.UNHEARD)

    @classmethod
    def of_log(cls, value: str) -> Phase:
        """The phase that a log calls so. :raises ValueError: none that a log knows."""
        phase = cls.of_value(value)
        if phase not in _IN_LOGS:
            raise ValueError("a robot cannot be '%s'" % value)
        return phase

    @classmethod
    def of_value(cls, value: str) -> Phase:
        """The phase of that value; UNHEARD where there is none."""
        return _BY_VALUE.get(value, cls.UNHEARD)

    @property
    def logged(self) -> Phase:
        """What the log says of a robot that is told to be in this phase; UNHEARD where that cannot
        be known from it."""
        return _LOGGED.get(self, self)


_IN_LOGS = (Phase.DOING, Phase.DONE, Phase.FAILED, Phase.INACTIVE, Phase.LOST, Phase.LEFT)

_BY_VALUE: Dict[str, Phase] = {phase.value: phase for phase in Phase}

_BY_STATE = {phase.told.state: phase for phase in (*_IN_LOGS, Phase.WAITING, Phase.PAUSED)}

_LOGGED = {Phase.FREE: Phase.DOING, Phase.WAITING: Phase.DONE, Phase.PAUSED: Phase.UNHEARD}


ENTERED = Phase.DOING
"""The phase of a robot that a firing has put into a place."""


def phases_to_json() -> Dict[str, Any]:
    """For the page, as a JSON object: how each phase is told, by its value, and the phases that the
    page names itself."""
    left_out = ("state", "agent")
    return {
        "table": {
            phase.value: {k: v for k, v in phase.told._asdict().items() if k not in left_out}
            for phase in Phase
        },
        "named": {
            "entered": ENTERED.value,
            "paused": Phase.PAUSED.value,
            "waiting": Phase.WAITING.value,
            "stopped": Phase.STOPPED.value,
        },
    }
