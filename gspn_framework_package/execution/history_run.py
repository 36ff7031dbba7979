"""Plays the world of a recorded run to a plan, in virtual time.

Every robot's next attempt in a place lasts and ends as its next recorded one there; tasks, orders
and losses come at their times; events and firings of the environment come when they could have
occurred for as long as in the recorded run. What the record does not show is drawn from the plan:
attempts beyond the recorded ones, the rest of an attempt that was cut off, and places with another
action.
"""

from __future__ import annotations

import math
import random
from dataclasses import replace
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.environment import Environment
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.history import RecordedAction, RecordedRun, busy_servers
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import RobotState, TeamState
from gspn_framework_package.execution.token_game import Step
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.outcome import FAILURES, Outcome
from gspn_framework_package.model.plan import Plan, RobotSpec

_STEPS_WITHOUT_TIME = 10_000
"""Number of steps at one moment that counts as a plan running endlessly without time."""

_TRIES = 200
"""Number of attempts to draw a time longer than a known one; after them, a drawn time is added to
the known one."""

_MOMENT = 1e-6
"""The resolution of the clocks in a log (s)."""


class PlanNames(NamedTuple):
    """The names of the recorded plan's places and transitions in the plan that is played.

    :ivar mapping: name of a place or transition -> its new name, where they differ.
    :ivar places: action place of the new plan -> the recorded one that has the same action.
    """

    mapping: Mapping[str, str]
    places: Mapping[str, str]

    @classmethod
    def between(cls, old: Plan, new: Plan, mapping: Mapping[str, str]) -> PlanNames:
        """The names, where ``mapping`` says which differ."""
        places = {}
        for place in old.action_places:
            name = mapping.get(place, place)
            if name in new.action_places and old.actions.get(place) == new.actions.get(name):
                places[name] = place
        return cls(mapping, places)

    def new(self, name: str) -> str:
        """The new name."""
        return self.mapping.get(name, name)


class PlayedHistory(NamedTuple):
    """A recorded run, as a plan would have gone through it. Numbers are totals up to the end of
    each window of time.

    :ivar seconds: how long it lasted.
    :ivar firings: firings of each transition.
    :ivar tokens: token-seconds of each place.
    :ivar done: tasks that were done; ``task_seconds``: the time from their arrival to then.
    :ivar late: tasks whose time was over while they waited.
    :ivar refused: what the plan does not know of the record -> how often.
    :ivar stands_still: since when the team would stand still (s), and where; None if it goes on.
    :ivar recorded: attempts played as recorded; ``drawn``: attempts of which at least the rest was
        drawn.
    :ivar ended: why the run ended; "" if it did not.
    """

    seconds: List[float]
    firings: List[List[int]]
    tokens: List[List[float]]
    done: List[int]
    task_seconds: List[float]
    late: int
    refused: Dict[str, int]
    stands_still: Optional[Tuple[float, str]]
    recorded: int
    drawn: int
    ended: str


