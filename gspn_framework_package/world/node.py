"""The world as a ROS node: one process simulates the room and the robots' bodies, sensors and
navigation.

``docs/ros_interface.md`` lists what it serves, publishes and subscribes to.

Private parameters: ``room`` (file), ``robots`` (a number N, for robot_1 to robot_N, or names
separated by commas), ``real_time_factor`` (1 is real time, 0 as fast as possible), ``gui``,
``seed`` (of the times at which people come), ``duration`` (seconds of world time, 0 for no limit),
``record`` (file to record the run in, for ``gspn film``), ``navigation`` and ``localisation``
(true, or false: ``move_base``, or ``amcl_pose`` and where the odometry is in the map, come from
nodes of the user).
"""

from __future__ import annotations

import json
import queue
import sys
import time
from typing import Any, Callable, Dict, List, Optional

import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan, Temperature
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage

from gspn_framework_package.formats.source import read_text
from gspn_framework_package.model.errors import GspnError, InputError
from gspn_framework_package.ros.options import launched_file
from gspn_framework_package.world import messages
from gspn_framework_package.world.driving_team import CONTROL_PERIOD, DrivingTeam
from gspn_framework_package.world.move_base import MAP_FRAME, MoveBase
from gspn_framework_package.world.parameters import number_parameter, robot_names
from gspn_framework_package.world.recording import Recorder
from gspn_framework_package.world.referee import Referee
from gspn_framework_package.world.room import Room
from gspn_framework_package.world.room_file import load_room

STATE_PERIOD = 0.1
"""Seconds of wall time between two messages on ``/world/state``."""

SCAN_EVERY = 2
"""Control periods between two scans."""


class _Robot:
    """The ROS side of one robot.

    :param navigation: serve ``move_base``.
    :param localisation: publish ``amcl_pose``, and where the odometry is in the map.

    :ivar base: its ``move_base``, if it has one.
    """

    def __init__(
        self,
        name: str,
        team: DrivingTeam,
        hand_off: Callable[[Callable[[], None]], None],
        navigation: bool,
        localisation: bool,
    ) -> None:
        self.name = name
        self._team = team
        self.base = MoveBase(name, team, hand_off) if navigation else None
        self._odometry = self._publisher("odom", Odometry)
        self._pose = (
            self._publisher("amcl_pose", PoseWithCovarianceStamped, latch=True)
            if localisation
            else None
        )
        self._temperature = self._publisher("temperature", Temperature)
        self._scan = self._publisher("scan", LaserScan)
        rospy.Subscriber(
            "/%s/cmd_vel" % name,
            Twist,
            lambda twist: hand_off(lambda: team.teleoperate(name, twist.linear.x, twist.angular.z)),
            queue_size=5,
        )

    def _publisher(self, topic: str, kind: Any, latch: bool = False) -> Any:
        return rospy.Publisher("/%s/%s" % (self.name, topic), kind, queue_size=5, latch=latch)

    def publish(self, stamp: rospy.Time, scan: bool) -> List[Any]:
        """Publish the robot's sensor data; return the transforms of its frames."""
        physics, name = self._team.physics, self.name
        pose, odometry = physics.pose(name), physics.odometry(name)
        odom, base = name + "/odom", name + "/base_footprint"
        self._odometry.publish(messages.odometry_message(odometry, stamp, odom, base))
        self._temperature.publish(
            messages.temperature_message(physics.temperature(name), stamp, base)
        )
        if scan and self._scan.get_num_connections():
            self._scan.publish(
                messages.scan_message(physics.scan(name), self._team.room.robot, stamp, base)
            )
        transforms = [messages.transform(odometry[0], stamp, odom, base)]
        if self._pose is not None:
            self._pose.publish(messages.stamped_pose(pose, stamp, MAP_FRAME))
            moved = messages.correction(pose, odometry[0])
            transforms.append(messages.transform(moved, stamp, MAP_FRAME, odom))
        return transforms

    def state(self) -> Dict[str, Any]:
        """The state of the robot for the page."""
        pose = self._team.physics.pose(self.name)
        navigator = self._team.navigators[self.name]
        goal = self.base.target if self.base is not None else None
        return {
            "pose": [round(pose.x, 3), round(pose.y, 3), round(pose.yaw, 3)],
            "goal": [round(goal.x, 3), round(goal.y, 3), round(goal.yaw, 3)] if goal else None,
            "path": [[round(x, 2), round(y, 2)] for x, y in navigator.path],
            "status": navigator.status.value,
            "reason": navigator.reason,
            "temperature": round(self._team.physics.temperature(self.name), 2),
        }


