"""The execution node of one robot: connects a replica of the team's log to ROS and to the robot's
actions (thesis 4.3, Algorithm 1)."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import queue
import threading
import time
import uuid
from typing import Any, BinaryIO, Callable, Dict, List, Mapping, Optional

import rospy

from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.actions import TEXT_LIMIT
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.breakpoints import (
    BreakpointFile,
    Breakpoints,
    read_names,
)
from gspn_framework_package.execution.event_log import (
    EventLogWriter,
    Record,
    end_is_there,
    header,
    read_log,
)
from gspn_framework_package.execution.firing import CancelAction, Ended, Fault, StartAction
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import told_phase
from gspn_framework_package.execution.told_data import told_of_robot, told_of_team
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan, Synchronisation
from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.ros.action_caller import CONNECT_POLL, ActionCaller, ActionEnded
from gspn_framework_package.ros.action_targets import action_targets
from gspn_framework_package.ros.event_sources import EventSources, Host
from gspn_framework_package.ros.goal_id import GoalIdentity
from gspn_framework_package.ros.job_runner import ActionRunner, JobRunner
from gspn_framework_package.ros.links import ServiceLink, TopicLink
from gspn_framework_package.ros.messages import FIRED_TOPIC, fired_message
from gspn_framework_package.ros.narrator import Diagnosis, Narrator, level_of
from gspn_framework_package.ros.node_services import Answer, NodeServices, View, Worker
from gspn_framework_package.ros.options import NodeOptions
from gspn_framework_package.ros.place_servers import PlaceServers
from gspn_framework_package.ros.plan_examination import (
    jobs_of,
    why_not_followed,
    why_refused,
    with_folder,
)
from gspn_framework_package.ros.transport.eager_publisher import eager_publisher
from gspn_framework_package.team.carrier import firing_fields

FAREWELL = 2.0
"""Seconds that a node keeps running after the end of the run, so that the others hear of it."""
LOCK_TIME = 8.0
"""Seconds to wait for a log that is still locked by a node that is about to end."""


def lock_log(path: str) -> BinaryIO:
    """Lock a log, since two nodes that write to one file would make it unreadable.

    :returns: the file; closing it releases the lock.
    :raises LogError: another process holds the lock, or the file cannot be written.
    """
    deadline = time.monotonic() + LOCK_TIME
    try:
        os.makedirs(os.path.dirname(path), exist_ok=True)
        file = open(path, "ab")  # noqa: SIM115
    except OSError as error:
        raise LogError("cannot be written (%s)" % error.strerror, file=path) from None
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            if time.monotonic() > deadline:
                file.close()
                raise LogError(
                    "another node is writing this log",
                    file=path,
                    hint="a robot has one node in a run: end that one, or give another run",
                ) from None
            time.sleep(0.1)
        except OSError:  # a file system without locks
            return file


BREAKPOINTS_PERIOD = 0.5
"""Seconds between two looks at the file with the breakpoints."""


class ExecutionNode(Worker):
    """Executes a plan for one robot, until the run is over.

    One thread, the *worker*, owns all state: ROS callbacks only put calls into its queue, and the
    worker executes them one by one.

    It publishes ``/fired_transitions`` (gspn_framework_package/FiredTransition). The rest of the
    node's ROS interface is documented in :class:`TopicLink`, :class:`NodeServices`,
    :class:`Narrator`, :class:`PlaceServers`, :class:`ActionCaller` and :class:`EventSources`.

    :param plan: the checked plan, with the team that begins the run.
    :param robot: name of the robot.
    :param namespace: absolute namespace of the robot.
    :param options: see :class:`NodeOptions`.
    :raises GspnError: the log or the actions cannot be used.

    :ivar jobs: the robot's actions that are no action servers, by place.
    :ivar foreign_servers: absolute names of the action servers that the robot needs and this node
        does not serve.
    :ivar exit_code: None while the run goes on; then 0 if the run completed, 1 if it was stopped or
        failed, or this node or its replica failed.
    """

    def __init__(self, plan: Plan, robot: str, namespace: str, options: NodeOptions) -> None:
        self.plan, self.robot, self.namespace, self.options = plan, robot, namespace, options
        self.run = options.run
        self.exit_code: Optional[int] = None
        self.reason = ""
        self._tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._numbers = itertools.count(1)
        self._answers: Dict[str, Callable[[Any], None]] = {}
        self._wake_at = 0.0
        self._visit = (0, 0)
        self._leave_at: Optional[float] = None
        self._breakpoints = BreakpointFile(plan)
        self._look_at = 0.0
        self._running = True
        self._progress: List[int] = []
        self._attempt = 0
        self._told_visit = 0
        self._gone: Dict[str, Phase] = {}
        self._told_length = -1
        self._began_with = plan
        self._narrator = Narrator(robot, namespace, options.run)
        self._fired = eager_publisher(FIRED_TOPIC, FiredTransition)
        witness = robot in plan.witness  # votes, but has no token and runs no actions
        self._events = EventSources(plan, robot, namespace, witness, self._host())
        self._open_log()
        targets = {} if witness else action_targets(plan, robot, namespace)
        serves = options.place_servers and not witness
        self._servers = PlaceServers(plan, robot, namespace) if serves else None
        served = set(self._servers.names) if self._servers else set()
        self.foreign_servers = sorted({t.server for t in targets.values()} - served)
        self._witness = witness
        self.jobs = {} if witness else jobs_of(plan, robot, namespace, options)
        caller = ActionCaller(
            robot,
            targets,
            plan.timeout,
            self.enqueue,
            self._action_ended,
            self._action_progress,
            options.patience,
            options.max_connections,
            self._servers.servers if self._servers and options.direct_actions else None,
            plan.cancel_grace,
            self._narrator.warn,
        )
        runner = JobRunner(
            robot,
            self.jobs,
            plan.timeout,
            self.enqueue,
            self._action_ended,
            options.patience,
            plan.cancel_grace,
            self._narrator.warn,
        )
        self._caller = ActionRunner(caller, runner, self.jobs)
        self._services = NodeServices(self, namespace)
        full = plan.synchronisation is Synchronisation.FULL
        link = TopicLink if full else ServiceLink
        quiet = 3 * self._replica.pace.heartbeat
        self._link = link(
            robot, options.run, namespace, self._received, self._serve_neighbour, quiet
        )
        self._link.serve_at(self._services.uri)
        self._events.subscribe()
        self._told_end: Callable[[str], None] = lambda robot: None
        self._thread = threading.Thread(target=self._work, name="worker", daemon=True)

    def _open_log(self) -> None:
        path = self.options.log_file(self.robot)
        self._lock = lock_log(path)
        log_id, records, whole = uuid.uuid4().hex, [], True
        if os.path.exists(path) and os.path.getsize(path):
            try:
                known = read_log(path)
                log_id, records, whole = (
                    str(known.header["log"]),
                    known.records,
                    end_is_there(known),
                )
            except LogError:
                with open(path, "rb") as file:
                    if b"\n" in file.readline():  # else it was killed while writing the first line
                        raise
        first = header(self.plan, self.options.run, self.robot, log_id)
        self._log = EventLogWriter(path, first, fsync=self.plan.fsync)
        self._replica = Replica(
            self.plan,
            self.robot,
            self.options.run,
            log_id,
            records,
            place=self.options.place,
            trusted=whole,
        )

    def _host(self) -> Host:
        """This node, as the sources of events use it."""
        return Host(
            self.enqueue,
            self._step,
            lambda transition: self._replica.watches(transition),
            lambda text: self.enqueue(self._narrator.warn, text),
            self._data_of,
        )

    def _data_of(self, robot: str) -> Mapping[str, Any]:
        """The data that a robot, or "" the team, may read now; called on any thread."""
        team = self._replica.ledger.state
        if not robot:
            return team.team_data()
        known = team.robots.get(robot)
        return team.data_of(known) if known is not None else {}

    # -- from any thread ---------------------------------------------------------------------------

    def serve(self) -> None:
        """Start the place servers, if this node has them."""
        if self._servers is not None:
            self._servers.start()

    def start(self, ended: Callable[[str], None]) -> None:
        """Start the worker; call :meth:`serve` first.

        :param ended: receives the name of the robot when the node has ended.
        """
        self._told_end = ended
        self._thread.start()
        self._events.start()

    def stop(self) -> None:
        """End soon, without leaving the team; the running action is cancelled."""
        self.enqueue(self._end)

    def join(self, timeout: Optional[float] = None) -> None:
        """Wait until the node has ended, at most ``timeout`` seconds; returns at once if it was
        never started."""
        if self._thread.ident is not None:
            self._thread.join(timeout)

    def enqueue(self, function: Callable[..., Any], *arguments: Any) -> None:
        """See :class:`Worker`."""
        self._tasks.put((function, arguments))

    def ask(self, question: Callable[[], Answer], timeout: float) -> Answer:
        """See :class:`Worker`."""
        answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        self.enqueue(lambda: answers.put(question()))
        return answers.get(timeout=timeout)

    def _received(self, message: interface.Message) -> None:
        self.enqueue(self._step, interface.Received(message))

    def _serve_neighbour(
        self, message: interface.Message, answer: Callable[[interface.Message], None]
    ) -> None:
        self.enqueue(self.request, message, answer)

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
                rospy.logerr("%s: %s", self.robot, error)
            else:
                rospy.logfatal("%s: the node fails", self.robot, exc_info=True)
        finally:
            try:
                self._close()
            finally:
                self._told_end(self.robot)

    def _turn(self) -> None:
        now = time.monotonic()
        if now >= self._wake_at:
            self._wake_at = now + 1.0
            self._step(interface.Tick())
            self._narrator.note_change()
        if now >= self._look_at:
            self._look_at = now + BREAKPOINTS_PERIOD
            self._look_at_breakpoints()
        if self._leave_at is not None and now >= self._leave_at:
            self._end()
            return
        action_due = self._caller.poll(now)
        if action_due is not None and action_due <= now + CONNECT_POLL:
            self._narrator.note_change()  # the action side waits for something
        due = min(self._wake_at, self._narrator.poll(now, self._activity, self._diagnosis))
        if action_due is not None:
            due = min(due, action_due)
        try:
            function, arguments = self._tasks.get(timeout=max(0.0, due - time.monotonic()))
        except queue.Empty:
            return
        function(*arguments)
        self._narrator.note_change()

    def _look_at_breakpoints(self) -> None:
        """Halt at other places and transitions if the file with the breakpoints has changed."""
        try:
            if self._breakpoints.changed():
                self._replica.halt_at(self._breakpoints.breakpoints)
                self._narrator.warn("halts at: %s" % self._breakpoints.breakpoints.told)
        except GspnError as error:
            self._narrator.warn("the breakpoints stay as they were: %s" % error)

    def breakpoints(self, argument: str) -> str:
        """See :class:`Worker`."""
        if argument:
            found = Breakpoints.of_names(read_names(argument), self.plan)
            self._replica.halt_at(found)
            self._breakpoints.write(found)
        return "halts at: %s" % self._breakpoints.breakpoints.told

    def _end(self) -> None:
        self._running = False

    def _close(self) -> None:
        parts: List[Any] = [self._events, self._caller, self._link, self._services, self._log]
        for part in parts:
            # rospy may have closed it already
            with contextlib.suppress(rospy.ROSException, rospy.ServiceException):
                part.close()
        self._lock.close()
        if self._servers is not None:
            self._servers.stop()

    def _step(self, given: interface.Input) -> None:
        self._carry_out(self._replica.step(given, time.monotonic()))
        if self._replica.visit != self._visit:
            self._visit = self._replica.visit
            self._events.visit_began()
        self._note_team()

    def _note_team(self) -> None:
        """Report robots that were lost, have left or are back, and detect the end of the run if it
        came with a snapshot."""
        ledger = self._replica.ledger
        if ledger.length == self._told_length:
            return
        first, self._told_length = self._told_length < 0, ledger.length
        gone = {
            robot.name: robot.phase for robot in ledger.state.robots.values() if robot.phase.gone
        }
        if gone != self._gone:
            for name in sorted(set(gone) | set(self._gone)):
                if name != self.robot and gone.get(name) != self._gone.get(name):
                    self._tell_gone(name, gone.get(name), first)
            self._gone = gone
        if ledger.state.ended is not None and not first:
            self._is_over("is over")

    def _tell_gone(self, name: str, phase: Optional[Phase], long_ago: bool) -> None:
        if phase is None:
            self._narrator.tell("%s is in the team again" % name)
        elif phase is Phase.LEFT:
            self._narrator.tell("%s has left the team" % name)
        else:
            place = self._net.places[self._replica.ledger.state.robots[name].place].name
            text = "%s is lost: the team goes on without it; its token was in %s" % (name, place)
            (self._narrator.tell if long_ago else self._narrator.warn)(text)

    # -- effects of the replica --------------------------------------------------------------------

    def _carry_out(self, effects: List[interface.Effect]) -> None:
        """Carry out effects in order; records are written before any later effect leaves the
        node."""
        records: List[Record] = []
        durable = False
        sends: List[interface.Send] = []
        for effect in effects:
            if isinstance(effect, interface.Persist):
                if sends:
                    self._link.send(sends)
                    sends = []
                records.append(effect.record)
                durable = durable or effect.durable
                continue
            if records:
                self._log.append(*records, durable=durable)
                records, durable = [], False
            if isinstance(effect, interface.Send):
                sends.append(effect)
            else:
                self._effects[type(effect)](self, effect)
        if records:
            self._log.append(*records, durable=durable)
        if sends:
            self._link.send(sends)

    def _reply(self, effect: interface.Reply) -> None:
        answer = self._answers.pop(effect.request_id, None)
        if answer is not None:
            answer(effect.message)

    def _order_result(self, effect: interface.OrderResult) -> None:
        answer = self._answers.pop(effect.order_id, None)
        if answer is not None:
            answer(effect)

    def _on_fired(self, effect: interface.Fired) -> None:
        if effect.publish or effect.private:
            self._fired.publish(fired_message(firing_fields(effect, self.run)))
        for move in effect.firing.moves:
            # a local transition is reported a second time when it is in the agreed log
            if move.robot == self.robot and move.visit > self._told_visit:
                self._told_visit = move.visit
                self._narrator.say(
                    "%s fires, %s -> %s" % (effect.firing.transition, move.source, move.target)
                )

    def _start_action(self, command: StartAction) -> None:
        again = " again, attempt %d" % command.attempt if command.attempt > 1 else ""
        self._narrator.say("does %s%s (visit %d)" % (command.place, again, command.visit))
        self._progress, self._attempt = [], command.attempt
        self._caller.start(command, time.monotonic())

    def _cancel_action(self, command: CancelAction) -> None:
        self._caller.cancel()

    def _fault(self, fault: Fault) -> None:
        if fault.robot in ("", self.robot):
            self._narrator.warn(fault.message)

    # -- another plan ------------------------------------------------------------------------------

    @property
    def _net(self) -> Net:
        """The net of the plan that the team follows, as far as our log goes."""
        return self._replica.ledger.game.net

    def _examine(self, effect: interface.Examine) -> None:
        """Find out whether the robot can follow a staged plan. This may take a while, in which the
        node has to be heard."""
        plan = with_folder(effect.plan, effect.folder, self._began_with)
        self._narrator.tell("looks at the staged plan '%s'" % plan.name)

        def look() -> None:
            try:
                why = why_not_followed(
                    plan,
                    self.plan,
                    self.robot,
                    self.namespace,
                    self.options,
                    self._servers,
                    self._host(),
                )
            except Exception as error:  # whatever it is, the robot cannot follow the plan
                why = "%s: %s" % (type(error).__name__, error)
            self.enqueue(self._step, interface.Examined(effect.stage, why))

        threading.Thread(target=look, name="examine", daemon=True).start()

    def _plan_changed(self, effect: interface.PlanChanged) -> None:
        """Bind later actions as another plan says; what runs goes on.

        :raises GspnError: the robot cannot follow the plan.
        """
        before = self.plan
        plan = self.plan = with_folder(effect.plan, effect.folder, self._began_with)
        self._narrator.tell("follows the plan '%s'" % plan.name)
        if not self._witness:
            if self._servers is not None:
                self._servers.follow(plan)
            own = self._servers.servers if self._servers and self.options.direct_actions else None
            self.jobs = jobs_of(plan, self.robot, self.namespace, self.options)
            targets = action_targets(plan, self.robot, self.namespace)
            self._caller.follow(plan, targets, self.jobs, own)
        if plan.events != before.events or plan.submissions != before.submissions:
            sources = EventSources(plan, self.robot, self.namespace, self._witness, self._host())
            self._events.close()
            self._events = sources
            sources.subscribe()
            sources.start()

    def _status_changed(self, effect: interface.StatusChanged) -> None:
        """Do nothing: the narrator reports what the robot waits for, if it lasts."""

    def _ended(self, effect: Ended) -> None:
        self._end_with("the run is over: %s" % effect.reason, effect.reason, effect.finished)

    def _is_over(self, how: str) -> None:
        """End the node if the run is over according to the log, although no effect reported it
        because this node started late or was behind."""
        state = self._replica.ledger.state
        if self.exit_code is None and state.ended is not None:
            text = "the run '%s' %s: %s" % (self.run, how, state.ended)
            self._end_with(text, state.ended, state.finished)

    def _end_with(self, text: str, reason: str, finished: bool) -> None:
        self.exit_code, self.reason = (0 if finished else 1), reason
        self._caller.cancel()
        (self._narrator.tell if finished else self._narrator.warn)(text)
        if not self.options.stay:
            self._leave_at = time.monotonic() + FAREWELL

    def _halted(self, effect: interface.Halted) -> None:
        self.exit_code, self.reason = 1, effect.reason
        rospy.logerr("%s: halted: %s", self.robot, effect.reason)
        self._caller.cancel()
        self._end()

    def _wake(self, effect: interface.WakeAt) -> None:
        self._wake_at = effect.time

    _effects: Dict[type, Callable[[ExecutionNode, Any], None]] = {
        interface.Reply: _reply,
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
        Ended: _ended,
    }

    # -- reports of the action side ----------------------------------------------------------------

    def _action_ended(self, ended: ActionEnded) -> None:
        """Pass the end of an attempt to the replica. The server's text goes into the log, to all
        robots and onto screens, so it is shortened to one line."""
        attempt = ended.identity[1:4]
        if ended.reason:
            self._step(
                interface.AttemptFailed(*attempt, ended.reason, shorten(ended.detail, TEXT_LIMIT))
            )
        elif not ended.result or ended.result in self.plan.net.transition_index:
            self._step(interface.ActionDone(*attempt, ended.result, ended.data))
        else:
            result = shorten(ended.result, TEXT_LIMIT) or repr(ended.result[:20])
            self._step(interface.ActionDone(*attempt, result, ended.data))

    def _action_progress(self, identity: GoalIdentity, feedback: Any) -> None:
        self._progress = list(getattr(feedback, "time_passed", ()))

    # -- questions (see Worker) --------------------------------------------------------------------

    def view(self) -> View:
        """See :class:`Worker`."""
        ledger, own = self._replica.ledger, self._replica.state
        robot = ledger.state.robots.get(self.robot)
        place, visit, phase = "", 0, told_phase(ledger.state, robot)
        if robot is not None and own.position is not None:
            place, visit = self._net.places[own.position.place].name, own.position.visit
            # there are local transitions that the log does not have yet
            if visit != robot.visit and ledger.state.ended is None:
                phase = Phase.DOING
            if phase is Phase.DOING and own.reported == own.position.goal:
                phase = Phase.DONE  # although this is not in the log yet
        elif robot is not None and not robot.phase.gone:
            place, visit = self._net.places[robot.place].name, robot.visit
        return View(
            place,
            phase.told.state,
            self._replica.incarnation,
            visit,
            self._replica.marking(),
            self._net,
            ledger.length,
            ledger.hash,
        )

    def status(self, data: str = "") -> Dict[str, Any]:
        """See :class:`Worker`."""
        status = dict(
            self._replica.status(), log_file=self._log.path, messages_sent=self._link.sent
        )
        status["plan"] = self.plan.hash()
        state = self._replica.ledger.state
        status.update(
            finished=state.finished, fault=state.fault or self._replica.halted is not None
        )
        status["waits_for"] = self._waits_for()
        status["needs_operator"] = self._needs_operator()
        status["breakpoints"] = self._breakpoints.breakpoints.to_json()
        if data:
            brief = data == "brief"
            status["data"] = told_of_team(state, self._net, brief)
            for robot in status["robots"]:
                told = told_of_robot(state.robots[robot["robot"]], self._net, brief)
                robot.update(told)
        return status

    def request(
        self, message: interface.Message, answer: Callable[[interface.Message], None]
    ) -> None:
        """See :class:`Worker`."""
        number = "request %d" % next(self._numbers)
        self._answers[number] = answer
        self._step(interface.Received(message, number))

    def order(
        self, entry: Optional[log_entries.Entry], force_evict: str, answer: Callable[[Any], None]
    ) -> None:
        """See :class:`Worker`."""
        number = "order %d" % next(self._numbers)
        self._answers[number] = answer
        if entry is None:
            self._step(interface.ForceEvict(number, force_evict))
        elif isinstance(entry, log_entries.Adopt):
            self._order_adopt(number, entry)
        else:
            self._step(interface.Order(number, entry))

    def _order_adopt(self, number: str, entry: log_entries.Adopt) -> None:
        """Have the staged plan adopted, unless the check, from where the team is, refuses it."""
        game, team = self._replica.ledger.game, self._replica.ledger.state
        stage = entry.stage if entry.stage >= 0 or team.staged is None else team.staged.number
        order = interface.Order(number, entry._replace(stage=stage))
        why, new = plan_change.why_not_adopted(team, game.plan, stage)
        if why or new is None or team.staged is None:
            self._step(order)  # which says why not
            return
        here = plan_change.begun_here(team, game.plan, new, team.staged.mapping)

        def look() -> None:
            refused = why_refused(here)
            if refused:
                text = "the check refuses the plan from where the team is: %s" % refused
                self.enqueue(self._order_result, interface.OrderResult(number, False, text))
            else:
                self.enqueue(self._step, order)

        threading.Thread(target=look, name="check", daemon=True).start()

    def _waits_for(self) -> str:
        """What this robot waits for: its action, the team, or its transition; "" if nothing."""
        replica = self._replica
        if replica.ledger.state.ended is not None:
            return ""
        robot = replica.ledger.state.robots.get(self.robot)
        reasons = [self._caller.doing(), replica.waits_for()]
        if robot is not None:
            reasons.append(replica.ledger.game.why_waiting(replica.ledger.state, robot))
        return "; ".join(filter(None, reasons))

    def _needs_operator(self) -> bool:
        """Whether this robot cannot go on without the operator: it was evicted, it has halted, its
        action failed, or too many logs of the team are lost."""
        state = self._replica.ledger.state
        robot = state.robots.get(self.robot)
        if self._replica.halted is not None or self._replica.is_stuck():
            return True
        return robot is not None and state.ended is None and robot.phase.told.needs_operator

    def _activity(self) -> Dict[str, Any]:
        view, state = self.view(), self._replica.ledger.state
        return {
            "robot": self.robot,
            "run": self.run,
            "plan": self.plan.hash(),
            "place": view.place,
            "state": view.robot_state,
            "visit": view.visit,
            "attempt": self._attempt,
            "waits_for": self._waits_for(),
            "needs_operator": self._needs_operator(),
            "feedback": self._progress,
            "ended": state.ended,
            "finished": state.finished,
            "fault": state.fault or self._replica.halted is not None,
        }

    def _diagnosis(self) -> Diagnosis:
        view, waits_for = self.view(), self._waits_for()
        message = "%s in %s" % (view.robot_state, view.place or "no place")
        if waits_for:
            message += ", " + waits_for
        status = self._replica.status()
        if status["ended"] is not None:
            message += ", the run is over: " + status["ended"]
        lost = sorted(
            name for name, phase in self._gone.items() if phase is Phase.LOST and name != self.robot
        )
        if lost:
            message += "; lost: " + ", ".join(lost)
        values = {
            "robot": self.robot,
            "run": self.run,
            "place": view.place,
            "state": view.robot_state,
            "visit": view.visit,
            "log length": view.slot,
            "waits for": waits_for,
            "quorum": status["quorum"],
            "lost robots": ", ".join(lost),
        }
        for robot in status["robots"]:
            if robot["robot"] != self.robot:
                values["last contact with " + robot["robot"]] = robot["last_contact"]
        return level_of(self._needs_operator(), bool(waits_for or lost)), message, values