class HistoryRun(VirtualRun):
    """A run of a plan in the world of a recorded one.

    :param plan: the plan to play.
    :param recorded: the run.
    :param names: how the plan calls what the record names.
    """

    def __init__(self, plan: Plan, recorded: RecordedRun, names: PlanNames) -> None:
        super().__init__(
            _beginning(plan, recorded, names),
            seed=recorded.seed,
            agents=recorded.agents,
            environment=False,
        )
        self._recorded, self._names = recorded, names
        self._began_at = recorded.began
        self._unplayed = {key: iter(actions) for key, actions in recorded.actions.items()}
        self._arrivals = [
            (when, log_entries.from_json(entry)) for when, entry in reversed(recorded.arrivals)
        ]
        self._unseen = {key: iter(events) for key, events in recorded.events.items()}
        self._coming: Dict[str, Dict[str, Tuple[float, Mapping[str, Any]]]] = {}
        """Robot -> event of its visit -> when it comes, and its data."""
        self._postponed: Dict[Tuple[str, str], Tuple[float, Mapping[str, Any]]] = {}
        """(robot, event) -> for how much longer it must be possible, and its data."""
        if self.plan.simulate_environment:
            self._environment = _RecordedEnvironment(self, recorded.environment, names)
        self._arrived: Dict[str, float] = {}
        self._done, self._task_seconds, self._late = 0, 0.0, 0
        self._refused: Dict[str, int] = {}
        self._as_recorded = self._drawn = 0
        self._moved_at = 0.0
        self._circles = False

    def play(self, windows: int, patience: float = 1.0) -> PlayedHistory:
        """Play the run. Call this once.

        :param windows: number of equal parts of its time.
        :param patience: how many times as long it may take, if it ends by a condition.
        """
        end = self._recorded.seconds * patience
        self._latest = end
        self.begin()
        played = PlayedHistory([], [], [], [], [], 0, {}, None, 0, 0, "")
        for number in range(1, windows + 1):
            limit = end * number / windows
            self._go_until(limit)
            finished = self.result is not None and self.result.finished
            played.seconds.append(self.now if finished else limit)
            played.firings.append(list(self._firings))
            played.tokens.append(list(self._tokens))
            played.done.append(self._done)
            played.task_seconds.append(self._task_seconds)
        return played._replace(
            late=self._late,
            refused=self._refused,
            stands_still=self._standstill(),
            recorded=self._as_recorded,
            drawn=self._drawn,
            ended="" if self.result is None else self.result.reason,
        )

    def _go_until(self, limit: float) -> None:
        steps, moment = 0, self.now
        while self.result is None and not self._circles:
            due = self._arrivals[-1][0] if self._arrivals else math.inf
            if not self.step(min(due, limit)):
                if due > limit:
                    break
                self.wait_until(due)
                self._arrive(self._arrivals.pop()[1])
            steps = steps + 1 if self.now == moment else 0
            moment = self.now
            self._circles = steps > _STEPS_WITHOUT_TIME
        if self.now < limit and (self.result is None or not self.result.finished):
            self.wait_until(limit)

    def _standstill(self) -> Optional[Tuple[float, str]]:
        """See :attr:`PlayedHistory.stands_still`; a team that waits for tasks does not stand
        still."""
        state, net = self.state, self.plan.net
        if self._circles:
            return self.now, "transitions fire endlessly without time"
        if self.result is not None:
            if self.result.finished:
                return None
            return self.now, "the run breaks off: %s" % self.result.reason
        if self._running or state.paused:
            return None
        if self._environment.next_time(state, self.now) is not None:
            return None
        if self.plan.submissions and not any(
            found.place is not None or found.before is not None for found in state.tasks()
        ):
            return None
        where = [
            "%s %s in %s"
            % (
                robot.name,
                "has failed" if robot.phase is Phase.FAILED else "waits",
                net.places[robot.place].name,
            )
            for robot in state.active()
            if net.consumers[robot.place]
        ]
        return (self._moved_at, ", ".join(where)) if where else None

    # -- actions -----------------------------------------------------------------------------------

    def _attempt(self, command: StartAction) -> Tuple[float, log_entries.Entry]:
        place = self._names.places.get(command.place)
        action = None
        if place is not None:
            action = next(self._unplayed.get((command.robot, place), iter(())), None)
        if action is None:
            self._drawn += 1
            return super()._attempt(command)
        timeout = self.plan.timeout(command.place)
        if timeout is not None and action.seconds >= timeout - _MOMENT:
            self._as_recorded += 1
            return timeout, command.timed_out(timeout)
        if not action.completed or action.failed == Outcome.TIMEOUT:
            self._drawn += 1
            return self._longer(command, action.seconds)
        self._as_recorded += 1
        return action.seconds, self._end(command, action)

    def _longer(self, command: StartAction, known: float) -> Tuple[float, log_entries.Entry]:
        """An attempt that is only known to have lasted for some seconds."""
        for _ in range(_TRIES):
            seconds, entry = super()._attempt(command)
            if seconds > known:
                return seconds, entry
        return known + seconds, entry

    def _end(self, command: StartAction, action: RecordedAction) -> log_entries.Entry:
        if action.failed:
            known = action.failed in FAILURES
            reason = Outcome(action.failed) if known else Outcome.ABORTED
            return command.failed(reason, "as recorded")
        result = self._names.new(action.result) if action.result else ""
        if result:
            net = self.plan.net
            leaving = net.consumers[net.place_index[command.place]]
            if net.transition_index.get(result) not in leaving:
                self._refuse("%s names %s, which does not leave it" % (command.place, result))
                return command.failed(Outcome.BAD_RESULT, "'%s'" % result)
        robot, incarnation, visit = command.robot, command.incarnation, command.visit
        return log_entries.Done(robot, incarnation, visit, result, action.data)

    # -- what comes at its time --------------------------------------------------------------------

    def _arrive(self, entry: log_entries.Entry) -> None:
        """Let an entry of the record take effect, or note that the plan refuses it."""
        if isinstance(entry, (log_entries.Submit, log_entries.Fire)):
            self._arrive_at_transition(entry)
        elif isinstance(entry, log_entries.CancelTask) and entry.late:
            there = self.state.tasks_with(entry.id)
            self._late += len(there) == 1 and not there[0].robot
            self.order(entry)
        elif isinstance(entry, log_entries.Join):
            known = self.state.robots.get(entry.robot)
            incarnation = 0 if known is None else known.incarnation + 1
            place = self._names.new(entry.place)
            if known is None and place not in self.plan.action_places:
                self._refuse("a robot joins in %s, which is not an action place" % place)
                return
            self.order(entry._replace(incarnation=incarnation, place=place))
        elif isinstance(entry, log_entries.Evict):
            known = self.state.robots.get(entry.robot)
            if known is not None:
                self.order(entry._replace(incarnation=known.incarnation))
        else:
            self.order(entry)

    def _arrive_at_transition(self, entry: Union[log_entries.Submit, log_entries.Fire]) -> None:
        name = self._names.new(entry.transition)
        net = self.plan.net
        t = net.transition_index.get(name)
        if isinstance(entry, log_entries.Fire):
            if t is None or not net.is_enabled(self.state.marking, t):
                why = "the plan does not have it" if t is None else "is not enabled"
                self._refuse("%s is fired, and %s" % (name, why))
                return
        elif t is None or name not in self.plan.submissions:
            self._refuse("a task comes through %s, which takes no tasks" % name)
            return
        else:
            self._arrived[entry.id] = self.now
            if entry.until:
                when = max(entry.until - self._recorded.began, self.now)
                late = when, log_entries.CancelTask(entry.id, late=True)
                self._arrivals.append(late)
                self._arrivals.sort(key=lambda one: -one[0])
        self.order(entry._replace(transition=name))

    def _refuse(self, what: str) -> None:
        self._refused[what] = self._refused.get(what, 0) + 1

    def _report(
        self, entries: Sequence[log_entries.Entry], step: Step, before: Tuple[int, ...]
    ) -> None:
        if step.firings:
            self._moved_at = self.now
        for firing in step.firings:
            for move in firing.tasks:
                if move.target == "done":
                    self._done += 1
                    self._task_seconds += self.now - self._arrived.get(move.id, self.now)

    # -- events ------------------------------------------------------------------------------------

    def _follow_visits(self, begun: Sequence[Tuple[RobotState, Tuple[int, int]]]) -> None:
        for robot, _ in begun:
            for transition, (when, cause) in self._coming.pop(robot.name, {}).items():
                if when > self.now:
                    self._postponed[robot.name, transition] = when - self.now, cause
        super()._follow_visits(begun)

    def _draw_event(self, event: log_entries.Interrupt) -> None:
        if self.plan.events[event.transition].comes_after is not None:
            super()._draw_event(event)
            return
        key = event.robot, event.transition
        left = self._postponed.pop(key, None)
        if left is None:
            left = next(self._unseen.get(key, iter(())), None)
        if left is None:
            rate = self.plan.net.transition(event.transition).number
            left = self._random.exponential(1 / rate), log_entries.NOTHING
        when, cause = self.now + left[0], left[1]
        self._coming.setdefault(event.robot, {})[event.transition] = when, cause
        if when <= self._latest:
            self._at(when, event._replace(cause=cause))


