"""The room: the shape of a world, its working and waiting areas, and its temperature.

Lengths are in metres, angles in radians, temperatures in degrees Celsius, times in seconds; x
points east, y north, and yaw is counter-clockwise from east (REP 103). ``room_file`` reads rooms
from YAML.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Tuple, Union

import numpy as np

from gspn_framework_package.model.net import Point


@dataclass(frozen=True)
class Pose:
    """A position and a heading.

    :param x: metres east.
    :param y: metres north.
    :param yaw: radians, counter-clockwise from east.
    """

    x: float
    y: float
    yaw: float = 0.0

    def distance(self, other: Union[Pose, Point]) -> float:
        """The straight distance to another pose or point, in metres."""
        x, y = (other.x, other.y) if isinstance(other, Pose) else other
        return math.hypot(self.x - x, self.y - y)


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder; ``at`` is its axis."""

    at: Point
    radius: float
    height: float = 0.5
    color: str = "#ffffff"

    def distance(self, x: Any, y: Any) -> Any:
        """The distance from points to the surface, negative inside; numbers or arrays, metres."""
        return np.hypot(x - self.at[0], y - self.at[1]) - self.radius

    def corners(self) -> List[Point]:
        """The corners of the square around it."""
        (x, y), r = self.at, self.radius
        return [(x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r)]


@dataclass(frozen=True)
class Box:
    """A box on the floor; ``size`` is its extent along x and y before it is rotated by ``yaw``."""

    at: Point
    size: Tuple[float, float]
    yaw: float = 0.0
    height: float = 0.5
    color: str = "#8d99ae"

    def distance(self, x: Any, y: Any) -> Any:
        """The distance from points to the surface, negative inside; numbers or arrays, metres."""
        dx, dy = x - self.at[0], y - self.at[1]
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        ex = np.abs(dx * cos + dy * sin) - self.size[0] / 2
        ey = np.abs(dy * cos - dx * sin) - self.size[1] / 2
        outside = np.hypot(np.maximum(ex, 0.0), np.maximum(ey, 0.0))
        return outside + np.minimum(np.maximum(ex, ey), 0.0)

    def corners(self) -> List[Point]:
        """Its corners on the floor."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        halves = [
            (sx * self.size[0] / 2, sy * self.size[1] / 2) for sx in (-1, 1) for sy in (-1, 1)
        ]
        return [
            (self.at[0] + dx * cos - dy * sin, self.at[1] + dx * sin + dy * cos)
            for dx, dy in halves
        ]


Obstacle = Union[Cylinder, Box]


@dataclass(frozen=True)
class Area:
    """A rectangle parallel to the room's axes, from its south-west to its north-east corner."""

    low: Point
    high: Point

    def distance(self, point: Point) -> float:
        """The distance from a point to the rectangle, 0 inside."""
        dx = max(self.low[0] - point[0], 0.0, point[0] - self.high[0])
        dy = max(self.low[1] - point[1], 0.0, point[1] - self.high[1])
        return math.hypot(dx, dy)


@dataclass(frozen=True)
class Location:
    """A place where robots work, and the bay beside it where they wait for the next location.

    :param name: its name in the plan.
    :param area: the floor of the location; at most one robot may be in it.
    :param entry: where a robot waits until the area is clear; outside the area.
    :param sweep: the points to drive through, in this order, to sweep the area.
    :param bay: the poses in which robots may wait for the next location, one robot each.
    """

    name: str
    area: Area
    entry: Pose
    sweep: Tuple[Point, ...]
    bay: Tuple[Pose, ...]


