"""The world as a ROS node: one process simulates the room and the robots' bodies, sensors and
navigation.

``docs/ros_interface.md`` lists what it serves, publishes and subscribes to.

Private parameters: ``room`` (file), ``robots`` (a number N, for robot_1 to robot_N, or names
separated by commas), ``real_time_factor`` (1 is real time, 0 as fast as possible), ``gui``,
``seed`` (of the times at which people come, and of the sensors' errors), ``duration`` (seconds of
world time, 0 for no limit),
``record`` (file to record the run in, for ``gspn film``), ``navigation`` and ``localisation``
(true, or false: ``move_base``, or ``amcl_pose`` and where the odometry is in the map, come from
nodes of the user), ``scan_noise`` (metres), ``odom_drift`` (a part of a wheel's circumference),
``clock_rate`` (messages on ``/clock`` in a second of world time; 0 for 100 up to real time and 30
beyond).
"""

from __future__ import annotations

import json
import queue
import sys
import threading
import time
from typing import Any, Callable, Dict, List, Optional

import rospy
from nav_msgs.msg import MapMetaData, OccupancyGrid
from nav_msgs.srv import GetMap, GetMapResponse
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage

from gspn_framework_package.formats.source import read_text
from gspn_framework_package.model.errors import GspnError, InputError
from gspn_framework_package.ros.options import launched_file
from gspn_framework_package.srv import Command, CommandRequest, CommandResponse
from gspn_framework_package.world import messages
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.faults import read_fault
from gspn_framework_package.world.gazebo_services import GazeboServices
from gspn_framework_package.world.move_base import MAP_FRAME
from gspn_framework_package.world.parameters import number_parameter, robot_names
from gspn_framework_package.world.physics import TIME_STEP
from gspn_framework_package.world.recording import Recorder
from gspn_framework_package.world.referee import Referee
from gspn_framework_package.world.robot_topics import MESSAGE_STEPS, RobotTopics, Sensing
from gspn_framework_package.world.room import Room
from gspn_framework_package.world.room_file import load_room

STATE_PERIOD = 0.1
"""Seconds of wall time between two messages on ``/world/state``."""

PAUSED_PERIOD = 0.01
"""Seconds of wall time between two checks for orders while the world is paused."""

CLOCK_RATE = 100.0
"""Messages on ``/clock`` in a second, unless the world is faster than real time: each takes time of
every node."""


