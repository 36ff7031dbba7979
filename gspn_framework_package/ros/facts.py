"""Publishes on ROS what a robot's host says to whoever watches."""

from __future__ import annotations

import json
from typing import Any, Dict

import rospy
from std_msgs.msg import String

from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.ros.messages import FIRED_TOPIC, fired_message
from gspn_framework_package.ros.transport.eager_publisher import eager_publisher


class RosFacts:
    """Publishes ``/fired_transitions`` (gspn_framework_package/FiredTransition) and
    ``NAMESPACE/activity`` (std_msgs/String, JSON: robot, run, plan (its hash), place, state, visit,
    attempt, waits_for, needs_operator, feedback, ended, finished, fault; at most ten a second, the
    last one latched).

    :param namespace: absolute namespace of the robot.
    """

    def __init__(self, namespace: str) -> None:
        self._fired = eager_publisher(FIRED_TOPIC, FiredTransition)
        self._activity = rospy.Publisher(
            rospy.names.ns_join(namespace, "activity"), String, latch=True, queue_size=10
        )

    def tell_firing(self, fields: Dict[str, Any]) -> None:
        """See :class:`Carrier`."""
        self._fired.publish(fired_message(fields))

    def is_watched(self) -> bool:
        """See :class:`Carrier`."""
        return bool(self._activity.get_num_connections())

    def tell_activity(self, activity: Dict[str, Any]) -> None:
        """See :class:`Carrier`."""
        self._activity.publish(json.dumps(activity))
