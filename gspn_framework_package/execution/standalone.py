"""Standalone execution: a plan runs without ROS, and its agents are threads (thesis 4.1).

The executor is one thread with one queue. Actions run on separate threads, created on demand, which
only put results into the queue. The executor turns the results into entries of a local log, and the
token game determines what follows. Listeners are notified of the phases of the agents (thesis
4.1.2, Figure 4.5); the log alone determines the state.
"""

# In one piece: one thread owns the state that all of it reads and changes

from __future__ import annotations

import contextlib
import heapq
import itertools
import queue
import random
import threading
import time
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.actions import (
    TEXT_LIMIT,
    ActionContext,
    ActionFailed,
    Cancellation,
    error_text,
)
from gspn_framework_package.execution.breakpoints import (
    BreakpointFile,
    Breakpoints,
    RobotBreakpoints,
)
from gspn_framework_package.execution.environment import Environment, next_of_clock
from gspn_framework_package.execution.event_functions import EventFunctions, EventHost
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.event_watch import EventWatch, Visit, asked_anew
from gspn_framework_package.execution.firing import (
    CancelAction,
    Ended,
    Fault,
    Firing,
    GameCommand,
    StartAction,
    TaskEnded,
)
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.local_kinds import (
    ALLOW_IN_STANDALONE_RUN,
    LocalAction,
    load_local_actions,
    refuse_commands,
    refuse_ros,
)
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.timed_get import get_within
from gspn_framework_package.execution.token_game import Step, TokenGame, robots_in
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.model.errors import (
    DataError,
    ExecutionError,
    GspnError,
    InputError,
    RefusedError,
    UsageError,
)
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan

_LOOK_AT_CLOCK = 1.0
"""Seconds after which a run reads the time of day again, since the clock may have been set."""


class Listener:
    """Receives the events of a run; override the methods you need. Unless noted otherwise, they are
    called on the executor's thread and should return quickly."""

    def on_step(
        self,
        slot: int,
        entries: Sequence[log_entries.Entry],
        firings: Sequence[Firing],
        state: TeamState,
    ) -> None:
        """The entries of log slot ``slot`` were reduced and led to these firings and this state."""

    def on_plan(self, plan: Plan) -> None:
        """The run switches to another plan; called before the step that adopts it."""

    def on_phase(self, agent: str, phase: Phase) -> None:
        """An agent entered a phase: FREE, DOING (Occupied), DONE, WAITING, FAILED, INACTIVE, or at
        its end VOID, LEFT or LOST."""

    def on_feedback(self, agent: str, visit: int, progress: Tuple[Any, ...]) -> None:
        """The action of an agent reports its progress (called on the action's thread)."""

    def on_task_ended(self, ended: TaskEnded) -> None:
        """A task was done, cancelled, late or lost."""

    def on_fault(self, agent: str, message: str) -> None:
        """A fault occurred that a person should know about; ``agent`` is "" if the fault concerns
        no agent."""

    def on_end(self, reason: str, finished: bool) -> None:
        """The run is over: it ran to completion (``finished``), or was stopped or failed."""

    def on_broken(self, reason: str) -> None:
        """The run is over because the executor itself, its log or a listener failed."""
        self.on_fault("", reason)
        self.on_end(reason, False)


class _Attempt(NamedTuple):
    """An attempt at an action, with the means to cancel it; ``ended`` is set when its function has
    returned."""

    visit: int
    attempt: int
    cancellation: Cancellation
    ended: threading.Event


_Message = Callable[[], List[log_entries.Entry]]
"""Called on the executor's thread; returns the entries that follow."""


