"""Action client: sends goals and puts a deadline on every step."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections import OrderedDict, deque
from functools import partial
from typing import Any, Callable, Deque, Dict, Mapping, NamedTuple, Optional, Set, Tuple, Union

import genpy
import rospy

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.model.errors import DataError, PlanError
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.action_connection import ActionConnection
from gspn_framework_package.ros.action_targets import ActionTarget
from gspn_framework_package.ros.direct_connection import DirectConnection
from gspn_framework_package.ros.goal_data import goal_text
from gspn_framework_package.ros.goal_id import GoalIdentity, new_tag
from gspn_framework_package.ros.goal_state import GoalNews, GoalState
from gspn_framework_package.ros.place_servers import PlaceServer
from gspn_framework_package.ros.ros_clock import ROS_CLOCK
from gspn_framework_package.ros.transport.registration import (
    MASTER_ERRORS,
    published_topics,
    registered_together,
)
from gspn_framework_package.team.clock import Clock
from gspn_framework_package.team.patience import DEFAULT_PATIENCE, Patience, earliest
from gspn_framework_package.team.sides import LOOK_AGAIN

_AnyConnection = Union[ActionConnection, DirectConnection]

LOOK_AT_TYPE = 1.0
"""Seconds after which the type of an unconnected server is checked."""

MISSED = 2.5
"""Number of periods without a status after which a server counts as silent."""

MOST_GIVEN_UP = 20
"""Number of the latest abandoned goals whose late results are reported."""


class ActionEnded(NamedTuple):
    """How an attempt ended. If it succeeded, ``result`` is a transition, or "" to let the policy
    decide."""

    identity: GoalIdentity
    result: str = ""
    outcome: Outcome = Outcome.SUCCEEDED
    detail: str = ""
    data: Mapping[str, Any] = NOTHING
    """The data that the action wrote: name -> value."""


class _Abandoned(NamedTuple):
    """A goal that was cancelled; at ``report_at`` (monotonic seconds) it should have ended."""

    goal_id: str
    target: ActionTarget
    connection: _AnyConnection
    report_at: float


class _Goal:
    """A goal, and the deadlines of its current state, in monotonic seconds unless the caller's
    clock is named."""

    def __init__(
        self, identity: GoalIdentity, target: ActionTarget, command: StartAction, start_at: float
    ) -> None:
        self.identity, self.target, self.command = identity, target, command
        self.id = str(identity)
        self.state = GoalState.DELAYED
        self.start_at = start_at
        """When its attempt begins, on the caller's clock."""
        self.connect_by = self.look_at_type = 0.0
        self.connection: Optional[_AnyConnection] = None
        """The connection over which it was sent; None before that."""
        self.message: Optional[genpy.Message] = None
        """The goal message that was sent; None before that."""
        self.text = ""
        """The text that was sent with it; see ``ros.goal_data``."""
        self.sent_at = 0.0
        self.cut_off_at: Optional[float] = None
        """When the action times out, on the caller's clock; None for never."""
        self.acknowledged_by = ""
        """Caller id of the server that acknowledged it."""
        self.ended: Optional[Tuple[Outcome, str]] = None
        """(Outcome, text) as the server reported it; None if it has not."""
        self.result_by = 0.0

    def become(self, state: GoalState) -> None:
        """Enter a state. :raises IllegalTransitionError: it cannot follow the current one."""
        self.state = self.state.then(state)

    @property
    def waits_for(self) -> str:
        """What the goal waits for, in words; "" while its action runs."""
        if self.state is GoalState.DELAYED:
            return "waits before attempt %d" % self.identity.attempt
        if self.state is GoalState.CONNECTING:
            return "waits for the action server %s" % self.target.server
        if self.state is GoalState.SENT:
            return "waits for %s to accept the goal" % self.target.server
        return ""


