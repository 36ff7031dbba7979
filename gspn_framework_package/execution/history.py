"""The world of a recorded run, so that another plan can run in the same world.

A plan decides where robots go. The rest is the world: how long each action takes, how it ends, what
it writes, when tasks and orders arrive, which robots are lost, when events occur. This module reads
the world from the log of a run; :mod:`.history_run` plays it to a plan.

Actions are remembered by robot and place, in their order. What comes at a certain time, whatever
the robots do (tasks, orders, losses), is remembered with its time. What can only occur in a certain
state (an event while a robot is in its place, a firing of the environment while its transition is
enabled) is remembered with its *exposure*: for how long it could have occurred before it did.
"""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.attempts import AttemptFollower
from gspn_framework_package.execution.event_log import clock_reading
from gspn_framework_package.execution.log_parts import LogPart, log_parts
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.replayer import Replayed
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import Step, TokenGame, robots_in
from gspn_framework_package.model.attempt import Attempt, EventCount
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

_AT_THEIR_TIME = (
    log_entries.Submit,
    log_entries.TaskDue,
    log_entries.PrioritiseTask,
    log_entries.CancelTask,
    log_entries.GiveBack,
    log_entries.Pause,
    log_entries.Resume,
    log_entries.Join,
    log_entries.Leave,
    log_entries.Evict,
    log_entries.Fire,
)
"""The entries that come at their time, whatever the robots do."""

_LEFT_OUT = (log_entries.Retry, log_entries.SetPlace)
"""Orders that answer what the robots did, and are therefore not given again."""


class RecordedAction(NamedTuple):
    """An attempt at an action: its ``seconds``, whether its end is known (``completed``), the
    ``result`` that it named, the reason if it ``failed``, and the ``data`` that it wrote."""

    seconds: float
    completed: bool
    result: str
    failed: str
    data: Mapping[str, Any]


class RecordedRun(NamedTuple):
    """The world that a run recorded.

    :ivar name: its name.
    :ivar plan: the plan that the team followed.
    :ivar agents: whether it is a standalone run.
    :ivar seed: seed of the policy's draws.
    :ivar began: when it began (seconds since 1970, by the wall clock of the log).
    :ivar seconds: how long it lasted.
    :ivar came: whether it ended by the condition of its plan.
    :ivar roster: (robot, place) at the beginning.
    :ivar resources: resource place -> tokens, if the log begins in the middle of the run.
    :ivar actions: (robot, place) -> the attempts in their order.
    :ivar arrivals: (seconds after the beginning, entry as JSON) of what came at its time.
    :ivar events: (robot, transition) -> the exposures (s) between occurrences of the event, each
        with the data of the event.
    :ivar environment: transition -> the exposures (s) between its firings.
    :ivar firings: transition -> how often it fired.
    :ivar attempts: the attempts, for a fit; ``counts``: the events, for a fit.
    :ivar notes: what a person should know.
    """

    name: str
    plan: Plan
    agents: bool
    seed: int
    began: float
    seconds: float
    came: bool
    roster: Tuple[Tuple[str, str], ...]
    resources: Mapping[str, int]
    actions: Mapping[Tuple[str, str], Sequence[RecordedAction]]
    arrivals: Sequence[Tuple[float, Dict[str, Any]]]
    events: Mapping[Tuple[str, str], Sequence[Tuple[float, Mapping[str, Any]]]]
    environment: Mapping[str, Sequence[float]]
    firings: Mapping[str, int]
    attempts: Sequence[Attempt]
    counts: Mapping[str, EventCount]
    notes: Tuple[str, ...]


def runs_of_logs(paths: Sequence[str]) -> List[Tuple[LogPart, ...]]:
    """The logs of each run: those of a team have the name of their run in common. A log that is
    given twice counts once. Where a team adopted another plan, another run begins.

    :raises LogError: a log cannot be read.
    """
    runs: Dict[Tuple[str, str], Dict[Tuple[str, str], LogPart]] = {}
    for part in (part for path in paths for part in log_parts(path)):
        log = str(part.header["log"])
        run = ("team", str(part.header["run"])) if part.robot else ("", log)
        runs.setdefault(run, {}).setdefault((part.robot, log), part)
    return [tuple(logs.values()) for logs in runs.values()]