class WorldNode:
    """Steps the world and connects it to ROS; see the module.

    :param robots: names of the robots, which are also their namespaces.
    :param sensing: what the robots publish; its seed is also that of the times at which people
        come.
    :param real_time_factor: seconds of world time per second of wall time; 0 for as fast as
        possible.
    :param gui: open PyBullet's window.
    :param clock_rate: messages on ``/clock`` in a second of world time, beside those that come
        before the messages of the robots; 0 for :data:`CLOCK_RATE`, or none faster than real time.
    """

    def __init__(
        self,
        room: Room,
        robots: List[str],
        sensing: Sensing,
        real_time_factor: float = 1.0,
        gui: bool = False,
        clock_rate: float = 0.0,
    ) -> None:
        self._factor = real_time_factor
        self._clock_rate = clock_rate or (CLOCK_RATE if 0.0 < real_time_factor <= 1.0 else 0.0)
        self.team = DrivingTeam(room, robots, gui=gui, seed=sensing.seed, drift=sensing.odom_drift)
        self.referee = Referee(self.team)
        self._inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._clock = rospy.Publisher("/clock", Clock, queue_size=1)
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=5)
        self._tf_static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self._map = rospy.Publisher("/map", OccupancyGrid, queue_size=1, latch=True)
        self._metadata = rospy.Publisher("/map_metadata", MapMetaData, queue_size=1, latch=True)
        self._room = rospy.Publisher("/world/room", String, queue_size=1, latch=True)
        self._state = rospy.Publisher("/world/state", String, queue_size=2)
        self._report = rospy.Publisher("/world/referee", String, queue_size=1, latch=True)
        self._faults = rospy.Publisher("/world/faults", String, queue_size=1, latch=True)
        self._fault_text = ""
        rospy.Subscriber("/world/fault", String, self._take_fault, queue_size=20)
        rospy.Service("/world/order_fault", Command, self._order_fault)
        self._robots = [RobotTopics(name, self.team, self._inbox.put, sensing) for name in robots]
        self._gazebo = GazeboServices(self._in_world, self._reset, self.team.models)
        grid = messages.map_message(self.team.grid, MAP_FRAME)
        self._map.publish(grid)
        self._metadata.publish(grid.info)
        rospy.Service("/static_map", GetMap, lambda _request: GetMapResponse(grid))
        start = messages.stamp_of(self.team.time)
        self._tf_static.publish(
            TFMessage([frame for robot in self._robots for frame in robot.fixed_frames(start)])
        )
        self._room.publish(json.dumps(room.as_json()))
        self._somebody = False
        self._person: Any = None
        if room.people:
            self._person = rospy.Publisher("/person", Bool, queue_size=5, latch=True)
            self._person.publish(Bool(False))
        self.recorder: Optional[Recorder] = None
        self._steps = 0
        self._due = time.monotonic()
        self._clock_number = -1
        self._reported = 0.0
        self._state_time = 0.0
        self.real_time_factor = 0.0

    def _in_world(self, order: Callable[[], None]) -> None:
        """Run a function in the thread that steps the world, and wait until it has run."""
        done = threading.Event()

        def run() -> None:
            order()
            done.set()

        self._inbox.put(run)
        while not done.wait(1.0):
            if rospy.is_shutdown():
                raise rospy.ServiceException("the world has ended")

    def _take_fault(self, message: String) -> None:
        """Have a fault happen that was ordered on ``/world/fault``."""

        def order() -> None:
            try:
                self.team.faults.order(read_fault(json.loads(message.data)))
            except ValueError as error:
                self.team.faults.refused = str(error)
                rospy.logwarn("world: no such fault: %s", error)

        self._inbox.put(order)

    def _order_fault(self, request: CommandRequest) -> CommandResponse:
        """Have a fault happen that was ordered by service: its kind, its robot and, as JSON, the
        other keys."""
        refused = ""

        def order() -> None:
            nonlocal refused
            try:
                keys = json.loads(request.argument or "{}")
                robot = {"robot": request.robot} if request.robot else {}
                fault = read_fault({**keys, "fault": request.command, **robot})
                self.team.faults.order(fault)
            except (ValueError, TypeError) as error:
                refused = str(error)

        self._in_world(order)
        return CommandResponse(not refused, refused or "ordered")

    def _report_faults(self) -> None:
        """Publish what goes wrong when that changes."""
        text = json.dumps(self.team.faults.report())
        if text != self._fault_text:
            self._fault_text = text
            self._faults.publish(text)

    def _reset(self, time_too: bool) -> None:
        self.team.reset(time_too)
        if time_too:
            self.referee = Referee(self.team)
            self._steps = 0

    def _run_orders(self) -> None:
        """Run what the ROS threads handed off."""
        while True:
            try:
                self._inbox.get_nowait()()
            except queue.Empty:
                return

    def step(self) -> None:
        """Advance one control period, and publish changes."""
        self._run_orders()
        self.team.step(self._publish)
        self.referee.watch()
        self._report_people()
        self._report_faults()
        self._gazebo.publish(self.team.time)
        if self.recorder is not None:
            self.recorder.record()
        for robot in self._robots:
            if robot.base is not None:
                robot.base.update()
        wall = time.monotonic()
        if wall - self._state_time >= STATE_PERIOD:
            self._state_time = wall
            self._state.publish(json.dumps(self.state()))
        if wall - self._reported >= 1.0:
            self._reported = wall
            self._report.publish(json.dumps(self.referee.report()))

    def _publish(self) -> None:
        """Wait until a step of the physics is due in wall time, and publish what belongs to it."""
        self._wait()
        self._steps += 1
        stamp = messages.stamp_of(self.team.time)
        speaks = self._steps % MESSAGE_STEPS == 0
        self._publish_clock(stamp, speaks)
        if not speaks:
            return
        for robot in self._robots:
            robot.publish(stamp, self._steps)
        if self._tf.get_num_connections():
            frames = [frame for robot in self._robots for frame in robot.moving_frames(stamp)]
            self._tf.publish(TFMessage(frames))
        self._run_orders()

    def _wait(self) -> None:
        if self._factor <= 0.0:
            return
        self._due += TIME_STEP / self._factor
        wall = time.monotonic()
        if self._due > wall:
            time.sleep(self._due - wall)
        elif wall - self._due > 0.5:
            # too slow for the requested factor; do not try to catch up later
            self._due = wall

    def _publish_clock(self, stamp: rospy.Time, needed: bool) -> None:
        number = int(self.team.time * self._clock_rate)
        if needed or number != self._clock_number:
            self._clock_number = number
            self._clock.publish(Clock(stamp))

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
        self._due = time.monotonic()
        window, window_time = self._due, self.team.time
        while not rospy.is_shutdown() and (duration <= 0.0 or self.team.time < duration):
            if self._gazebo.paused:
                self._run_orders()
                time.sleep(PAUSED_PERIOD)
                self._due = time.monotonic()
                continue
            self.step()
            wall = time.monotonic()
            if wall - window >= 1.0:
                self.real_time_factor = (self.team.time - window_time) / (wall - window)
                window, window_time = wall, self.team.time
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
        for number, fault in enumerate(room.faults):
            if fault.robot and fault.robot not in robots:
                raise InputError(
                    "there is no robot '%s'" % fault.robot,
                    file=room_file,
                    element="faults[%d]" % number,
                    hint="the robots are %s" % ", ".join(robots),
                )
        factor, duration = (
            number_parameter("real_time_factor", 1.0),
            number_parameter("duration", 0.0),
        )
        sensing = Sensing(
            navigation=bool(rospy.get_param("~navigation", True)),
            localisation=bool(rospy.get_param("~localisation", True)),
            scan_noise=number_parameter("scan_noise", 0.0),
            odom_drift=number_parameter("odom_drift", 0.0),
            seed=int(number_parameter("seed", 0)),
        )
        gui, clock_rate = (
            bool(rospy.get_param("~gui", False)),
            number_parameter("clock_rate", 0.0),
        )
        node = WorldNode(room, robots, sensing, factor, gui, clock_rate)
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
