"""Reads URDF: a robot of the user, or a model that is put into the room while it runs.

All joints are taken at position 0. Poses are 4x4 matrices, lengths in metres.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Dict, List, Mapping, Optional, Tuple

import numpy as np

from gspn_framework_package.formats.xml_tree import all_of, child, line_of, parse_xml, tag
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.room import Obstacle
from gspn_framework_package.world.shapes import ShapePlace, matrix, read_shape

if TYPE_CHECKING:
    from lxml import etree

_SIZES = {"box": ("size", 3), "cylinder": ("radius length", 1), "sphere": ("radius", 1)}


@dataclass(frozen=True)
class UrdfJoint:
    """A joint: its parent and child link, and where it is in its parent.

    :param element: as it was read.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: np.ndarray
    element: etree._Element


@dataclass(frozen=True)
class Urdf:
    """The content of a file.

    :param file: its name.
    :param root: its element ``<robot>``.
    :param links: the elements of the links by name.
    :param joints: the joints by name.
    :param poses: where each link is in the frame of the first.
    """

    file: str
    root: etree._Element
    links: Mapping[str, etree._Element]
    joints: Mapping[str, UrdfJoint]
    poses: Mapping[str, np.ndarray] = field(default_factory=dict)

    def error(
        self, message: str, element: etree._Element, hint: Optional[str] = None
    ) -> InputError:
        """An error at an element."""
        name = "%s '%s'" % (tag(element), element.get("name", ""))
        return InputError(message, file=self.file, line=line_of(element), element=name, hint=hint)


def read_urdf(data: bytes, file: str) -> Urdf:
    """Read a URDF.

    :raises InputError: it is not a URDF, its links are not a tree, or a file that it names is
        missing.
    """
    root = parse_xml(data, file)
    if tag(root) != "robot":
        raise InputError("it is not a URDF: the outermost element is <%s>" % tag(root), file=file)
    urdf = Urdf(file, root, {}, {}, {})
    for element in root.iter():
        if isinstance(element.tag, str) and "xacro" in element.tag:
            raise urdf.error("it has to go through xacro first", element, "xacro FILE > robot.urdf")
    links = {str(link.get("name", "")): link for link in all_of(root, "link")}
    joints = {}
    for element in all_of(root, "joint"):
        ends = []
        for end in ("parent", "child"):
            found = child(element, end)
            name = "" if found is None else str(found.get("link", ""))
            if name not in links:
                raise urdf.error("its %s is not a link of the file: '%s'" % (end, name), element)
            ends.append(name)
        joint = UrdfJoint(
            str(element.get("name", "")),
            str(element.get("type", "")),
            ends[0],
            ends[1],
            _origin(urdf, element, element),
            element,
        )
        joints[joint.name] = joint
    for link in links.values():
        for part in (*all_of(link, "collision"), *all_of(link, "visual")):
            for mesh in part.iter("mesh"):
                mesh.set("filename", _file_of(urdf, str(mesh.get("filename", "")), link))
    return Urdf(file, root, links, joints, _link_poses(urdf, links, joints))


def _link_poses(
    urdf: Urdf, links: Mapping[str, etree._Element], joints: Mapping[str, UrdfJoint]
) -> Dict[str, np.ndarray]:
    """Where each link is in the first.

    :raises InputError: the links are not a tree.
    """
    above = {joint.child: joint for joint in joints.values()}
    first = [name for name in links if name not in above]
    if len(first) != 1 or len(above) != len(joints):
        raise InputError(
            "its links are no tree: %s"
            % ("several joints lead to one" if len(first) == 1 else "%d begin one" % len(first)),
            file=urdf.file,
        )
    poses = {first[0]: np.eye(4)}
    left = list(joints.values())
    while left:
        ready = [joint for joint in left if joint.parent in poses]
        if not ready:
            raise urdf.error("its links are not a tree: the joints form a circle", left[0].element)
        for joint in ready:
            poses[joint.child] = poses[joint.parent] @ joint.origin
        left = [joint for joint in left if joint.child not in poses]
    return poses


def _origin(urdf: Urdf, parent: etree._Element, named: etree._Element) -> np.ndarray:
    """The pose that the ``<origin>`` of an element states."""
    origin = child(parent, "origin")
    if origin is None:
        return np.eye(4)
    xyz, rpy = (numbers(urdf, origin, key, 3, named, "0 0 0") for key in ("xyz", "rpy"))
    return matrix(*xyz, *rpy)


