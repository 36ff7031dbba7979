"""The customers and the batteries of plans/warehouse as a ROS node (see :mod:`.shop`).

It publishes ``/orders`` (std_msgs/String, JSON with ``id``, ``shelf`` and ``pose``), and for each
robot that has a pose ``ROBOT/battery`` (sensor_msgs/BatteryState, twice a second). It subscribes to
every ``ROBOT/amcl_pose``. Its time is that of ROS.

Private parameters: ``shop`` (file), ``robots`` (a number N, for robot_1 to robot_N, or names
separated by commas), ``seed``, ``orders_for`` (seconds after which there are no more orders, 0 for
no limit).
"""

from __future__ import annotations

import json
import threading
import time
from typing import Any, Dict

import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String

from gspn_framework_package.model.errors import GspnError, InputError
from gspn_framework_package.ros.options import launched_file
from gspn_framework_package.ros.ros_clock import ROS_CLOCK
from gspn_framework_package.world.messages import pose_from
from gspn_framework_package.world.parameters import number_parameter, robot_names
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.shop import Shop, load_settings

SHOP_PERIOD = 0.1
"""Seconds of wall time between two readings of the clock."""

BATTERY_PERIOD = 0.5
"""Seconds of ROS time between two messages of a battery."""


class ShopNode:
    """Connects a shop to ROS.

    :param robots: names of the robots, which are also their namespaces.
    :param orders_for: seconds of ROS time after which there are no more orders; 0 for no limit.
    """

    def __init__(self, shop: Shop, robots: Any, orders_for: float = 0.0) -> None:
        self._shop = shop
        self._orders_for = orders_for
        self._lock = threading.Lock()
        self._poses: Dict[str, Pose] = {}
        self._orders = rospy.Publisher("/orders", String, queue_size=100)
        self._batteries = {
            name: rospy.Publisher("/%s/battery" % name, BatteryState, queue_size=1)
            for name in robots
        }
        for name in robots:
            topic, kind = "/%s/amcl_pose" % name, PoseWithCovarianceStamped
            rospy.Subscriber(topic, kind, self._on_pose, name, queue_size=1)
        self._reported = 0.0

    def _on_pose(self, message: Any, robot: str) -> None:
        pose = pose_from(message.pose.pose)
        with self._lock:
            self._poses[robot] = pose

    def step(self, begin: float, now: float) -> None:
        """Publish what happens until ``now``; the shop opened at ``begin`` (s of ROS time)."""
        since = now - begin
        is_open = not self._orders_for or since < self._orders_for
        for order in self._shop.orders(since, is_open):
            self._orders.publish(String(json.dumps(order.to_json())))
        if now - self._reported >= BATTERY_PERIOD:
            self._reported = now
            with self._lock:
                poses = dict(self._poses)
            for robot, pose in poses.items():
                message = BatteryState(
                    percentage=self._shop.battery(robot, pose, now), present=True
                )
                message.header.stamp = rospy.get_rostime()
                self._batteries[robot].publish(message)

    def spin(self) -> None:
        """Publish until shutdown."""
        begin = 0.0
        while not rospy.is_shutdown():
            now = ROS_CLOCK.seconds()  # continues from the same value if ROS time goes back
            if rospy.get_time() > 0.0:
                begin = begin or now
                self.step(begin, now)
            time.sleep(SHOP_PERIOD)


def main() -> int:
    """Run the node; return the exit code."""
    rospy.init_node("shop")
    try:
        file = rospy.get_param("~shop", "")
        if not file:
            raise InputError("no file", element="parameter ~shop")
        settings = load_settings(launched_file(str(file), "parameter ~shop"))
        robots = robot_names(rospy.get_param("~robots", "robot_1"))
        seed = int(number_parameter("seed", 0))
        # a new shop needs new ids, for a team that has seen those of an earlier one
        shop = Shop(settings, seed, "order_%x" % int(time.time()))
        ShopNode(shop, robots, number_parameter("orders_for", 0.0)).spin()
    except GspnError as error:
        rospy.logfatal("shop: %s", error)
        return error.exit_code
    except rospy.ROSInterruptException:
        pass
    return 0