class _RecordedEnvironment(Environment):
    """An environment whose transitions fire after the recorded exposures."""

    def __init__(
        self, run: HistoryRun, recorded: Mapping[str, Sequence[float]], names: PlanNames
    ) -> None:
        super().__init__(run.game, random.Random(run.plan.seed))
        self._transitions = [t for t in self._transitions if t not in run.game.submissions]
        net = run.plan.net
        exposed = {names.new(name): iter(exposures) for name, exposures in recorded.items()}
        self._exposures = {
            t: exposed.get(net.transitions[t].name, iter(())) for t in self._transitions
        }
        self._left = {t: self._next(t) for t in self._transitions}
        self._busy: Dict[int, int] = {}
        self._since = 0.0
        self._state: Optional[Tuple[int, bool]] = None

    def _next(self, t: int) -> float:
        rate = self._game.net.transitions[t].number
        drawn = self._source.expovariate(rate) if rate > 0 else math.inf
        return next(self._exposures[t], drawn)

    def _advance(self, now: float) -> None:
        for t, busy in self._busy.items():
            self._left[t] = max(self._left[t] - busy * (now - self._since), 0.0)
        self._since = now

    def next_time(self, state: TeamState, now: float) -> Optional[float]:
        """See the base class."""
        if self._state != (state.version, state.paused):
            self._advance(now)
            self._state = state.version, state.paused
            busy = [(t, busy_servers(self._game.net, state, t)) for t in self._transitions]
            self._busy = {t: servers for t, servers in busy if servers}
            waits = [self._left[t] / servers for t, servers in self._busy.items()]
            self._time = now + min(waits) if waits else None
        return None if state.ended is not None else self._time

    def due(
        self, state: TeamState, now: float
    ) -> Optional[Union[log_entries.Fire, log_entries.Submit]]:
        """See the base class."""
        time = self.next_time(state, now)
        if time is None or now < time:
            return None
        self._advance(now)
        t = min(self._busy, key=lambda t: self._left[t] / self._busy[t])
        self._left[t] = self._next(t)
        self._state = None
        return log_entries.Fire(self._game.net.transitions[t].name)


def _beginning(plan: Plan, recorded: RecordedRun, names: PlanNames) -> Plan:
    """The plan with the robots of the record, in their places where the plan has these."""
    known = {robot.name: robot for robot in plan.robots}
    robots = []
    for name, old in recorded.roster:
        place = names.new(old)
        own = known.get(name)
        if place not in plan.action_places:
            place = (own or plan.robots[0]).place
        robots.append(own._replace(place=place) if own else RobotSpec(name, place))
    team = plan.with_robots(robots)
    resources = {names.new(place): count for place, count in recorded.resources.items()}
    kept = {place: n for place, n in resources.items() if place in plan.resource_places}
    if not kept:
        return team
    marking = {**team.net.named(team.net.initial_marking), **kept}
    return replace(team, net=team.net.with_marking(marking))