class WorldNode:
    """Steps the world and connects it to ROS; see the module.

    :param robots: names of the robots, which are also their namespaces.
    :param real_time_factor: seconds of world time per second of wall time; 0 for as fast as
        possible.
    :param gui: open PyBullet's window.
    :param seed: seed of the times at which people come.
    :param navigation: serve ``move_base`` for every robot.
    :param localisation: publish ``amcl_pose`` for every robot, and where its odometry is in the
        map.
    """

    def __init__(
        self,
        room: Room,
        robots: List[str],
        real_time_factor: float = 1.0,
        gui: bool = False,
        seed: int = 0,
        navigation: bool = True,
        localisation: bool = True,
    ) -> None:
        self._factor = real_time_factor
        self.team = DrivingTeam(room, robots, gui=gui, seed=seed)
        self.referee = Referee(self.team)
        self._inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._clock = rospy.Publisher("/clock", Clock, queue_size=1)
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=5)
        self._map = rospy.Publisher("/map", OccupancyGrid, queue_size=1, latch=True)
        self._room = rospy.Publisher("/world/room", String, queue_size=1, latch=True)
        self._state = rospy.Publisher("/world/state", String, queue_size=2)
        self._report = rospy.Publisher("/world/referee", String, queue_size=1, latch=True)
        self._robots = [
            _Robot(name, self.team, self._inbox.put, navigation, localisation) for name in robots
        ]
        self._map.publish(messages.map_message(self.team.grid, MAP_FRAME))
        self._room.publish(json.dumps(room.as_json()))
        self._somebody = False
        self._person: Any = None
        if room.people:
            self._person = rospy.Publisher("/person", Bool, queue_size=5, latch=True)
            self._person.publish(Bool(False))
        self.recorder: Optional[Recorder] = None
        self._steps = 0
        self._reported = 0.0
        self._state_time = 0.0
        self.real_time_factor = 0.0

    def step(self) -> None:
        """Run what the ROS threads handed off, advance one control period, and publish changes."""
        while True:
            try:
                self._inbox.get_nowait()()
            except queue.Empty:
                break
        self.team.step()
        self.referee.watch()
        self._report_people()
        if self.recorder is not None:
            self.recorder.record()
        self._steps += 1
        stamp = messages.stamp_of(self.team.time)
        self._clock.publish(Clock(stamp))
        transforms: List[Any] = []
        for robot in self._robots:
            if robot.base is not None:
                robot.base.update()
            transforms += robot.publish(stamp, self._steps % SCAN_EVERY == 0)
        self._tf.publish(TFMessage(transforms))
        wall = time.monotonic()
        if wall - self._state_time >= STATE_PERIOD:
            self._state_time = wall
            self._state.publish(json.dumps(self.state()))
        if wall - self._reported >= 1.0:
            self._reported = wall
            self._report.publish(json.dumps(self.referee.report()))

    def _report_people(self) -> None:
        """Publish whether anybody is in the room when that changes."""
        somebody = any(walker.at is not None for walker in self.team.people)
        if somebody != self._somebody:
            self._somebody = somebody
            self._person.publish(Bool(somebody))

    def state(self) -> Dict[str, Any]:
        """The current state for the page."""
        heat = self.team.room.temperature
        return {
            "time": round(self.team.time, 3),
            "real_time_factor": round(self.real_time_factor, 2),
            "robots": {robot.name: robot.state() for robot in self._robots},
            "people": [
                {
                    "at": [round(walker.at[0], 3), round(walker.at[1], 3)],
                    "radius": walker.person.radius,
                    "color": walker.person.color,
                }
                for walker in self.team.people
                if walker.at is not None
            ],
            "hot_spots": [
                {"at": spot.at(self.team.time), "radius": spot.radius, "excess": spot.excess}
                for spot in heat.hot_spots
                if spot.burns(self.team.time)
            ],
        }

    def spin(self, duration: float = 0.0) -> None:
        """Step until shutdown, or for ``duration`` seconds of world time."""
        self._clock.publish(Clock(messages.stamp_of(self.team.time)))
        due = time.monotonic()
        window, window_time = due, self.team.time
        while not rospy.is_shutdown() and (duration <= 0.0 or self.team.time < duration):
            self.step()
            wall = time.monotonic()
            if wall - window >= 1.0:
                self.real_time_factor = (self.team.time - window_time) / (wall - window)
                window, window_time = wall, self.team.time
            if self._factor > 0.0:
                due += CONTROL_PERIOD / self._factor
                if due > wall:
                    time.sleep(due - wall)
                elif wall - due > 0.5:
                    # too slow for the requested factor; do not try to catch up later
                    due = wall
        self._report.publish(json.dumps(self.referee.report()))


def main() -> int:
    """Run the node; return the exit code."""
    rospy.init_node("world")
    try:
        room_file = rospy.get_param("~room", "")
        if not room_file:
            raise InputError("no room file", element="parameter ~room")
        room_file = launched_file(str(room_file), "parameter ~room")
        room = load_room(room_file)
        robots = robot_names(rospy.get_param("~robots", "robot_1"))
        if len(robots) > len(room.spawn):
            raise InputError(
                "%d robots, but %d places to start in" % (len(robots), len(room.spawn)),
                file=room_file,
                element="spawn",
                hint="add poses, or start fewer robots",
            )
        factor, duration = (
            number_parameter("real_time_factor", 1.0),
            number_parameter("duration", 0.0),
        )
        gui, seed = bool(rospy.get_param("~gui", False)), int(number_parameter("seed", 0))
        navigation, localisation = (
            bool(rospy.get_param("~" + part, True)) for part in ("navigation", "localisation")
        )
        node = WorldNode(room, robots, factor, gui, seed, navigation, localisation)
        speed = "%g times real time" % factor if factor else "as fast as possible"
        rospy.loginfo("world: '%s' with %d robots, %s", room.name, len(robots), speed)
        recording = str(rospy.get_param("~record", ""))
        if recording:
            text = read_text(room_file)
            node.recorder = Recorder(recording, text, node.team)
        try:
            node.spin(duration)
        finally:
            if node.recorder is not None:
                node.recorder.close()
    except GspnError as error:
        rospy.logfatal("world: %s", error)
        return error.exit_code
    except rospy.ROSInterruptException:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
