"""The room and its robots as PyBullet bodies: wheels, motors, contacts, a laser scanner, encoders.

Robots are differential-drive discs of a TurtleBot3's size. They move because their wheels turn on
the floor. A simulation sets their pose only at the start, when it is reset, and when they are
carried away; it does set that of people.
The time step is fixed, and the caller decides how fast to step.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import Any, Dict, List, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.model.goal_pose import yaw_of
from gspn_framework_package.model.net import Point
from gspn_framework_package.model.robot_colours import colour_of
from gspn_framework_package.world.bodies import (
    AWAY,
    SCAN_HEIGHT,
    connect_bullet,
    make_floor,
    make_person,
    make_robot,
    make_solid,
)
from gspn_framework_package.world.room import Pose, Room
from gspn_framework_package.world.urdf_robot import UrdfBody, make_urdf_robot
from gspn_framework_package.world.window import set_up_window

TIME_STEP = 1.0 / 120.0
"""Duration of one physics step, in seconds."""

_Frame = Tuple[Tuple[float, float, float], Tuple[float, float, float, float]]

TOUCH = 0.001
"""Metres between a robot and a person that count as a contact; Bullet keeps bodies that press on
each other less than half of that apart."""


@dataclass
class Contacts:
    """Counts contacts between bodies; each contact counts once, however long it lasts.

    :ivar robots: contacts between two robots, by pair of names in alphabetical order.
    :ivar solids: contacts of a robot with a wall or an obstacle, by name of the robot.
    :ivar people: contacts of a robot with a person, by name of the robot.
    """

    robots: Dict[Tuple[str, str], int] = field(default_factory=dict)
    solids: Dict[str, int] = field(default_factory=dict)
    people: Dict[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """The number of all contacts."""
        counts = (self.robots, self.solids, self.people)
        return sum(sum(count.values()) for count in counts)


@dataclass
class _Body:
    unique_id: int
    joints: Tuple[int, int]
    forward: Tuple[float, float]
    inertial: Optional[_Frame]
    speed: float = 0.0
    turn_rate: float = 0.0
    target_speed: float = 0.0
    target_turn_rate: float = 0.0
    driven: bool = False
    rests: bool = True
    wheels: Tuple[float, float] = (0.0, 0.0)
    measures: Tuple[float, float] = (1.0, 1.0)
    odometry: Pose = Pose(0.0, 0.0, 0.0)


class Physics:
    """A room with robots in it.

    :param robots: names of the robots, in the order of ``room.spawn``.
    :param poses: their start poses, instead of ``room.spawn``.
    :param gui: open PyBullet's window.
    :param drift: standard deviation of the error in each wheel's circumference that the odometry
        assumes, as a fraction of the circumference.
    :param seed: of these errors.
    :raises ValueError: there are fewer start poses than robots.
    """

    def __init__(
        self,
        room: Room,
        robots: Sequence[str],
        poses: Optional[Sequence[Pose]] = None,
        gui: bool = False,
        drift: float = 0.0,
        seed: int = 0,
    ) -> None:
        starts = list(poses if poses is not None else room.spawn)
        if len(starts) < len(robots):
            raise ValueError("%d robots, but %d start poses" % (len(robots), len(starts)))
        self.room = room
        self.robots: Tuple[str, ...] = tuple(robots)
        self._starts = starts
        self.contacts = Contacts()
        self._steps = 0
        self._touching: Set[Tuple[str, str]] = set()
        self._client = connect_bullet(gui)
        self._client.setGravity(0, 0, -9.81)
        self._client.setTimeStep(TIME_STEP)
        self._floor = make_floor(self._client, room)
        for solid in room.solids():
            make_solid(self._client, solid)
        self._doors = {name: make_solid(self._client, door) for name, door in room.doors.items()}
        for name in room.doors:
            self.place_door(name, False)
        self._people = [make_person(self._client, person) for person in room.people]
        self._where: List[Optional[Point]] = [None] * len(room.people)
        self._met: Set[Tuple[str, int]] = set()
        self._bodies: Dict[str, _Body] = {}
        for name, pose in zip(robots, starts):
            robot = self._make_robot(name, pose)
            errors = random.Random("drift %d %s" % (seed, name))
            measures = (1.0 + errors.gauss(0.0, drift), 1.0 + errors.gauss(0.0, drift))
            self._bodies[name] = _Body(
                *robot, self._inertial(robot.unique_id), odometry=pose, measures=measures
            )
        self._names = {body.unique_id: name for name, body in self._bodies.items()}
        if gui:
            set_up_window(
                self._client, room, {name: body.unique_id for name, body in self._bodies.items()}
            )
        # let the bodies settle on their wheels, so that the first second is like the others
        for body in self._bodies.values():
            self._let_sleep(body)
            self._turn_wheels(body)
        for _ in range(20):
            self._client.stepSimulation()
        for body in self._bodies.values():
            body.wheels = self._wheel_angles(body)

    def _make_robot(self, name: str, pose: Pose) -> UrdfBody:
        kind = self.room.robot
        if kind.urdf:
            return make_urdf_robot(self._client, kind, pose)
        return UrdfBody(make_robot(self._client, kind, pose, colour_of(name)), (0, 1), (1.0, 1.0))

    def _inertial(self, unique_id: int) -> Optional[_Frame]:
        """The origin of a body in its inertial frame, whose pose Bullet reports; None if it is
        right above or below that."""
        dynamics = self._client.getDynamicsInfo(unique_id, -1)
        place, turned = dynamics[3], dynamics[4]
        if abs(place[0]) < 1e-9 and abs(place[1]) < 1e-9 and abs(turned[3]) > 1.0 - 1e-9:
            return None
        return self._client.invertTransform(place, turned)

    def close(self) -> None:
        """Free the memory of the simulation."""
        self._client.disconnect()

    # ---- running -----------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""
        return self._steps * TIME_STEP

    def drive(self, robot: str, speed: float, turn_rate: float) -> None:
        """Set the target speeds of a robot's motors; both are limited to the robot's maximum.

        :param speed: forward, metres per second.
        :param turn_rate: counter-clockwise, radians per second.
        """
        kind, body = self.room.robot, self._bodies[robot]
        body.target_speed = min(max(speed, -kind.max_speed), kind.max_speed)
        body.target_turn_rate = min(max(turn_rate, -kind.max_turn_rate), kind.max_turn_rate)
        rests = body.target_speed == 0.0 and body.target_turn_rate == 0.0
        if rests != body.rests:
            body.rests = rests
            self._let_sleep(body)

    def _let_sleep(self, body: _Body) -> None:
        """Put a standing body to sleep, which acts as static friction; wake a driven one.

        While awake, Bullet's contacts creep by a millimetre in a few seconds.
        """
        client = self._client
        modes = [client.ACTIVATION_STATE_WAKE_UP, client.ACTIVATION_STATE_DISABLE_SLEEPING]
        for mode in [client.ACTIVATION_STATE_ENABLE_SLEEPING] if body.rests else modes:
            client.changeDynamics(body.unique_id, -1, activationState=mode)

    def show(self, robot: str, pose: Pose) -> None:
        """Place a robot at a pose, for pictures of a recorded run."""
        body, client = self._bodies[robot], self._client
        place, turned = client.getBasePositionAndOrientation(body.unique_id)
        if body.inertial is not None:
            place = client.multiplyTransforms(place, turned, *body.inertial)[0]
        frame = ([pose.x, pose.y, place[2]], client.getQuaternionFromEuler([0, 0, pose.yaw]))
        if body.inertial is not None:
            frame = client.multiplyTransforms(*frame, *client.invertTransform(*body.inertial))
        client.resetBasePositionAndOrientation(body.unique_id, *frame)

    def carry(self, robot: str, pose: Pose) -> None:
        """Lift a robot and put it down at a pose, where it stands; its wheels do not turn."""
        body = self._bodies[robot]
        self.show(robot, pose)
        self._client.resetBaseVelocity(body.unique_id, [0, 0, 0], [0, 0, 0])
        body.speed = body.turn_rate = 0.0
        body.driven = False

    def reset(self, time: bool) -> None:
        """Put the robots where they started, at rest, with the odometry of the start.

        :param time: set the time back to 0, and forget the contacts.
        """
        for (name, body), pose in zip(self._bodies.items(), self._starts):
            self.carry(name, pose)
            self.drive(name, 0.0, 0.0)
            body.odometry = pose
        if time:
            self._steps = 0
            self.contacts = Contacts()

    def place_person(self, number: int, at: Optional[Point]) -> None:
        """Move a person of the room to a point; None to remove the person."""
        if at == self._where[number]:
            return
        self._where[number] = at
        height = self.room.people[number].height
        self._client.resetBasePositionAndOrientation(
            self._people[number],
            AWAY if at is None else [at[0], at[1], height / 2],
            [0.0, 0.0, 0.0, 1.0],
        )

    def place_door(self, name: str, closed: bool) -> None:
        """Put the body of a door into its place, or remove it."""
        door = self.room.doors[name]
        self._client.resetBasePositionAndOrientation(
            self._doors[name],
            [*door.at, door.height / 2] if closed else AWAY,
            self._client.getQuaternionFromEuler([0, 0, door.yaw]),
        )

    def grip(self, robot: str, wheel: int, friction: float) -> None:
        """Set the friction of a wheel on the floor.

        :param wheel: 0 left, 1 right.
        :param friction: 1 is that of a sound wheel.
        """
        body = self._bodies[robot]
        self._client.changeDynamics(body.unique_id, body.joints[wheel], lateralFriction=friction)

    def step(self) -> None:
        """Advance by :data:`TIME_STEP`."""
        for body in self._bodies.values():
            self._turn_wheels(body)
        self._client.stepSimulation()
        self._steps += 1
        for body in self._bodies.values():
            self._read_encoders(body)
        self._count_contacts()
        self._count_meetings()

    def advance(self, seconds: float) -> None:
        """Advance by the number of steps that brings the time nearest to ``time + seconds``."""
        for _ in range(round(seconds / TIME_STEP)):
            self.step()

    def _turn_wheels(self, body: _Body) -> None:
        kind = self.room.robot
        most, most_turn = kind.acceleration * TIME_STEP, kind.turn_acceleration * TIME_STEP
        change = body.target_speed - body.speed
        turn_change = body.target_turn_rate - body.turn_rate
        if change == 0.0 and turn_change == 0.0 and body.driven:
            return
        body.driven = True
        body.speed += min(max(change, -most), most)
        body.turn_rate += min(max(turn_change, -most_turn), most_turn)
        difference = body.turn_rate * kind.wheel_separation / 2
        self._client.setJointMotorControlArray(
            body.unique_id,
            body.joints,
            self._client.VELOCITY_CONTROL,
            targetVelocities=[
                body.forward[0] * (body.speed - difference) / kind.wheel_radius,
                body.forward[1] * (body.speed + difference) / kind.wheel_radius,
            ],
            forces=[0.3 * kind.mass, 0.3 * kind.mass],
        )

    def _wheel_angles(self, body: _Body) -> Tuple[float, float]:
        left, right = self._client.getJointStates(body.unique_id, body.joints)
        return (left[0] * body.forward[0], right[0] * body.forward[1])

    def _read_encoders(self, body: _Body) -> None:
        kind = self.room.robot
        angles = self._wheel_angles(body)
        left, right = (
            (angle - before) * kind.wheel_radius * measure
            for angle, before, measure in zip(angles, body.wheels, body.measures)
        )
        body.wheels = angles
        turn = (right - left) / kind.wheel_separation
        heading = body.odometry.yaw + turn / 2
        way = (left + right) / 2
        body.odometry = Pose(
            body.odometry.x + way * math.cos(heading),
            body.odometry.y + way * math.sin(heading),
            math.remainder(body.odometry.yaw + turn, math.tau),
        )

    def _count_contacts(self) -> None:
        touching: Set[Tuple[str, str]] = set()
        for name, body in self._bodies.items():
            for contact in self._client.getContactPoints(bodyA=body.unique_id, linkIndexA=-1):
                if contact[2] == self._floor or contact[2] in self._people or contact[8] > 0.0:
                    continue
                other = self._names.get(contact[2], "")
                touching.add((min(name, other), max(name, other)))
        for pair in touching - self._touching:
            first, second = pair
            if first:
                self.contacts.robots[pair] = self.contacts.robots.get(pair, 0) + 1
            else:
                self.contacts.solids[second] = self.contacts.solids.get(second, 0) + 1
        self._touching = touching

    def _count_meetings(self) -> None:
        """Count contacts with people. They are upright cylinders like robots, so the distance is
        sufficient; Bullet omits contacts of a sleeping body with one that is moved."""
        met: Set[Tuple[str, int]] = set()
        for number, at in enumerate(self._where):
            if at is None:
                continue
            reach = self.room.robot.radius + self.room.people[number].radius + TOUCH
            met |= {(n, number) for n in self.robots if self.pose(n).distance(at) < reach}
        for name, _ in met - self._met:
            self.contacts.people[name] = self.contacts.people.get(name, 0) + 1
        self._met = met

    # ---- measurements ------------------------------------------------------------------------

    def pose(self, robot: str) -> Pose:
        """The true pose of a robot."""
        body = self._bodies[robot]
        position, orientation = self._client.getBasePositionAndOrientation(body.unique_id)
        if body.inertial is not None:
            position, orientation = self._client.multiplyTransforms(
                position, orientation, *body.inertial
            )
        return Pose(position[0], position[1], yaw_of(*orientation))

    def velocity(self, robot: str) -> Tuple[float, float, float]:
        """The true velocity: metres per second east and north, and turn rate in radians per
        second."""
        linear, angular = self._client.getBaseVelocity(self._bodies[robot].unique_id)
        return (linear[0], linear[1], angular[2])

    def odometry(self, robot: str) -> Tuple[Pose, float, float]:
        """The odometry of the wheel encoders: pose (initially the true one), speed, turn rate."""
        body = self._bodies[robot]
        return (body.odometry, body.speed, body.turn_rate)

    def wheels(self, robot: str) -> List[Tuple[float, float]]:
        """The angle in radians and the speed in radians per second of the left wheel and the right
        wheel."""
        body = self._bodies[robot]
        states = self._client.getJointStates(body.unique_id, body.joints)
        return [(state[0], state[1]) for state in states]

    def temperature(self, robot: str) -> float:
        """The reading of the robot's thermometer, in degrees Celsius."""
        pose = self.pose(robot)
        return self.room.temperature.at((pose.x, pose.y), self.time)

    def scan(self, robot: str) -> List[float]:
        """One revolution of the laser scanner: ranges in metres, counter-clockwise from straight
        ahead.

        A ray that hits nothing has infinite range.
        """
        kind, pose = self.room.robot, self.pose(robot)
        # rays start outside the robot's own body
        start = kind.radius + 0.005
        directions = pose.yaw + np.arange(kind.scan_rays) * (math.tau / kind.scan_rays)
        away = np.stack([np.cos(directions), np.sin(directions), np.zeros(kind.scan_rays)], axis=1)
        centre = np.array([pose.x, pose.y, SCAN_HEIGHT])
        hits = self._client.rayTestBatch(
            (centre + start * away).tolist(), (centre + kind.scan_range * away).tolist()
        )
        span = kind.scan_range - start
        return [start + hit[2] * span if hit[0] >= 0 else math.inf for hit in hits]

    @property
    def client(self) -> Any:
        """The PyBullet connection, for a camera."""
        return self._client