class StandaloneExecutor:
    """Runs a plan on threads, once.

    :param plan: a validated plan whose actions are Python functions, commands or null.
    :param listener: notified of what happens.
    :param event_log: the log that records the run; its creator writes the header.
    :param time_source: returns monotonic seconds.
    :param firing_limit: the run stops after the event that makes the number of firings reach this
        limit. An event may cause several firings, which are not separated, so the limit may be
        exceeded.
    :param allow_commands: whether the plan may run programs.
    :raises PlanError: an action needs ROS; a function is missing or broken.
    :raises RefusedError: an action is a command, and they are not allowed.

    ``start`` returns at once; ``wait`` waits for the end; ``stop`` ends the run at any time,
    without waiting for functions that never return.
    """

    def __init__(
        self,
        plan: Plan,
        listener: Optional[Listener] = None,
        event_log: Optional[EventLogWriter] = None,
        time_source: Callable[[], float] = time.monotonic,
        firing_limit: Optional[int] = None,
        allow_commands: bool = False,
    ) -> None:
        self.plan = plan
        self._firing_limit = firing_limit
        self._fired = 0
        self.game = TokenGame(plan, agents=True)
        self._ledger = Ledger(self.game)
        self.state = self._ledger.state
        """Only for the executor's thread; other threads call :meth:`status`."""
        self.result: Optional[Ended] = None
        """How the run ended; None while it is running."""
        self._listener = listener or Listener()
        self._event_log = event_log
        self._clock = time_source
        if not allow_commands:
            refuse_commands(plan, ALLOW_IN_STANDALONE_RUN)
        self._allow_commands = allow_commands
        self._actions = _load_functions(plan)
        self._prepared: Dict[str, Tuple[Plan, Dict[str, Dict[str, LocalAction]]]] = {}
        """Digest of a plan that is about to be adopted -> the plan and its actions."""
        self._pool = WorkerPool("agent")
        self._queue: queue.SimpleQueue[_Message] = queue.SimpleQueue()
        self._running: Dict[str, _Attempt] = {}
        self.break_at = Breakpoints()
        """The breakpoints of agents; may be replaced at any time."""
        self.breakpoint_file: Optional[BreakpointFile] = None
        """The file with the breakpoints, which is read again when it changes."""
        self._breaks: Dict[str, RobotBreakpoints] = {}
        self._halted: Dict[str, StartAction] = {}
        self._timers: List[Tuple[float, int, _Message]] = []
        self._timer_numbers = itertools.count()
        self._host = EventHost(
            self._event_observed, self._task_came, self._event_failed, self._data_of
        )
        self._functions = EventFunctions(plan, self._host, topics=False)
        self._environment = Environment(
            self.game, random.Random(plan.seed), without=self._functions.tasks
        )
        self._watches: Dict[str, EventWatch] = {}
        """Agent -> its events, if events can interrupt any."""
        self._interrupts = any(plan.interrupts(place) for place in plan.action_places)
        self._watched_visits: Dict[str, Tuple[int, int]] = {}
        self._asked_anew = asked_anew(plan, topics=False)
        self._task_numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._phases: Dict[str, Tuple[Phase, float]] = {}
        self._thread = threading.Thread(target=self._run, name="executor", daemon=True)
        self._crash: Optional[BaseException] = None
        self._over = threading.Event()

    # -- called from other threads -----------------------------------------------------------------

    def start(self) -> None:
        """Start the run. :raises UsageError: it was already started."""
        if self._thread.ident is not None:
            raise UsageError("this run was started before", hint="create a new executor")
        self._thread.start()

    def record_to(self, event_log: EventLogWriter) -> None:
        """Record the run in this log. Call it before :meth:`start`."""
        self._event_log = event_log

    def stop(self, reason: str = "stopped by the operator") -> None:
        """End the run; running actions are asked to cancel."""
        self.order(log_entries.Stop(reason))

    def order(self, entry: log_entries.Entry) -> None:
        """Queue an order of the operator: Pause, Resume, Retry, SetPlace, Fire, Submit, Leave or
        Stop."""
        self._queue.put(
            lambda: [
                self.state.with_again(entry, self.plan.net)
                if isinstance(entry, log_entries.Submit)
                else entry
            ]
        )

    def deploy(
        self,
        plan: Plan,
        mapping: Mapping[str, str] = NOTHING,
        timeout: float = 30.0,
        check: Callable[[Plan], str] = lambda plan: "",
    ) -> None:
        """Switch to another plan without stopping; returns when the run follows it. Running actions
        finish under their old binding (see ``docs/semantics.md``).

        :param plan: a validated plan.
        :param mapping: names of places and transitions of the present net -> their names in
            ``plan``.
        :param timeout: maximum number of seconds to wait.
        :param check: receives the plan with the run's present state as its start; returns why it
            must not run, "" if it may.
        :raises PlanError: an action needs ROS; a function is missing or broken.
        :raises RefusedError: the state of the run does not fit the plan, the check refuses it, an
            action is a command and commands are not allowed, or the run is over. Nothing has
            changed.
        :raises ExecutionError: the executor did not adopt the plan in time, and will not.
        """
        if not self._allow_commands:
            refuse_commands(plan, ALLOW_IN_STANDALONE_RUN)
        actions = _load_functions(plan)
        self._check_from_here(plan, mapping, check)
        entry = plan_change.stage_of(plan, mapping, plan.folder or "")
        answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        taken = threading.Lock()  # removed by the executor, or by this thread when it gives up

        def adopted() -> List[log_entries.Entry]:
            now = self.state.adopted
            answers.put(
                "" if now is not None and now.digest == entry.digest else "the plan was superseded"
            )
            return []

        def message() -> List[log_entries.Entry]:
            if not taken.acquire(blocking=False):
                return []
            why = plan_change.why_not(self.state, self.plan, plan, mapping)
            if why:
                answers.put("; ".join(why))
                return []
            self._prepared[entry.digest] = plan, actions
            self._queue.put(adopted)
            number = self.state.stages + 1
            return [entry, log_entries.Staged("", 0, number), log_entries.Adopt(number)]

        self._queue.put(message)
        deadline = time.monotonic() + timeout
        while True:
            try:
                why = get_within(answers, 0.05)
                break
            except queue.Empty:
                if self.over:
                    why = "the run is over"
                    break
                if time.monotonic() > deadline and taken.acquire(blocking=False):
                    raise ExecutionError("the plan was not adopted within %g s" % timeout) from None
        if why:
            raise RefusedError("the plan was not adopted: %s" % why, file=plan.file)

    def _check_from_here(
        self, plan: Plan, mapping: Mapping[str, str], check: Callable[[Plan], str]
    ) -> None:
        """:raises RefusedError: the check refuses a plan from the run's present marking."""
        with self._lock:
            why = plan_change.why_not(self.state, self.plan, plan, mapping)
            if why:
                raise RefusedError("the plan was not adopted: %s" % "; ".join(why), file=plan.file)
            here = plan_change.begun_here(self.state, self.plan, plan, mapping)
        refused = check(here)
        if refused:
            raise RefusedError(
                "the check refuses the plan from the run's present marking: %s" % refused,
                file=plan.file,
            )

    def submit(
        self, transition: str, data: Mapping[str, Any] = NOTHING, task: Union[str, int] = ""
    ) -> str:
        """Submit a task from outside.

        :param transition: a transition of the environment that takes tasks.
        :param data: the task's data: name -> JSON value.
        :param task: its id; by default a new one. A task whose id was submitted before is refused,
            unless the robot that carries it is gone.
        :returns: the id.
        :raises UsageError: that transition does not take tasks.
        :raises DataError: the data or the id cannot be stored.
        """
        known = self.plan.submissions
        if transition not in known:
            raise UsageError(
                "'%s' does not take tasks" % transition,
                hint="transitions that take tasks: %s" % ", ".join(known)
                if known
                else "the plan has no tasks: give it 'tasks' or 'events'",
            )
        entry = self._with_id(log_entries.make_submit(transition, task, data))
        self.order(entry)
        return entry.id

    @property
    def over(self) -> bool:
        """Whether the run has ended or failed."""
        return self._over.is_set()

    def wait(self, timeout: Optional[float] = None) -> Optional[Ended]:
        """Wait up to ``timeout`` seconds for the end; return how the run ended, None if it has not.

        :raises ExecutionError: the executor itself, its log or a listener failed.
        """
        if self._thread.ident is not None:
            self._thread.join(timeout)
        if self._crash is not None:
            raise ExecutionError(_broke_off(self._crash)) from self._crash
        return self.result

    def status(self) -> Dict[str, Any]:
        """The run as a JSON object: ``marking``; ``agents``, each with its name, place, state,
        visit, the ``seconds`` that it has been in that state, and why it waits; ``slots``, the
        number of log slots; and ``ended``, the reason why the run ended (None while it is
        running)."""
        with self._lock:
            now = self._clock()
            agents = []
            for robot in self.state.active():
                phase, since = self._phases.get(robot.name, (Phase.FREE, now))
                agents.append(
                    {
                        "name": robot.name,
                        "place": self.plan.net.places[robot.place].name,
                        "state": phase.report.agent,
                        "visit": robot.visit,
                        "seconds": round(now - since, 3),
                        "why": self.game.why_waiting(self.state, robot),
                    }
                )
            return {
                "marking": self.plan.net.named(self.state.marking),
                "agents": agents,
                "slots": self.state.next_slot,
                "ended": self.state.ended,
            }

    # -- the executor's thread ---------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._reduce([self.game.start_entry()])
            self._functions.watch_tasks()
            while self.result is None:
                self._reduce(self._next_entries())
        # reported by wait() and the listener, since a thread has no caller to raise to
        except BaseException as error:
            self._crash = error
        finally:
            self._over.set()
            self._functions.close()
            for attempt in self._running.values():
                attempt.cancellation.cancel()
            if self._crash is not None:
                with contextlib.suppress(Exception):  # the listener itself may have failed
                    self._listener.on_broken(_broke_off(self._crash))

    def _next_entries(self) -> List[log_entries.Entry]:
        """Wait for the next message, timer, or transition of the environment."""
        now = self._clock()
        fire_at = self._environment.next_time(self.state, now)
        times = [
            t for t in (self._timers[0][0] if self._timers else None, fire_at) if t is not None
        ]
        clock = next_of_clock(self.game, self.state, time.time())
        if clock is not None:
            times.append(now + min(clock[0], _LOOK_AT_CLOCK))
        timeout = min(times) - now if times else None
        try:
            entries = get_within(self._queue, timeout)()
        except queue.Empty:
            entries = []
        if any(isinstance(entry, log_entries.Adopt) for entry in entries):
            return entries  # in a separate slot, so that a slot concerns one net
        now = self._clock()
        while self._timers and self._timers[0][0] <= now:
            entries += heapq.heappop(self._timers)[2]()
        if clock is not None and not clock[0]:
            return [*entries, clock[1]]
        fired = self._environment.due(self.state, now)
        return entries if fired is None else [*entries, fired]

    def _reduce(self, entries: List[log_entries.Entry]) -> None:
        """Process one log slot: reduce the entries, notify the listener, carry out the commands."""
        if not entries:
            return
        self._look_at_breakpoints()
        for entry in entries:
            if isinstance(entry, log_entries.Done):
                self._set_phase(entry.robot, Phase.DONE)
        with self._lock:
            slot = self._ledger.length
            step = self.game.reduce(self.state, slot, entries)
            if step.adopted:
                self._follow_plan(step.game(self.game))
        if self._event_log is not None:  # recorded before any of its effects leaves the process
            self._record(self._ledger.record(slot, entries, [], step))
        self._report_phases(step)
        self._listener.on_step(slot, entries, step.firings, self.state)
        self._fired += len(step.firings)
        limit = self._firing_limit
        enough = limit is not None and self._fired >= limit and self.state.ended is None
        for command in step.commands:
            if not (enough and isinstance(command, StartAction)):
                self._carry_out(command)
        if self._halted:
            self._release()
        if self._interrupts and self.state.ended is None:
            everyone = self.state.robots if step.adopted else ()
            self._follow_visits({*robots_in(self.state, entries, step), *everyone})
        if enough:
            more = (
                ""
                if self._fired == limit
                else " (%d fired, because an event may cause several)" % self._fired
            )
            self._reduce([log_entries.Stop("the limit of %s firings%s" % (limit, more))])

    def _follow_plan(self, game: TokenGame) -> None:
        """Use another plan for later actions, and watch its events."""
        adopted = self.state.adopted
        assert adopted is not None
        before = self.plan
        self.game = game
        self.plan, self._actions = self._prepared.pop(adopted.digest)
        if (self.plan.events, self.plan.submissions) != (before.events, before.submissions):
            self._functions.close()
            self._functions = EventFunctions(self.plan, self._host, topics=False)
            self._functions.watch_tasks()
            self._watched_visits.clear()
        self._environment = Environment(
            game, random.Random(self.plan.seed), without=self._functions.tasks
        )
        self._interrupts = any(self.plan.interrupts(place) for place in self.plan.action_places)
        self._asked_anew = asked_anew(self.plan, topics=False)
        watches, self._watches = self._watches, {}
        if self._interrupts:
            for agent, watch in watches.items():
                self._watches[agent] = EventWatch(self.plan, agent, self._asked_anew)
                self._watches[agent].go_on_from(watch, adopted.mapping)
                self._functions.watch(agent)
        self._listener.on_plan(self.plan)

    def _record(self, *records: Record) -> None:
        if self._event_log is not None:
            self._event_log.append(*records)

    def _report_phases(self, step: Step) -> None:
        for firing in step.firings:
            for move in firing.moves:
                if move.target is None:
                    self._running.pop(move.robot, None)
                    self._set_phase(move.robot, Phase.VOID)
                else:
                    self._set_phase(move.robot, Phase.FREE)
        for name in self.state.waiting:
            self._set_phase(name, Phase.WAITING)
        for robot in self.state.robots.values():
            if robot.phase not in (Phase.DOING, Phase.DONE):  # already set above
                self._set_phase(robot.name, robot.phase)

    def _set_phase(self, name: str, phase: Phase) -> None:
        known = self._phases.get(name)
        if known is not None and known[0] is phase:
            return
        with self._lock:
            self._phases[name] = (phase, self._clock())
        self._listener.on_phase(name, phase)

    def _carry_out(self, command: GameCommand) -> None:
        if isinstance(command, StartAction):
            if command.attempt == 1:
                self._set_phase(command.robot, Phase.FREE)
            if not self._may_start(command):
                self._halted[command.robot] = command
            elif command.delay > 0:
                self._at(self._clock() + command.delay, lambda: self._start_action(command))
            else:
                self._start_action(command)
        elif isinstance(command, CancelAction):
            self._halted.pop(command.robot, None)
            attempt = self._running.pop(command.robot, None)
            if attempt is not None:
                attempt.cancellation.cancel()
                grace = self._clock() + self.plan.cancel_grace
                self._at(grace, lambda: self._report_deaf(command.robot, attempt))
        elif isinstance(command, Fault):
            self._listener.on_fault(command.robot, command.message)
        elif isinstance(command, TaskEnded):
            self._listener.on_task_ended(command)
        elif isinstance(command, Ended):
            self.result = command
            self._record({"kind": "ended", "reason": command.reason, "finished": command.finished})
            self._over.set()
            self._listener.on_end(command.reason, command.finished)

    # -- breakpoints -------------------------------------------------------------------------------

    def _look_at_breakpoints(self) -> None:
        if self.breakpoint_file is None:
            return
        try:
            self.breakpoint_file.changed()
        except InputError as error:
            self._listener.on_fault("", "the breakpoints are unchanged: %s" % error)
        self.break_at = self.breakpoint_file.breakpoints

    def _may_start(self, command: StartAction) -> bool:
        """Whether an agent may start its action; if a breakpoint holds it, pause the agent."""
        robot = self.state.robots.get(command.robot)
        if robot is None or not (self.break_at.places or command.robot in self._breaks):
            return True
        breaks = self._breaks.setdefault(command.robot, RobotBreakpoints())
        breaks.breakpoints = self.break_at
        visit = (command.incarnation, command.visit)
        answer = breaks.may_start(visit, command.place, command.attempt, robot.paused)
        if answer == "pause":
            self._queue.put(lambda: self._pause(command.robot) if self._is_current(command) else [])
        return answer == "yes"

    def _is_current(self, command: StartAction) -> bool:
        robot = self.state.robots.get(command.robot)
        return (
            robot is not None
            and not robot.phase.gone
            and (robot.visit, robot.attempt) == (command.visit, command.attempt)
        )

    def _pause(self, agent: str) -> List[log_entries.Entry]:
        robot = self.state.robots.get(agent)
        return [log_entries.Pause(agent)] if robot is not None and not robot.paused else []

    def _release(self) -> None:
        """Start the actions of agents that stopped at a breakpoint and were resumed."""
        for agent, command in list(self._halted.items()):
            if not self._is_current(command) or self.state.ended is not None:
                del self._halted[agent]
            elif self.state.is_stopped(self.state.robots[agent]):
                continue  # its next attempt starts on resume
            elif self._may_start(command):
                del self._halted[agent]
                data = self.state.data_of(self.state.robots[agent])
                self._start_action(command._replace(data=data))

    def _at(self, when: float, message: _Message) -> None:
        heapq.heappush(self._timers, (when, next(self._timer_numbers), message))

    def _report_deaf(self, agent: str, attempt: _Attempt) -> List[log_entries.Entry]:
        """Report a cancelled action that does not end."""
        if not attempt.ended.is_set():
            self._listener.on_fault(
                agent,
                "the action of its visit %d was cancelled, but has not ended for %g s"
                % (attempt.visit, self.plan.cancel_grace),
            )
        return []

    # -- events and tasks --------------------------------------------------------------------------

    def _event_observed(
        self, agent: str, transition: str, holds: Optional[bool], cause: Mapping[str, Any]
    ) -> None:
        """Take a report of an event's function (called on its thread)."""
        asked = self._functions.round(agent, transition)

        def message() -> List[log_entries.Entry]:
            watch = self._watches.get(agent)
            if watch is None or asked != self._functions.round(agent, transition):
                return []  # the agent is gone, or has moved
            watch.observe(transition, holds, cause)
            return self._events_of(agent)

        self._queue.put(message)

    def _task_came(self, task: log_entries.Submit) -> None:
        """Take a task from a function (called on its thread)."""
        entry = self._with_id(task)

        def message() -> List[log_entries.Entry]:
            t = self.plan.net.transition_number(entry.transition)
            return [] if self.state.is_known(t, entry.id) else [entry]

        self._queue.put(message)

    def _event_failed(self, agent: str, message: str) -> None:
        """Report that the function of an event failed (called on its thread)."""

        def tell() -> List[log_entries.Entry]:
            self._listener.on_fault(agent, message)
            return []

        self._queue.put(tell)

    def _data_of(self, agent: str) -> Mapping[str, Any]:
        """The data that an agent may read now; that of the team for "" (for any thread)."""
        with self._lock:
            robot = self.state.robots.get(agent)
            return self.state.data_of(robot) if robot is not None else self.state.team_data()

    def _with_id(self, task: log_entries.Submit) -> log_entries.Submit:
        """Give the task an id if it has none (on any thread)."""
        t = self.plan.net.transition_number(task.transition)
        while not task.id:
            new = "%s-%d" % (task.transition, next(self._task_numbers))
            with self._lock:
                if not self.state.is_known(t, new):
                    task = task._replace(id=new)
        return task

    def _follow_visits(self, agents: Collection[str]) -> None:
        """Look for events that interrupt the visits of these agents, which may have begun."""
        for agent in sorted(agents):
            robot = self.state.robots.get(agent)
            if robot is None or robot.phase.gone:
                if self._watches.pop(agent, None) is not None:
                    self._functions.forget(agent)
                    self._watched_visits.pop(agent, None)
                continue
            if agent not in self._watches:
                self._watches[agent] = EventWatch(self.plan, agent, self._asked_anew)
                self._functions.watch(agent)
            if self._watched_visits.get(agent) != (robot.incarnation, robot.visit):
                self._watched_visits[agent] = robot.incarnation, robot.visit
                self._functions.ask_again(agent)
            found = self._events_of(agent)
            self._wake_for(agent)
            if found:  # later, so that an order to stop gets through even if events never cease
                self._queue.put(lambda found=found: found)  # type: ignore[misc]

    def _events_of(self, agent: str) -> List[log_entries.Entry]:
        """The events that interrupt an agent now, and a pause before those with a breakpoint."""
        visit = self._visit(agent)
        if visit is None:
            return []
        found: List[log_entries.Entry] = []
        for event in self._watches[agent].due(visit, self._clock()):
            if event.transition in self.break_at.transitions:
                found += self._pause(agent)
            found.append(event)
        return found

    def _visit(self, agent: str) -> Optional[Visit]:
        robot = self.state.robots.get(agent)
        if robot is None or agent not in self._watches:
            return None
        return Visit(self.plan.net.places[robot.place].name, robot.incarnation, robot.visit)

    def _wake_for(self, agent: str) -> None:
        """Schedule a check of an agent's events for when the next timed event is due."""
        visit = self._visit(agent)
        wake = self._watches[agent].wake_time(visit)
        if wake is None:
            return

        def message() -> List[log_entries.Entry]:
            if self._visit(agent) != visit:
                return []
            found = self._events_of(agent)
            self._wake_for(agent)
            return found

        self._at(wake, message)

    # -- actions -----------------------------------------------------------------------------------

    def _start_action(self, command: StartAction) -> List[log_entries.Entry]:
        robot = self.state.robots.get(command.robot)
        if robot is None or (robot.visit, robot.attempt) != (command.visit, command.attempt):
            return []
        attempt = _Attempt(command.visit, command.attempt, Cancellation(), threading.Event())
        self._running[command.robot] = attempt
        timeout = self.plan.timeout(command.place)
        if timeout is not None:
            self._at(self._clock() + timeout, lambda: self._timed_out(command, timeout))
        self._set_phase(command.robot, Phase.DOING)
        plan, actions = self.plan, self._actions  # another plan may be adopted before it ends
        try:
            self._pool.submit(lambda: self._execute(command, attempt, plan, actions))
        except RuntimeError as error:  # the system cannot create another thread
            entry = command.failed(Outcome.ABORTED, "the action cannot be started: %s" % error)
            self._queue.put(lambda: self._finished(command, attempt, entry))
        return []

    def _execute(
        self,
        command: StartAction,
        attempt: _Attempt,
        plan: Plan,
        actions: Mapping[str, Mapping[str, LocalAction]],
    ) -> None:
        """Run the function and put the outcome into the queue (on a thread of the pool)."""

        def feedback(*progress: Any) -> None:
            self._listener.on_feedback(command.robot, command.visit, progress)

        context = ActionContext.of(command, feedback, attempt.cancellation)
        entry: log_entries.Entry
        try:
            action = actions.get(command.robot) or actions[""]
            result = action[command.place](context)
            entry = log_entries.Done(
                command.robot,
                command.incarnation,
                command.visit,
                plan.transition_meant(command.place, result.transition),
                result.data,
            )
        except (ActionFailed, DataError) as error:
            entry = command.failed(Outcome.ABORTED, error_text(error))
        except BaseException as error:  # anything a user's function raises, even SystemExit
            text = "%s: %s" % (type(error).__name__, error_text(error))
            entry = command.failed(Outcome.ABORTED, text[:TEXT_LIMIT])
        attempt.ended.set()
        self._queue.put(lambda: self._finished(command, attempt, entry))

    def _finished(
        self, command: StartAction, attempt: _Attempt, entry: log_entries.Entry
    ) -> List[log_entries.Entry]:
        if self._running.get(command.robot) is not attempt:
            return []  # timed out or cancelled in the meantime
        del self._running[command.robot]
        if isinstance(entry, log_entries.Done) and self.break_at.stops_result(
            self.plan, command.place, entry.result
        ):
            return [*self._pause(command.robot), entry]
        return [entry]

    def _timed_out(self, command: StartAction, timeout: float) -> List[log_entries.Entry]:
        attempt = self._running.get(command.robot)
        if attempt is None or attempt[:2] != (command.visit, command.attempt):
            return []
        attempt.cancellation.cancel()
        del self._running[command.robot]
        return [command.timed_out(timeout)]


def _broke_off(error: BaseException) -> str:
    what = (
        str(error)
        if isinstance(error, GspnError)
        else "%s: %s" % (type(error).__name__, error_text(error))
    )
    return "the run failed: %s" % what


def _load_functions(plan: Plan) -> Dict[str, Dict[str, LocalAction]]:
    """Load the actions by agent and place; "" stands for agents without their own actions, and for
    agents created later."""
    refuse_ros(
        plan, plan.bindings(), "run the plan with roslaunch, or bind the place to a function"
    )
    own = [r.name for r in plan.robots if r.actions]
    return {name: load_local_actions(plan, name) for name in ["", *own]}
