"""Robots of the user: what their URDF says of their size, and their bodies in PyBullet.

A robot drives on two wheels, which are on an axis across it; whatever else its URDF lets move is
held where it is, and slides.
"""

from __future__ import annotations

import copy
import math
import tempfile
from dataclasses import replace
from typing import Any, Dict, List, Mapping, NamedTuple, Tuple

import numpy as np

from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.formats.xml_tree import all_of, child, tag
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.bodies import call_apart, connect_bullet, quiet
from gspn_framework_package.world.room import Pose, RobotType
from gspn_framework_package.world.shapes import fault_of_mesh, matrix, read_shape
from gspn_framework_package.world.urdf import (
    Urdf,
    UrdfJoint,
    collision_shapes,
    mass_of,
    numbers,
    read_urdf,
)

_MOST_OFFSET = 0.005
"""Metres that the axis of the wheels may be away from the origin of the robot."""

_NO_MASS = (
    '<inertial><mass value="1e-6"/>'
    '<inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def measured(kind: RobotType, given: Mapping[str, Any]) -> RobotType:
    """The type of a robot with what its URDF says of its size.

    :param kind: names the URDF and its wheels.
    :param given: what the room file states itself, which takes precedence.
    :raises InputError: the URDF cannot be read, or the robot cannot drive.
    """
    urdf = read_urdf(read_bytes(kind.urdf), kind.urdf)
    left, right = (_wheel(urdf, name) for name in kind.wheel_joints)
    at = [urdf.poses[joint.child][:3, 3] for joint in (left, right)]
    if at[0][1] <= at[1][1] or max(abs(at[0][0]), abs(at[1][0])) > _MOST_OFFSET:
        raise urdf.error(
            "the wheels are at (%.3g, %.3g) and (%.3g, %.3g)" % (*at[0][:2], *at[1][:2]),
            left.element,
            "the origin of the first link is between them; wheel_joints names left, then right",
        )
    masses = {name: mass_of(urdf, link) for name, link in urdf.links.items()}
    if not any(masses[name] for name in _base_links(urdf)):
        first = urdf.links[next(iter(urdf.poses))]
        raise urdf.error("neither it nor what is fixed to it has an <inertial>", first)
    found: Dict[str, Any] = {
        "wheel_separation": float(at[0][1] - at[1][1]),
        "mass": sum(masses.values()),
        "wheel_radius": _wheel_radius(urdf, left),
        **given,
    }
    if not found["wheel_radius"]:
        raise urdf.error(
            "the wheel's radius is not known: its shape is neither a cylinder nor a sphere",
            urdf.links[left.child],
            "state wheel_radius under robot in the room file",
        )
    kind = replace(kind, **found)
    if "radius" not in given:
        kind = replace(kind, radius=_reach(urdf, height_of(urdf, kind)))
    _try_loading(urdf, kind)
    return kind


def _base_links(urdf: Urdf) -> List[str]:
    """The first link, and all that are fixed to it."""
    found: List[str] = []
    joints = {joint.child: joint for joint in urdf.joints.values()}
    for name in urdf.poses:  # parents come before children
        joint = joints.get(name)
        if joint is None or (joint.kind == "fixed" and joint.parent in found):
            found.append(name)
    return found


def _wheel(urdf: Urdf, name: str) -> UrdfJoint:
    joint = urdf.joints.get(name)
    if joint is None:
        raise InputError(
            "it has no joint '%s'" % name,
            file=urdf.file,
            hint="wheel_joints under robot in the room file must name the left and the right wheel",
        )
    if joint.kind not in ("continuous", "revolute"):
        raise urdf.error("it does not turn: its type is '%s'" % joint.kind, joint.element)
    if abs(_forward(urdf, joint)) < 0.99:
        raise urdf.error("its axis is not across the robot", joint.element)
    link = urdf.links[joint.child]
    if not mass_of(urdf, link):
        raise urdf.error("it has no <inertial>", link)
    return joint


def _forward(urdf: Urdf, joint: UrdfJoint) -> float:
    """About 1 if the robot drives forward when the angle of the joint grows, -1 if it drives
    backward."""
    axis = child(joint.element, "axis")
    turned = [1.0, 0.0, 0.0] if axis is None else numbers(urdf, axis, "xyz", 3, joint.element)
    return float((urdf.poses[joint.child][:3, :3] @ turned)[1] / (math.hypot(*turned) or 1.0))


def _wheel_radius(urdf: Urdf, joint: UrdfJoint) -> float:
    for collision in all_of(urdf.links[joint.child], "collision"):
        for shape in collision.iter("cylinder", "sphere"):
            return numbers(urdf, shape, "radius", 1, urdf.links[joint.child])[0]
    return 0.0


def height_of(urdf: Urdf, kind: RobotType) -> float:
    """The height of the first link above the floor, on which the wheels stand."""
    left = urdf.joints[kind.wheel_joints[0]]
    return kind.wheel_radius - float(urdf.poses[left.child][2, 3])


def _reach(urdf: Urdf, height: float) -> float:
    """The radius of the circle around its collision shapes."""
    far = [0.0]
    for shape, place in collision_shapes(urdf, matrix(0.0, 0.0, height, 0.0, 0.0, 0.0)):
        if tag(shape) not in ("box", "cylinder", "sphere"):
            for solid in read_shape(shape, place) or []:
                far += [math.hypot(*corner) for corner in solid.corners()]
            continue
        sizes = [float(word) for part in shape for word in (part.text or "").split()]
        if tag(shape) == "sphere":
            far.append(float(np.hypot(*place.pose[:2, 3])) + sizes[0])
            continue
        if tag(shape) == "box":
            halves = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
            points = np.array(halves) * sizes
        else:
            radius, length = sizes
            turned = np.linspace(0.0, math.tau, 73)
            rim = np.stack([radius * np.cos(turned), radius * np.sin(turned), 0 * turned], axis=1)
            points = np.concatenate([rim + [0, 0, length / 2], rim - [0, 0, length / 2]])
        far.append(
            float(np.hypot(*(points @ place.pose[:3, :3].T + place.pose[:3, 3]).T[:2]).max())
        )
    if max(far) == 0.0:
        raise InputError("it has no collision shapes", file=urdf.file, element="robot")
    return round(max(far), 4)


class UrdfBody(NamedTuple):
    """A robot in PyBullet.

    :ivar unique_id: of the body.
    :ivar wheels: the joints of the left wheel and the right one.
    :ivar forward: 1 for each if the robot drives forward when its angle grows, else -1.
    """

    unique_id: int
    wheels: Tuple[int, int]
    forward: Tuple[float, float]


def make_urdf_robot(client: Any, kind: RobotType, pose: Pose) -> UrdfBody:
    """Create a robot of the user.

    :param kind: as :func:`measured` returns it.
    """
    urdf = read_urdf(read_bytes(kind.urdf), kind.urdf)
    unique_id = _load(client, urdf, kind, pose)
    infos = [client.getJointInfo(unique_id, n) for n in range(client.getNumJoints(unique_id))]
    numbered = {info[1].decode(): int(info[0]) for info in infos}
    left, right = (numbered[name] for name in kind.wheel_joints)
    for link in (left, right):
        client.changeDynamics(unique_id, link, lateralFriction=1.0, jointDamping=0.0)
    client.changeDynamics(unique_id, -1, lateralFriction=0.0, linearDamping=0.0, angularDamping=0.0)
    forward = [math.copysign(1.0, _forward(urdf, urdf.joints[name])) for name in kind.wheel_joints]
    return UrdfBody(unique_id, (left, right), (forward[0], forward[1]))


def _load(client: Any, urdf: Urdf, kind: RobotType, pose: Pose) -> int:
    from lxml import etree

    root = copy.deepcopy(urdf.root)
    for joint in all_of(root, "joint"):
        if joint.get("name") not in kind.wheel_joints:
            joint.set("type", "fixed")
    for link in all_of(root, "link"):
        if child(link, "inertial") is None:
            # PyBullet would assume 1 kg, and an inertia of 1 kg m2
            link.append(etree.fromstring(_NO_MASS))
    with tempfile.NamedTemporaryFile("wb", suffix=".urdf") as file:
        file.write(etree.tostring(root))
        file.flush()
        with quiet(1), quiet(2):
            return int(
                client.loadURDF(
                    file.name,
                    [pose.x, pose.y, height_of(urdf, kind)],
                    client.getQuaternionFromEuler([0, 0, pose.yaw]),
                    flags=client.URDF_MERGE_FIXED_LINKS | client.URDF_USE_INERTIA_FROM_FILE,
                )
            )


def _try_loading(urdf: Urdf, kind: RobotType) -> None:
    """Load it on trial. :raises InputError: PyBullet does not load it, or loads it incorrectly."""
    for link in urdf.links.values():
        for mesh in link.iter("mesh"):
            fault = fault_of_mesh(str(mesh.get("filename")))
            if fault:
                raise urdf.error(fault, link, "export the mesh again")
    if not call_apart(_loads, kind):
        hint = "it loads meshes of .dae, .obj and binary .stl"
        raise InputError("PyBullet does not load it", file=urdf.file, hint=hint)


def _loads(kind: RobotType) -> bool:
    client = connect_bullet(False)
    try:
        make_urdf_robot(client, kind, Pose(0.0, 0.0))
    except client.error:
        return False
    return True
