"""Models that are put into the room while it runs, and where robots and models are, as Gazebo's
services have it.

A spawned model stands still, as all bodies of the room but robots and people do; robots plan around
it. Poses are on the floor, with a height for models; all stand upright.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Callable, Dict, List, Tuple

from gspn_framework_package.model.errors import InputError, closest
from gspn_framework_package.world.bodies import make_solid
from gspn_framework_package.world.physics import Physics
from gspn_framework_package.world.room import Obstacle, Pose
from gspn_framework_package.world.shapes import matrix

if TYPE_CHECKING:
    from gspn_framework_package.world.urdf import Urdf

Twist = Tuple[float, float, float]
"""Metres per second along x and y, and radians per second about z."""

WORLD_FRAMES = ("", "world", "map")
"""The names of the frame of the map."""


@dataclass(frozen=True)
class Placed:
    """Where a robot or model is.

    :param height: metres above the floor, of the origin of a model.
    """

    pose: Pose
    height: float = 0.0
    twist: Twist = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _Model:
    urdf: Urdf
    placed: Placed
    solids: Tuple[Obstacle, ...]
    bodies: Tuple[int, ...]


class Models:
    """The robots and the spawned models of a world.

    :param carry: puts a robot elsewhere. :raises ValueError: it does not fit.
    :param changed: called when models have come, gone or moved.
    """

    def __init__(
        self,
        physics: Physics,
        carry: Callable[[str, Pose], None],
        changed: Callable[[], None],
    ) -> None:
        self._physics = physics
        self._carry = carry
        self._changed = changed
        self._models: Dict[str, _Model] = {}

    def solids(self) -> List[Obstacle]:
        """The boxes and cylinders of all models."""
        return [solid for model in self._models.values() for solid in model.solids]

    def names(self) -> List[str]:
        """All robots, then all models."""
        return [*self._physics.robots, *self._models]

    def placed(self, name: str) -> Placed:
        """Where a robot or model is in the map. :raises ValueError: there is none of that name."""
        if name in self._physics.robots:
            return Placed(self._physics.pose(name), 0.0, self._physics.velocity(name))
        if name not in self._models:
            meant = closest(name, self.names())
            hint = "; did you mean '%s'?" % meant if meant else ""
            raise ValueError("there is no model '%s'%s" % (name, hint))
        return self._models[name].placed

    def seen_from(self, frame: str, placed: Placed) -> Placed:
        """A pose of the map, in the frame of a robot or model.

        :raises ValueError: there is no such frame.
        """
        if frame in WORLD_FRAMES:
            return placed
        other = self.placed(frame)
        x, y = _turned(placed.pose.x - other.pose.x, placed.pose.y - other.pose.y, -other.pose.yaw)
        vx, vy = _turned(
            placed.twist[0] - other.twist[0], placed.twist[1] - other.twist[1], -other.pose.yaw
        )
        yaw = math.remainder(placed.pose.yaw - other.pose.yaw, math.tau)
        turn = placed.twist[2] - other.twist[2]
        return Placed(Pose(x, y, yaw), placed.height - other.height, (vx, vy, turn))

    def in_map(self, frame: str, placed: Placed) -> Placed:
        """A pose in the frame of a robot or model, in the map. :raises ValueError: there is no such
        frame."""
        if frame in WORLD_FRAMES:
            return placed
        other = self.placed(frame)
        x, y = _turned(placed.pose.x, placed.pose.y, other.pose.yaw)
        pose = Pose(x + other.pose.x, y + other.pose.y, placed.pose.yaw + other.pose.yaw)
        return Placed(pose, placed.height + other.height)

    def spawn(self, name: str, xml: str, placed: Placed) -> None:
        """Put a model into the room.

        :param xml: URDF.
        :raises ValueError: the name is taken, the text cannot be read, or a robot stands there.
        """
        from gspn_framework_package.world.urdf import read_urdf

        if not name or name in self.names():
            raise ValueError("there is a model '%s' already" % name if name else "it has no name")
        try:
            urdf = read_urdf(xml.encode(), "model_xml")
            self._place(name, urdf, placed)
        except InputError as error:
            raise ValueError(str(error)) from None

    def move(self, name: str, placed: Placed) -> None:
        """Put a robot or model elsewhere. :raises ValueError: there is none, or it does not fit."""
        if name in self._physics.robots:
            self._carry(name, placed.pose)
            return
        self.placed(name)
        model = self._models[name]
        self._place(name, model.urdf, placed)
        self._remove(model)

    def delete(self, name: str) -> None:
        """Take a model out of the room. :raises ValueError: there is none, or it is a robot."""
        if name in self._physics.robots:
            raise ValueError("%s is a robot of the world and cannot be removed" % name)
        self.placed(name)
        self._remove(self._models.pop(name))
        self._changed()

    def _place(self, name: str, urdf: Urdf, placed: Placed) -> None:
        from gspn_framework_package.world.urdf import read_solids

        pose = placed.pose
        there = matrix(pose.x, pose.y, placed.height, 0.0, 0.0, pose.yaw)
        solids = tuple(read_solids(urdf, there))
        for robot in self._physics.robots:
            at = self._physics.pose(robot)
            if any(s.distance(at.x, at.y) < self._physics.room.robot.radius for s in solids):
                raise ValueError("%s stands there" % robot)
        bodies = tuple(make_solid(self._physics.client, solid) for solid in solids)
        self._models[name] = _Model(urdf, placed, solids, bodies)
        self._changed()

    def _remove(self, model: _Model) -> None:
        for body in model.bodies:
            self._physics.client.removeBody(body)


def _turned(x: float, y: float, angle: float) -> Tuple[float, float]:
    cos, sin = math.cos(angle), math.sin(angle)
    return (x * cos - y * sin, x * sin + y * cos)
