"""The elements of a map of a site: nodes, edges, groups of mutual exclusion and doors."""

from __future__ import annotations

import math
from typing import Any, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.formats.yaml_file import is_finite_number
from gspn_framework_package.making.restrictions import Restriction
from gspn_framework_package.model.errors import InputError


class MapNode(NamedTuple):
    """A node: its position (m), the pose for goals, and the frame of the pose.

    :ivar tags: the tags of the node in the map.
    :ivar restriction: which robots may be there; None for all.
    :ivar capacity: how many robots may be there, if the map specifies it.
    :ivar said: the node's data in the map, for the words in goals.
    :ivar slots: poses (x, y, yaw) for robots that are there together (m, rad).
    """

    name: str
    x: float
    y: float
    pose: Mapping[str, Any]
    frame: str = "map"
    tags: Sequence[str] = ()
    restriction: Optional[Restriction] = None
    capacity: Optional[int] = None
    said: Mapping[str, Any] = {}
    slots: Sequence[Tuple[float, float, float]] = ()

    def has_room_for_two(self, diameter: float) -> bool:
        """Whether two robots of a diameter (m) fit there, by the corners of its area (``verts``)
        and its ``xy_goal_tolerance``; if the map gives neither, they do not."""
        node = self.said.get("node", {})
        corners = node.get("verts")
        points = [
            (corner["x"], corner["y"])
            for corner in (corners if isinstance(corners, list) else ())
            if isinstance(corner, dict) and all(is_finite_number(corner.get(a)) for a in "xy")
        ]
        widths = [math.hypot(a[0] - b[0], a[1] - b[1]) for a in points for b in points]
        properties = node.get("properties")
        if isinstance(properties, dict) and is_finite_number(properties.get("xy_goal_tolerance")):
            widths.append(2 * properties["xy_goal_tolerance"])
        return max(widths, default=0.0) >= diameter


class MapEdge(NamedTuple):
    """A directed edge.

    :ivar length: in metres.
    :ivar speed: in m/s, if the map specifies it.
    :ivar seconds: how long it takes, if the map specifies it.
    :ivar capacity: how many robots may be on it, if the map specifies it.
    :ivar action: name of the action server that drives along it.
    :ivar action_type: the type of its goals, as written in the map.
    :ivar goal: its goal, with its words replaced.
    :ivar restriction: which robots may drive there; None for all.
    """

    source: str
    target: str
    length: float
    speed: Optional[float] = None
    seconds: Optional[float] = None
    capacity: Optional[int] = None
    action: str = "move_base"
    action_type: str = "move_base_msgs/MoveBaseGoal"
    goal: Optional[Mapping[str, Any]] = None
    restriction: Optional[Restriction] = None


class MapGroup(NamedTuple):
    """Nodes and edges (A, B), in both directions, where at most ``capacity`` robots may be in
    total."""

    nodes: Sequence[str]
    edges: Sequence[Tuple[str, str]]
    capacity: int


class DoorAction(NamedTuple):
    """A robot's action at a door, to open or close it: its mean ``seconds``, and its ``action`` on
    ROS (as in a plan file), if any."""

    seconds: float
    action: Any = None


class MapDoor(NamedTuple):
    """A door or a lift: a group, with all edges to and from its nodes.

    :ivar open: what a robot does before it drives in; None for nothing.
    :ivar close: what it does when it has left.
    """

    group: MapGroup
    open: Optional[DoorAction] = None
    close: Optional[DoorAction] = None


class SiteMap(NamedTuple):
    """A map: its ``nodes`` by name, its ``edges``, ``notes`` on how it was read, and ``groups`` of
    mutual exclusion and ``doors`` by name."""

    name: str
    nodes: Mapping[str, MapNode]
    edges: Sequence[MapEdge]
    notes: Sequence[str]
    groups: Mapping[str, MapGroup] = {}
    doors: Mapping[str, MapDoor] = {}

    def node(self, name: Any) -> str:
        """Return the node of that name.

        :raises InputError: the map has none; the error names no file.
        """
        if str(name) not in self.nodes:
            raise InputError(
                "there is no node '%s' in the map" % name,
                hint="it has %s" % ", ".join(list(self.nodes)[:8]),
            )
        return str(name)

    def edge(self, name: Any) -> Tuple[str, str]:
        """Return the edge named ``A_B``, or ``A -> B`` if several edges have that name.

        :raises InputError: the map has none, or several; the error names no file.
        """
        pairs = [(edge.source, edge.target) for edge in self.edges]
        found = [pair for pair in pairs if str(name) in ("_".join(pair), " -> ".join(pair))]
        if len(found) != 1:
            raise InputError(
                "there is %s edge '%s' in the map" % ("more than one" if found else "no", name),
                hint="A_B is the edge between A and B, and so is 'A -> B'",
            )
        return found[0]
