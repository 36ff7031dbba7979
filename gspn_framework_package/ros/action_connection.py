"""The topics between an execution node and one action server."""

from __future__ import annotations

import contextlib
import math
import time
from typing import Any, Callable, Dict, List, Optional, Set, Tuple

import genpy
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray

from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.ros.goal_id import parse_goal_id
from gspn_framework_package.ros.goal_state import GoalNews
from gspn_framework_package.ros.ros_clock import ROS_CLOCK
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, nearest_parameter

ENDED = {
    GoalStatus.SUCCEEDED: Outcome.SUCCEEDED,
    GoalStatus.ABORTED: Outcome.ABORTED,
    GoalStatus.REJECTED: Outcome.REJECTED,
    GoalStatus.PREEMPTED: Outcome.PREEMPTED,
    GoalStatus.RECALLED: Outcome.PREEMPTED,
    GoalStatus.LOST: Outcome.LOST,
}
"""The status of a goal that has ended -> its outcome."""


class ActionConnection:
    """The client's side of the action protocol, for one goal at a time.

    It handles the protocol's messages itself, by goal id, instead of using
    ``actionlib.ActionClient``. That class generates its own goal ids (which collide), mistakes a
    status from a second server of the same name for the loss of the goal, and drops a result that
    arrives after such a loss.

    It publishes ``SERVER/goal`` and ``SERVER/cancel``, and subscribes to ``SERVER/status``,
    ``/result`` and ``/feedback``. Its callbacks run on rospy's threads and only pass on messages
    about the watched goal.

    :param server: absolute name of the server.
    :param action_type: class of the action.
    :param robot: name of the robot that sends the goals.
    :param tag: tag of this start of the node. An unfinished goal of the robot with another tag is
        cancelled as a leftover of a dead node if it existed when this node connected, or belongs to
        an earlier incarnation.
    :param hand_on: called as ``hand_on(connection, what, goal_id, value)``; :class:`GoalNews`
        documents the value for each ``what``.
    """

    def __init__(
        self,
        server: str,
        action_type: type,
        robot: str,
        tag: str,
        hand_on: Callable[[ActionConnection, GoalNews, str, Any], None],
    ) -> None:
        spec = action_type()
        self.server = server
        self._robot, self._tag, self._hand_on = robot, tag, hand_on
        self._goal_type = type(spec.action_goal)
        self._watched = ""
        self._acknowledged_by: Optional[str] = None
        self._reported_end = False
        self._incarnation = 0
        self._cancelled: Dict[str, bool] = {}
        self._abandoned: Dict[str, str] = {}
        """Cancelled goal that has not ended -> caller id of the server that has it; "" if
        unknown."""
        self.last_status: Dict[str, float] = {}
        """Caller id of each server of this name -> monotonic time of its last status."""
        self._last_status_ros: Dict[str, float] = {}
        self._listed: Dict[str, List[Tuple[str, int]]] = {}
        """Caller id -> the goals of its last status, with their states."""
        self._regular: Dict[str, int] = {}
        """Caller id -> ``times_back`` of the clock at its last periodic status."""
        self._periods: Dict[str, float] = {}
        self._newest_stamp = rospy.Time()
        subscribe = rospy.Subscriber
        self._goal = rospy.Publisher(server + "/goal", self._goal_type, queue_size=10)
        self._cancel = rospy.Publisher(server + "/cancel", GoalID, queue_size=10)
        self._result = subscribe(
            server + "/result", type(spec.action_result), self._on_result, tcp_nodelay=True
        )
        self._feedback = subscribe(
            server + "/feedback", type(spec.action_feedback), self._on_feedback, tcp_nodelay=True
        )
        self._status = subscribe(
            server + "/status", GoalStatusArray, self._on_status, tcp_nodelay=True
        )

    def close(self) -> None:
        """Unregister from all topics."""
        for topic in (self._status, self._feedback, self._result, self._cancel, self._goal):
            topic.unregister()

    # -- called by the node's worker thread --------------------------------------------------------

    def ready_server(self) -> Optional[str]:
        """The caller id of a server with all topics connected, in both directions; None if there is
        none yet. (A goal published before that would be lost silently.)"""
        for caller in sorted(self.last_status, key=self.last_status.__getitem__, reverse=True):
            if self.is_connected(caller):
                return caller
        return None

    def is_connected(self, caller: str) -> bool:
        """Whether goals reach the server with this caller id, and results arrive from it."""
        return (
            self._goal.impl.has_connection(caller)
            and self._cancel.impl.has_connection(caller)
            and all(
                any(c.callerid_pub == caller for c in topic.impl.connections)
                for topic in (self._result, self._feedback, self._status)
            )
        )

    def silence(self, caller: str) -> float:
        """Seconds since the last status of this server. With simulated time, which servers use, a
        slow or paused simulation does not count as silence. Nor does silence since time went back:
        that stops the status timer of a Python action server, although the server keeps working."""
        passed = ROS_CLOCK.seconds() - self._last_status_ros[caller]
        if self._regular.get(caller) != ROS_CLOCK.times_back:
            return 0.0
        return min(time.monotonic() - self.last_status[caller], passed)

    def period(self, caller: str) -> float:
        """Seconds between two statuses of this server, according to its parameters; 0 if they do
        not say, infinity if it sends none periodically."""
        return self._periods.get(caller, 0.0)

    def learn_periods(self) -> None:
        """Read the servers' status periods; may be called from any thread."""
        for caller in set(self.last_status) - set(self._periods):
            with contextlib.suppress(*MASTER_ERRORS):  # read again with the next goal
                given = nearest_parameter("actionlib_status_frequency", caller, None)
                given = nearest_parameter(self.server + "/status_frequency", caller, given)
                known = isinstance(given, (int, float))
                self._periods[caller] = (1.0 / given if given > 0 else math.inf) if known else 0.0

    def send(self, goal_id: str, goal: genpy.Message, incarnation: int, text: str = "") -> None:
        """Send a goal and watch it. It is sent only once, because a server that receives a goal
        twice may start it twice.

        The stamp of the goal id is empty, so the server fills in its own time; otherwise an older
        "cancel everything before" could apply to the goal if clocks differ. When simulated time
        went back, it is the newest stamp that the server has seen, since ``SimpleActionServer``
        refuses a goal that is older than the one before.

        :param text: the ``frame_id`` of the header; see ``ros.goal_data``.
        """
        self._acknowledged_by = None
        self._reported_end = False
        self._watched = goal_id
        self._incarnation = incarnation
        message = self._goal_type()
        message.header.stamp = rospy.get_rostime()
        message.header.frame_id = text
        message.goal_id.id = goal_id
        if not rospy.rostime.is_wallclock() and rospy.get_rostime() < self._newest_stamp:
            message.goal_id.stamp = self._newest_stamp
        message.goal = goal
        self._goal.publish(message)

    def forget(self) -> None:
        """Stop watching the goal."""
        self._watched = ""

    def cancel(self, goal_id: str) -> None:
        """Ask the server to cancel a goal."""
        self._cancel.publish(GoalID(id=goal_id))

    def abandon(self, goal_id: str) -> None:
        """Ask the server to cancel the watched goal, and watch only whether it ends."""
        self._abandoned[goal_id] = self._acknowledged_by or ""
        self.forget()
        self.cancel(goal_id)

    def still_has(self, goal_id: str) -> bool:
        """Whether a server still has an abandoned goal; can be asked only once."""
        caller = self._abandoned.pop(goal_id, "")
        return bool(caller) and self.is_connected(caller)

    # -- rospy's threads ---------------------------------------------------------------------------

    def _on_status(self, message: GoalStatusArray) -> None:
        caller = message._connection_header.get("callerid", "")
        first = caller not in self.last_status
        self._last_status_ros[caller] = ROS_CLOCK.seconds()
        self.last_status[caller] = time.monotonic()
        listed = [(status.goal_id.id, status.status) for status in message.status_list]
        # otherwise it may only be an ordinary status
        if self._listed.get(caller, listed) == listed:
            self._regular[caller] = ROS_CLOCK.times_back
        self._listed[caller] = listed
        watched, known = self._watched, False
        unended: Set[str] = set()
        for status in message.status_list:
            goal_id = status.goal_id.id
            self._newest_stamp = max(self._newest_stamp, status.goal_id.stamp)
            if goal_id in self._abandoned and status.status not in ENDED:
                self._abandoned[goal_id] = caller
                unended.add(goal_id)
            if goal_id == watched:
                known = True
                if self._acknowledged_by is None:
                    self._acknowledged_by = caller
                    self._hand_on(self, GoalNews.ACKNOWLEDGED, watched, caller)
                if status.status in ENDED and not self._reported_end:
                    self._reported_end = True
                    self._hand_on(
                        self, GoalNews.ENDED, watched, (ENDED[status.status], status.text)
                    )
            elif status.status not in ENDED and not goal_id.endswith(self._tag):
                self._cancel_leftover(goal_id, first)
        if watched and not known and self._acknowledged_by == caller:
            self._hand_on(self, GoalNews.UNKNOWN, watched, None)
        for goal_id, server in list(self._abandoned.items()):
            if server == caller and goal_id not in unended:
                self._abandoned.pop(goal_id, None)

    def _cancel_leftover(self, goal_id: str, first: bool) -> None:
        identity = parse_goal_id(goal_id)
        if identity is None or identity.robot != self._robot or identity.tag == self._tag:
            return
        if first or goal_id in self._cancelled or identity.incarnation < self._incarnation:
            if not self._cancelled.get(goal_id):
                self._cancelled[goal_id] = True
                rospy.logwarn(
                    "%s: cancelling the goal %s of an earlier start", self.server, goal_id
                )
            self.cancel(goal_id)

    def _on_result(self, message: genpy.Message) -> None:
        status = message.status
        self._abandoned.pop(status.goal_id.id, None)
        if status.goal_id.id.endswith(self._tag) and status.status in ENDED:
            value = (ENDED[status.status], status.text, message.result)
            self._hand_on(self, GoalNews.RESULT, status.goal_id.id, value)

    def _on_feedback(self, message: genpy.Message) -> None:
        if message.status.goal_id.id == self._watched:
            self._hand_on(self, GoalNews.FEEDBACK, self._watched, message.feedback)
