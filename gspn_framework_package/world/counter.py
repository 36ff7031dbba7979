"""Handing over an order as an action; plans/warehouse uses it at the counter."""

from __future__ import annotations

import time
from typing import Any, Mapping, Optional

import rospy
from std_msgs.msg import String

from gspn_framework_package.execution.actions import Cancellation
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, subscribers

_CONNECTED_AFTER = 3.0
"""Seconds within which the subscribers of a new topic are connected."""

_LOOK_EVERY = 0.05


class HandOver:
    """Publishes the id of the robot's order (``std_msgs/String``).

    :param topic: where.
    :param without: the transition of a robot that has no order any more, because it was cancelled.
    """

    def __init__(self, topic: str, without: str) -> None:
        self._without = without
        self._topic = rospy.resolve_name(topic)
        self._publisher = rospy.Publisher(topic, String, queue_size=100, tcp_nodelay=True)
        self._opened_at = time.monotonic()

    def __call__(self, data: Mapping[str, Any], is_cancelled: Cancellation) -> Optional[str]:
        """Publish it; the policy, or the place's only transition, follows."""
        if "task.id" not in data:
            return self._without
        # subscribers that are not connected yet would miss it
        give_up = self._opened_at + _CONNECTED_AFTER
        while time.monotonic() < give_up and not self._is_connected():
            if is_cancelled.wait(_LOOK_EVERY):
                return None
        self._publisher.publish(data["task.id"])
        return None

    def _is_connected(self) -> bool:
        try:
            return self._publisher.get_num_connections() >= len(subscribers(self._topic))
        except MASTER_ERRORS:
            return False
