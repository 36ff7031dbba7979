"""Converts poses, scans and rooms to ROS messages, and poses back."""

from __future__ import annotations

import math
from typing import Any, List, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import (
    Point,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    Vector3,
)
from geometry_msgs.msg import Pose as PoseMessage
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import LaserScan, Temperature

from gspn_framework_package.world.grid import RESOLUTION, Grid
from gspn_framework_package.world.room import Pose, RobotType


def stamp_of(seconds: float) -> rospy.Time:
    """The world's time for messages; it starts at 1 s, since 0 means "no time yet" in ROS."""
    return rospy.Time.from_sec(1.0 + seconds)


def quaternion(yaw: float) -> Quaternion:
    """A rotation about the vertical axis by ``yaw`` radians."""
    return Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def pose_message(pose: Pose) -> PoseMessage:
    """A pose on the floor."""
    return PoseMessage(Point(pose.x, pose.y, 0.0), quaternion(pose.yaw))


def pose_from(message: PoseMessage) -> Pose:
    """The pose on the floor in a message.

    :raises ValueError: it has numbers that are not finite, or an invalid orientation.
    """
    q = message.orientation
    numbers = (message.position.x, message.position.y, q.x, q.y, q.z, q.w)
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError("the pose has numbers that are not finite")
    if q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w < 1e-6:
        raise ValueError("the orientation is not a quaternion: its length is 0")
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    return Pose(message.position.x, message.position.y, yaw)


def stamped_pose(pose: Pose, stamp: rospy.Time, frame: str) -> PoseWithCovarianceStamped:
    """A pose as localisation publishes it. It is exact, so its covariance is 0."""
    message = PoseWithCovarianceStamped()
    message.header.stamp, message.header.frame_id = stamp, frame
    message.pose.pose = pose_message(pose)
    return message


def odometry_message(
    state: Tuple[Pose, float, float], stamp: rospy.Time, frame: str, child: str
) -> Odometry:
    """The odometry of the wheels: pose, speed, turn rate."""
    pose, speed, turn_rate = state
    message = Odometry(child_frame_id=child)
    message.header.stamp, message.header.frame_id = stamp, frame
    message.pose.pose = pose_message(pose)
    message.twist.twist.linear.x = speed
    message.twist.twist.angular.z = turn_rate
    return message


def transform(pose: Pose, stamp: rospy.Time, frame: str, child: str) -> TransformStamped:
    """The pose of the frame ``child`` in ``frame``."""
    message = TransformStamped(child_frame_id=child)
    message.header.stamp, message.header.frame_id = stamp, frame
    message.transform.translation = Vector3(pose.x, pose.y, 0.0)
    message.transform.rotation = quaternion(pose.yaw)
    return message


def correction(true: Pose, odometry: Pose) -> Pose:
    """The pose of the odometry frame in the map, which is localisation's correction."""
    yaw = true.yaw - odometry.yaw
    cos, sin = math.cos(yaw), math.sin(yaw)
    return Pose(
        true.x - (odometry.x * cos - odometry.y * sin),
        true.y - (odometry.x * sin + odometry.y * cos),
        math.remainder(yaw, math.tau),
    )


def scan_message(ranges: List[float], robot: RobotType, stamp: rospy.Time, frame: str) -> LaserScan:
    """One revolution of the scanner, counter-clockwise from straight ahead."""
    step = math.tau / len(ranges)
    message = LaserScan(
        angle_min=0.0,
        angle_max=math.tau - step,
        angle_increment=step,
        range_min=robot.radius,
        range_max=robot.scan_range,
        ranges=ranges,
    )
    message.header.stamp, message.header.frame_id = stamp, frame
    return message


def temperature_message(celsius: float, stamp: rospy.Time, frame: str) -> Temperature:
    """The temperature reading, which is exact."""
    message = Temperature(temperature=celsius, variance=0.0)
    message.header.stamp, message.header.frame_id = stamp, frame
    return message


def map_message(grid: Grid, frame: str) -> OccupancyGrid:
    """The room as an occupancy grid: 100 for walls and obstacles."""
    message = OccupancyGrid()
    message.header.frame_id = frame
    message.info.resolution = RESOLUTION
    message.info.width, message.info.height = grid.columns, grid.rows
    # the origin is the corner of the first cell
    message.info.origin = pose_message(
        Pose(float(grid.xs[0]) - RESOLUTION / 2, float(grid.ys[0]) - RESOLUTION / 2)
    )
    occupied: Any = np.where(grid.clearance <= 0.0, 100, 0)
    message.data = [int(value) for value in occupied]
    return message
