"""The actions of robots on ROS that drive along the edges of a map."""

from __future__ import annotations

import re
from typing import Any, Dict

from gspn_framework_package.making.site_map import MapEdge, MapNode

_MOVE_BASE = {"target_pose": {"header": {"frame_id": "$node.parent_frame"}, "pose": "$node.pose"}}


def drive_action(edge: MapEdge, node: MapNode, arrive: str) -> Dict[str, Any]:
    """Return the action of an edge: the goal of the map, or one for move_base.

    :param node: where the edge leads.
    :param arrive: the transition that fires when the robot is there.
    """
    # in maps: move_base_msgs/MoveBaseGoal, nav2_msgs/action/Spin, nav2_msgs.action.Spin
    package, *_, name = re.split(r"[./]", edge.action_type)
    for ending in ("ActionGoal", "Action", "Goal"):
        if name.endswith(ending):
            name = name[: -len(ending)]
            break
    goal = edge.goal or _MOVE_BASE
    if name == "MoveBase" and not isinstance(goal.get("target_pose"), dict):
        goal = _MOVE_BASE  # the oldest maps give the pose without a header
    return {
        "type": "%s/%sAction" % (package, name),
        "server": edge.action,
        "goal": _filled(goal, node),
        "outcomes": {"succeeded": arrive},
    }


def _filled(value: Any, node: MapNode) -> Any:
    """A goal of the map with what its ``$node`` words stand for, and the current time."""
    if isinstance(value, dict):
        found = {str(key): _filled(part, node) for key, part in value.items()}
        if "frame_id" in found:
            found.setdefault("stamp", "now")
        return found
    if isinstance(value, list):
        return [_filled(part, node) for part in value]
    return {
        "$node.pose": node.pose,
        "$node.parent_frame": node.frame,
        "$node.name": node.name,
        "+node.pose": node.pose,
    }.get(value, value if isinstance(value, (str, int, float, bool)) else None)
