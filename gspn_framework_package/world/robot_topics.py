"""The topics of one simulated robot, which are those of a TurtleBot3 in Gazebo, and more.

``docs/world.md`` compares the two.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState, LaserScan, Temperature

from gspn_framework_package.formats.source import read_bytes, read_text
from gspn_framework_package.world import messages
from gspn_framework_package.world.driving_team import CONTROL_STEPS, DrivingTeam
from gspn_framework_package.world.move_base import MAP_FRAME, MoveBase
from gspn_framework_package.world.physics import TIME_STEP
from gspn_framework_package.world.robot_urdf import FIXED_FRAMES, robot_urdf
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.urdf import read_urdf
from gspn_framework_package.world.urdf_robot import height_of

MESSAGE_STEPS = 4
"""Physics steps between two messages of odometry: 30 a second."""

SCAN_STEPS = round(messages.SCAN_PERIOD / TIME_STEP)
"""Physics steps between two scans."""

_GRAVITY = 9.81


class Sensing(NamedTuple):
    """The topics that robots publish, and their accuracy.

    :ivar navigation: serve ``move_base``.
    :ivar localisation: publish ``amcl_pose``, and where the odometry is in the map.
    :ivar scan_noise: standard deviation of the ranges of a scan, metres.
    :ivar odom_drift: standard deviation of the error in each wheel's circumference that the
        odometry assumes, as a fraction of the circumference.
    :ivar seed: of both.
    """

    navigation: bool = True
    localisation: bool = True
    scan_noise: float = 0.0
    odom_drift: float = 0.0
    seed: int = 0


class RobotTopics:
    """The ROS side of one robot.

    :param hand_off: called from ROS threads with a function to run in the world's thread.

    :ivar base: its ``move_base``, if it has one.
    """

    def __init__(
        self,
        name: str,
        team: DrivingTeam,
        hand_off: Callable[[Callable[[], None]], None],
        sensing: Sensing,
    ) -> None:
        self.name = name
        self._team = team
        self._sensing = sensing
        self.base = MoveBase(name, team, hand_off) if sensing.navigation else None
        self._odometry = self._publisher("odom", Odometry)
        self._imu = self._publisher("imu", Imu)
        self._joints = self._publisher("joint_states", JointState)
        self._temperature = self._publisher("temperature", Temperature)
        self._scan = self._publisher("scan", LaserScan)
        self._velocity = (-1.0, 0.0, 0.0)  # and the time
        self._pose: Any = None
        if sensing.localisation:
            self._pose = self._publisher("amcl_pose", PoseWithCovarianceStamped, latch=True)
            self._subscribe("initialpose", PoseWithCovarianceStamped, self._compare_pose)
        self._subscribe(
            "cmd_vel",
            Twist,
            lambda twist: hand_off(lambda: team.teleoperate(name, twist.linear.x, twist.angular.z)),
        )
        description = "/%s/robot_description" % name
        if not rospy.has_param(description):
            rospy.set_param(description, self._description())
            rospy.on_shutdown(lambda: rospy.delete_param(description))

    def _publisher(self, topic: str, kind: Any, latch: bool = False) -> Any:
        return rospy.Publisher("/%s/%s" % (self.name, topic), kind, queue_size=5, latch=latch)

    def _subscribe(self, topic: str, kind: Any, heard: Callable[[Any], None]) -> None:
        rospy.Subscriber("/%s/%s" % (self.name, topic), kind, heard, queue_size=5)

    def _compare_pose(self, message: PoseWithCovarianceStamped) -> None:
        """Say that localisation, which is exact, does not follow a wrong ``initialpose``."""
        pose = self._team.physics.pose(self.name)
        away = pose.distance((message.pose.pose.position.x, message.pose.pose.position.y))
        if not away < self._team.room.robot.radius:
            rospy.logwarn(
                "world: the initialpose of %s is %.2f m away from it; amcl_pose is the true pose",
                self.name,
                away,
            )

    def fixed_frames(self, stamp: rospy.Time) -> List[Any]:
        """The transforms of the frames on the robot."""
        return [
            messages.transform(
                Pose(0.0, 0.0), stamp, self._frame(below), self._frame(frame), height
            )
            for frame, (below, height) in self._fixed_frames().items()
        ]

    def _description(self) -> str:
        kind = self._team.room.robot
        return read_text(kind.urdf) if kind.urdf else robot_urdf(kind)

    def _fixed_frames(self) -> Mapping[str, Tuple[str, float]]:
        """The frames that the world publishes; robot_state_publisher publishes those in a user's
        URDF."""
        kind = self._team.room.robot
        if not kind.urdf:
            return FIXED_FRAMES
        urdf = read_urdf(read_bytes(kind.urdf), kind.urdf)
        first = next(iter(urdf.poses))
        frames = {
            frame: (below if below in urdf.links else first, height)
            for frame, (below, height) in FIXED_FRAMES.items()
            if frame not in (*urdf.links, "base_link")
        }
        if "base_footprint" not in urdf.links:
            frames[first] = ("base_footprint", height_of(urdf, kind))
        return frames

    def _frame(self, name: str) -> str:
        return "%s/%s" % (self.name, name)

    def moving_frames(self, stamp: rospy.Time) -> List[Any]:
        """Where the robot is in its odometry and, with localisation, where that is in the map."""
        physics, name = self._team.physics, self.name
        odometry = physics.odometry(name)[0]
        odom, base = self._frame("odom"), self._frame("base_footprint")
        transforms = [messages.transform(odometry, stamp, odom, base)]
        if self._pose is not None:
            moved = messages.correction(physics.pose(name), odometry)
            transforms.append(messages.transform(moved, stamp, MAP_FRAME, odom))
        return transforms

    def publish(self, stamp: rospy.Time, step: int) -> None:
        """Publish what the robot measures.

        :param step: number of the physics step, a multiple of :data:`MESSAGE_STEPS`.
        """
        physics, name = self._team.physics, self.name
        base = self._frame("base_footprint")
        if self._odometry.get_num_connections():
            odometry, odom = physics.odometry(name), self._frame("odom")
            self._odometry.publish(messages.odometry_message(odometry, stamp, odom, base))
        if self._joints.get_num_connections():
            wheels = physics.wheels(name)
            names = self._team.room.robot.wheel_joints
            self._joints.publish(messages.joint_message(names, wheels, stamp))
        if self._imu.get_num_connections():
            self._publish_imu(stamp)
        dark = self._team.faults.has("lidar", name)
        if step % SCAN_STEPS == 0 and self._scan.get_num_connections() and not dark:
            ranges = self._noisy(physics.scan(name), step)
            frame = self._frame("base_scan")
            self._scan.publish(messages.scan_message(ranges, self._team.room.robot, stamp, frame))
        if step % CONTROL_STEPS == 0:
            self._temperature.publish(
                messages.temperature_message(physics.temperature(name), stamp, base)
            )
            if self._pose is not None:
                pose = messages.stamped_pose(physics.pose(name), stamp, MAP_FRAME)
                self._pose.publish(pose)

    def _publish_imu(self, stamp: rospy.Time) -> None:
        """Publish the turn rate, and the mean acceleration since the last message."""
        pose = self._team.physics.pose(self.name)
        x, y, turn_rate = self._team.physics.velocity(self.name)
        (time, x_before, y_before), self._velocity = self._velocity, (self._team.time, x, y)
        seconds, ax, ay = self._team.time - time, 0.0, 0.0
        if 0.0 < seconds < 1.5 * MESSAGE_STEPS * TIME_STEP:  # else nobody has listened since then
            ax, ay = (x - x_before) / seconds, (y - y_before) / seconds
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        acceleration = Vector3(ax * cos + ay * sin, ay * cos - ax * sin, _GRAVITY)
        self._imu.publish(
            messages.imu_message(pose.yaw, turn_rate, acceleration, stamp, self._frame("imu_link"))
        )

    def _noisy(self, ranges: List[float], step: int) -> List[float]:
        """The ranges with noise, which depends on the seed, the robot and the step alone."""
        if self._sensing.scan_noise == 0.0:
            return ranges
        kind = self._team.room.robot
        number = self._team.robots.index(self.name)
        source = np.random.default_rng([self._sensing.seed, number, step])
        noisy = np.array(ranges) + source.normal(0.0, self._sensing.scan_noise, len(ranges))
        seen = np.isfinite(noisy)
        noisy[seen] = np.clip(noisy[seen], kind.radius, kind.scan_range)
        return [float(value) for value in noisy]

    def state(self) -> Dict[str, Any]:
        """The state of the robot for the page."""
        pose = self._team.physics.pose(self.name)
        navigator = self._team.navigators[self.name]
        goal: Optional[Pose] = self.base.target if self.base is not None else None
        return {
            "pose": [round(pose.x, 3), round(pose.y, 3), round(pose.yaw, 3)],
            "goal": [round(goal.x, 3), round(goal.y, 3), round(goal.yaw, 3)] if goal else None,
            "path": [[round(x, 2), round(y, 2)] for x, y in navigator.path],
            "status": navigator.status.value,
            "reason": navigator.reason,
            "temperature": round(self._team.physics.temperature(self.name), 2),
        }
