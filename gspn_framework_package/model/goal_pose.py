"""Poses as ROS writes them: where the goal of an action sends a robot, and where it looks."""

from __future__ import annotations

import math
from typing import Any, List, Mapping, NamedTuple, Optional


class GoalPose(NamedTuple):
    """A pose in ``frame``: ``position`` x, y, z (m), ``orientation`` the quaternion x, y, z, w."""

    frame: str
    position: List[float]
    orientation: List[float]


def goal_pose(goal: Any) -> Optional[GoalPose]:
    """The first stamped pose in the fields of a goal; None if it has none."""
    if not isinstance(goal, Mapping):
        return None
    header, pose = goal.get("header"), goal.get("pose")
    if isinstance(header, Mapping) and isinstance(pose, Mapping):
        position = _numbers(pose.get("position"), "xyz")
        orientation = _numbers(pose.get("orientation"), "xyzw")
        frame = header.get("frame_id")
        if position and orientation and isinstance(frame, str):
            return GoalPose(frame, position, orientation)
    return next(filter(None, map(goal_pose, goal.values())), None)


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """The rotation about the vertical axis of a unit quaternion (rad)."""
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _numbers(fields: Any, names: str) -> Optional[List[float]]:
    """The numbers of a map, 0 for missing keys; None if a value is not a number."""
    if not isinstance(fields, Mapping):
        return None
    values = [fields.get(name, 0.0) for name in names]
    if any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in values):
        return None
    return [float(v) for v in values]
