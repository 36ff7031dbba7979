"""The output of the token game: firings, and commands to the executor of the actions."""

from __future__ import annotations

from typing import Any, Dict, Mapping, NamedTuple, Optional, Tuple, Union

from gspn_framework_package.execution.log_entries import NOTHING, Entry, Failed
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.model.outcome import Outcome


class Move(NamedTuple):
    """A robot's token moves from ``source`` (None if it was created) to ``target`` (None if it was
    destroyed, Void in thesis 4.1.2); ``visit`` is the number of the visit that begins."""

    robot: str
    source: Optional[str]
    target: Optional[str]
    visit: int


class TaskMove(NamedTuple):
    """The task ``id`` moves from ``source`` to ``target``: "place NAME" (a queue), "robot NAME", ""
    (from outside), "done", or "dropped" if it ends in another way."""

    id: str
    source: str
    target: str


class Firing(NamedTuple):
    """A transition fired at position (``slot``, ``index``) of the log.

    ``robot`` requested it ("" if no robot did), in its ``visit`` and ``incarnation``. ``moves``
    lists all robots that moved, and ``marking`` is the marking afterwards. ``drawn`` is the log
    position (slot, index) of the random draw that chose this transition (None if there was none).
    ``tasks`` lists the task movements, and ``cause`` holds the data of the event that fired the
    transition.
    """

    slot: int
    index: int  # type: ignore[assignment]  # hides tuple.index, unused
    transition: str
    robot: str
    incarnation: int
    visit: int
    moves: Tuple[Move, ...]
    marking: Marking
    drawn: Optional[Tuple[int, int]] = None
    tasks: Tuple[TaskMove, ...] = ()
    cause: Mapping[str, Any] = NOTHING


class StartAction(NamedTuple):
    """Start the action of ``place`` for this visit, after ``delay`` seconds; ``attempt`` counts
    from 1. ``data`` (full name -> value) holds the values that the action may read, and
    ``resumed_from`` is the earlier visit to the place that this one continues after an interrupt (0
    for none)."""

    robot: str
    place: str
    incarnation: int
    visit: int
    attempt: int
    delay: float = 0.0
    data: Mapping[str, Any] = NOTHING
    resumed_from: int = 0

    def failed(self, reason: Outcome, detail: str) -> Failed:
        """The entry of the log if the attempt fails."""
        return Failed(self.robot, self.incarnation, self.visit, self.attempt, reason.value, detail)

    def timed_out(self, seconds: float) -> Failed:
        """The entry of the log if the attempt takes longer than ``seconds``."""
        return self.failed(Outcome.TIMEOUT, "no result within %g s" % seconds)


class CancelAction(NamedTuple):
    """Cancel the actions of ``robot`` for visits up to ``visit``."""

    robot: str
    visit: int


class Fault(NamedTuple):
    """A fault that a person should know about; ``robot`` is "" if it concerns no robot, and
    ``failed`` is the reason why its action failed ("" for other faults). ``void`` is the entry that
    had no effect, if the fault says why; ``about_task``: it says what becomes of a task."""

    robot: str
    message: str
    failed: str = ""
    void: Optional[Entry] = None
    about_task: bool = False


class Ended(NamedTuple):
    """The run is over: it ran to completion (``finished``), or was stopped or failed."""

    reason: str
    finished: bool


class TaskEnded(NamedTuple):
    """The team no longer has a task. ``outcome`` is one of
    :data:`~gspn_framework_package.execution.team_tasks.OUTCOMES_OF_TASKS`, ``why`` says more, for
    people. ``robot`` had it ("" if none), ``data`` is what it had with it in the end, ``since``
    when it was submitted (seconds since 1970; 0 if that is not known), ``attempts`` how often a
    robot took it."""

    id: str
    outcome: str
    why: str
    robot: str = ""
    data: Mapping[str, Any] = NOTHING
    since: int = 0
    attempts: int = 0

    def seconds(self, now: float) -> Optional[float]:
        """How long the team had it (s); None if that is not known.

        :param now: when it ended (seconds since 1970).
        """
        return max(0.0, now - self.since) if self.since else None


GameCommand = Union[StartAction, CancelAction, Fault, Ended, TaskEnded]


def firing_to_json(firing: Firing, net: Net) -> Dict[str, Any]:
    """Convert a firing to a JSON object; its marking maps place names to counts, without empty
    places."""
    data = firing._asdict()
    data["marking"] = net.named(firing.marking, zeros=False)
    data["moves"] = [list(m) for m in firing.moves]
    data["drawn"] = list(firing.drawn) if firing.drawn else None
    if firing.tasks:
        data["tasks"] = [list(m) for m in firing.tasks]
    else:
        del data["tasks"]
    if firing.cause:
        data["cause"] = dict(firing.cause)
    else:
        del data["cause"]
    return data


def firing_from_json(data: Dict[str, Any], net: Net) -> Firing:
    """Convert a JSON object to a firing. :raises LogError: it is not a firing of this net."""
    try:
        fields = {key: data[key] for key in Firing._fields if key not in ("tasks", "cause")}
        fields["tasks"] = tuple(TaskMove(*map(str, m)) for m in data.get("tasks", ()))
        fields["cause"] = dict(data.get("cause", {}))
        fields["marking"] = net.marking(data["marking"])
        fields["moves"] = tuple(Move(*m) for m in data["moves"])
        fields["drawn"] = tuple(data["drawn"]) if data["drawn"] else None
        return Firing(**fields)
    except (KeyError, TypeError, ValueError) as error:
        raise LogError("not a firing: %.200r (%s)" % (data, error)) from None
