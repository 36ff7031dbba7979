"""The place servers of one robot: one action server for each place that has a Python action."""

from __future__ import annotations

import threading
import traceback
from typing import Any, Callable, Dict, List, Optional

import genpy
import rospy
from actionlib import ActionServer
from actionlib.server_goal_handle import ServerGoalHandle
from actionlib.status_tracker import StatusTracker
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray

from gspn_framework_package.execution.actions import (
    ActionContext,
    ActionFailed,
    ActionResult,
    PythonAction,
    error_text,
    load_actions,
)
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import DataError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.msg import (
    ExecGSPNAction,
    ExecGSPNActionGoal,
    ExecGSPNFeedback,
    ExecGSPNResult,
)
from gspn_framework_package.ros.goal_data import GoalData, read_goal_text, result_text
from gspn_framework_package.ros.goal_id import GoalIdentity, parse_goal_id
from gspn_framework_package.ros.goal_state import GoalNews
from gspn_framework_package.ros.ros_clock import RosCancellation
from gspn_framework_package.ros.transport.registration import found_parameter, registered_together

KEPT_ENDED = 10
"""Maximum number of ended goals in a server's status (after 5 s they are dropped anyway). Without
this bound, a server that answers 600 goals a second would list 3,000 in every status."""

TRACEBACK_LIMIT = 10_000
"""Maximum number of characters of a traceback that are shown, since the text of an exception may
have any length."""

NO_RESULT = ActionResult("", {})
"""The result of a failed action."""


class PlaceServers:
    """Serves the Python actions of a plan for one robot, all in this process. Each is an ordinary
    action server with its own name; they share a thread pool and a timer.

    A robot does one thing at a time: a newer goal (a later incarnation, visit or attempt) cancels
    the robot's older goals on all these servers. A goal is also cancelled when the node that sent
    it dies.

    It serves ``NAMESPACE/SERVER`` (gspn_framework_package/ExecGSPN action) for each server that the
    plan names, and reads the parameter ``actionlib_status_frequency`` (found by ``search_param``;
    1 Hz by default).

    :param plan: the plan; its functions are loaded from its folder.
    :param namespace: absolute namespace of the robot.
    :raises PlanError: a function does not exist, or is not an action.
    """

    def __init__(self, plan: Plan, robot: str, namespace: str) -> None:
        self.robot = robot
        self._pool = WorkerPool("action")
        self._lock = threading.Lock()
        self._running: Dict[str, _RunningGoal] = {}
        self._namespace = namespace
        self.servers: Dict[str, PlaceServer] = {}
        """The servers by their absolute names. Changes replace the map."""
        for name, by_place in self._load(plan).items():
            self.servers[name] = PlaceServer(self, name, by_place)
        self._timer: Optional[threading.Thread] = None
        self._stopping = threading.Event()

    def prepare(self, plan: Plan) -> None:
        """Load the functions of another plan, and start the additional servers that it needs. May
        be called from any thread.

        :raises PlanError: a function does not exist, or is not an action.
        """
        for name, by_place in self._load(plan).items():
            if name not in self.servers:
                server = PlaceServer(self, name, by_place)
                with registered_together():
                    server.start()
                self.servers = {**self.servers, name: server}

    def follow(self, plan: Plan) -> None:
        """Serve the functions of another plan from now on. Running actions continue.

        :raises PlanError: a function does not exist, or is not an action.
        """
        self.prepare(plan)
        for name, by_place in self._load(plan).items():
            self.servers[name].serve(by_place)

    def _load(self, plan: Plan) -> Dict[str, Dict[str, PythonAction]]:
        """The functions of a plan by the absolute names of their servers and by place."""
        actions: Dict[str, Dict[str, PythonAction]] = {}
        for place, action in load_actions(plan, self.robot).items():
            bound = plan.action(self.robot, place)
            assert isinstance(bound, FunctionAction)
            name = rospy.names.ns_join(self._namespace, bound.server)
            actions.setdefault(name, {})[place] = action
        return actions

    @property
    def names(self) -> List[str]:
        """The absolute names of the servers."""
        return list(self.servers)

    def start(self) -> None:
        """Register the servers and accept goals."""
        with registered_together():
            for server in self.servers.values():
                server.start()
        self._timer = threading.Thread(target=self._report_status, name="status", daemon=True)
        self._timer.start()

    def stop(self) -> None:
        """Cancel the running actions, and accept no more goals. No results are published: the goals
        were not cancelled by their clients, and a robot whose servers end just before it must not
        mistake that for a failed action. A robot that keeps running notices that the server is
        gone."""
        self._stopping.set()
        with self._lock:
            running = list(self._running.values())
        for goal in running:
            goal.cancellation.cancel()
        for server in self.servers.values():
            server.stop()

    # -- goals -------------------------------------------------------------------------------------

    def accept(
        self, server: PlaceServer, handle: ServerGoalHandle, caller: str, given: GoalData
    ) -> None:
        """Accept or reject a goal for ``server`` from the node ``caller`` ("" for this node), with
        the data that its action may read."""
        if self._stopping.is_set():
            return
        place = handle.get_goal().place
        goal_id = handle.get_goal_id().id
        action = server.action(place)
        if action is None:
            handle.set_rejected(text="%s does not serve place '%s'" % (server.ns, place))
            return
        identity = parse_goal_id(goal_id)
        goal = _RunningGoal(server, handle, action, place, identity, caller, given)
        with self._lock:
            older = [other for other in self._running.values() if goal.replaces(other)]
            self._running[goal_id] = goal
        for other in older:
            other.cancellation.cancel()
        handle.set_accepted()
        self._pool.submit(lambda: self._run(goal_id, goal))

    def cancel(self, handle: ServerGoalHandle) -> None:
        """Cancel the action of a goal if it is running."""
        with self._lock:
            goal = self._running.get(handle.get_goal_id().id)
        if goal is not None:
            goal.cancellation.cancel()

    def _run(self, goal_id: str, goal: _RunningGoal) -> None:
        identity = goal.identity
        context = ActionContext(
            goal.place,
            identity.robot if identity else self.robot,
            goal.tell,
            goal.cancellation,
            identity.visit if identity else 0,
            identity.attempt if identity else 1,
            *goal.given,
        )
        result, failure = NO_RESULT, None
        try:
            result = goal.action(context)
        except (ActionFailed, DataError) as error:
            failure = error_text(error) or "the action failed"
        except BaseException as error:  # even sys.exit() in an action ends only the action
            failure = "%s: %s" % (type(error).__name__, error_text(error))
            if not goal.cancellation():
                rospy.logerr(
                    "%s in %s: %s",
                    goal.action.name,
                    goal.place,
                    traceback.format_exc()[-TRACEBACK_LIMIT:],
                )
        finally:
            with self._lock:
                self._running.pop(goal_id, None)
        # cancelled because the node ends, see stop()
        if self._stopping.is_set() or rospy.is_shutdown():
            return
        try:
            self._report_result(goal, result, failure)
        except rospy.ROSException:
            if not self._stopping.is_set():  # otherwise stop() has closed the publisher
                raise

    @staticmethod
    def _report_result(goal: _RunningGoal, result: ActionResult, failure: Optional[str]) -> None:
        message = ExecGSPNResult(result.transition)
        if goal.cancellation():
            goal.handle.set_canceled(message, failure or "cancelled")
        elif failure is not None:
            goal.handle.set_aborted(ExecGSPNResult(), failure)
        else:
            goal.handle.set_succeeded(message, result_text(result.data))

    # -- status ------------------------------------------------------------------------------------

    def _report_status(self) -> None:
        period = 1.0 / max(float(found_parameter("actionlib_status_frequency", 1.0)), 0.1)
        while not self._stopping.wait(period) and not rospy.is_shutdown():
            for server in self.servers.values():
                server.send_status()
            with self._lock:
                running = list(self._running.values())
            for goal in running:
                if goal.is_orphan():
                    rospy.logwarn("%s: %s is gone; cancelling its goal", goal.place, goal.caller)
                    goal.cancellation.cancel()


