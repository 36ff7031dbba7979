"""The host of a replica: connects one robot's replica of the team's log to a carrier, the robot's
actions and its events (thesis 4.3, Algorithm 1). Independent of ROS."""

# In one piece: one thread owns the state that all of it reads and changes

from __future__ import annotations

import itertools
import queue
import threading
import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, TypeVar

from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.actions import TEXT_LIMIT
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.breakpoints import BreakpointFile, Breakpoints
from gspn_framework_package.execution.firing import (
    CancelAction,
    Ended,
    Fault,
    StartAction,
    TaskEnded,
)
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_messages import firing_fields, task_fields
from gspn_framework_package.execution.team_state import StagedPlan
from gspn_framework_package.execution.timed_get import get_within
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.carrier import Carrier
from gspn_framework_package.team.job_runner import AttemptEnd
from gspn_framework_package.team.log_file import OpenLog, open_log
from gspn_framework_package.team.plan_examination import (
    why_not_followed,
    why_refused_in_own_process,
    with_folder,
)
from gspn_framework_package.team.self_report import SelfReport, View
from gspn_framework_package.team.sides import (
    LOOK_AGAIN,
    ActionSide,
    EventListener,
    EventSide,
    Reporter,
)
from gspn_framework_package.team.status_reporter import StatusReporter

AnswerT = TypeVar("AnswerT")

FAREWELL = 2.0
"""Seconds that a host keeps running after the end of the run, so that the others learn of it."""

MOST_AT_ONCE = 64
"""Maximum number of consecutive calls before timers are checked."""

BREAKPOINTS_PERIOD = 0.5
"""Seconds between two checks of the file with the breakpoints."""


class HostOptions(NamedTuple):
    """Options of a host other than its plan and robot."""

    run: str
    """Name of the run."""
    log_file: str
    """Path of the robot's log."""
    place: str = ""
    """The place where a robot that is not in the plan joins the running team."""
    stay: bool = False
    """Whether the host keeps running and answering after the end of the run."""


