"""A run of a plan in virtual time, whose actions, events, tasks and faults a test determines."""

from __future__ import annotations

import heapq
import itertools
import math
import os
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, Union

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_watch import EventWatch, Visit
from gspn_framework_package.execution.firing import (
    Ended,
    Fault,
    StartAction,
)
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.execution.team_state import RobotState
from gspn_framework_package.execution.token_game import Step
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.outcome import FAILURES, Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.testing.coverage import Coverage
from gspn_framework_package.testing.outcomes import Outcomes
from gspn_framework_package.testing.seen import Act, ActionAttempt, FiredAt, Rule, fired_at

STEPS_WITHOUT_TIME = 10_000
"""Number of steps at one moment that counts as a plan running endlessly without time."""


_SHOWN = 20
"""Number of firings listed in the message of a failed check."""


class Scenario:
    """A run of a plan in virtual time.

    First specify actions (:meth:`action`) and which events occur when, then let time pass
    (:meth:`advance`, :meth:`until`, :meth:`until_fired`) and check the results. Actions that the
    test does not specify have the plan's durations and outcomes, drawn with its seed. Events and
    tasks occur only if the test specifies them, except timed events.

    :param plan: the plan, its file or its folder.
    :param robots: number of robots; by default those of the plan.
    :param seed: seed of all random draws; by default that of the plan.
    :param functions: whether the Python functions of the plan are called. Each is called when its
        action begins; the seconds for which it waits (``is_cancelled.wait``) are the time that the
        action takes. It must not sleep in any other way, and is not notified if an event interrupts
        it.
    :param drawn: whether events, tasks and transitions of the environment also occur by themselves,
        at their rates.
    :param agents: whether transitions may create and destroy agents, as in a standalone run.
    :param coverage: records the elements that the run reaches.
    :param log: file for an event log of the run, for ``gspn replay``; :meth:`close` it.
    :raises GspnError: the plan cannot be read, or a function is missing.
    """

    def __init__(
        self,
        plan: Union[Plan, str, os.PathLike[str]],
        *,
        robots: Optional[int] = None,
        seed: Optional[int] = None,
        functions: bool = False,
        drawn: bool = False,
        agents: bool = True,
        coverage: Optional[Coverage] = None,
        log: Optional[str] = None,
    ) -> None:
        plan = plan if isinstance(plan, Plan) else read_plan(os.fspath(plan))
        plan = plan if robots is None else plan.for_robots(robots)
        self._run = _ScriptedRun(self, plan, seed, agents, drawn)
        self.plan = self._run.plan
        self.coverage = coverage
        self.firings: List[FiredAt] = []
        """The firings so far."""
        self.attempts: List[ActionAttempt] = []
        """The attempts at actions that have begun."""
        self.faults: List[str] = []
        """The reported faults, with their robots."""
        self.tasks: Dict[str, str] = {}
        """Task -> its location: "place NAME", "robot NAME", "done", "dropped"; "" while it waits
        outside the net."""
        self._drawn = drawn
        self._rules: List[Tuple[Rule, List[int]]] = []
        self._agenda: List[Tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._task_numbers = itertools.count(1)
        self._watches: Dict[str, EventWatch] = {}
        self._pending: List[log_entries.Interrupt] = []
        self._outcomes = Outcomes(plan, functions)
        self._begun = False
        self._writer = self._run.record_in(log, plan.name, "test") if log is not None else None

    def close(self) -> None:
        """Close the log."""
        if self._writer is not None:
            self._writer.close()

    def __enter__(self) -> Scenario:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()

    # -- actions ---------------------------------------------------------------------------

    def action(
        self,
        place: str,
        *,
        robot: str = "",
        seconds: Union[None, float, Duration] = None,
        result: Optional[str] = None,
        data: Mapping[str, Any] = NOTHING,
        fails: Optional[str] = None,
        act: Optional[Act] = None,
        times: Optional[int] = None,
    ) -> None:
        """Specify the next attempts at the action of a place.

        If several calls match an attempt, the first whose ``times`` are not used up applies; but a
        call for all further attempts replaces an earlier one for the same place and robot.

        :param robot: apply only to this robot.
        :param seconds: the duration: a number (``math.inf`` for an endless action) or a
            distribution; by default that of the plan.
        :param result: the transition that it names, "" for none; by default as in the plan.
        :param data: the data that it writes.
        :param fails: make it fail for this reason ("aborted", "no server", ...). If the plan maps
            that outcome of the action to a transition, the robot asks for it.
        :param act: called when the attempt begins, instead of ``result``, ``data`` and ``fails``:
            returns a result or a pair (result, data), and raises ActionFailed to fail.
        :param times: number of attempts; by default all further ones.
        :raises NetError: there is no such place.
        """
        self.plan.net.place_number(place)
        if fails is not None and fails not in FAILURES:
            raise UsageError(
                "'%s' is not a reason for a failure" % fails,
                hint="choose from: %s" % ", ".join(FAILURES),
            )
        outcome = Outcome(fails) if fails is not None else None
        rule = Rule(place, robot, seconds, result, data, outcome, act)
        self._rules = [
            (other, left)
            for other, left in self._rules
            if times is not None or left[0] >= 0 or other[:2] != rule[:2]
        ]
        self._rules.append((rule, [-1 if times is None else times]))

    # -- events and orders -----------------------------------------------------------------

    def event(
        self,
        transition: str,
        robot: str = "",
        *,
        cause: Mapping[str, Any] = NOTHING,
        at: Optional[float] = None,
    ) -> None:
        """Let an instantaneous event occur.

        :param transition: the transition of the event.
        :param robot: for this robot; by default for each robot.
        :param cause: the data of the event.
        :param at: when (s); by default now.
        :raises UsageError: the plan has no such event for robots.
        """
        self._observe(transition, robot, None, cause, at)

    def holds(
        self,
        transition: str,
        holds: bool = True,
        robot: str = "",
        *,
        cause: Mapping[str, Any] = NOTHING,
        at: Optional[float] = None,
    ) -> None:
        """Set whether the condition of an event holds from now on; parameters as in
        :meth:`event`."""
        self._observe(transition, robot, holds, cause, at)

    def submit(
        self,
        transition: str,
        data: Mapping[str, Any] = NOTHING,
        task: Union[str, int] = "",
        *,
        at: Optional[float] = None,
    ) -> str:
        """Submit a task.

        :param task: its id; by default a new one, which is returned.
        :param at: when (s); by default now.
        :raises UsageError: that transition does not take tasks.
        :raises DataError: the data or the id cannot be stored.
        """
        if transition not in self.plan.submissions:
            raise UsageError("'%s' does not take tasks" % transition)
        name = task if task != "" else "%s-%d" % (transition, next(self._task_numbers))
        self.order(log_entries.make_submit(transition, name, data), at=at)
        return str(name)

    def order(self, entry: log_entries.Entry, *, at: Optional[float] = None) -> None:
        """Append any entry to the log: Pause, Resume, Retry, Fire, SetPlace, Leave, Stop, ...

        :param at: when (s); by default now.
        """
        self._at(at, lambda: self._run.order(entry))

    def lose(self, robot: str, *, at: Optional[float] = None) -> None:
        """Evict a robot as lost."""
        self._at(at, lambda: self._run.order(log_entries.Evict(robot, self._incarnation(robot))))

    def join(self, robot: str, place: str = "", *, at: Optional[float] = None) -> None:
        """Let a robot join in a place, or come back."""

        def join() -> None:
            known = robot in self._run.state.robots
            incarnation = self._incarnation(robot) + 1 if known else 0
            self._run.order(log_entries.Join(robot, incarnation, place))

        self._at(at, join)

    # -- time --------------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """The virtual time (s)."""
        return self._run.now

    def advance(self, seconds: float = 0.0) -> None:
        """Let some seconds pass, or fewer if the run ends."""
        self._until(lambda: False, self.now + seconds)

    def until(self, condition: Union[str, Callable[[], bool]], within: float = 3600.0) -> None:
        """Let time pass until a condition holds.

        :param condition: a condition on the marking, such as ``"Sorted >= 3"``, or a function.
        :param within: maximum number of seconds.
        :raises AssertionError: it does not become true in that time.
        """
        __tracebackhide__ = True
        if isinstance(condition, str):
            parsed = parse_condition(condition, self.plan.net.place_index)
            met, what = lambda: parsed.holds(self._run.state.marking), condition
        else:
            met, what = condition, "the condition"
        if not self._until(met, self.now + within):
            raise self._failure("%s does not become true within %g s" % (what, within))

    def until_fired(self, transition: str, times: int = 1, within: float = 3600.0) -> FiredAt:
        """Let time pass until a transition has fired a number of further times; return the last
        firing.

        :raises AssertionError: it does not within that many seconds.
        """
        __tracebackhide__ = True
        self.plan.net.transition_number(transition)
        wanted = self.count(transition) + times
        if not self._until(lambda: self.count(transition) >= wanted, self.now + within):
            raise self._failure("%s does not fire within %g s" % (transition, within))
        return [f for f in self.firings if f.transition == transition][wanted - 1]

    def to_end(self, within: float = 3600.0) -> Ended:
        """Let time pass until the run ends; returns how.

        :raises AssertionError: it does not end within that many seconds.
        """
        __tracebackhide__ = True
        self._until(lambda: False, self.now + within)
        if self._run.result is None:
            raise self._failure("the run does not end within %g s" % within)
        return self._run.result

    # -- state -----------------------------------------------------------------------------

    @property
    def fired(self) -> List[str]:
        """The transitions that have fired, in order."""
        return [firing.transition for firing in self.firings]

    @property
    def ended(self) -> Optional[Ended]:
        """How the run ended; None while it continues."""
        return self._run.result

    @property
    def marking(self) -> Dict[str, int]:
        """Place -> its tokens, without empty places."""
        return self.plan.net.named(self._run.state.marking, zeros=False)

    def count(self, transition: str) -> int:
        """How often a transition has fired."""
        return sum(firing.transition == transition for firing in self.firings)

    def place(self, robot: str) -> str:
        """The place of a robot. :raises UsageError: it is not in the team."""
        return self.plan.net.places[self._robot(robot).place].name

    def phase(self, robot: str) -> str:
        """The phase of a robot: "doing", "done", "failed", "inactive", "lost" or "left"."""
        return self._robot(robot).phase.name.lower()

    def why(self, robot: str) -> str:
        """Why a robot that is done, or has failed, does not move; "" if it is not waiting."""
        return self._run.game.why_waiting(self._run.state, self._robot(robot))

    def data(self, robot: str = "") -> Dict[str, Any]:
        """The data that a robot may read, by full name; that of the team for ""."""
        state = self._run.state
        return state.data_of(self._robot(robot)) if robot else state.team_data()

    def attempts_in(self, place: str, robot: str = "") -> List[ActionAttempt]:
        """The attempts that have begun in a place."""
        return [a for a in self.attempts if a.place == place and robot in ("", a.robot)]

    @property
    def tasks_done(self) -> List[str]:
        """The tasks that are done, in order of completion."""
        return [m.id for f in self.firings for m in f.tasks if m.target == "done"]

    # -- checks ------------------------------------------------------------------------------------

    def check_fired(self, *transitions: str) -> None:
        """Require that these transitions fired in this order; others may have fired in between.

        :raises AssertionError: they did not fire; the message lists the last firings.
        """
        __tracebackhide__ = True
        rest = iter(self.fired)
        for number, transition in enumerate(transitions):
            if transition not in rest:
                after = " after %s" % ", ".join(transitions[:number]) if number else ""
                raise self._failure("%s did not fire%s" % (transition, after))

    def check_not_fired(self, *transitions: str) -> None:
        """Require that none of these transitions fired. :raises AssertionError: one did."""
        __tracebackhide__ = True
        found = [t for t in transitions if t in self.fired]
        if found:
            raise self._failure("%s fired" % ", ".join(found))

    def check_no_faults(self) -> None:
        """Require that no fault was reported. :raises AssertionError: one was."""
        __tracebackhide__ = True
        if self.faults:
            raise self._failure("a fault: %s" % "; ".join(self.faults))

    def course(self, last: Optional[int] = None) -> str:
        """The firings as text, a line each: all, or the last ones."""
        shown = self.firings if last is None else self.firings[-last:]
        return "\n".join(map(str, shown))

    def _failure(self, text: str) -> AssertionError:
        left = len(self.firings) - _SHOWN
        more = "(%d firings before)\n" % left if left > 0 else ""
        at = ["%s is %s in %s" % (r.name, r.phase.name.lower(), self._name(r)) for r in self._team]
        return AssertionError(
            "%s\n%s%s\nat %g s: %s%s"
            % (
                text,
                more,
                self.course(_SHOWN) or "(nothing fired)",
                self.now,
                "; ".join(at),
                "; the run has ended: %s" % self.ended.reason if self.ended else "",
            )
        )

    # -- internals ---------------------------------------------------------------------------------

    @property
    def _team(self) -> List[RobotState]:
        return self._run.state.active()

    def _name(self, robot: RobotState) -> str:
        return self.plan.net.places[robot.place].name

    def _robot(self, name: str) -> RobotState:
        if not self._begun:
            raise UsageError("the run has not begun", hint="advance(0) begins it")
        robot = self._run.state.robots.get(name)
        if robot is None:
            raise UsageError(
                "there is no robot '%s'" % name,
                hint="there are: %s" % ", ".join(self._run.state.robots),
            )
        return robot

    def _incarnation(self, name: str) -> int:
        return self._robot(name).incarnation

    def _at(self, when: Optional[float], what: Callable[[], None]) -> None:
        if when is not None and when < self.now:
            raise UsageError("%g s is in the past; it is %g s now" % (when, self.now))
        moment = self.now if when is None else when
        heapq.heappush(self._agenda, (moment, next(self._numbers), what))

    def _until(self, met: Callable[[], bool], latest: float) -> bool:
        """Let time pass until ``met``, the end or ``latest``; returns whether ``met``."""
        if not self._begun:
            self._begun = True
            self._run.begin()
        steps, moment = 0, self.now
        while not met():
            if not self._next(latest):
                if self._run.result is None and math.isfinite(latest):
                    self._run.wait_until(latest)
                return met()
            steps = steps + 1 if self.now == moment else 0
            moment = self.now
            if steps > STEPS_WITHOUT_TIME:
                raise self._failure("the plan runs without time at %g s" % moment)
        return True

    def _next(self, latest: float) -> bool:
        """Advance to the next occurrence; return False if there is none until ``latest``."""
        if self._run.result is not None:
            return False
        if self._pending:
            self._run.order(self._pending.pop(0))
            return True
        due = self._agenda[0][0] if self._agenda else math.inf
        if due > latest:
            return self._run.step(latest)
        if not self._run.step(due):
            self._run.wait_until(due)
            heapq.heappop(self._agenda)[2]()
        return True

    def _observe(
        self,
        transition: str,
        robot: str,
        holds: Optional[bool],
        cause: Mapping[str, Any],
        at: Optional[float],
    ) -> None:
        known = [t for p in self.plan.action_places for t in self.plan.interrupts(p)]
        if transition not in known:
            raise UsageError(
                "no event fires '%s'" % transition,
                hint="events of the plan: %s" % ", ".join(known)
                if known
                else "the plan has no events",
            )

        def observe() -> None:
            if robot:
                self._robot(robot)
            for name in [robot] if robot else [r.name for r in self._team]:
                self._watch(name).observe(transition, holds, cause)
                self._look(name)

        self._at(at, observe)

    def _watch(self, name: str) -> EventWatch:
        if name not in self._watches:
            self._watches[name] = EventWatch(self.plan, name)
        return self._watches[name]

    def _look(self, name: str) -> None:
        """Put the events that interrupt a robot now into the log."""
        for event in self._watch(name).due(self._visit(name), self.now):
            self._run.order(event)

    def _visit(self, name: str) -> Optional[Visit]:
        robot = self._run.state.robots.get(name)
        if robot is None or robot.phase.gone:  # a move of another robot may have ended this visit
            return None
        return Visit(self._name(robot), robot.incarnation, robot.visit)

    # -- called by the run -------------------------------------------------------------------------

    def visit_begins(self, name: str) -> None:
        """Watch for events of a visit that begins; called by the run."""
        visit = self._visit(name)
        if visit is None:
            return
        self._pending += self._watch(name).due(visit, self.now)
        self._wake(name, visit)

    def _wake(self, name: str, visit: Visit) -> None:
        when = None if self._drawn else self._watch(name).wake_time(visit)

        def wake() -> None:
            if self._visit(name) == visit:
                self._look(name)
                if self._visit(name) == visit:
                    self._wake(name, visit)

        if when is not None:
            self._at(when, wake)

    def attempt(self, command: StartAction) -> Optional[Tuple[float, log_entries.Entry]]:
        """The duration and end of an attempt, None to use the plan's; called by the run."""
        self.attempts.append(
            ActionAttempt(
                self.now + command.delay,
                command.robot,
                command.place,
                command.visit,
                command.attempt,
                command.data,
                command.resumed_from,
            )
        )
        rule = self._rule(command)
        if rule is None or rule == Rule(*rule[:2], None, None, NOTHING, None, None):
            return self._outcomes.called(command)
        seconds, entry = self._run.drawn(command)
        if rule.seconds is not None:
            seconds = self._run.sample(rule.seconds)
        if rule.act is not None:
            entry = self._outcomes.acted(command, rule.act, self.attempts[-1])
        elif rule.fails is not None:
            entry = self._outcomes.failed(command, rule.fails, "as the test says")
        elif rule.result is not None or rule.data:
            result = rule.result
            if result is None:
                result = entry.result if isinstance(entry, log_entries.Done) else ""
            entry = self._outcomes.done(command, result, rule.data)
        return self._outcomes.in_time(command, seconds, entry)

    def _rule(self, command: StartAction) -> Optional[Rule]:
        for rule, left in self._rules:
            if left[0] and rule.place == command.place and rule.robot in ("", command.robot):
                left[0] -= 1
                return rule
        return None

    def stepped(
        self, entries: Sequence[log_entries.Entry], step: Step, before: Tuple[int, ...]
    ) -> None:
        """Process a step; called by the run."""
        for entry in entries:
            if isinstance(entry, log_entries.Submit):
                self.tasks.setdefault(entry.id, "")
        for firing in step.firings:
            self.firings.append(fired_at(self.now, firing))
            self.tasks.update((move.id, move.target) for move in firing.tasks)
        for command in step.commands:
            if isinstance(command, Fault):
                who = command.robot + ": " if command.robot else ""
                self.faults.append(who + command.message)
        if self.coverage is not None:
            self.coverage.take(step.firings, before, self._run.state)


class _ScriptedRun(VirtualRun):
    """A virtual run that consults its scenario first."""

    def __init__(
        self, owner: Scenario, plan: Plan, seed: Optional[int], agents: bool, drawn: bool
    ) -> None:
        super().__init__(plan, seed=seed, agents=agents, environment=drawn)
        self._owner = owner
        self._draws_events = drawn

    def drawn(self, command: StartAction) -> Tuple[float, log_entries.Entry]:
        """The duration and end of an attempt according to the plan."""
        return super()._attempt(command)

    def sample(self, seconds: Union[float, Duration]) -> float:
        """Draw a time in seconds."""
        return seconds.sample(self._random) if isinstance(seconds, Duration) else float(seconds)

    def _attempt(self, command: StartAction) -> Tuple[float, log_entries.Entry]:
        return self._owner.attempt(command) or self.drawn(command)

    def _follow_visits(self, begun: Sequence[Tuple[RobotState, Tuple[int, int]]]) -> None:
        if self._draws_events:
            super()._follow_visits(begun)
        for robot, _ in begun:
            self._owner.visit_begins(robot.name)

    def _report(
        self, entries: Sequence[log_entries.Entry], step: Step, before: Tuple[int, ...]
    ) -> None:
        self._owner.stepped(entries, step, before)