class _RunningGoal:
    def __init__(
        self,
        server: PlaceServer,
        handle: ServerGoalHandle,
        action: PythonAction,
        place: str,
        identity: Optional[GoalIdentity],
        caller: str,
        given: GoalData,
    ) -> None:
        self.server, self.handle, self.action = server, handle, action
        self.place, self.identity, self.caller, self.given = place, identity, caller, given
        self.cancellation = RosCancellation()
        self._was_there = server.status_pub.impl.has_connection(caller)

    def replaces(self, other: _RunningGoal) -> bool:
        mine, others = self.identity, other.identity
        if mine is None or others is None or mine.robot != others.robot:
            return False
        if mine.tag == others.tag:
            return mine.age > others.age
        return mine.incarnation >= others.incarnation

    def is_orphan(self) -> bool:
        """Whether the node that sent the goal was connected to this server, and no longer is."""
        there = self.server.status_pub.impl.has_connection(self.caller)
        self._was_there = self._was_there or there
        return self._was_there and not there

    def tell(self, *progress: Any) -> None:
        """Publish the action's ``feedback``: whole numbers, or one iterable of them."""
        if len(progress) == 1 and hasattr(progress[0], "__iter__"):
            progress = progress[0]
        self.handle.publish_feedback(ExecGSPNFeedback([int(value) for value in progress]))