class ReplicaHost:
    """Executes a plan for one robot, until the run is over.

    One thread, the *worker*, owns all state. Callbacks of the carrier and of the robot's parts only
    put calls into its queue; the worker executes them one by one.

    Create it, :meth:`connect` it to its parts, then :meth:`start` it; if connecting fails,
    :meth:`discard` it.

    :param plan: the checked plan, with the team at the start of the run.
    :param options: see :class:`HostOptions`. :param reporter: prints messages for people.
    :param sources: creates the sources of a plan's events, which report to the listener.
    :raises GspnError: the log or the sources cannot be used.

    :ivar plan: the plan that the robot is following.
    :ivar exit_code: None while the run continues; then 0 if the run completed, and 1 if it was
        stopped or failed or if this host or its replica failed.
    """

    def __init__(
        self,
        plan: Plan,
        robot: str,
        options: HostOptions,
        reporter: Reporter,
        sources: Callable[[Plan, EventListener], EventSide],
    ) -> None:
        self.plan, self.robot, self.run = plan, robot, options.run
        self.exit_code: Optional[int] = None
        self.reason = ""
        self._stay = options.stay
        # a witness votes, but has no token and runs no actions
        self._witness = robot in plan.witness
        self._tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()
        # inputs that the replica takes before the next wait
        self._inputs: List[interface.Input] = []
        self._numbers = itertools.count(1)
        self._answers: Dict[str, Callable[[Any], None]] = {}
        self._wake_at = 0.0
        self._visit = self._begun = (0, 0)
        self._leave_at: Optional[float] = None
        self._breakpoints = BreakpointFile(plan)
        self._look_at = 0.0
        self._running = True
        self._progress: List[int] = []
        self._attempt = 1
        self._reported_visit = 0
        self._gone: Dict[str, Phase] = {}
        self._reported_length = -1
        self._began_with = plan
        self._reporter, self._status_reporter = reporter, StatusReporter(reporter)
        self._make_sources: Callable[[Plan], EventSide] = lambda plan: sources(
            plan, self._listener()
        )
        # before the log is opened: a plan that the sources refuse leaves no log
        self._events = self._make_sources(plan)
        self._log: OpenLog = open_log(options.log_file, plan, options.run, robot)
        self._replica = Replica(
            plan,
            robot,
            options.run,
            self._log.log_id,
            self._log.records,
            place=options.place,
            trusted=self._log.whole,
            damage=self._log.damage,
        )
        self._carrier: Carrier
        self._actions: ActionSide
        self._report: SelfReport
        self._others: Sequence[Callable[[], None]] = ()
        self._on_end: Callable[[str], None] = lambda robot: None
        self._thread = threading.Thread(target=self._work, name="worker", daemon=True)

    def connect(
        self, carrier: Carrier, actions: ActionSide, others: Sequence[Callable[[], None]] = ()
    ) -> None:
        """Give the host its parts; call this once, before :meth:`start`.

        :param carrier: carries the replica's messages.
        :param actions: carries out the robot's actions.
        :param others: further functions to call at the end.
        """
        self._carrier, self._actions, self._others = carrier, actions, others
        self._report = SelfReport(self.robot, self.run, self._replica, actions, carrier.refusals)
        self._events.subscribe()

    def discard(self) -> None:
        """Release the log and the sources of a host that could not be connected."""
        self._events.close()
        self._close_log()

    @property
    def heartbeat(self) -> float:
        """Seconds between two hellos of a robot in a small team."""
        return self._replica.pace.heartbeat

    def _listener(self) -> EventListener:
        """The interface of this host for the sources of events."""
        return EventListener(
            self.enqueue,
            self._from_source,
            lambda transition: self._replica.watches(transition),
            self.warn,
            self._data_of,
        )

    def _from_source(self, given: interface.Input) -> None:
        """Take the report of a source of events."""
        if isinstance(given, interface.TaskCame):
            given = interface.TaskCame(_submitted_now(given.task))
        self._step(given)

    def _data_of(self, robot: str) -> Mapping[str, Any]:
        """The data that a robot ("" for the team) may read now; called on any thread."""
        team = self._replica.ledger.state
        if not robot:
            return team.team_data()
        known = team.robots.get(robot)
        return team.data_of(known) if known is not None else {}

    # -- called from any thread --------------------------------------------------------------------

    def start(self, ended: Callable[[str], None]) -> None:
        """Start the worker.

        :param ended: receives the name of the robot when the host has ended.
        """
        self._on_end = ended
        self._thread.start()
        self._events.start()

    def stop(self) -> None:
        """End soon, without leaving the team; the running action is cancelled."""
        self.enqueue(self._end)

    def join(self, timeout: Optional[float] = None) -> None:
        """Wait up to ``timeout`` seconds until the host has ended; return at once if it was never
        started."""
        if self._thread.ident is not None:
            self._thread.join(timeout)

    def enqueue(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Have the worker call ``function(*arguments)`` soon."""
        self._tasks.put((function, arguments))

    def ask(self, question: Callable[[], AnswerT], timeout: float) -> AnswerT:
        """Call ``question()`` on the worker and return its result.

        :param timeout: seconds to wait for it.
        :raises queue.Empty: the call did not return in time.
        """
        answers: queue.SimpleQueue[AnswerT] = queue.SimpleQueue()

        def look() -> None:
            self._take_inputs()
            answers.put(question())

        self.enqueue(look)
        return get_within(answers, timeout)

    def receive(self, message: interface.Message) -> None:
        """Take a protocol message."""
        self.enqueue(self._step, interface.Received(message))

    def serve(
        self, message: interface.Message, answer: Callable[[interface.Message], None]
    ) -> None:
        """Take a protocol message that expects a reply, which is passed to ``answer``."""
        self.enqueue(self.request, message, answer)

    def knows(self, robot: str) -> bool:
        """Whether the replica accepts messages from another robot."""
        return self._replica.knows(robot)

    def warn(self, text: str) -> None:
        """Print a warning."""
        self.enqueue(self._reporter.warn, text)

    # -- the worker --------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            self._carry_out(self._replica.start(time.monotonic()))
            self._note_team()
            if self._replica.ledger.state.ended is not None:
                self._is_over("was over before this node started")
            while self._running:
                self._turn()
        except Exception as error:
            self.exit_code, self.reason = 1, "%s: %s" % (type(error).__name__, error)
            if isinstance(error, GspnError):
                self._reporter.error(str(error))
            else:
                self._reporter.error("the node failed", traceback=True)
        finally:
            try:
                self._close()
            finally:
                self._on_end(self.robot)

    def _turn(self) -> None:
        now = time.monotonic()
        if now >= self._wake_at:
            self._wake_at = now + 1.0
            self._log.writer.check()
            self._step(interface.Tick())
            self._status_reporter.note_change()
        if now >= self._look_at:
            self._look_at = now + BREAKPOINTS_PERIOD
            self._look_at_breakpoints()
            ledger = self._replica.ledger
            if ledger.game.clock or any(
                found.task.until or found.task.at for found in ledger.state.tasks()
            ):
                self._step(interface.TimeOfDay(int(time.time())))
        if self._leave_at is not None and now >= self._leave_at:
            self._end()
            return
        action_due = self._actions.poll(now)
        if action_due is not None and action_due <= now + LOOK_AGAIN:
            self._status_reporter.note_change()  # the action side waits for something
        self._take_inputs()
        report = self._report
        report_due = self._status_reporter.poll(
            now, self._carrier, self._activity, report.team, report.diagnosis
        )
        due = min(self._wake_at, report_due)
        if action_due is not None:
            due = min(due, action_due)
        timeout = due - time.monotonic()
        for _ in range(MOST_AT_ONCE):
            try:
                function, arguments = get_within(self._tasks, timeout)
            except queue.Empty:
                break
            function(*arguments)
            self._status_reporter.note_change()
            if not self._running:
                break
            timeout = 0.0  # then only calls that are already waiting
        self._take_inputs()

    def _look_at_breakpoints(self) -> None:
        """Read the file with the breakpoints again if it has changed."""
        try:
            if self._breakpoints.changed():
                self._replica.break_at(self._breakpoints.breakpoints)
                self._reporter.warn("stops at: %s" % self._breakpoints.breakpoints.in_words)
        except GspnError as error:
            self._reporter.warn("the breakpoints are unchanged: %s" % error)

    def _end(self) -> None:
        self._running = False

    def _close(self) -> None:
        self._events.close()
        self._actions.close()
        self._carrier.close()
        for close in self._others:
            close()
        self._close_log()

    def _close_log(self) -> None:
        self._log.writer.close_whole()
        self._log.lock.close()

    def _step(self, given: interface.Input) -> None:
        """Queue an input for the replica, which takes all queued inputs in one step."""
        self._inputs.append(given)

    def _take_inputs(self) -> None:
        """Pass the queued inputs to the replica."""
        if not self._inputs:
            return
        inputs, self._inputs = self._inputs, []
        self._carry_out(self._replica.step_all(inputs, time.monotonic()))
        if self._replica.visit != self._visit:
            self._visit = self._replica.visit
            self._events.visit_began()
        self._note_team()

    def _note_team(self) -> None:
        """Report robots that were lost, left or came back, and detect an end of the run that
        arrived in a snapshot."""
        ledger = self._replica.ledger
        if ledger.length == self._reported_length:
            return
        first, self._reported_length = self._reported_length < 0, ledger.length
        gone = {
            robot.name: robot.phase for robot in ledger.state.robots.values() if robot.phase.gone
        }
        if gone != self._gone:
            for name in sorted(set(gone) | set(self._gone)):
                if name != self.robot and gone.get(name) != self._gone.get(name):
                    self._report_gone(name, gone.get(name), first)
            self._gone = gone
        if ledger.state.ended is not None and not first:
            self._is_over("is over")

    def _report_gone(self, name: str, phase: Optional[Phase], long_ago: bool) -> None:
        if phase is None:
            self._reporter.say("%s is back in the team" % name)
        elif phase is Phase.LEFT:
            self._reporter.say("%s has left the team" % name)
        else:
            ledger = self._replica.ledger
            place = ledger.game.net.places[ledger.state.robots[name].place].name
            text = "%s is lost; the team continues without it. Its token was in %s" % (name, place)
            (self._reporter.say if long_ago else self._reporter.warn)(text)

    # -- effects of the replica --------------------------------------------------------------------

    def _carry_out(self, effects: List[interface.Effect]) -> None:
        """Carry out the effects of a step: first write all records at once, before anything leaves
        the process; then send messages and replies, because others wait for them; then let this
        robot act."""
        records: List[interface.Persist] = []
        sends: List[interface.Send] = []
        replies: List[interface.Reply] = []
        reported: List[interface.Fired] = []
        others: List[interface.Effect] = []
        for effect in effects:
            if isinstance(effect, interface.Persist):
                records.append(effect)
            elif isinstance(effect, interface.Send):
                sends.append(effect)
            elif isinstance(effect, interface.Reply):
                replies.append(effect)
            else:
                others.append(effect)
                if isinstance(effect, interface.Fired) and (effect.publish or effect.private):
                    reported.append(effect)
        if records:
            durable = any(e.durable for e in records)
            synced = any(e.synced for e in records)
            self._log.writer.append(*(e.record for e in records), durable=durable, synced=synced)
        if sends:
            self._carrier.send(sends)
        for reply in replies:
            self._reply(reply)
        if reported:
            self._carrier.publish_firings([firing_fields(fired, self.run) for fired in reported])
        for effect in others:
            self._effects[type(effect)](self, effect)

    def _reply(self, effect: interface.Reply) -> None:
        answer = self._answers.pop(effect.request_id, None)
        if answer is not None:
            answer(effect.message)

    def _order_result(self, effect: interface.OrderResult) -> None:
        answer = self._answers.pop(effect.order_id, None)
        if answer is not None:
            answer(effect)

    def _on_fired(self, effect: interface.Fired) -> None:
        for move in effect.firing.moves:
            # a local transition was already reported when it fired; now it is in the agreed log
            if move.robot == self.robot and move.visit > self._reported_visit:
                self._reported_visit = move.visit
                self._status_reporter.say(
                    "%s fires, %s -> %s" % (effect.firing.transition, move.source, move.target)
                )

    def _start_action(self, command: StartAction) -> None:
        again = " again, attempt %d" % command.attempt if command.attempt > 1 else ""
        self._status_reporter.say("does %s%s (visit %d)" % (command.place, again, command.visit))
        self._begun, self._progress, self._attempt = self._replica.visit, [], command.attempt
        self._report.note_start()
        self._actions.start(command, time.monotonic())

    def _cancel_action(self, command: CancelAction) -> None:
        self._actions.cancel()

    def _task_ended(self, ended: TaskEnded) -> None:
        self._carrier.publish_task(task_fields(ended, self.run, time.time()))

    def _fault(self, fault: Fault) -> None:
        if fault.robot in ("", self.robot):
            self._reporter.warn(fault.message)

    # -- plan changes ------------------------------------------------------------------------------

    def _examine(self, effect: interface.Examine) -> None:
        """Find out, on another thread, whether the robot can follow a staged plan. This may take a
        while, during which the host must keep sending heartbeats."""
        self._reporter.say("examines the staged plan '%s'" % effect.plan.name)

        def staged() -> Plan:
            return with_folder(effect.plan, effect.folder, self._began_with)

        def look() -> None:
            why = why_not_followed(staged, self.plan, self._actions, self._make_sources)
            self.enqueue(self._step, interface.Examined(effect.stage, why))

        threading.Thread(target=look, name="examine", daemon=True).start()

    def _plan_changed(self, effect: interface.PlanChanged) -> None:
        """Follow another plan from the next action on; the running action continues.

        :raises GspnError: the robot cannot follow the plan.
        """
        before = self.plan
        plan = self.plan = with_folder(effect.plan, effect.folder, self._began_with)
        self._reporter.say("follows the plan '%s'" % plan.name)
        self._breakpoints.follow(plan)
        if not self._witness:
            self._actions.follow(plan)
        if plan.events != before.events or plan.submissions != before.submissions:
            sources = self._make_sources(plan)
            self._events.close()
            self._events = sources
            sources.subscribe()
            sources.start()

    def _status_changed(self, effect: interface.StatusChanged) -> None:
        """Do nothing: the status reporter says what the robot waits for if it waits long."""

    def _ended(self, effect: Ended) -> None:
        self._end_with("the run is over: %s" % effect.reason, effect.reason, effect.finished)

    def _is_over(self, how: str) -> None:
        """End the host if the log says that the run is over. A host that started late or was behind
        gets no effect that reports the end."""
        state = self._replica.ledger.state
        if self.exit_code is None and state.ended is not None:
            text = "the run '%s' %s: %s" % (self.run, how, state.ended)
            self._end_with(text, state.ended, state.finished)

    def _end_with(self, text: str, reason: str, finished: bool) -> None:
        self.exit_code, self.reason = (0 if finished else 1), reason
        self._actions.cancel()
        (self._reporter.say if finished else self._reporter.warn)(text)
        if not self._stay:
            self._leave_at = time.monotonic() + FAREWELL

    def _halted(self, effect: interface.Halted) -> None:
        self.exit_code, self.reason = 1, effect.reason
        self._reporter.error("halted: %s" % effect.reason)
        self._actions.cancel()
        self._end()

    def _wake(self, effect: interface.WakeAt) -> None:
        self._wake_at = effect.time

    _effects: Dict[type, Callable[[ReplicaHost, Any], None]] = {
        interface.OrderResult: _order_result,
        interface.Fired: _on_fired,
        interface.StatusChanged: _status_changed,
        interface.Examine: _examine,
        interface.PlanChanged: _plan_changed,
        interface.Halted: _halted,
        interface.WakeAt: _wake,
        StartAction: _start_action,
        CancelAction: _cancel_action,
        Fault: _fault,
        TaskEnded: _task_ended,
        Ended: _ended,
    }

    # -- reports of the action side, on the worker thread ------------------------------------------

    def attempt_ended(self, ended: AttemptEnd) -> None:
        """Pass the end of an attempt to the replica. The action's text is shortened to one line,
        because it goes into the log, to all robots and onto screens."""
        if isinstance(ended, interface.AttemptFailed):
            ended = ended._replace(detail=shorten(ended.detail, TEXT_LIMIT))
        elif ended.result and ended.result not in self.plan.net.transition_index:
            result = shorten(ended.result, TEXT_LIMIT) or repr(ended.result[:20])
            ended = ended._replace(result=result)
        self._step(ended)

    def attempt_progress(self, progress: List[int]) -> None:
        """Record the feedback of the running action."""
        self._progress = progress

    # -- queries and orders, on the worker thread --------------------------------------------------

    def view(self) -> View:
        """The robot and the team as this host knows them."""
        return self._report.view()

    def status(self, data: str = "") -> Dict[str, Any]:
        """The host's status, for people and programs, as a JSON object.

        :param data: ``data``: with the data, tasks and held events of the team; ``brief``: with
            these as short texts; "": without.
        """
        return dict(
            self._report.status(data),
            log_file=self._log.writer.path,
            synced_length=self._log.writer.synced_length,
            messages_sent=self._carrier.sent,
            plan=self.plan.hash(),
            began_with=self._began_with.hash(),
            breakpoints=self._breakpoints.breakpoints.to_json(),
        )

    def tasks(self) -> Dict[str, Any]:
        """The tasks of the team; see :meth:`SelfReport.tasks`."""
        return self._report.tasks()

    def adopted(self) -> Optional[StagedPlan]:
        """The plan that the team adopted; None if it still follows its first plan."""
        return self._replica.ledger.state.adopted

    def _activity(self) -> Dict[str, Any]:
        begun = self._begun == self._replica.visit  # otherwise they belong to an earlier place
        attempt, progress = (self._attempt, self._progress) if begun else (1, [])
        return self._report.activity(self.plan.hash(), attempt, progress)

    def breakpoints(self, names: Optional[List[str]]) -> str:
        """The breakpoints of the robot, for people.

        :param names: the places and transitions to set, None to leave them as they are.
        :raises GspnError: they are not in the plan, or cannot be kept in the file.
        """
        if names is not None:
            found = Breakpoints.of_names(names, self.plan)
            self._replica.break_at(found)
            self._breakpoints.write(found)
        return "stops at: %s" % self._breakpoints.breakpoints.in_words

    def request(
        self, message: interface.Message, answer: Callable[[interface.Message], None]
    ) -> None:
        """Pass a peer's protocol message to the replica; ``answer`` receives the reply, once."""
        number = "request %d" % next(self._numbers)
        self._answers[number] = answer
        self._step(interface.Received(message, number))

    def note_order(self, given: interface.OrderGiven) -> None:
        """Record in the log who gave an order; call this before the order."""
        self._report.note_order(given)
        self._step(given)

    def order(self, entry: log_entries.Ordered, answer: Callable[[Any], None]) -> None:
        """Give an operator's order to the replica; ``answer`` receives the ``OrderResult``."""
        number = "order %d" % next(self._numbers)
        self._answers[number] = answer
        if isinstance(entry, log_entries.Submit):
            entry = _submitted_now(entry)
        if isinstance(entry, log_entries.Evict) and entry.forced:
            self._step(interface.ForceEvict(number, entry.robot, entry.by))
        elif isinstance(entry, log_entries.Adopt):
            self._order_adopt(number, entry)
        else:
            self._step(interface.Order(number, entry))

    def _order_adopt(self, number: str, entry: log_entries.Adopt) -> None:
        """Have the staged plan adopted, unless the check refuses it from the team's present
        marking."""
        game, team = self._replica.ledger.game, self._replica.ledger.state
        stage = entry.stage if entry.stage >= 0 or team.staged is None else team.staged.number
        order = interface.Order(number, entry._replace(stage=stage))
        why, new = plan_change.why_not_adopted(team, game.plan, stage)
        if why or new is None or team.staged is None:
            self._step(order)  # answers with the reason
            return
        here = plan_change.begun_here(team, game.plan, new, team.staged.mapping)

        def look() -> None:
            refused = why_refused_in_own_process(here)
            if refused:
                text = "the check refuses the plan from the team's present marking: %s" % refused
                self.enqueue(self._order_result, interface.OrderResult(number, False, text))
            else:
                self.enqueue(self._step, order)

        threading.Thread(target=look, name="check", daemon=True).start()


def _submitted_now(task: log_entries.Submit) -> log_entries.Submit:
    """A task with the time at which it reached this robot."""
    return task._replace(since=int(time.time()))
