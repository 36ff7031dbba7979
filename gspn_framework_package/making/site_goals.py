"""The actions of robots on ROS that drive along the edges of a map."""

from __future__ import annotations

import re
from typing import Any, Dict, Mapping, Optional

from gspn_framework_package.making.site_elements import MapEdge, MapNode
from gspn_framework_package.model.outcome import Outcome


def drive_action(
    edge: MapEdge, node: MapNode, arrive: str, diameter: Optional[float] = None
) -> Dict[str, Any]:
    """Return the action of an edge: the goal of the map, or one for move_base; where it leads to a
    node with slots, a function that drives to a free one.

    :param node: where the edge leads.
    :param arrive: the transition that fires when the robot has arrived.
    :param diameter: of the robots (m); None if it is not known.
    """
    if node.slots:
        settings: Dict[str, Any] = {"slots": [*map(list, node.slots)], "then": arrive}
        if diameter is not None:
            settings["radius"] = diameter / 2
        return {"function": "gspn_framework_package.world.parking.Park", "settings": settings}
    # in maps: move_base_msgs/MoveBaseGoal, nav2_msgs/action/Spin, nav2_msgs.action.Spin
    package, *_, name = re.split(r"[./]", edge.action_type)
    for ending in ("ActionGoal", "Action", "Goal"):
        if name.endswith(ending):
            name = name[: -len(ending)]
            break
    goal = edge.goal
    given = goal and goal.get("target_pose")
    if goal is None or name == "MoveBase" and not (isinstance(given, dict) and "pose" in given):
        # the oldest maps specify the pose without a header
        goal = {"target_pose": {"header": {"frame_id": node.frame}, "pose": node.pose}}
    return {
        "type": "%s/%sAction" % (package, name),
        "server": edge.action,
        "goal": _stamped(goal),
        "outcomes": {Outcome.SUCCEEDED: arrive},
    }


def _stamped(value: Any) -> Any:
    """A goal with the current time in its headers."""
    if isinstance(value, list):
        return [_stamped(part) for part in value]
    if not isinstance(value, Mapping):
        return value
    found = {str(key): _stamped(part) for key, part in value.items()}
    if "frame_id" in found:
        found.setdefault("stamp", "now")
    return found