def read_run(logs: Sequence[LogPart]) -> RecordedRun:
    """Read a run from its logs: one of a standalone run, or those of the robots of a team.

    :raises LogError: a log cannot be read or is damaged, or no time passes in it.
    """
    team = any(log.robot for log in logs)
    gathered = gather(logs) if team else None
    file = logs[0] if gathered is None else logs[gathered.runs[0][0]]
    reader = _Reader(file)
    for line, record in file.numbered_records():
        try:
            reader.take(record)
        except LogError as error:
            raise error.located(file=file.path, line=line) from None
    return reader.result(None if gathered is None else gathered.attempts)


class _Reader:
    """Reads one log from beginning to end."""

    def __init__(self, file: LogPart) -> None:
        self._file = file
        self._plan = plan = file.plan
        self._agents = bool(file.header.get("agents"))
        self._follower = AttemptFollower(plan, file.robot, agents=self._agents, stage=file.stage)
        game = TokenGame(plan)
        self._submissions = game.submissions
        self._interrupts = {
            p: [t for t in plan.interrupts(plan.net.places[p].name) if _comes_by_chance(plan, t)]
            for p in (plan.net.place_index[name] for name in plan.action_places)
        }
        self._environment = [
            t
            for t in game.environment_transitions
            if plan.simulate_environment and t not in (*game.submissions, *game.clock)
        ]
        self._attempts: List[Attempt] = []
        self._began: Optional[float] = None
        self._ended: Optional[float] = None
        self._wall = 0.0
        self._came = False
        self._seed = plan.seed
        self._roster: List[Tuple[str, str]] = []
        self._resources: Dict[str, int] = {}
        self._arrivals: List[Tuple[float, Dict[str, Any]]] = []
        self._visits: Dict[str, Tuple[Tuple[int, int], int, float]] = {}
        """Robot -> its visit, the place, since when."""
        self._exposed: Dict[Tuple[str, str], float] = {}
        self._events: Dict[Tuple[str, str], List[Tuple[float, Mapping[str, Any]]]] = {}
        self._busy: List[Tuple[int, int]] = []
        self._unfired: Dict[int, float] = dict.fromkeys(self._environment, 0.0)
        self._fired: Dict[str, List[float]] = {}
        self._firings = {t.name: 0 for t in plan.net.transitions}
        self._data: Dict[Tuple[str, int], Mapping[str, Any]] = {}
        self._left_out = 0
        self._last = 0.0

    def take(self, record: Dict[str, Any]) -> None:
        """Process the next record."""
        self._attempts += self._follower.take(record)
        step, now = self._follower.step, self._follower.now
        if step is None or self._ended is not None:
            return
        if self._began is None:
            if not step.state.robots:
                return
            wall = clock_reading(record, "wall")
            self._wall = now if wall is None else wall
            self._begin(step, now)
        assert self._began is not None
        for t, busy in self._busy:
            self._unfired[t] += busy * (now - self._last)
        self._last = now
        for entry in step.entries:
            self._entry(entry, now)
        for firing in step.firings:
            self._firings[firing.transition] += 1
        self._follow(step, now)
        if step.state.ended is not None:
            self._ended = now
            self._came = step.state.finished and step.state.ended.startswith("until:")

    def result(self, attempts: Optional[Sequence[Attempt]]) -> RecordedRun:
        """The world so far; ``attempts``: those of all robots, if this log lacks them."""
        now = self._follower.now if self._ended is None else self._ended
        if self._began is None or now <= self._began:
            raise LogError("contains no run: no time passes in it", file=self._file.path)
        if attempts is None:
            attempts = [*self._attempts, *self._follower.running(self._follower.now)]
        actions: Dict[Tuple[str, str], List[RecordedAction]] = {}
        for a in sorted(attempts, key=lambda a: (a.robot, a.visit, a.attempt)):
            data = {} if a.failed else dict(self._data.get((a.robot, a.visit), {}))
            one = RecordedAction(a.duration, a.completed, a.result, a.failed, data)
            actions.setdefault((a.robot, a.place), []).append(one)
        notes = []
        if self._left_out:
            notes.append(
                "%d orders of the operator (retry, set-place) are not given again" % self._left_out
            )
        return RecordedRun(
            str(self._file.header["run"]),
            self._plan,
            self._agents,
            self._seed,
            self._wall,
            now - self._began,
            self._came,
            tuple(self._roster),
            self._resources,
            actions,
            self._arrivals,
            self._events,
            self._fired,
            self._firings,
            attempts,
            self._follower.events,
            tuple(notes),
        )

    def _begin(self, step: Replayed, now: float) -> None:
        self._began = self._last = now
        start = next((e for e in step.entries if isinstance(e, log_entries.Start)), None)
        net = self._plan.net
        if start is not None:
            self._seed = start.seed
            self._roster = [(name, place) for name, place, _ in start.roster]
            return
        self._seed = step.state.seed
        self._roster = [(r.name, net.places[r.place].name) for r in step.state.active()]
        marking = net.named(step.state.marking)
        self._resources = {p: marking.get(p, 0) for p in self._plan.resource_places}
        self._tasks_that_wait(step.state)
        paused = [r.name for r in step.state.active() if r.paused] + [""] * step.state.paused
        self._arrivals += [(0.0, log_entries.to_json(log_entries.Pause(name))) for name in paused]

    def _tasks_that_wait(self, state: TeamState) -> None:
        """Have the tasks that wait at the beginning arrive at time 0, through the transition that
        leads to their queue."""
        net = self._plan.net
        leads = {p: t for t in self._submissions for p, _ in net.outputs[t]}
        for found in state.tasks():
            t = found.before if found.place is None else leads.get(found.place)
            if t is None:
                continue
            if found.place is not None:
                self._resources[net.places[found.place].name] -= 1
            task = found.task
            entry = log_entries.Submit(
                net.transitions[t].name,
                task.id,
                task.data,
                priority=task.priority,
                since=task.since,
                until=task.until,
                to=task.to,
                at=task.at,
                every=task.every,
            )
            self._arrivals.append((0.0, log_entries.to_json(entry)))

    def _entry(self, entry: log_entries.Entry, now: float) -> None:
        assert self._began is not None
        if isinstance(entry, log_entries.Done):
            if entry.data:
                self._data[entry.robot, entry.visit] = entry.data
        elif isinstance(entry, log_entries.Interrupt):
            known = self._visits.get(entry.robot)
            if known is not None and known[0] == (entry.incarnation, entry.visit):
                self._leave(entry.robot, now)
                self._visits[entry.robot] = (*known[:2], now)
                key = entry.robot, entry.transition
                if key in self._exposed:
                    event = self._exposed.pop(key), dict(entry.cause)
                    self._events.setdefault(key, []).append(event)
        elif isinstance(entry, log_entries.Fire) and self._is_simulated(entry.transition):
            t = self._plan.net.transition_index[entry.transition]
            self._fired.setdefault(entry.transition, []).append(self._unfired[t])
            self._unfired[t] = 0.0
        elif isinstance(entry, log_entries.Fire) and entry.transition in self._plan.clock:
            pass  # the clock runs without an order
        elif isinstance(entry, _LEFT_OUT):
            self._left_out += 1
        elif isinstance(entry, _AT_THEIR_TIME) and not (
            isinstance(entry, log_entries.CancelTask) and entry.late
        ):
            self._arrivals.append((now - self._began, log_entries.to_json(entry)))

    def _is_simulated(self, transition: str) -> bool:
        return self._plan.net.transition_index.get(transition) in self._unfired

    def _follow(self, step: Replayed, now: float) -> None:
        """Follow the visits of robots, and what the environment could do."""
        state = step.state
        if self._interrupts:
            for name in robots_in(state, step.entries, Step(step.firings, list(step.commands))):
                robot = state.robots.get(name)
                visit = None if robot is None else (robot.incarnation, robot.visit)
                known = self._visits.get(name)
                if known is not None and known[0] == visit:
                    continue
                self._leave(name, now)
                self._visits.pop(name, None)
                if robot is not None and visit is not None and not robot.phase.gone:
                    self._visits[name] = visit, robot.place, now
        self._busy = [(t, busy_servers(self._plan.net, state, t)) for t in self._environment]

    def _leave(self, name: str, now: float) -> None:
        """Count the time of a robot's visit for the events that could have occurred in it."""
        known = self._visits.get(name)
        if known is None:
            return
        _, place, since = known
        for transition in self._interrupts.get(place, ()):
            key = name, transition
            self._exposed[key] = self._exposed.get(key, 0.0) + now - since


def _comes_by_chance(plan: Plan, transition: str) -> bool:
    return plan.events[transition].comes_after is None


def busy_servers(net: Net, state: TeamState, t: int) -> int:
    """How many servers of a transition of the environment are busy: none in a pause, and none at
    the end."""
    if state.paused or state.ended is not None or not net.transitions[t].number > 0:
        return 0
    return net.busy_servers(state.marking, t)


def attempts_of(runs: Sequence[RecordedRun]) -> List[Attempt]:
    """The attempts of some runs, numbered as if each had one log."""
    return [a._replace(log=number) for number, run in enumerate(runs) for a in run.attempts]
