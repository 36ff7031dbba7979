"""The interface of a robot's actions to the robot, over ROS: ``move_base``, ``amcl_pose``,
``temperature``. The robot may be simulated or real.

All names are relative: they are resolved in the namespace of the node that runs the actions.
"""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Dict, Optional, Set, Tuple

import actionlib
import rospy
from actionlib import CommState
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from sensor_msgs.msg import Temperature

from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.ros.ros_clock import ROS_CLOCK
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, published_topics
from gspn_framework_package.world import patrol
from gspn_framework_package.world.messages import pose_from, pose_message
from gspn_framework_package.world.room import Pose

Feedback = Callable[..., None]
IsCancelled = Callable[[], bool]

POSE_TYPE = "geometry_msgs/PoseWithCovarianceStamped"
DISCOVERY_PERIOD = 2.0
"""Seconds of wall time between two searches for other robots."""

POSES_DEADLINE = 3.0
"""Seconds of wall time within which other robots must publish their poses. Limited because a dead
robot's topic may still be registered."""

SILENCE_DEADLINE = 15.0
"""Seconds of wall time without a message from ``move_base`` after which a goal is given up.

Otherwise a client would wait forever for a dead server (``actionlib`` never reports a lost server).
"""


def _robot_of(topic: str) -> str:
    """The name of the robot, from the name of its topic."""
    return topic.strip("/").rpartition("/")[0]