@dataclass(frozen=True)
class HotSpot:
    """A source of heat whose excess temperature falls off as a Gaussian.

    :param path: the path of its centre: one point, or a closed path that it moves along.
    :param excess: temperature at its centre above the surroundings, in degrees.
    :param radius: the standard deviation of the Gaussian, metres.
    :param speed: speed along the path, metres per second.
    :param hot_for: seconds for which it burns.
    :param cold_for: seconds for which it is cold afterwards; 0 if it always burns.
    :param phase: seconds into the first ``hot_for`` at time 0.
    """

    path: Tuple[Point, ...]
    excess: float
    radius: float
    speed: float = 0.0
    hot_for: float = 0.0
    cold_for: float = 0.0
    phase: float = 0.0

    def burns(self, time: float) -> bool:
        """Whether it burns at a time."""
        period = self.hot_for + self.cold_for
        return self.cold_for <= 0.0 or (time + self.phase) % period < self.hot_for

    def at(self, time: float) -> Point:
        """The position of its centre at a time."""
        legs = list(zip(self.path, self.path[1:] + self.path[:1]))
        length = sum(math.dist(a, b) for a, b in legs)
        if length == 0.0:
            return self.path[0]
        rest = (self.speed * time) % length
        for start, end in legs:
            leg = math.dist(start, end)
            if rest <= leg and leg > 0.0:
                part = rest / leg
                return (
                    start[0] + part * (end[0] - start[0]),
                    start[1] + part * (end[1] - start[1]),
                )
            rest -= leg
        return self.path[0]


@dataclass(frozen=True)
class TemperatureField:
    """The temperature field: an ambient temperature, with hot spots on top of it."""

    ambient: float = 21.0
    hot_spots: Tuple[HotSpot, ...] = ()

    def at(self, point: Point, time: float) -> float:
        """The temperature at a point and a time, in degrees Celsius."""
        total = self.ambient
        for spot in self.hot_spots:
            if spot.burns(time):
                away = math.dist(spot.at(time), point) / spot.radius
                total += spot.excess * math.exp(-0.5 * away * away)
        return total


@dataclass(frozen=True)
class Person:
    """A person who walks into the room from time to time, and out again.

    :param path: comes in at the first point, goes from point to point, and leaves at the last.
    :param away_mean: mean of the exponential time between two visits, seconds.
    :param speed: metres per second.
    :param stands: seconds at each point between the first and the last.
    :param radius: metres.
    :param height: metres.
    :param color: of the body.
    """

    path: Tuple[Point, ...]
    away_mean: float
    speed: float = 0.8
    stands: float = 0.0
    radius: float = 0.2
    height: float = 1.7
    color: str = "#d98c3f"


@dataclass(frozen=True)
class RobotType:
    """Size and limits of the robots. The defaults are those of TurtleBot3 Burger (ROBOTIS
    e-manual).

    :param radius: radius of the disc that the robot covers, metres.
    :param max_speed: metres per second.
    :param max_turn_rate: radians per second.
    :param acceleration: metres per second squared.
    :param turn_acceleration: radians per second squared.
    :param wheel_radius: metres.
    :param wheel_separation: metres between the wheels.
    :param mass: kilograms.
    :param scan_rays: number of rays of the laser scanner in a full circle.
    :param scan_range: metres.
    :param urdf: the file of a robot of the user; empty for a TurtleBot3.
    :param wheel_joints: its joints of the left wheel and the right one.
    """

    radius: float = 0.105
    max_speed: float = 0.22
    max_turn_rate: float = 2.84
    acceleration: float = 2.5
    turn_acceleration: float = 3.2
    wheel_radius: float = 0.033
    wheel_separation: float = 0.16
    mass: float = 1.0
    scan_rays: int = 360
    scan_range: float = 3.5
    urdf: str = ""
    wheel_joints: Tuple[str, str] = ("wheel_left_joint", "wheel_right_joint")


ROBOT_TYPES: Mapping[str, RobotType] = {
    "burger": RobotType(),
    # the disc of the robot_radius in the navigation files of ROBOTIS
    "waffle": RobotType(
        radius=0.22, max_speed=0.26, max_turn_rate=1.82, wheel_separation=0.287, mass=1.8
    ),
}
"""The types of TurtleBot3 that a room file can name."""


@dataclass(frozen=True)
class RoomFault:
    """Something that goes wrong, for tests of plans.

    :param kind: what: a key of :data:`.FAULT_KINDS`, which also says which of the rest it has.
    :param time: when, in seconds of world time.
    :param robot: whose; "" for all robots, where the fault has no one robot.
    :param wheel: which one slips: ``left``, ``right`` or ``both``.
    :param grip: the friction that is left between a wheel and the floor; 1 is that of a sound one.
    :param lasts: seconds until it is over.
    :param to: where the robot is carried.
    :param door: which one closes.
    :param person: the number of the person who comes.
    :param delay: seconds of wall time by which the robot hears the others late.
    """

    kind: str
    time: float = 0.0
    robot: str = ""
    wheel: str = "both"
    grip: float = 0.0
    lasts: float = math.inf
    to: Pose = Pose(0.0, 0.0)
    door: str = ""
    person: int = 0
    delay: float = 0.0