class PlaceServer(ActionServer):
    """An action server without its own thread that does not query the master; its goals may
    also come from its own process.

    The library's ``initialize`` calls the master six times and starts a timer for each server; with
    13 robots and 7 places, that dominates the start-up time.

    :param owner: runs the actions.
    :param name: absolute name of the server.
    :param actions: the server's actions by place.
    """

    def __init__(self, owner: PlaceServers, name: str, actions: Dict[str, PythonAction]) -> None:
        super().__init__(name, ExecGSPNAction, self._goal, owner.cancel, auto_start=False)
        self._owner = owner
        self._actions = actions
        self._caller, self._given = "", GoalData()
        self._direct: Dict[str, Callable[[GoalNews, GoalStatus, genpy.Message], None]] = {}

    started: bool
    status_list: List[StatusTracker]

    def action(self, place: str) -> Optional[PythonAction]:
        """The action for ``place``, None if there is none; a server with one action runs it for any
        place."""
        if len(self._actions) == 1:
            return next(iter(self._actions.values()))
        return self._actions.get(place)

    def serve(self, actions: Dict[str, PythonAction]) -> None:
        """Run these actions, by place, from now on."""
        self._actions = actions

    def initialize(self) -> None:
        """Create the topics."""
        self.status_list_timeout = rospy.Duration(5.0)
        topic = self.ns + "/"
        self.status_pub = rospy.Publisher(
            topic + "status", GoalStatusArray, latch=True, queue_size=50
        )
        # latched: a client knows that it is connected a moment before this side does, and would
        # miss a result published in between
        self.result_pub = rospy.Publisher(
            topic + "result", self.ActionResult, latch=True, queue_size=50
        )
        self.feedback_pub = rospy.Publisher(topic + "feedback", self.ActionFeedback, queue_size=50)
        self.goal_sub = rospy.Subscriber(
            topic + "goal", self.ActionGoal, self.internal_goal_callback, tcp_nodelay=True
        )
        self.cancel_sub = rospy.Subscriber(
            topic + "cancel", GoalID, self.internal_cancel_callback, tcp_nodelay=True
        )

    def stop(self) -> None:
        """Accept no more goals, and unregister from the topics."""
        with self.lock:
            if not self.started:
                return
            self.started = False
        for topic in (
            self.goal_sub,
            self.cancel_sub,
            self.status_pub,
            self.feedback_pub,
            self.result_pub,
        ):
            topic.unregister()

    def take(
        self, goal: ExecGSPNActionGoal, told: Callable[[GoalNews, GoalStatus, genpy.Message], None]
    ) -> None:
        """Accept a goal from this process.

        :param told: receives (FEEDBACK or RESULT, status, message) of the goal, in addition to the
            topics.
        """
        with self.lock:
            self._direct[goal.goal_id.id] = told
            self._caller, self._given = "", read_goal_text(goal.header.frame_id)
            super().internal_goal_callback(goal)

    def cancel_goal(self, goal_id: str) -> None:
        """Cancel a goal that came from this process."""
        self.internal_cancel_callback(GoalID(id=goal_id))

    def internal_goal_callback(self, goal: ExecGSPNActionGoal) -> None:
        """Accept a goal from the topic."""
        with self.lock:
            self._caller = goal._connection_header.get("callerid", "")
            self._given = read_goal_text(goal.header.frame_id)
            super().internal_goal_callback(goal)

    def publish_result(self, status: GoalStatus, result: ExecGSPNResult) -> None:
        """Publish the result of a goal; a goal from this process also gets it directly."""
        super().publish_result(status, result)
        told = self._direct.pop(status.goal_id.id, None)
        if told is not None:
            told(GoalNews.RESULT, status, result)

    def publish_feedback(self, status: GoalStatus, feedback: ExecGSPNFeedback) -> None:
        """Publish the progress of a goal; a goal from this process also gets it directly."""
        super().publish_feedback(status, feedback)
        told = self._direct.get(status.goal_id.id)
        if told is not None:
            told(GoalNews.FEEDBACK, status, feedback)

    def _goal(self, handle: ServerGoalHandle) -> None:
        self._owner.accept(self, handle, self._caller, self._given)

    def send_status(self) -> None:
        """Publish the status again if there are subscribers or goals to report."""
        with self.lock:
            if self.started and (self.status_list or self.status_pub.impl.has_connections()):
                self._forget_ended()
                super().publish_status()

    def publish_status(self) -> None:
        """Publish the status of all goals, but only the last :data:`KEPT_ENDED` ended ones. If
        there are no subscribers, goals of this process, which are notified directly, can wait for
        :meth:`send_status`: the library takes longer for a status than a replica for a firing."""
        with self.lock:
            self._forget_ended()
            if self._caller or self.status_pub.impl.has_connections():
                super().publish_status()

    def _forget_ended(self) -> None:
        """Drop the ended goals that a status no longer reports. The library drops those that ended
        a while ago too, but first formats each as YAML, for a debug message."""
        never, now = rospy.Time(), rospy.Time.now()
        ended = [t for t in self.status_list if t.status.status in _ENDED]
        surplus = len(self.status_list) - KEPT_ENDED
        dropped = {
            id(tracker)
            for number, tracker in enumerate(ended)
            if number < surplus
            or never != tracker.handle_destruction_time < now - self.status_list_timeout
        }
        if dropped:
            self.status_list = [t for t in self.status_list if id(t) not in dropped]


_ENDED = (
    GoalStatus.PREEMPTED,
    GoalStatus.SUCCEEDED,
    GoalStatus.ABORTED,
    GoalStatus.REJECTED,
    GoalStatus.RECALLED,
)
