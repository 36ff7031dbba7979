"""Solid shapes of world and robot files, as the boxes and cylinders of a room.

Upright boxes and cylinders are read without change, and a sphere as the cylinder that a robot could
touch. Everything else, also meshes, becomes small boxes where PyBullet's rays hit it at the heights
of a robot.
"""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, List, NamedTuple, Optional, Tuple
from xml.sax.saxutils import quoteattr

import numpy as np

from gspn_framework_package.formats.xml_tree import attributes, child, line_of, tag, text_of
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.bodies import (
    BODY_BOTTOM,
    BODY_HEIGHT,
    call_apart,
    connect_bullet,
    quiet,
)
from gspn_framework_package.world.grid import merged_boxes
from gspn_framework_package.world.room import Box, Cylinder, Obstacle
from gspn_framework_package.world.room_check import LARGEST_FLOOR

if TYPE_CHECKING:
    from lxml import etree

ROBOT_TOP = 0.2
"""Height in metres above which nothing touches a robot."""

CELL = 0.025
"""Side of the small boxes, metres."""

_HEIGHTS = np.arange(BODY_BOTTOM, BODY_HEIGHT + BODY_BOTTOM, 0.02)

_UPRIGHT = 1.0 - 1e-6


class ShapePlace(NamedTuple):
    """Where an element is: its file, the names around it, and its pose in the world."""

    file: str
    names: Tuple[str, ...]
    pose: np.ndarray

    def inner(self, element: etree._Element, pose: Optional[np.ndarray] = None) -> ShapePlace:
        """The place of an element in this one."""
        name = "%s '%s'" % (tag(element), element.get("name", ""))
        own = pose_of(element, self) if pose is None else pose
        return ShapePlace(self.file, (*self.names, name), self.pose @ own)

    def error(
        self, message: str, element: etree._Element, hint: Optional[str] = None
    ) -> InputError:
        """An error at an element in this one."""
        return InputError(
            message,
            file=self.file,
            line=line_of(element),
            element=", ".join(self.names) or None,
            hint=hint,
        )


def resolve(uri: str, place: ShapePlace, element: etree._Element) -> str:
    """The file or folder of a URI: ``model://NAME/...``, ``file://...`` or a relative path."""
    scheme, _, rest = uri.rpartition("://")
    beside = os.path.dirname(os.path.abspath(place.file))
    folders = [beside]
    if scheme == "model":
        folders += os.environ.get("GAZEBO_MODEL_PATH", "").split(os.pathsep)
        folders += [str(Path.home() / ".gazebo" / "models"), os.path.dirname(beside)]
    if scheme in ("", "file", "model") and rest:
        for folder in filter(None, folders):
            path = os.path.join(folder, rest)
            if os.path.exists(path):
                return path
    raise place.error(
        "there is no '%s'" % uri,
        element,
        "looked in %s; GAZEBO_MODEL_PATH names more folders" % ", ".join(filter(None, folders)),
    )


def pose_of(element: etree._Element, place: ShapePlace) -> np.ndarray:
    """The pose of an element in the one around it, as a matrix."""
    pose = child(element, "pose")
    if pose is None:
        return np.eye(4)
    for name, value in attributes(pose).items():
        if value and not (name == "degrees" and value == "false"):
            raise place.error("a pose with '%s' is not read" % name, pose)
    return matrix(*numbers_in(pose, 6, place))


