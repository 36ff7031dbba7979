"""Converts poses, scans and rooms to ROS messages, and poses back."""

from __future__ import annotations

import math
from typing import Any, List, Sequence, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Point as PointMessage
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import (
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    Vector3,
)
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from sensor_msgs.msg import Imu, JointState, LaserScan, Temperature

from gspn_framework_package.model.goal_pose import yaw_of
from gspn_framework_package.model.net import Point
from gspn_framework_package.world.grid import RESOLUTION, Grid
from gspn_framework_package.world.room import Pose, RobotType

SCAN_PERIOD = 0.2
"""Seconds between two revolutions of the laser scanner."""


_UNKNOWN = 1e12
ODOMETRY_COVARIANCE = [
    value if row == column else 0.0
    for row, value in enumerate((1e-5, 1e-5, _UNKNOWN, _UNKNOWN, _UNKNOWN, 1e-3))
    for column in range(6)
]
"""The covariance that Gazebo's differential drive gives: x and y, and the yaw."""


def stamp_of(seconds: float) -> rospy.Time:
    """The world's time for messages; it starts at 1 s, since 0 means "no time yet" in ROS."""
    return rospy.Time.from_sec(1.0 + seconds)


def quaternion(yaw: float) -> Quaternion:
    """A rotation about the vertical axis by ``yaw`` radians."""
    return Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def pose_message(pose: Pose) -> PoseMessage:
    """A pose on the floor."""
    return PoseMessage(PointMessage(pose.x, pose.y, 0.0), quaternion(pose.yaw))


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
    return Pose(message.position.x, message.position.y, yaw_of(q.x, q.y, q.z, q.w))


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
    message.pose.covariance = message.twist.covariance = ODOMETRY_COVARIANCE
    return message


def transform(
    pose: Pose, stamp: rospy.Time, frame: str, child: str, height: float = 0.0
) -> TransformStamped:
    """The pose of the frame ``child`` in ``frame``, ``height`` metres above it."""
    message = TransformStamped(child_frame_id=child)
    message.header.stamp, message.header.frame_id = stamp, frame
    message.transform.translation = Vector3(pose.x, pose.y, height)
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
        scan_time=SCAN_PERIOD,
        ranges=ranges,
    )
    message.header.stamp, message.header.frame_id = stamp, frame
    return message


def imu_message(
    yaw: float, turn_rate: float, acceleration: Vector3, stamp: rospy.Time, frame: str
) -> Imu:
    """The reading of the inertial sensor; ``acceleration`` is in the frame of the robot."""
    message = Imu(
        orientation=quaternion(yaw),
        angular_velocity=Vector3(0.0, 0.0, turn_rate),
        linear_acceleration=acceleration,
    )
    message.header.stamp, message.header.frame_id = stamp, frame
    return message


def joint_message(
    names: Sequence[str], wheels: Sequence[Tuple[float, float]], stamp: rospy.Time
) -> JointState:
    """The angle and speed of the wheels."""
    message = JointState(
        name=list(names),
        position=[angle for angle, _ in wheels],
        velocity=[speed for _, speed in wheels],
    )
    message.header.stamp = stamp
    return message


def path_message(points: Sequence[Point], end: Pose, stamp: rospy.Time, frame: str) -> Path:
    """A path as poses that look along it; at its end the yaw is that of ``end``."""
    message = Path()
    message.header.stamp, message.header.frame_id = stamp, frame
    for (x, y), (to_x, to_y) in zip(points, [*points[1:], *points[-1:]]):
        message.poses.append(
            PoseStamped(message.header, pose_message(Pose(x, y, math.atan2(to_y - y, to_x - x))))
        )
    if points:
        message.poses[-1].pose.orientation = quaternion(end.yaw)
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
