"""A team of robots in a simulated room: physics and one navigator for each, stepped together.

It uses no ROS, no threads and no wall clock: the node, the tests and the benchmark share this
class.
"""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Callable, Dict, List, Optional, Sequence, Tuple

from gspn_framework_package.world.avoidance import OtherRobot
from gspn_framework_package.world.faults import Faults
from gspn_framework_package.world.grid import Grid
from gspn_framework_package.world.models import Models
from gspn_framework_package.world.navigation import Navigator, Observation
from gspn_framework_package.world.people import Walker, halted
from gspn_framework_package.world.physics import TIME_STEP, Physics
from gspn_framework_package.world.room import Pose, Room

CONTROL_STEPS = 12
"""Physics steps between two commands of the navigators: 10 commands per second."""

CONTROL_PERIOD = CONTROL_STEPS * TIME_STEP
"""Seconds between two commands of the navigators."""


class DrivingTeam:
    """Robots that drive in a room.

    :param robots: their names.
    :param poses: their start poses, instead of ``room.spawn``.
    :param gui: open PyBullet's window.
    :param seed: seed of the times at which people come, and of the odometry's errors.
    :param drift: of the odometry, as :class:`.Physics` takes it.

    :ivar people: the people of the room, whether they are there or not.
    :ivar faults: what goes wrong.
    :ivar models: the robots, and what was put into the room while it runs.
    """

    def __init__(
        self,
        room: Room,
        robots: Sequence[str],
        poses: Optional[Sequence[Pose]] = None,
        gui: bool = False,
        seed: int = 0,
        drift: float = 0.0,
    ) -> None:
        self.room = room
        self._seed = seed
        self.physics = Physics(room, robots, poses, gui, drift, seed)
        self.grid = Grid(room)
        self.robots: Tuple[str, ...] = tuple(robots)
        self.navigators: Dict[str, Navigator] = {
            name: Navigator(self.grid, index) for index, name in enumerate(robots)
        }
        self.people = self._walkers()
        self._teleop: Dict[str, Tuple[float, float, float]] = {}
        self._closed: Tuple[str, ...] = ()
        self.models = Models(self.physics, self.carry, self._plan_anew)
        self.faults = Faults(self.physics, self.close_doors, self.models.solids)

    def _walkers(self) -> Tuple[Walker, ...]:
        return tuple(
            Walker(person, self.room, random.Random("%d %d" % (self._seed, number)))
            for number, person in enumerate(self.room.people)
        )

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""
        return self.physics.time

    def teleoperate(self, robot: str, speed: float, turn_rate: float) -> None:
        """Drive a robot manually while it has no goal; half a second later it stops, unless another
        command follows.

        :param speed: forward, metres per second.
        :param turn_rate: counter-clockwise, radians per second.
        """
        self._teleop[robot] = (speed, turn_rate, self.time + 0.5)
        if not self.navigators[robot].active:
            self._drive(robot, self.physics.pose(robot), speed, turn_rate)

    def peers(self) -> List[OtherRobot]:
        """The current observations and announcements of all robots."""
        peers = []
        for name in self.robots:
            velocity = self.physics.velocity(name)
            peers.append(
                self.navigators[name].announce(
                    name, self.physics.pose(name), (velocity[0], velocity[1]), self.time
                )
            )
        return peers

    def reset(self, time: bool) -> None:
        """Put the robots where they started; their goals end.

        :param time: set the time back to 0 too; people come as at the start.
        """
        self.faults.reset(time)
        self.physics.reset(time)
        self._teleop.clear()
        for navigator in self.navigators.values():
            navigator.reset("the world was reset")
        if time:
            self.people = self._walkers()

    def close_doors(self, names: Sequence[str]) -> None:
        """Close these doors, and open all others; robots and people replan their paths."""
        for name in self.room.doors:
            self.physics.place_door(name, name in names)
        self._closed = tuple(names)
        self._plan_anew()

    def carry(self, robot: str, pose: Pose) -> None:
        """Put a robot elsewhere; its goal stays. :raises ValueError: there is no room for it."""
        self.faults.carry(robot, pose)
        self.navigators[robot].plan_anew()

    def _plan_anew(self) -> None:
        """Have robots and people find paths around what is in the room now."""
        closed = [self.room.doors[name] for name in self._closed]
        solids = (*self.room.obstacles, *closed, *self.models.solids())
        room = replace(self.room, obstacles=solids)
        self.grid = Grid(room)
        for navigator in self.navigators.values():
            navigator.use_grid(self.grid)
        for walker in self.people:
            walker.use_room(room)

    def step(self, after: Callable[[], None] = lambda: None) -> None:
        """Advance by :data:`CONTROL_PERIOD`: a step of each person, one command for each robot,
        then the physics.

        :param after: called after each step of the physics.
        """
        for name in self.faults.step(self.people):
            self.navigators[name].plan_anew()
        peers = self.peers()
        poses = [peer.pose for peer in peers]
        for number, walker in enumerate(self.people):
            walker.step(self.time, CONTROL_PERIOD, poses)
            self.physics.place_person(number, walker.at)
        for me in peers:
            navigator = self.navigators[me.name]
            if navigator.active:
                others = tuple(peer for peer in peers if peer is not me)
                command = navigator.step(Observation(self.time, me.pose, others), CONTROL_PERIOD)
            else:
                command = self._by_hand(me.name)
            self._drive(me.name, me.pose, *command)
        for _ in range(CONTROL_STEPS):
            self.physics.step()
            after()

    def _drive(self, robot: str, pose: Pose, speed: float, turn_rate: float) -> None:
        """Command a robot's motors, but not to drive towards a person nearby, or while blocked."""
        if self.faults.has("blocked", robot):
            speed = turn_rate = 0.0
        if halted(pose, speed, self.room.robot.radius, self.people):
            speed = 0.0
        self.physics.drive(robot, speed, turn_rate)

    def _by_hand(self, robot: str) -> Tuple[float, float]:
        speed, turn_rate, until = self._teleop.get(robot, (0.0, 0.0, -1.0))
        return (speed, turn_rate) if self.time < until else (0.0, 0.0)

    def close(self) -> None:
        """Free the memory of the simulation."""
        self.physics.close()