def matrix(x: float, y: float, z: float, roll: float, pitch: float, yaw: float) -> np.ndarray:
    """A pose as a 4x4 matrix."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y],
            [-sp, cp * sr, cp * cr, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def numbers_in(element: etree._Element, count: int, place: ShapePlace) -> List[float]:
    """The numbers in an element. :raises InputError: there are fewer finite ones."""
    words = (element.text or "").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise place.error("<%s> has not %d numbers" % (tag(element), count), element)
    return values


def _size(geometry: etree._Element, name: str, count: int, place: ShapePlace) -> List[float]:
    element = child(geometry, name)
    if element is None:
        raise place.error("<%s> is missing" % name, geometry)
    values = numbers_in(element, count, place)
    if min(values) <= 0.0:
        raise place.error("<%s> is not more than 0" % name, element)
    return values


def read_shape(shape: etree._Element, place: ShapePlace) -> Optional[List[Obstacle]]:
    """A shape as boxes and cylinders; None if no robot can touch it."""
    kind, pose = tag(shape), place.pose
    x, y, z = (float(value) for value in pose[:3, 3])
    upright = abs(pose[2, 2]) > _UPRIGHT
    if kind == "plane":
        normal = child(shape, "normal")
        up = (0.0, 0.0, 1.0) if normal is None else numbers_in(normal, 3, place)
        if (pose[:3, :3] @ up)[2] < _UPRIGHT * np.linalg.norm(up) or abs(z) > 1e-3:
            raise place.error("a plane that is not the floor is not read", shape)
        return []
    if kind == "sphere":
        (radius,) = _size(shape, "radius", 1, place)
        if _out_of_reach(z - radius, z + radius):
            return None
        # it is widest at its middle, or where the robot ends
        widest = math.sqrt(radius**2 - max(z - ROBOT_TOP, 0.0) ** 2)
        return [Cylinder(at=(x, y), radius=widest, height=z + radius)]
    if kind == "box":
        size = _size(shape, "size", 3, place)
        if not upright:
            return _hit(place, shape, '<box size="%r %r %r"/>' % tuple(size))
        if _out_of_reach(z - size[2] / 2, z + size[2] / 2):
            return None
        yaw = math.atan2(pose[1, 0], pose[0, 0])
        return [Box((x, y), (size[0], size[1]), yaw, height=z + size[2] / 2)]
    if kind == "cylinder":
        (radius,), (length,) = (_size(shape, name, 1, place) for name in ("radius", "length"))
        if not upright:
            return _hit(place, shape, '<cylinder radius="%r" length="%r"/>' % (radius, length))
        if _out_of_reach(z - length / 2, z + length / 2):
            return None
        return [Cylinder((x, y), radius, height=z + length / 2)]
    if kind == "mesh":
        return _read_mesh(shape, place)
    raise place.error("<%s> is not read" % kind, shape)


def _out_of_reach(bottom: float, top: float) -> bool:
    return bottom >= ROBOT_TOP or top <= BODY_BOTTOM


def _read_mesh(shape: etree._Element, place: ShapePlace) -> Optional[List[Obstacle]]:
    part = child(shape, "submesh")
    if part is not None:
        raise place.error("<submesh> is not read", part, "save the part as its own file")
    file = os.path.abspath(resolve(text_of(shape, "uri") or "", place, shape))
    element = child(shape, "scale")
    scale = (1.0, 1.0, 1.0) if element is None else tuple(numbers_in(element, 3, place))
    if 0.0 in scale:
        raise place.error("its <scale> is 0", shape)
    fault = fault_of_mesh(file)
    if fault:
        raise place.error(fault, shape, "export the mesh again")
    return _hit(
        place, shape, '<mesh filename=%s scale="%r %r %r"/>' % (quoteattr(file), *scale), file
    )


def fault_of_mesh(file: str) -> str:
    """Where a face of an ``.obj`` file names a point that is not in the file, of which PyBullet
    would read whatever lies there in memory; "" if none does, or the file is of another kind."""
    if not file.lower().endswith(".obj"):
        return ""
    with open(file, encoding="utf-8", errors="replace") as lines:
        words = [(number, line.split()) for number, line in enumerate(lines, 1)]
    before, points = 0, sum(word[:1] == ["v"] for _, word in words)
    for number, word in words:
        before += word[:1] == ["v"]
        for corner in word[1:] if word[:1] == ["f"] else ():
            with contextlib.suppress(ValueError):  # which PyBullet refuses
                point = int(corner.split("/")[0])
                if not (1 <= point <= points or -before <= point <= -1):
                    return "line %d of %s names a point that is not in it" % (number, file)
    return ""


def _hit(
    place: ShapePlace, shape: etree._Element, geometry: str, file: str = ""
) -> Optional[List[Obstacle]]:
    """Boxes where rays hit a shape at the heights of a robot; None if none does.

    :param geometry: the shape, as an element of URDF.
    :param file: of the mesh.
    """
    try:
        boxes = call_apart(_hit_boxes, geometry, place.pose)
    except ValueError as error:
        raise place.error(str(error), shape) from None
    if boxes is None:
        raise place.error(
            "PyBullet does not load %s" % file,
            shape,
            "it loads .dae, .obj and binary .stl; export the mesh again",
        )
    return list(boxes) or None


def _hit_boxes(geometry: str, pose: np.ndarray) -> Optional[List[Box]]:
    """Boxes where rays hit a shape; None if PyBullet does not load it.

    :raises ValueError: it is larger than a room.
    """
    client = connect_bullet(False)
    collision = '<collision concave="yes"><geometry>%s</geometry></collision>' % geometry
    with tempfile.NamedTemporaryFile("w", suffix=".urdf") as urdf, quiet(1), quiet(2):
        urdf.write('<robot name="r"><link name="l">%s</link></robot>' % collision)
        urdf.flush()
        turned = _quaternion(client, pose)
        try:
            body = client.loadURDF(urdf.name, pose[:3, 3].tolist(), turned, useFixedBase=True)
        except client.error:
            return None
    if not client.getCollisionShapeData(body, -1):
        return None
    low, high = (np.array(corner) for corner in client.getAABB(body))
    if _out_of_reach(low[2], high[2]):
        return []
    south_west, north_east = np.floor(low / CELL) - 1, np.ceil(high / CELL) + 1
    wide, deep = (north_east - south_west)[:2] * CELL
    if wide * deep > LARGEST_FLOOR:
        raise ValueError("it is too large for a room: %.0f m x %.0f m" % (wide, deep))
    return _hit_cells(client, south_west, north_east)


def _quaternion(client: Any, pose: np.ndarray) -> List[float]:
    """The rotation of a matrix, as PyBullet has it."""
    yaw, pitch = math.atan2(pose[1, 0], pose[0, 0]), math.asin(min(max(-pose[2, 0], -1.0), 1.0))
    roll = math.atan2(pose[2, 1], pose[2, 2])
    return list(client.getQuaternionFromEuler([roll, pitch, yaw]))


def _hit_cells(client: Any, low: np.ndarray, high: np.ndarray) -> List[Box]:
    """Boxes of the cells in which rays along x and y, to and fro, hit something.

    :param low: south-west corner of the area, in cells.
    :param high: north-east corner of the area, in cells.
    """
    columns, rows = (int(high[axis] - low[axis]) for axis in (0, 1))
    filled = np.zeros((rows, columns), bool)
    for axis in (0, 1):
        lanes = low[1 - axis] + 0.5 + np.arange((rows, columns)[axis])
        for begin, end in ((low[axis], high[axis]), (high[axis], low[axis])):
            starts = np.empty((len(lanes) * len(_HEIGHTS), 3))
            starts[:, axis] = begin * CELL
            starts[:, 1 - axis] = np.repeat(lanes, len(_HEIGHTS)) * CELL
            starts[:, 2] = np.tile(_HEIGHTS, len(lanes))
            step = math.copysign(1e-3, end - begin)
            while len(starts):
                ends = starts.copy()
                ends[:, axis] = end * CELL
                hits = _rays(client, starts, ends)
                cells = np.floor(hits[:, :2] / CELL - low[:2]).astype(int)
                filled[cells[:, 1], cells[:, 0]] = True
                starts = hits
                starts[:, axis] += step
                starts = starts[(end * CELL - starts[:, axis]) * step > 0.0]
    return merged_boxes(filled, CELL, (float(low[0]) * CELL, float(low[1]) * CELL))


_RAYS = 8_000  # PyBullet takes no more at once


def _rays(client: Any, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """The points that are hit."""
    found: List[Tuple[float, float, float]] = []
    for first in range(0, len(starts), _RAYS):
        part = slice(first, first + _RAYS)
        hits = client.rayTestBatch(starts[part].tolist(), ends[part].tolist())
        found += [hit[3] for hit in hits if hit[0] >= 0]
    return np.array(found).reshape(-1, 3)
