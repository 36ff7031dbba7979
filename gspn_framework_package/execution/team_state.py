"""The state of a team according to the log: the marking, and for each robot its place, visit and
phase.

Only the token game changes a :class:`TeamState`. It can be written as JSON and read back (a
*snapshot*); the copy behaves exactly like the original.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import (
    AbstractSet,
    Any,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Tuple,
)

from gspn_framework_package.execution.log_entries import Submit
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_tasks import ENDED_TASKS, EndedTask, FoundTask, Task
from gspn_framework_package.model.data import check_values
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan_timing import POLICY

OUTSIDE_LIMIT = 10_000
"""Maximum number of tasks waiting for a transition; further tasks have no effect."""


class Draw(NamedTuple):
    """A choice that a robot keeps: ``transition`` was drawn from ``candidates`` at log position
    (``slot``, ``index``), for the marking with this ``version``."""

    version: int
    candidates: Tuple[int, ...]
    transition: int
    slot: int
    index: int  # type: ignore[assignment]  # hides tuple.index, unused


@dataclass
class RobotState:
    """A robot (or agent) in a :class:`TeamState`; places and transitions are indices of the net."""

    name: str
    place: int
    incarnation: int = 0
    visit: int = 1
    attempt: int = 1
    phase: Phase = Phase.DOING
    request: int = POLICY
    """The request of a DONE robot: a transition, or POLICY."""
    order: int = 0
    """Sequence number of its ``Done``."""
    failures: int = 0
    """Failed attempts since the last retry by the operator."""
    paused: bool = False
    stopped: bool = False
    """Whether the pause stops its action as well."""
    drawn: Optional[Draw] = None
    why: str = ""
    """Why its action failed, or why the policy makes it wait."""
    data: Dict[str, Any] = field(default_factory=dict)
    """Its own data: name -> value."""
    task: Optional[Task] = None
    """The task that it carries."""
    held: Dict[int, Mapping[str, Any]] = field(default_factory=dict)
    """Held events: transitions that fire as soon as they can in this visit, with their causes."""
    interrupted: Dict[int, int] = field(default_factory=dict)
    """Place -> the interrupted visit there that the next one continues."""
    resumed_from: int = 0
    """The visit that this one continues; 0 for none."""

    @property
    def wanted(self) -> Optional[int]:
        """The transition that it requests or that the policy drew for it; None if there is none."""
        if self.request != POLICY:
            return self.request
        return self.drawn.transition if self.drawn else None


@dataclass
class StagedPlan:
    """A plan that the team may adopt: its entry ``StagePlan``, its ``number``, and the votes on
    it."""

    number: int
    digest: str
    plan: Mapping[str, Any]
    mapping: Mapping[str, str] = field(default_factory=dict)
    folder: str = ""
    votes: Dict[str, Tuple[int, str]] = field(default_factory=dict)
    """Member -> its incarnation, and why it cannot follow the plan ("" if it can)."""

    def to_json(self) -> Dict[str, Any]:
        """The plan and the votes as a JSON object."""
        return {
            "number": self.number,
            "digest": self.digest,
            "plan": dict(self.plan),
            "mapping": dict(self.mapping),
            "folder": self.folder,
            "votes": {name: list(vote) for name, vote in self.votes.items()},
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> StagedPlan:
        """Parse a staged plan. :raises KeyError, TypeError, ValueError: the JSON object is not
        one."""
        votes = {str(r): (whole_number(i), str(why)) for r, (i, why) in data["votes"].items()}
        if not isinstance(data["plan"], dict):
            raise ValueError("the staged plan is not an object")
        return cls(
            whole_number(data["number"]),
            str(data["digest"]),
            data["plan"],
            {str(a): str(b) for a, b in data["mapping"].items()},
            str(data["folder"]),
            votes,
        )


@dataclass
class TeamState:
    """The state of a run after a prefix of its log.

    ``waiting`` holds the robots that are DONE, in order of completion; ``done_in`` holds the same
    for each place. Both follow from ``robots``. ``version`` counts the changes of the marking,
    ``orders`` counts how often a robot became DONE, and ``created`` numbers new agents.

    ``draws_ties`` is that of :class:`~gspn_framework_package.execution.log_entries.Start`.

    ``data`` belongs to the team. ``queues`` holds the tasks of each queue (place), the next one
    first; ``submitted`` holds tasks whose transition was not enabled yet; ``known`` holds the
    newest ids of tasks that arrived through each transition; ``ended_tasks`` holds the last tasks
    that ended.
    """

    marking: Tuple[int, ...]
    robots: Dict[str, RobotState] = field(default_factory=dict)
    witnesses: Tuple[str, ...] = ()
    seed: int = 0
    draws_ties: bool = False
    next_slot: int = 0
    version: int = 0
    orders: int = 0
    created: int = 0
    paused: bool = False
    stopped: bool = False
    """Whether the pause stops actions as well."""
    ended: Optional[str] = None
    """Why the run is over; None while it is running."""
    finished: bool = False
    """Whether the run completed; false if it was stopped or ended by a fault."""
    fault: bool = False
    """Whether the run ended because of a fault."""
    waiting: Dict[str, None] = field(default_factory=dict)
    done_in: Dict[int, Dict[str, None]] = field(default_factory=dict)
    data: Dict[str, Any] = field(default_factory=dict)
    queues: Dict[int, List[Task]] = field(default_factory=dict)
    submitted: List[Tuple[int, Task]] = field(default_factory=list)
    known: Dict[int, Dict[str, None]] = field(default_factory=dict)
    ended_tasks: List[EndedTask] = field(default_factory=list)
    stages: int = 0
    """Number of plans staged so far."""
    staged: Optional[StagedPlan] = None
    """The staged plan, if any."""
    adopted: Optional[StagedPlan] = None
    """The plan that the team adopted; None for its first plan."""
    renamed: Dict[str, str] = field(default_factory=dict)
    """Name of a place or transition in an earlier plan -> its name in the present one, if they
    differ."""

    def members(self) -> List[str]:
        """The names of the voters: the robots that are neither lost nor have left, and the
        witnesses."""
        return [r.name for r in self.robots.values() if not r.phase.gone] + list(self.witnesses)

    def active(self) -> List[RobotState]:
        """The robots whose tokens are in the net."""
        return [r for r in self.robots.values() if not r.phase.gone]

    def is_stopped(self, robot: RobotState) -> bool:
        """Whether a pause keeps the robot from doing its action."""
        return self.stopped or robot.stopped

    def add_waiting(self, robot: RobotState) -> None:
        """Mark ``robot`` as DONE, after all others that are."""
        self.orders += 1
        robot.order = self.orders
        robot.phase = Phase.DONE
        self._index(robot)

    def remove_waiting(self, robot: RobotState) -> None:
        """Remove ``robot`` from the DONE robots, if it is one, and forget its draw."""
        robot.drawn = None
        if self.waiting.pop(robot.name, 0) is None:
            names = self.done_in[robot.place]
            del names[robot.name]
            if not names:
                del self.done_in[robot.place]

    def _index(self, robot: RobotState) -> None:
        self.waiting[robot.name] = None
        self.done_in.setdefault(robot.place, {})[robot.name] = None

    def set_marking(self, marking: Tuple[int, ...]) -> None:
        """Set a new marking; draws made for the old one no longer hold."""
        if marking != self.marking:
            self.marking = marking
            self.version += 1

    # -- data and tasks ----------------------------------------------------------------------------

    def data_of(self, robot: RobotState) -> Dict[str, Any]:
        """The data that an action of ``robot`` may read: full name -> value."""
        if robot.task is None and not robot.data and not self.data:
            return {}
        found = {"robot." + name: value for name, value in robot.data.items()}
        found.update(self.team_data())
        if robot.task is not None:
            found.update(("task." + name, value) for name, value in robot.task.data.items())
            found["task.id"] = robot.task.id
        return found

    def team_data(self) -> Dict[str, Any]:
        """The data of the team: full name -> value."""
        return {"team." + name: value for name, value in self.data.items()}

    def present_name(self, name: str) -> str:
        """The present name of a place or transition of an earlier plan. Actions that were running
        when the team adopted the present plan still use the old one."""
        return self.renamed.get(name, name)

    def is_known(self, t: int, task: str) -> bool:
        """Whether a task with this id has arrived through transition ``t``."""
        return task in self.known.get(t, ())

    def with_again(self, task: Submit, net: Net) -> Submit:
        """Mark a task that an operator submits as ``again`` if it was submitted before and the
        robot that carries it is gone."""
        t = net.transition_index.get(self.present_name(task.transition))
        gone = t is not None and self.gone_with(t, task.id) is not None
        return task._replace(again=gone)

    def tasks(self) -> Iterator[FoundTask]:
        """The tasks that are not done: those that robots carry, in queues, and outside."""
        for robot in self.robots.values():
            if robot.task is not None and robot.task.id:
                yield FoundTask(robot.task, robot=robot.name)
        for p, queue in self.queues.items():
            yield from (FoundTask(task, place=p) for task in queue if task.id)
        yield from (FoundTask(task, before=t) for t, task in self.submitted if task.id)

    def tasks_left(self, net: Net) -> List[str]:
        """The tasks that are not done, each with its location."""
        return ["%s %s" % (found.task.id, found.where(net)) for found in self.tasks()]

    def tasks_with(self, task_id: str) -> List[FoundTask]:
        """The tasks with an id that are not done; several if they arrived through several
        transitions."""
        return [found for found in self.tasks() if found.task.id == task_id]

    def whereabouts(self, task_id: str, net: Net) -> str:
        """Where the task with an id is, or how it ended, in words."""
        there, ended = self.tasks_with(task_id), self.end_of(task_id)
        if there:
            return "it is " + there[0].where(net)
        return ended.text if ended is not None else "the team no longer has it"

    def end_of(self, task_id: str) -> Optional[EndedTask]:
        """How the last task with an id ended; None if it did not, or long ago."""
        return next((e for e in reversed(self.ended_tasks) if e.id == task_id), None)

    def why_not_one_task(self, task_id: str) -> str:
        """Why no order about the task with an id is possible; "" if it is."""
        there = self.tasks_with(task_id)
        if len(there) > 1:
            return "%d tasks have the id '%s'" % (len(there), task_id)
        ended = self.end_of(task_id)
        if there:
            return ""
        if ended is not None:
            return "the team no longer has task '%s': %s" % (task_id, ended.text)
        return "the team has no task '%s'" % task_id

    def end_task(self, task: Task, outcome: str, why: str) -> None:
        """Remember that a task ended."""
        self.ended_tasks = [
            *self.ended_tasks[1 - ENDED_TASKS :],
            EndedTask(task.id, outcome, why),
        ]

    def gone_with(self, t: int, task: str) -> Optional[RobotState]:
        """The lost or departed robot that carries the task with this id of transition ``t``; None
        if there is none."""
        if not self.is_known(t, task) or sum(task in ids for ids in self.known.values()) > 1:
            return None  # the task did not arrive, or there are several with this id
        carriers = (r for r in self.robots.values() if r.task is not None and r.task.id == task)
        return next((robot for robot in carriers if robot.phase.gone), None)

    def is_full(self, t: int) -> bool:
        """Whether no more tasks can wait for transition ``t``."""
        return len(self.submitted) >= OUTSIDE_LIMIT and OUTSIDE_LIMIT <= sum(
            other == t for other, _ in self.submitted
        )

    # -- snapshots ---------------------------------------------------------------------------------

    def to_json(self, net: Net) -> Dict[str, Any]:
        """The state as a JSON object, with names instead of indices."""
        return {
            "marking": net.named(self.marking, zeros=False),
            "robots": [_robot_to_json(r, net) for r in self.robots.values()],
            "witnesses": list(self.witnesses),
            **{key: getattr(self, key) for key in _PLAIN},
            **{key: True for key in _FLAGS if getattr(self, key)},
            **self._reacting_to_json(net),
            **self._plans_to_json(),
        }

    @classmethod
    def from_json(cls, data: Dict[str, Any], net: Net, queues: AbstractSet[int]) -> TeamState:
        """Parse a state.

        :param queues: the places of the plan whose tokens are tasks.
        :raises LogError: it is not a state, or not of this plan.
        """
        try:
            state = cls(
                net.marking(data["marking"]),
                witnesses=tuple(data["witnesses"]),
                draws_ties=bool(data.get("draws_ties", False)),
                stopped=bool(data.get("stopped", False)),
                finished=bool(data.get("finished", False)),
                fault=bool(data.get("fault", False)),
                **{key: data[key] for key in _PLAIN},
            )
            for item in data["robots"]:
                robot = _robot_from_json(item, net)
                state.robots[robot.name] = robot
            state._read_reacting(data, net, queues)
            state._read_plans(data)
            for robot in sorted(state.robots.values(), key=lambda r: r.order):
                if robot.phase is Phase.DONE:
                    state._index(robot)
            state._check()
            return state
        except (KeyError, TypeError, ValueError, AttributeError, GspnError) as error:
            raise LogError("not a snapshot of this plan (%s)" % error) from None

    def _reacting_to_json(self, net: Net) -> Dict[str, Any]:
        """Data and tasks, if there are any."""
        place, transition = net.places, net.transitions
        found: Dict[str, Any] = {
            "data": dict(self.data),
            "queues": {place[p].name: [t.to_json() for t in q] for p, q in self.queues.items()},
            "submitted": [[transition[t].name, task.to_json()] for t, task in self.submitted],
            "known": {transition[t].name: list(ids) for t, ids in self.known.items()},
            "ended_tasks": [list(ended) for ended in self.ended_tasks],
        }
        return {key: value for key, value in found.items() if value}

    def _read_reacting(self, data: Dict[str, Any], net: Net, queues: AbstractSet[int]) -> None:
        self.data = check_values(data.get("data", {}), None)
        self.queues = {
            net.place_number(p): [Task.from_json(task) for task in queue]
            for p, queue in data.get("queues", {}).items()
        }
        self.submitted = [
            (net.transition_number(t), Task.from_json(task))
            for t, task in data.get("submitted", ())
        ]
        self.known = {
            net.transition_number(t): dict.fromkeys(map(str, ids))
            for t, ids in data.get("known", {}).items()
        }
        self.ended_tasks = [EndedTask(*map(str, ended)) for ended in data.get("ended_tasks", ())]
        if not self.queues.keys() <= queues:
            raise ValueError("a place that is not a queue has tasks")
        for p in queues:
            if len(self.queues.get(p, ())) != self.marking[p]:
                raise ValueError("a queue does not have as many tasks as tokens")

    def _plans_to_json(self) -> Dict[str, Any]:
        """The plans that were staged and adopted, if any were."""
        found: Dict[str, Any] = {
            "stages": self.stages,
            "staged": self.staged.to_json() if self.staged else None,
            "adopted": self.adopted.to_json() if self.adopted else None,
            "renamed": dict(self.renamed),
        }
        return {key: value for key, value in found.items() if value}

    def _read_plans(self, data: Dict[str, Any]) -> None:
        self.stages = whole_number(data.get("stages", 0))
        for key in ("staged", "adopted"):
            if key in data:
                setattr(self, key, StagedPlan.from_json(data[key]))
        self.renamed = {str(a): str(b) for a, b in data.get("renamed", {}).items()}

    def _check(self) -> None:
        """:raises ValueError: fields have the wrong type, or contradict each other."""
        numbers = [
            self.seed,
            self.next_slot,
            self.version,
            self.orders,
            self.created,
            *self.marking,
        ]
        for robot in self.robots.values():
            numbers += [robot.incarnation, robot.visit, robot.attempt, robot.order, robot.failures]
            if (
                not isinstance(robot.name, str)
                or not isinstance(robot.paused, bool)
                or not isinstance(robot.why, str)
            ):
                raise ValueError("a robot has a field of another type")
            if not robot.phase.gone and self.marking[robot.place] < 1:
                raise ValueError("there is no token in the place of %s" % robot.name)
        if (
            any(type(number) is not int for number in numbers)
            or self.next_slot < 0
            or min(self.marking, default=0) < 0
        ):
            raise ValueError("a number is invalid, or out of bounds")
        if not isinstance(self.paused, bool) or not all(isinstance(w, str) for w in self.witnesses):
            raise ValueError("a field is of another type")
        if self.ended is not None and not isinstance(self.ended, str):
            raise ValueError("a field is of another type")


def whole_number(value: object) -> int:
    """Return the value if it is a non-negative integer. :raises ValueError: it is not."""
    if type(value) is not int or value < 0:
        raise ValueError("not a whole number: %.80r" % (value,))
    return value


def reported_phase(state: TeamState, robot: Optional[RobotState]) -> Phase:
    """The phase that is reported for a robot of a team. LOST, LEFT and FAILED take precedence, then
    the end of the run, then a pause. A robot that the team does not know (yet) is reported as
    LOST."""
    if robot is None:
        return Phase.LOST
    phase = robot.phase
    if phase.report.outlasts:
        return phase
    if state.ended is not None:
        return phase if state.finished and phase is Phase.INACTIVE else Phase.STOPPED
    if state.paused or robot.paused:
        return Phase.PAUSED
    return Phase.WAITING if phase is Phase.DONE else phase


_FLAGS = ("finished", "fault", "draws_ties", "stopped")
_PLAIN = ("seed", "next_slot", "version", "orders", "created", "paused", "ended")
_ROBOT_PLAIN = ("name", "incarnation", "visit", "attempt", "order", "failures", "paused", "why")


def _robot_to_json(robot: RobotState, net: Net) -> Dict[str, Any]:
    data: Dict[str, Any] = {key: getattr(robot, key) for key in _ROBOT_PLAIN}
    data["place"] = net.places[robot.place].name
    data["phase"] = robot.phase.value
    data["request"] = "" if robot.request == POLICY else net.transitions[robot.request].name
    if robot.stopped:
        data["stopped"] = True
    if robot.data:
        data["data"] = dict(robot.data)
    if robot.task is not None:
        data["task"] = robot.task.to_json()
    if robot.held:
        data["held"] = {net.transitions[t].name: dict(c) for t, c in robot.held.items()}
    if robot.interrupted:
        data["interrupted"] = {net.places[p].name: v for p, v in robot.interrupted.items()}
    if robot.resumed_from:
        data["resumed_from"] = robot.resumed_from
    if robot.drawn is not None:
        drawn = robot.drawn
        data["drawn"] = [
            drawn.version,
            [net.transitions[t].name for t in drawn.candidates],
            net.transitions[drawn.transition].name,
            drawn.slot,
            drawn.index,
        ]
    return data


def _robot_from_json(data: Dict[str, Any], net: Net) -> RobotState:
    robot = RobotState(
        place=net.place_number(data["place"]),
        phase=Phase.of_log(data["phase"]),
        **{key: data[key] for key in _ROBOT_PLAIN},
    )
    robot.stopped = bool(data.get("stopped", False))
    robot.data = check_values(data.get("data", {}), None)
    if "task" in data:
        robot.task = Task.from_json(data["task"])
    robot.held = {net.transition_number(t): dict(c) for t, c in data.get("held", {}).items()}
    robot.interrupted = {
        net.place_number(p): whole_number(v) for p, v in data.get("interrupted", {}).items()
    }
    robot.resumed_from = whole_number(data.get("resumed_from", 0))
    if data["request"]:
        robot.request = net.transition_number(data["request"])
    if "drawn" in data:
        version, candidates, transition, slot, index = data["drawn"]
        robot.drawn = Draw(
            version,
            tuple(net.transition_number(t) for t in candidates),
            net.transition_number(transition),
            slot,
            index,
        )
    return robot
