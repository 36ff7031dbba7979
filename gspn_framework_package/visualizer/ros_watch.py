"""The page's connection to a team on ROS."""

from __future__ import annotations

import json
from typing import Any, Callable, List, Optional, Set, Type

import genpy
import rospy
from std_msgs.msg import String

from gspn_framework_package.model.plan import Plan
from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.ros.messages import FIRED_TOPIC
from gspn_framework_package.ros.service_line import SealedOrders, ServiceLine
from gspn_framework_package.ros.transport.registration import (
    MASTER_ERRORS,
    published_topics,
)
from gspn_framework_package.team.operator_client import UnreachableError
from gspn_framework_package.team.seal import TeamKey
from gspn_framework_package.visualizer.live_comparison import Departures
from gspn_framework_package.visualizer.ros_poses import RosPoses
from gspn_framework_package.visualizer.ros_prediction import RosPrediction
from gspn_framework_package.visualizer.team_connection import STATUS_TIME

_ACTIVITY = "/activity"


class RosConnection:
    """A :class:`~gspn_framework_package.visualizer.team_connection.TeamConnection` on one ROS
    master; a robot's address is its namespace.

    Subscribes to ``/fired_transitions`` (gspn_framework_package/FiredTransition), to every existing
    ``NAMESPACE/activity`` (std_msgs/String), to ``/world/room`` and ``/world/state``
    (std_msgs/String), and without such a world to ``/map`` and the poses of the robots. Calls
    ``NAMESPACE/command`` (gspn_framework_package/Command).

    :param key: the key of the team, to give orders; None if it has none.
    """

    says = "a team of robots on ROS"
    where = "on this master"
    orders = True

    def __init__(self, key: Optional[TeamKey] = None) -> None:
        self._orders = SealedOrders(key, "the page")
        self._found: Set[str] = set()
        self._subscribers: List[rospy.Subscriber] = []

    def open(self, seen: Callable[..., None]) -> None:
        """See :class:`TeamConnection`."""
        self._seen = seen
        self._prediction = RosPrediction()
        self._subscribe(FIRED_TOPIC, FiredTransition, lambda message: seen("fired", message))
        self._poses = RosPoses(self._subscribe, seen)
        for what in ("room", "state"):
            name = "world" if what == "state" else what
            self._subscribe("/world/" + what, String, self._with_json(name))

    def close(self) -> None:
        """See :class:`TeamConnection`."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._subscribers = []

    def find(self) -> Set[str]:
        """See :class:`TeamConnection`."""
        try:
            published = published_topics(STATUS_TIME)
        except MASTER_ERRORS as error:
            raise UnreachableError("the ROS master does not answer (%s)" % error) from None
        for topic, kind in published.items():
            namespace = topic[: -len(_ACTIVITY)]
            if topic.endswith(_ACTIVITY) and kind == String._type and namespace not in self._found:
                self._found.add(namespace)
                self._subscribe(topic, String, self._with_json("activity", namespace))
        self._poses.find(published, self._found)
        return set(self._found)

    def line(self, seconds: float) -> ServiceLine:
        """See :class:`TeamConnection`."""
        return ServiceLine(seconds, self._orders)

    def label(self, address: str) -> str:
        """See :class:`TeamConnection`."""
        return address

    def why_unheard(self) -> str:
        """See :class:`TeamConnection`."""
        return (
            " on %s (is the topic remapped, or can this machine not reach the robots?)"
            % rospy.resolve_name(FIRED_TOPIC)
        )

    def report(self, text: str) -> None:
        """See :class:`TeamConnection`."""
        rospy.logwarn_throttle(5.0, text)

    def report_departures(self, plan: Plan, run: str, found: Departures) -> None:
        """See :class:`TeamConnection`."""
        self._prediction.publish(plan, run, found)

    def _with_json(self, *what: str) -> Callable[[String], None]:
        """A callback that passes on the JSON content of a message."""

        def callback(message: String) -> None:
            try:
                reported: Any = json.loads(message.data)
            except ValueError as error:
                self.report("the page: %s is not JSON (%s)" % (" of ".join(what), error))
                return
            self._seen(*what, reported)

        return callback

    def _subscribe(
        self, topic: str, kind: Type[genpy.Message], callback: Callable[[Any], None]
    ) -> None:
        self._subscribers.append(
            rospy.Subscriber(topic, kind, callback, queue_size=10_000, tcp_nodelay=True)
        )
