"""Runs a plan in virtual time: the token game of a real run, with durations drawn instead of waited
for.

:class:`VirtualRun` is the reference for every other simulation and for the analysis: it uses the
token game itself (``token_game``), so its policy draws, priorities, failure rules and time-outs
match those of a real run. Its log is a real event log, whose clocks start at 0.

Events occur at the rates of their transitions, independently for each robot and throughout its
visit, whatever its phase; a timed event (``after``) occurs when its time is over. Tasks arrive at
the rate of their transition while it is enabled, and are cancelled at those of the transitions of
``tasks.on_cancel`` whose events have no source. The plan's sources are not used, so whether an
event counts by level or by edge makes no difference.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> from gspn_framework_package.model.duration import Duration
>>> from gspn_framework_package.model.action import FunctionAction
>>> from gspn_framework_package.model.plan import Plan, RobotSpec
>>> net = (NetBuilder().place("a", 1).place("b").exponential("t", rate=1, inputs="a", outputs="b")
...        .exponential("u", rate=1, inputs="b", outputs="a").build())
>>> act = FunctionAction("actions.work", "work")
>>> plan = Plan(net, actions={"a": act, "b": act}, robots=(RobotSpec("r", "a"),),
...             durations={"a": Duration.deterministic(2.0), "b": Duration.deterministic(3.0)})
>>> result = VirtualRun(plan).run(time=50.0)
>>> result.firings["t"], result.mean_tokens["a"]
(10, 0.4)
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.environment import Environment, next_of_clock
from gspn_framework_package.execution.event_log import Record, header
from gspn_framework_package.execution.firing import CancelAction, Ended, GameCommand, StartAction
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import RobotState
from gspn_framework_package.execution.token_game import Step, TokenGame, robots_in
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import POLICY, PlanTiming

Slowness = Callable[[str, str, float], float]
"""Called with (robot, place, time in seconds) when an attempt starts; returns the factor by which
its duration is multiplied."""


class VirtualResult(NamedTuple):
    """The result of a virtual run, after its warm-up.

    :ivar time: when it ended (s).
    :ivar seconds: how long it was observed (s), without the warm-up.
    :ivar firings: transition -> number of firings.
    :ivar mean_tokens: place -> time-averaged number of tokens.
    :ivar slots: number of log slots.
    :ivar ended: why the run ended; None if the time or the number of firings was reached.
    """

    time: float
    seconds: float
    firings: Dict[str, int]
    mean_tokens: Dict[str, float]
    slots: int
    ended: Optional[Ended]

    def throughput(self, transition: str) -> float:
        """Firings per second of a transition."""
        return self.firings[transition] / self.seconds


class VirtualRun:
    """One run of a plan in virtual time.

    :param plan: a validated plan.
    :param seed: seed of the durations, outcomes and failures, and of the policy; by default that of
        the plan.
    :param agents: whether transitions may create and destroy agents, as in a standalone run.
    :param loss_rate: rate at which each robot is lost, per second.
    :param slowness: makes actions slower, for experiments.
    :param environment: whether to simulate the environment's transitions and the arrival of tasks.
    """

    def __init__(
        self,
        plan: Plan,
        *,
        seed: Optional[int] = None,
        agents: bool = True,
        loss_rate: float = 0.0,
        slowness: Optional[Slowness] = None,
        environment: bool = True,
    ) -> None:
        import numpy as np

        self.plan = plan if seed is None else plan.with_seed(seed)
        self.timing = PlanTiming(plan)
        self.game = TokenGame(self.plan, agents=agents)
        self._ledger = Ledger(self.game)
        self.state = self._ledger.state
        self.now = 0.0
        """The virtual time (s)."""
        self._began_at = 0.0
        """The time of day at which it begins, in seconds since 1970."""
        self.result: Optional[Ended] = None
        """How the run ended; None while it is running."""
        self._random = np.random.Generator(np.random.PCG64(self.plan.seed % 2**64))
        self._environment = Environment(
            self.game,
            random.Random(self.plan.seed),
            without=() if environment else [t.name for t in plan.net.transitions],
            tasks=True,
        )
        self._interrupts = {p: plan.interrupts(p) for p in plan.action_places if plan.events}
        self._visits: Dict[str, Tuple[int, int]] = {}  # robot -> incarnation, visit, with events
        self._latest = math.inf
        self._begun = False
        self._loss_rate = loss_rate
        self._slowness = slowness
        self._log: Optional[EventLogWriter] = None
        self._heap: List[Tuple[float, float, int, Optional[StartAction], log_entries.Entry]] = []
        self._numbers = itertools.count()
        self._running: Dict[str, Tuple[int, int]] = {}  # robot -> visit, attempt
        self._choices: Dict[Tuple[Tuple[int, float], ...], Tuple[List[str], List[float]]] = {}
        self._firings = [0] * len(plan.net.transitions)
        self._tokens = [0.0] * len(plan.net.places)
        self._counted_from = 0.0

    def record_to(self, event_log: EventLogWriter) -> None:
        """Record the run in this log, whose ``clocks`` should be :meth:`clocks`."""
        self._log = event_log

    def record_in(self, path: str, run: str, log_id: str) -> EventLogWriter:
        """Record the run in a new file, which the caller must close.

        :param log_id: a unique id for this log.
        :raises LogError: the file cannot be written.
        """
        agents = self.game.agents
        first = header(self.plan, run, "", log_id, agents=agents, virtual=True)
        self._log = EventLogWriter(path, first, clocks=self.clocks)
        return self._log

    def clocks(self) -> Tuple[float, float]:
        """The virtual time, as the wall clock and as the monotonic clock (s)."""
        return self.now, self.now

    def run(
        self,
        time: float = math.inf,
        *,
        firings: Optional[int] = None,
        warmup: float = 0.0,
        while_running: Optional[Callable[[int], None]] = None,
    ) -> VirtualResult:
        """Run until the plan ends or a limit is reached. Call this once.

        :param time: virtual time at which to stop (s).
        :param firings: stop after the slot in which the number of firings reaches this limit.
        :param warmup: time (s) at the start to exclude from the result.
        :param while_running: called at intervals with the number of slots; may raise to cancel the
            run.
        :raises UsageError: the run would never end, or was run before.
        """
        self._latest = time
        self.begin(warmup)
        left = math.inf if firings is None else firings
        while self.result is None and left > 0:
            before = sum(self._firings) if firings is not None else 0
            if not self.step(time):
                break
            if firings is not None:
                left -= sum(self._firings) - before
            if while_running is not None and self._ledger.length % 1024 == 0:
                while_running(self._ledger.length)
        if self.result is None and math.isfinite(time) and left > 0:
            self.wait_until(time)
        if self._log is not None and self.result is None:
            self._reduce([log_entries.Stop("the end of the simulated time")])
        return self._summary()

    # -- step by step ------------------------------------------------------------------------------

    def begin(self, warmup: float = 0.0) -> None:
        """Start the run, for :meth:`step`.

        :param warmup: see :meth:`run`.
        :raises UsageError: the run was started before.
        """
        if self._begun:
            raise UsageError("this run was started before", hint="create a new one")
        self._begun = True
        self._counted_from = warmup
        if self._ledger.length:
            self._go_on()
        else:
            self._reduce([self.game.start_entry()])
        if self._loss_rate > 0:
            self._schedule_losses()

    def continue_from(self, snapshot: Record, began_at: float = 0.0) -> None:
        """Start at time 0 from the middle of another run of the plan: the robots keep their places,
        and running actions start again. Call this before the run.

        :param snapshot: a ``snapshot`` record.
        :param began_at: the time of day at time 0, in seconds since 1970.
        :raises LogError: it is not a snapshot of this plan.
        """
        self._ledger.restore(snapshot)
        self.state = self._ledger.state
        self._began_at = began_at
        if self._log is not None:
            self._log.append(snapshot)

    def order(self, entry: log_entries.Entry) -> None:
        """Append an entry to the log now, for example an operator's order."""
        if isinstance(entry, log_entries.Submit):
            entry = self.state.with_again(entry, self._ledger.game.net)
        self._reduce([entry])

    def step(self, time: float) -> bool:
        """Advance to the next occurrence; return False if there is none until ``time``."""
        fire_at = self._environment.next_time(self.state, self.now)
        due = self._heap[0][0] if self._heap else math.inf
        clock = next_of_clock(self._ledger.game, self.state, self._began_at + self.now)
        if clock is not None:
            clock_at = self.now + clock[0]
            if clock_at <= due and (fire_at is None or clock_at <= fire_at):
                if clock_at > time:
                    return False
                self.wait_until(clock_at)
                self._reduce([clock[1]])
                return True
        if fire_at is not None and fire_at < due:
            if fire_at > time:
                return False
            self.wait_until(fire_at)
            drawn = self._environment.due(self.state, fire_at)
            if drawn is not None:
                self._reduce([drawn])
            return True
        if due > time or not self._heap:
            return False
        when, _, _, command, entry = heapq.heappop(self._heap)
        if command is not None:
            if self._running.get(command.robot) != (command.visit, command.attempt):
                return True  # cancelled in the meantime
            del self._running[command.robot]
        elif isinstance(entry, log_entries.Interrupt):
            if self._visit(entry.robot) != (entry.incarnation, entry.visit):
                return True  # the visit is over
            self.wait_until(when)
            self._reduce([self._cancels(entry) or entry])
            self._come_again(entry)
            return True
        self.wait_until(when)
        self._reduce([entry])
        return True

    def wait_until(self, when: float) -> None:
        """Advance the time to ``when``, before which nothing happens."""
        seconds = when - max(self.now, self._counted_from)
        if seconds > 0:
            for p, count in enumerate(self.state.marking):
                if count:
                    self._tokens[p] += count * seconds
        self.now = when

    def _reduce(self, entries: List[log_entries.Entry]) -> None:
        slot, before = self._ledger.length, self.state.marking
        step = self.game.reduce(self.state, slot, entries)
        if self._log is not None:
            self._log.append(self._ledger.record(slot, entries, [], step))
        if self.now >= self._counted_from:
            for firing in step.firings:
                self._firings[self.plan.net.transition_index[firing.transition]] += 1
        self._report(entries, step, before)
        for command in step.commands:
            self._carry_out(command)
        if self.plan.events:
            self._follow_visits(self._begun_visits(entries, step))

    def _report(
        self, entries: Sequence[log_entries.Entry], step: Step, before: Tuple[int, ...]
    ) -> None:
        """Hook for subclasses, called after a step; ``before`` is the previous marking."""

    # -- events ------------------------------------------------------------------------------------

    def _visit(self, name: str) -> Optional[Tuple[int, int]]:
        """The present visit of a robot, as (incarnation, number)."""
        robot = self.state.robots.get(name)
        return None if robot is None or robot.phase.gone else (robot.incarnation, robot.visit)

    def _begun_visits(
        self, entries: Sequence[log_entries.Entry], step: Step
    ) -> List[Tuple[RobotState, Tuple[int, int]]]:
        """The visits that began with this step."""
        begun = []
        for name in robots_in(self.state, entries, step):
            visit = self._visit(name)
            if visit is not None and self._visits.get(name) != visit:
                self._visits[name] = visit
                begun.append((self.state.robots[name], visit))
        return begun

    def _follow_visits(self, begun: Sequence[Tuple[RobotState, Tuple[int, int]]]) -> None:
        """Draw the events of visits that have begun. Subclasses may override this."""
        for robot, visit in begun:
            for transition in self._interrupts[self.plan.net.places[robot.place].name]:
                self._draw_event(log_entries.Interrupt(robot.name, *visit, transition))

    def _draw_event(self, event: log_entries.Interrupt) -> None:
        after = self.plan.events[event.transition].comes_after
        if after is not None:
            self._at(self.now + after, event._replace(cause={"after": after}))
            return
        rate = self.plan.net.transition(event.transition).number
        when = self.now + self._random.exponential(1 / rate)
        if when <= self._latest:  # keeps rare events of many visits from filling the memory
            self._at(when, event)

    def _cancels(self, event: log_entries.Interrupt) -> Optional[log_entries.Entry]:
        """The cancellation of a robot's task that an event stands for; None if it stands for
        itself."""
        task = self.state.robots[event.robot].task
        if task is None or not task.id or event.transition not in self.plan.cancellations:
            return None
        return log_entries.CancelTask(task.id)

    def _come_again(self, event: log_entries.Interrupt) -> None:
        """Draw the next event if the last one changed nothing."""
        same = self._visit(event.robot) == (event.incarnation, event.visit)
        if same and self.plan.events[event.transition].comes_after is None:
            self._draw_event(event)

    # -- actions -----------------------------------------------------------------------------------

    def _carry_out(self, command: GameCommand) -> None:
        if isinstance(command, StartAction):
            self._start(command)
        elif isinstance(command, CancelAction):
            self._running.pop(command.robot, None)
        elif isinstance(command, Ended):
            self.result = command
            if self._log is not None:
                self._log.append(
                    {"kind": "ended", "reason": command.reason, "finished": command.finished}
                )

    def _go_on(self) -> None:
        """Start the actions and the events of a team in the middle of a run."""
        state = self.state
        if state.ended is not None:
            self.result = Ended(state.ended, state.finished)
            return
        begun = []
        for robot in state.active():
            visit = robot.incarnation, robot.visit
            self._visits[robot.name] = visit
            begun.append((robot, visit))
            if robot.phase is Phase.DOING:
                place = self.plan.net.places[robot.place].name
                self._start(
                    StartAction(
                        robot.name,
                        place,
                        *visit,
                        robot.attempt,
                        data=state.data_of(robot),
                        resumed_from=robot.resumed_from,
                    )
                )
        if self.plan.events:
            self._follow_visits(begun)

    def _start(self, command: StartAction) -> None:
        seconds, entry = self._attempt(command)
        self._running[command.robot] = command.visit, command.attempt
        if math.isfinite(seconds):
            # those that take no time end in any order
            draw = self._random.random() if seconds == 0 and self.state.draws_ties else 0.0
            self._at(self.now + command.delay + seconds, entry, command, draw)

    def _attempt(self, command: StartAction) -> Tuple[float, log_entries.Entry]:
        """Draw how long an attempt takes (s), and the log entry at its end. Subclasses may override
        this."""
        p = self.plan.net.place_index[command.place]
        timing = self.timing.of(command.robot, p)
        seconds = timing.duration.sample(self._random)
        if self._slowness is not None:
            seconds *= self._slowness(command.robot, command.place, self.now)
        timeout = self.plan.timeout(command.place)
        if timeout is not None and seconds > timeout:
            return timeout, command.timed_out(timeout)
        if timing.failure > 0 and self._random.random() < timing.failure:
            return seconds, command.failed(Outcome.ABORTED, "a simulated failure")
        result = self._outcome(timing.outcomes)
        return seconds, log_entries.Done(command.robot, command.incarnation, command.visit, result)

    def _outcome(self, outcomes: Tuple[Tuple[int, float], ...]) -> str:
        if len(outcomes) < 2:
            return self._result(outcomes[0][0]) if outcomes else ""
        if outcomes not in self._choices:
            self._choices[outcomes] = (
                [self._result(t) for t, _ in outcomes],
                list(itertools.accumulate(chance for _, chance in outcomes)),
            )
        names, levels = self._choices[outcomes]
        number = self._random.random() * levels[-1]
        return next((n for n, level in zip(names, levels) if number < level), names[-1])

    def _result(self, t: int) -> str:
        return "" if t == POLICY else self.plan.net.transitions[t].name

    def _at(
        self,
        when: float,
        entry: log_entries.Entry,
        command: Optional[StartAction] = None,
        draw: float = 0.0,
    ) -> None:
        """Let something happen later; at one time the lowest ``draw`` comes first."""
        heapq.heappush(self._heap, (when, draw, next(self._numbers), command, entry))

    def _schedule_losses(self) -> None:
        for robot in self.state.active():
            when = self._random.exponential(1 / self._loss_rate)
            self._at(when, log_entries.Evict(robot.name, robot.incarnation))

    def _summary(self) -> VirtualResult:
        net = self.plan.net
        seconds = max(self.now - self._counted_from, 0.0)
        return VirtualResult(
            self.now,
            seconds,
            {t.name: n for t, n in zip(net.transitions, self._firings)},
            {
                p.name: total / seconds if seconds else math.nan
                for p, total in zip(net.places, self._tokens)
            },
            self._ledger.length,
            self.result,
        )