def numbers(
    urdf: Urdf,
    element: etree._Element,
    key: str,
    count: int,
    named: etree._Element,
    default: str = "",
) -> List[float]:
    """The numbers of an attribute.

    :param named: the element that an error names.
    :raises InputError: there are fewer finite ones.
    """
    try:
        values = [float(word) for word in element.get(key, default).split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        meant = "a number" if count == 1 else "%d numbers" % count
        raise urdf.error("the %s of its <%s> is not %s" % (key, tag(element), meant), named)
    return values


def mass_of(urdf: Urdf, link: etree._Element) -> float:
    """The mass of a link, kg; 0 if it states none.

    :raises InputError: its ``<inertial>`` is not complete.
    """
    inertial = child(link, "inertial")
    if inertial is None:
        return 0.0
    _origin(urdf, inertial, link)
    mass, inertia = (_part(urdf, inertial, name, link) for name in ("mass", "inertia"))
    for key in ("ixx", "iyy", "izz"):
        _positive(urdf, inertia, key, 1, link)
    for key in ("ixy", "ixz", "iyz"):
        numbers(urdf, inertia, key, 1, link, "0")
    return _positive(urdf, mass, "value", 1, link)[0]


def _part(urdf: Urdf, parent: etree._Element, name: str, named: etree._Element) -> etree._Element:
    found = child(parent, name)
    if found is None:
        raise urdf.error("its <%s> has no <%s>" % (tag(parent), name), named)
    return found


def _positive(
    urdf: Urdf, element: etree._Element, key: str, count: int, named: etree._Element
) -> List[float]:
    values = numbers(urdf, element, key, count, named)
    if min(values) <= 0.0:
        raise urdf.error("the %s of its <%s> is not more than 0" % (key, tag(element)), named)
    return values


def _file_of(urdf: Urdf, uri: str, named: etree._Element) -> str:
    """The file of a mesh: ``package://NAME/...``, ``file://...`` or beside the URDF."""
    scheme, _, rest = uri.rpartition("://")
    path = os.path.join(os.path.dirname(os.path.abspath(urdf.file)), rest)
    if scheme == "package":
        package, _, inner = rest.partition("/")
        path = os.path.join(_package_folder(urdf, package, named), inner)
    if not os.path.isfile(path):
        raise urdf.error("there is no mesh '%s'" % uri, named, "looked for %s" % path)
    return path


def _package_folder(urdf: Urdf, package: str, named: etree._Element) -> str:
    try:
        import rospkg

        return str(rospkg.RosPack().get_path(package))
    except ImportError:
        hint = "paths of ROS packages need ROS"
    except rospkg.ResourceNotFound:
        hint = "source the workspace that has it"
    raise urdf.error("there is no package '%s'" % package, named, hint)


def read_solids(urdf: Urdf, pose: np.ndarray) -> List[Obstacle]:
    """The collision shapes of a model as the boxes and cylinders of a room, as in a world file.

    :param pose: of its first link in the room.
    :raises InputError: a shape cannot be read.
    """
    solids: List[Obstacle] = []
    for shape, place in collision_shapes(urdf, pose):
        solids += read_shape(shape, place) or []
    return solids


def collision_shapes(urdf: Urdf, pose: np.ndarray) -> List[Tuple[etree._Element, ShapePlace]]:
    """The collision shapes, each written as in SDF, and its place.

    :param pose: of the first link.
    :raises InputError: a shape is not valid URDF.
    """
    from lxml import etree

    found = []
    for name, link in urdf.links.items():
        for collision in all_of(link, "collision"):
            geometry = child(collision, "geometry")
            shapes = [] if geometry is None else [e for e in geometry if isinstance(e.tag, str)]
            if len(shapes) != 1:
                raise urdf.error("a <collision> must have exactly one geometry", link)
            (shape,) = shapes
            there = pose @ urdf.poses[name] @ _origin(urdf, collision, link)
            written = etree.Element(tag(shape))
            written.sourceline = line_of(shape)  # type: ignore[assignment]
            if tag(shape) == "mesh":
                etree.SubElement(written, "uri").text = "file://" + shape.get("filename", "")
                etree.SubElement(written, "scale").text = shape.get("scale", "1 1 1")
            elif tag(shape) in _SIZES:
                keys, count = _SIZES[tag(shape)]
                for key in keys.split():
                    _positive(urdf, shape, key, count, link)
                    etree.SubElement(written, key).text = shape.get(key)
            found.append((written, ShapePlace(urdf.file, ("link '%s'" % name,), there)))
    return found