class BaseClient:
    """One robot; implements :class:`.patrol.Robot`.

    Subscribes to ``amcl_pose`` and ``temperature``, and to every existing ``/*/amcl_pose`` (the
    other robots). A client of ``move_base``.

    :param name: name of the robot.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._news = threading.Condition()
        self._pose: Optional[Pose] = None
        self._temperature: Optional[float] = None
        self._others: Dict[str, Pose] = {}
        self._awaited: Set[str] = set()
        self._subscribers: Dict[str, Any] = {}
        self._own_topic = rospy.resolve_name("amcl_pose")
        self._handle: Any = None
        self._goal_number = 0
        self._arrived: Optional[bool] = False
        self._trouble = "no goal yet"
        rospy.Subscriber("amcl_pose", PoseWithCovarianceStamped, self._on_pose, queue_size=1)
        rospy.Subscriber("temperature", Temperature, self._on_temperature, queue_size=1)
        self._client = actionlib.ActionClient("move_base", MoveBaseAction)
        self._discovered = -DISCOVERY_PERIOD
        self._heard = _moment()
        rospy.Subscriber("move_base/status", GoalStatusArray, self._on_status, queue_size=1)

    # ---- news, from ROS threads --------------------------------------------------------------

    def _on_status(self, message: Any) -> None:
        with self._news:
            self._heard = _moment()

    def _on_pose(self, message: Any) -> None:
        with self._news:
            self._pose = pose_from(message.pose.pose)
            self._news.notify_all()

    def _on_temperature(self, message: Any) -> None:
        with self._news:
            self._temperature = float(message.temperature)
            self._news.notify_all()

    def _on_other(self, message: Any, topic: str) -> None:
        with self._news:
            self._others[_robot_of(topic)] = pose_from(message.pose.pose)
            self._news.notify_all()

    def _on_transition(self, handle: Any, number: int) -> None:
        if handle.get_comm_state() != CommState.DONE:
            return
        status = handle.get_terminal_state()
        with self._news:
            if number == self._goal_number:
                self._arrived = status == GoalStatus.SUCCEEDED
                self._trouble = handle.get_goal_status_text() or GoalStatus.to_string(status)
                self._news.notify_all()

    # ---- connecting --------------------------------------------------------------------------

    def connect(self, seconds: float = 30.0, *, thermometer: bool = True) -> None:
        """Wait until the robot is available.

        :param seconds: timeout in wall time.
        :param thermometer: whether the robot must have a thermometer.
        :raises ActionFailed: no ``move_base``, pose or thermometer within that time.
        """
        deadline = time.monotonic() + seconds
        while not rospy.is_shutdown():
            missing = [
                name
                for name, value in (("amcl_pose", self._pose), ("temperature", self._temperature))
                if value is None and (thermometer or name != "temperature")
            ]
            if not self._client.wait_for_server(rospy.Duration(0.01)):
                missing.append("move_base")
            if not missing:
                self._discover()
                self._await_others()
                return
            if time.monotonic() > deadline:
                break
            self.await_news(0.1)
        raise ActionFailed(
            "%s: nothing from %s in %g s"
            % (self.name, ", ".join(rospy.resolve_name(name) for name in missing), seconds)
        )

    def _await_others(self) -> None:
        """Wait for the poses of newly discovered robots; ``amcl_pose`` is latched.

        A robot that does not know the poses of the others must not enter a location.
        """
        deadline = time.monotonic() + POSES_DEADLINE
        with self._news:
            while self._awaited - set(self._others) and not rospy.is_shutdown():
                left = deadline - time.monotonic()
                if left <= 0.0:
                    break
                self._news.wait(left)
            self._awaited.clear()

    def _discover(self) -> None:
        """Subscribe to the poses of robots that have appeared."""
        self._discovered = time.monotonic()
        try:
            topics = published_topics()
        except MASTER_ERRORS:  # known robots still publish their poses
            return
        for topic, kind in topics.items():
            if (
                kind == POSE_TYPE
                and topic.endswith("/amcl_pose")
                and topic != self._own_topic
                and topic not in self._subscribers
            ):
                self._awaited.add(_robot_of(topic))
                self._subscribers[topic] = rospy.Subscriber(
                    topic, PoseWithCovarianceStamped, self._on_other, topic, queue_size=1
                )

    # ---- the interface of the actions --------------------------------------------------------

    def await_news(self, seconds: float) -> None:
        """Sleep until a message arrives from the robot, at most ``seconds`` of wall time."""
        with self._news:
            self._news.wait(seconds)

    def now(self) -> float:
        """Seconds of ROS time, which continue from the same value if ROS time goes back."""
        return ROS_CLOCK.seconds()

    def pose(self) -> Pose:
        """The pose of the robot."""
        with self._news:
            assert self._pose is not None, "connect() first"
            return self._pose

    def others(self) -> Dict[str, Pose]:
        """The last known poses of the other robots, by name."""
        if time.monotonic() - self._discovered > DISCOVERY_PERIOD:
            self._discover()
        with self._news:
            return dict(self._others)

    def temperature(self) -> float:
        """The measured temperature in degrees Celsius."""
        with self._news:
            assert self._temperature is not None, "connect() first"
            return self._temperature

    def go(self, goal: Pose) -> None:
        """Start driving to a pose."""
        message = MoveBaseGoal()
        message.target_pose.header.frame_id = "map"
        message.target_pose.header.stamp = rospy.Time.now()
        message.target_pose.pose = pose_message(goal)
        with self._news:
            self._goal_number += 1
            number = self._goal_number
            self._arrived, self._trouble = None, ""
            self._heard = _moment()
        # the client only holds a weak reference to the handle
        self._handle = self._client.send_goal(
            message, transition_cb=lambda handle: self._on_transition(handle, number)
        )

    def arrived(self) -> Optional[bool]:
        """None while driving; afterwards whether the last goal was reached."""
        with self._news:
            silent = min(now - then for now, then in zip(_moment(), self._heard))
            if self._arrived is None and silent > SILENCE_DEADLINE:
                self._arrived = False
                self._trouble = "move_base has been silent for %d s" % silent
            return self._arrived

    def trouble(self) -> str:
        """Why the last goal was not reached."""
        with self._news:
            return self._trouble

    def stop(self) -> None:
        """Drop the goal."""
        with self._news:
            under_way, self._goal_number = self._arrived is None, self._goal_number + 1
            self._arrived, self._trouble = False, "cancelled"
        if under_way and self._handle is not None:
            self._handle.cancel()


_lock = threading.Lock()
_clients: Dict[str, BaseClient] = {}


def client_of(robot: str) -> BaseClient:
    """The client of a robot, created once per process."""
    with _lock:
        if robot not in _clients:
            _clients[robot] = BaseClient(robot)
        return _clients[robot]


def _moment() -> Tuple[float, float]:
    """The present in wall time and in ROS time: neither a slow nor a fast simulation counts as
    silence."""
    return time.monotonic(), ROS_CLOCK.seconds()


def carry_out(
    steps: patrol.ActionSteps,
    client: BaseClient,
    place: str,
    feedback: Feedback,
    is_cancelled: IsCancelled,
) -> Optional[str]:
    """Run the steps of an action until it ends or is cancelled; the feedback is the elapsed time in
    seconds."""
    start, reported, said = client.now(), -1, ""
    while not rospy.is_shutdown():
        if is_cancelled():
            break
        try:
            text = next(steps)
        except StopIteration as done:
            return done.value
        seconds = int(client.now() - start)
        if seconds != reported:
            reported = seconds
            feedback(seconds)
        if text.partition(",")[0] != said.partition(",")[0]:
            said = text
            rospy.logdebug("%s in %s: %s", client.name, place, text)
        client.await_news(0.2)
    steps.close()
    client.stop()
    return None