class ActionCaller:
    """Action client of one robot: sends goals, one at a time, and puts a deadline on every step.
    All methods belong to the node's worker thread.

    Goals for servers in its own process go to them directly. Other servers are connected when their
    place is first needed; the remaining ones follow in the background. Connections are kept; when
    there are more than ``limit``, the least recently used are closed. A separate thread calls the
    master, because without a master rospy's registrations block until it is back.

    :param targets: its actions by place.
    :param timeout: place -> seconds that its action may take, or None.
    :param enqueue: has the worker thread call ``function(*arguments)`` soon.
    :param ended: called once when an attempt ends.
    :param feedback: receives (identity, feedback message) while an action runs.
    :param patience: how long each step may take.
    :param limit: maximum number of open connections to servers in other processes.
    :param own_servers: the servers in this process that receive goals directly, by their absolute
      names.
    :param cancel_grace: seconds that a server has to end a cancelled goal.
    :param fault: receives the text of a fault: a server did not end its goal in that time, or sent
        a result for an abandoned goal, or time went back.
    :param clock: the clock that the plan's times refer to.
    """

    def __init__(
        self,
        robot: str,
        targets: Mapping[str, ActionTarget],
        timeout: Callable[[str], Optional[float]],
        enqueue: Callable[..., None],
        ended: Callable[[ActionEnded], None],
        feedback: Callable[[GoalIdentity, genpy.Message], None] = lambda identity, message: None,
        patience: Patience = DEFAULT_PATIENCE,
        limit: int = 32,
        own_servers: Optional[Mapping[str, PlaceServer]] = None,
        cancel_grace: float = Plan.cancel_grace,
        fault: Callable[[str], None] = lambda text: None,
        clock: Clock = ROS_CLOCK,
    ) -> None:
        self.robot, self._clock = robot, clock
        self.tag = new_tag()
        self._targets, self._timeout = targets, timeout
        self._enqueue, self._ended, self._feedback = enqueue, ended, feedback
        self._patience = patience
        self._limit = max(1, limit)
        self._cancel_grace, self._fault = cancel_grace, fault
        self._goal: Optional[_Goal] = None
        self._abandoned: Deque[_Abandoned] = deque()
        self._given_up: OrderedDict[str, str] = OrderedDict()
        """Id of an abandoned goal -> the reason."""
        self._times_back = clock.times_back
        self._connections: OrderedDict[str, ActionConnection] = OrderedDict()
        self._opening: Set[str] = set()
        self._direct: Dict[str, DirectConnection] = {
            name: DirectConnection(server, self._hand_on)
            for name, server in (own_servers or {}).items()
        }
        self._spare = [target for target in targets.values() if target.server not in self._direct]
        self._background: queue.SimpleQueue[Optional[Callable[[], None]]] = queue.SimpleQueue()
        self._closed = False
        threading.Thread(target=self._work, name="connections", daemon=True).start()

    # -- the worker thread: orders -----------------------------------------------------------------

    def start(self, command: StartAction, now: float) -> None:
        """Start an action, cancelling the previous one if it still runs."""
        self.cancel()
        identity = GoalIdentity(
            self.robot, command.incarnation, command.visit, command.attempt, self.tag
        )
        start_at = self._clock.seconds() + command.delay
        self._goal = _Goal(identity, self._targets[command.place], command, start_at)
        self.poll(now)

    def follow(
        self,
        targets: Mapping[str, ActionTarget],
        timeout: Callable[[str], Optional[float]],
        own_servers: Optional[Mapping[str, PlaceServer]],
    ) -> None:
        """Start the actions of another plan from now on; a running goal continues."""
        self._targets, self._timeout = targets, timeout
        for name, server in (own_servers or {}).items():
            if name not in self._direct:
                self._direct[name] = DirectConnection(server, self._hand_on)
        self._spare = [target for target in targets.values() if target.server not in self._direct]

    def cancel(self) -> None:
        """Cancel the running goal, if any; nothing more is reported about it."""
        goal, self._goal = self._goal, None
        if goal is not None:
            goal.become(GoalState.OVER)
            self._abandon(goal)

    def close(self) -> None:
        """Cancel the running goal and end the thread of the connections. The connections themselves
        stay open until the process ends."""
        self.cancel()
        self._closed = True
        self._background.put(None)

    def doing(self) -> str:
        """What the current goal waits for, in words; "" if its action runs or there is none."""
        return self._clock.stands() or self._goal.waits_for if self._goal else ""

    @property
    def connections(self) -> int:
        """The number of open connections to servers in other processes."""
        return len(self._connections)

    # -- the worker thread: time -------------------------------------------------------------------

    def poll(self, now: float) -> Optional[float]:
        """Do what is due at ``now`` (monotonic seconds). Returns when to call this next; None if no
        time is set."""
        self._clock.seconds()
        if self._times_back != self._clock.times_back:
            self._times_back = self._clock.times_back
            self._fault(
                "time went back by %.1f s (/clock); the run continues, and goals for action "
                "servers keep the newest time stamp" % self._clock.back_by
            )
        return earliest(self._poll_goal(now), self._poll_abandoned(now))

    def _poll_abandoned(self, now: float) -> Optional[float]:
        """Report goals that their servers have not ended in time."""
        while self._abandoned and now >= self._abandoned[0].report_at:
            goal = self._abandoned.popleft()
            if goal.connection.still_has(goal.goal_id):
                self._fault(
                    "%s has not ended the goal of %s, %g s after it was cancelled (cancel_grace in "
                    "the plan)" % (goal.target.server, goal.target.place, self._cancel_grace)
                )
        return self._abandoned[0].report_at if self._abandoned else None

    def _abandon(self, goal: _Goal) -> None:
        """Cancel a goal that is no longer wanted."""
        if goal.connection is not None:
            goal.connection.abandon(goal.id)
            report_at = time.monotonic() + self._cancel_grace
            self._abandoned.append(_Abandoned(goal.id, goal.target, goal.connection, report_at))

    def _poll_goal(self, now: float) -> Optional[float]:
        goal = self._goal
        if goal is None:
            return None
        if goal.state is GoalState.DELAYED:
            if self._clock.seconds() < goal.start_at:
                return self._clock.look_at(goal.start_at, now)
            goal.become(GoalState.CONNECTING)
            goal.connect_by = now + self._patience.server
            goal.look_at_type = now + min(LOOK_AT_TYPE, self._patience.server / 2)
        if goal.state is GoalState.CONNECTING:
            return self._poll_connecting(goal, now)
        if goal.state is GoalState.RESULT_DUE:
            return self._poll_result_due(goal, now)
        cut_off = None
        if goal.cut_off_at is not None:
            if self._clock.seconds() >= goal.cut_off_at:
                self._fail(
                    goal,
                    Outcome.TIMEOUT,
                    "the action took longer than %g s (timeout in the plan)"
                    % (self._timeout(goal.target.place) or 0),
                    cancel=True,
                )
                return None
            cut_off = self._clock.look_at(goal.cut_off_at, now)
        poll = self._poll_sent if goal.state is GoalState.SENT else self._poll_active
        look_again = poll(goal, now)
        return look_again if look_again is None else earliest(look_again, cut_off)

    def _poll_connecting(self, goal: _Goal, now: float) -> Optional[float]:
        connection = self._connection(goal.target.server)
        if connection is None:
            self._open(goal.target)
        elif connection.ready_server() is not None:
            self._send(goal, connection, now)
            return self._poll_goal(now)
        if now >= goal.connect_by:
            detail = "%s did not answer within %g s (~server_timeout)" % (
                goal.target.server,
                self._patience.server,
            )
            if connection and connection.last_status:
                detail += ": only some of its topics are connected"
            self._fail(goal, Outcome.NO_SERVER, detail)
            return None
        if now >= goal.look_at_type:
            goal.look_at_type = math.inf
            self._background.put(partial(self._look_at_type, goal))
        return min(now + LOOK_AGAIN, goal.connect_by)

    def _look_at_type(self, goal: _Goal) -> None:
        """Make a goal fail if its server has another type; runs on the thread of the
        connections."""
        try:
            clash = goal.target.clash(published_topics())
        except MASTER_ERRORS:
            return
        if clash:
            self._enqueue(self._found_clash, goal, clash)

    def _found_clash(self, goal: _Goal, clash: str) -> None:
        if goal is self._goal and goal.state is GoalState.CONNECTING:
            self._fail(goal, Outcome.NO_SERVER, clash)

    def _send(self, goal: _Goal, connection: _AnyConnection, now: float) -> None:
        if goal.target.server in self._connections:
            self._connections.move_to_end(goal.target.server)
        try:
            goal.message = goal.target.new_goal(goal.command.data)
        except (DataError, PlanError) as error:
            self._fail(goal, Outcome.ABORTED, error.message)
            return
        goal.connection = connection
        goal.text = goal_text(goal.command) if goal.target.speaks_gspn else ""
        goal.become(GoalState.SENT)
        goal.sent_at = now
        seconds = self._timeout(goal.target.place)
        goal.cut_off_at = None if seconds is None else self._clock.seconds() + seconds
        self._background.put(connection.learn_periods)
        connection.send(goal.id, goal.message, goal.identity.incarnation, goal.text)
        self._open_spare()

    def _poll_sent(self, goal: _Goal, now: float) -> Optional[float]:
        assert goal.connection is not None
        seconds = self._patience.acknowledgement
        server = goal.connection.ready_server()
        if server is not None:
            seconds = _at_least(seconds, goal.connection.period(server))
        if now >= goal.sent_at + seconds:
            detail = "%s did not acknowledge the goal within %g s (~acknowledgement_timeout)"
            self._fail(goal, Outcome.LOST, detail % (goal.target.server, seconds), cancel=True)
            return None
        return min(goal.sent_at + seconds, now + 0.5)

    def _poll_active(self, goal: _Goal, now: float) -> Optional[float]:
        assert goal.connection is not None
        if not goal.connection.is_connected(goal.acknowledged_by):
            # it must reconnect within the time limit for a result, otherwise it counts as gone
            self._await_result(goal, now)
            return goal.result_by
        silence = goal.connection.silence(goal.acknowledged_by)
        period = goal.connection.period(goal.acknowledged_by)
        limit = max(self._patience.status, MISSED * period)
        if silence >= limit:
            detail = "%s has sent no status for %.1f s (~status_timeout)"
            self._fail(
                goal, Outcome.SERVER_DIED, detail % (goal.target.server, silence), cancel=True
            )
            return None
        return now + min(0.5, limit - silence)

    def _await_result(self, goal: _Goal, now: float) -> None:
        goal.become(GoalState.RESULT_DUE)
        goal.result_by = now + self._patience.result

    def _poll_result_due(self, goal: _Goal, now: float) -> Optional[float]:
        """Give up on a result that has not arrived in time, or continue if the server has
        reconnected and has not ended the goal."""
        if now < goal.result_by:
            return goal.result_by
        assert goal.connection is not None
        if goal.ended is None and goal.connection.is_connected(goal.acknowledged_by):
            goal.become(GoalState.ACTIVE)
            return self._poll_goal(now)
        outcome, detail = goal.ended or (
            Outcome.SERVER_DIED,
            "%s closed its connections and did not reopen them within %g s (~result_timeout)"
            % (goal.target.server, self._patience.result),
        )
        if outcome in (Outcome.SERVER_DIED, Outcome.LOST):
            self._fail(goal, outcome, detail)
        elif outcome == Outcome.SUCCEEDED and (
            goal.target.keep or goal.target.transition_of(outcome, None) == ""
        ):
            detail = "%s ended the goal, but sent no result within %g s (~result_timeout)"
            self._fail(goal, Outcome.LOST, detail % (goal.target.server, self._patience.result))
        else:
            self._finish(goal, outcome, detail, None)
        return None

    # -- the worker thread: reports of servers -----------------------------------------------------

    def _heard(self, connection: _AnyConnection, what: GoalNews, goal_id: str, value: Any) -> None:
        goal = self._goal
        if goal is None or goal.id != goal_id or goal.connection is not connection:
            if what is GoalNews.RESULT and goal_id in self._given_up:
                why = self._given_up.pop(goal_id)
                # otherwise it ended because it was cancelled
                if value[0] not in (Outcome.PREEMPTED, Outcome.LOST):
                    text = "%s reports '%s' for an abandoned goal: %s"
                    self._fault(text % (connection.server, value[0], why))
            return
        if what is GoalNews.ACKNOWLEDGED:
            if goal.state is not GoalState.SENT:
                return
            goal.become(GoalState.ACTIVE)
            goal.acknowledged_by = value
            callers = [c for c in connection.last_status if connection.is_connected(c)]
            if len(callers) > 1:
                rospy.logwarn(
                    "there are %d servers %s: %s", len(callers), connection.server, callers
                )
        elif what is GoalNews.RESULT:
            self._finish(goal, *value)
        elif what is GoalNews.FEEDBACK:
            self._feedback(goal.identity, value)
        elif goal.state is GoalState.ACTIVE:  # the goal ended, or the server no longer knows it
            self._await_result(goal, time.monotonic())
            goal.ended = value or (
                Outcome.SERVER_DIED,
                "%s no longer knows the goal" % connection.server,
            )

    def _finish(
        self, goal: _Goal, outcome: Outcome, text: str, result: Optional[genpy.Message]
    ) -> None:
        transition = None if outcome == Outcome.LOST else goal.target.transition_of(outcome, result)
        if transition is None:
            self._fail(goal, outcome, text)
            return
        try:
            data = goal.target.data_of(outcome, text, result)
        except DataError as error:
            self._fail(goal, Outcome.BAD_RESULT, error.message)
            return
        self._end(goal, ActionEnded(goal.identity, transition, data=data))

    def _fail(self, goal: _Goal, reason: Outcome, detail: str, cancel: bool = False) -> None:
        if goal.connection is not None and reason in (
            Outcome.LOST,
            Outcome.TIMEOUT,
            Outcome.SERVER_DIED,
        ):
            self._given_up[goal.id] = detail
            if len(self._given_up) > MOST_GIVEN_UP:
                self._given_up.popitem(last=False)
        if cancel:
            self._abandon(goal)
        if self._times_back and reason in (Outcome.PREEMPTED, Outcome.REJECTED):
            detail += " (time went back during this run, by %.1f s)" % self._clock.back_by
        self._end(goal, ActionEnded(goal.identity, "", reason, detail))

    def _end(self, goal: _Goal, ended: ActionEnded) -> None:
        goal.become(GoalState.OVER)
        if goal.connection is not None:
            goal.connection.forget()
        self._goal = None
        self._ended(ended)

    # -- connections -------------------------------------------------------------------------------

    def _connection(self, server: str) -> Optional[_AnyConnection]:
        return self._direct.get(server) or self._connections.get(server)

    def _open_spare(self) -> None:
        """Connect to one more server of the plan, if the limit allows."""
        while self._spare and len(self._connections) + len(self._opening) < self._limit:
            target = self._spare.pop(0)
            if target.server not in self._connections and target.server not in self._opening:
                self._open(target)
                return

    def _open(self, target: ActionTarget) -> None:
        if target.server in self._opening:
            return
        self._opening.add(target.server)

        def open_it() -> None:
            with registered_together():
                connection = ActionConnection(
                    target.server, target.action_type, self.robot, self.tag, self._hand_on
                )
            self._enqueue(self._opened, connection)

        self._background.put(open_it)

    def _hand_on(
        self, connection: _AnyConnection, what: GoalNews, goal_id: str, value: Any
    ) -> None:
        self._enqueue(self._heard, connection, what, goal_id, value)

    def _opened(self, connection: ActionConnection) -> None:
        self._opening.discard(connection.server)
        self._connections[connection.server] = connection
        in_use = self._goal.target.server if self._goal else ""
        for server in list(self._connections):
            if len(self._connections) <= self._limit:
                break
            if server not in (in_use, connection.server):
                self._background.put(self._connections.pop(server).close)
        if self._goal is not None and self._goal.message is not None:
            self._open_spare()
        self.poll(time.monotonic())

    def _work(self) -> None:
        while True:
            task = self._background.get()
            if task is None or rospy.is_shutdown():
                return
            try:
                task()
            except Exception as error:
                if not rospy.is_shutdown() and not self._closed:
                    rospy.logerr("connections of %s: %s", self.robot, error)


def _at_least(seconds: float, period: float) -> float:
    """The time limit for a server that reports periodically; ``seconds`` if it does not."""
    return seconds if math.isinf(period) else max(seconds, MISSED * period)
