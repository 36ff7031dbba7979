"""The robots as URDF, with the links of a TurtleBot3, for robot_state_publisher and rviz.

The world itself makes its robots from the same numbers (:mod:`.bodies`); it does not read this.
"""

from __future__ import annotations

import math
from typing import Mapping, Tuple

from gspn_framework_package.world.bodies import BODY_BOTTOM, BODY_HEIGHT, SCAN_HEIGHT
from gspn_framework_package.world.room import RobotType

BASE_HEIGHT = 0.01
"""Height of the frame ``base_link`` above the floor, in metres."""

FIXED_FRAMES: Mapping[str, Tuple[str, float]] = {
    "base_link": ("base_footprint", BASE_HEIGHT),
    "base_scan": ("base_link", SCAN_HEIGHT - BASE_HEIGHT),
    "imu_link": ("base_link", 0.068),
}
"""Frame -> the frame below it, and its height above that in metres. All are on the robot's axis."""

WHEEL_JOINTS = ("wheel_left_joint", "wheel_right_joint")
"""The joints of the wheels."""

_WHEEL_MASS = 0.03
_WHEEL_WIDTH = 0.018

_SOLID = """  <link name="%(name)s">
    <inertial>
      <origin xyz="0 0 %(z)g"/>
      <mass value="%(mass)g"/>
      <inertia ixx="%(across).4g" iyy="%(across).4g" izz="%(along).4g" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual>
      <origin xyz="0 0 %(z)g"/>
      <geometry><cylinder radius="%(radius)g" length="%(length)g"/></geometry>
    </visual>
    <collision>
      <origin xyz="0 0 %(z)g"/>
      <geometry><cylinder radius="%(radius)g" length="%(length)g"/></geometry>
    </collision>
  </link>
"""

_JOINT = """  <joint name="%(name)s" type="%(type)s">
    <parent link="%(parent)s"/>
    <child link="%(child)s"/>
    <origin xyz="0 %(y)g %(z)g" rpy="%(roll)g 0 0"/>%(axis)s
  </joint>
"""


def _cylinder(name: str, mass: float, radius: float, length: float, z: float = 0.0) -> str:
    return _SOLID % {
        "name": name,
        "mass": mass,
        "radius": radius,
        "length": length,
        "z": z,
        "across": mass * (3 * radius * radius + length * length) / 12,
        "along": mass * radius * radius / 2,
    }


def robot_urdf(kind: RobotType) -> str:
    """The URDF of a robot of that size."""
    text = '<?xml version="1.0"?>\n<robot name="robot">\n'
    text += '  <link name="base_footprint"/>\n'
    middle = BODY_BOTTOM + BODY_HEIGHT / 2 - BASE_HEIGHT
    text += _cylinder("base_link", kind.mass, kind.radius, BODY_HEIGHT, middle)
    text += '  <link name="base_scan"/>\n  <link name="imu_link"/>\n'
    for frame, (below, height) in FIXED_FRAMES.items():
        joint = {"name": frame.split("_link")[0] + "_joint", "type": "fixed", "axis": ""}
        place = {"parent": below, "child": frame, "y": 0.0, "z": height, "roll": 0.0}
        text += _JOINT % {**joint, **place}
    for joint_name, side in zip(WHEEL_JOINTS, (0.5, -0.5)):
        link = joint_name.replace("_joint", "_link")
        text += _cylinder(link, _WHEEL_MASS, kind.wheel_radius, _WHEEL_WIDTH)
        # the axis of a cylinder is z; that of a wheel is y
        text += _JOINT % {
            "name": joint_name,
            "type": "continuous",
            "parent": "base_link",
            "child": link,
            "y": side * kind.wheel_separation,
            "z": kind.wheel_radius - BASE_HEIGHT,
            "roll": -math.pi / 2,
            "axis": '\n    <axis xyz="0 0 1"/>',
        }
    return text + "</robot>\n"