@dataclass(frozen=True)
class Room:
    """A room and its contents, as described by the room file.

    :param walls: polylines, each the centre line of a wall.
    :param wall_thickness: metres.
    :param wall_height: metres.
    :param obstacles: cylinders and boxes.
    :param locations: the locations by name, in the order of the file.
    :param spawn: the start poses of the robots, in the order of the team.
    :param temperature: the temperature field.
    :param robot: size and limits of the robots.
    :param people: who walks in.
    :param doors: boxes that are there only while the door of that name is closed.
    :param faults: what goes wrong by itself.
    """

    name: str
    walls: Tuple[Tuple[Point, ...], ...]
    wall_thickness: float = 0.1
    wall_height: float = 0.3
    obstacles: Tuple[Obstacle, ...] = ()
    locations: Mapping[str, Location] = field(default_factory=dict)
    spawn: Tuple[Pose, ...] = ()
    temperature: TemperatureField = TemperatureField()
    robot: RobotType = RobotType()
    people: Tuple[Person, ...] = ()
    doors: Mapping[str, Box] = field(default_factory=dict)
    faults: Tuple[RoomFault, ...] = ()

    def wall_boxes(self) -> List[Box]:
        """The walls as boxes, one per straight section, long enough to close the corners."""
        boxes = []
        for line in self.walls:
            for (x1, y1), (x2, y2) in zip(line, line[1:]):
                boxes.append(
                    Box(
                        at=((x1 + x2) / 2, (y1 + y2) / 2),
                        size=(
                            math.hypot(x2 - x1, y2 - y1) + self.wall_thickness,
                            self.wall_thickness,
                        ),
                        yaw=math.atan2(y2 - y1, x2 - x1),
                        height=self.wall_height,
                        color="#22262e",
                    )
                )
        return boxes

    def solids(self) -> List[Obstacle]:
        """The fixed solid bodies: walls and obstacles."""
        return [*self.wall_boxes(), *self.obstacles]

    def bounds(self) -> Area:
        """The rectangle around everything; around the origin if the room is empty."""
        points = [point for line in self.walls for point in line]
        points += [corner for solid in self.obstacles for corner in solid.corners()]
        poses = list(self.spawn)
        for place in self.locations.values():
            points += [place.area.low, place.area.high]
            poses += [place.entry, *place.bay]
        points += [(pose.x, pose.y) for pose in poses]
        points = points or [(0.0, 0.0)]
        xs, ys = [p[0] for p in points], [p[1] for p in points]
        return Area((min(xs), min(ys)), (max(xs), max(ys)))

    def clearance(self, x: Any, y: Any) -> Any:
        """The distance from points to the nearest wall or obstacle, negative inside one, metres."""
        nearest = np.full(np.shape(x), np.inf)
        for solid in self.solids():
            nearest = np.minimum(nearest, solid.distance(x, y))
        return nearest

    def as_json(self) -> Dict[str, Any]:
        """The data that the page needs to draw the room."""
        boxes = [
            {
                "at": box.at,
                "size": box.size,
                "yaw": box.yaw,
                "height": box.height,
                "color": box.color,
            }
            for box in [*self.wall_boxes(), *(o for o in self.obstacles if isinstance(o, Box))]
        ]
        bounds = self.bounds()
        return {
            "name": self.name,
            "bounds": [bounds.low, bounds.high],
            "boxes": boxes,
            "cylinders": [
                {"at": o.at, "radius": o.radius, "height": o.height, "color": o.color}
                for o in self.obstacles
                if isinstance(o, Cylinder)
            ],
            "locations": {
                name: {
                    "area": [place.area.low, place.area.high],
                    "entry": [place.entry.x, place.entry.y, place.entry.yaw],
                    "sweep": list(place.sweep),
                    "bay": [[slot.x, slot.y, slot.yaw] for slot in place.bay],
                }
                for name, place in self.locations.items()
            },
            "robot_radius": self.robot.radius,
            "ambient": self.temperature.ambient,
        }
