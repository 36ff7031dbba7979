"""Maps of a site: topological maps (``.tmap2``, and the older ``.tmap``) of topological_navigation,
and plain graphs in YAML or JSON."""

from __future__ import annotations

import math
import os
import re
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from gspn_framework_package.formats.json_file import KeyOrIndex
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.formats.yaml_file import YamlDocument, is_finite_number
from gspn_framework_package.making.map_definitions import MapDefinitions
from gspn_framework_package.making.restrictions import Restriction
from gspn_framework_package.making.site_elements import MapEdge, MapNode, SiteMap
from gspn_framework_package.making.site_groups import Located, read_doors, read_groups
from gspn_framework_package.model.errors import ExpressionError, InputError

MOST_MAP_NODES = 2000
"""Maximum number of nodes of a map."""

MOST_MAP_ELEMENTS = 1_000_000
"""Maximum number of elements in the file of a map: a node has about a hundred."""

_WORD_OF_GOAL = re.compile(r"\$\{?[A-Za-z_]|\+\{?(?:node|meta)\b")
"""Prefixes of words in a goal that are replaced."""

_OLD_RESTRICTIONS = (("robot", "robot_type"), ("task", "task_name"))


def read_map(path: str) -> SiteMap:
    """Read a map.

    :raises InputError: the file cannot be read, or is not a map; with file, line and element.
    """
    content = read_bytes(path)
    text = content.decode("utf-8", "replace")
    if re.match(r"\s*node:\s*\n\s*[^\s:]+\s*\n\s*waypoint:", text):
        return _read_oldest(path, text)
    document = YamlDocument(content, path, MOST_MAP_ELEMENTS)
    reader = _Reader(document)
    data = document.data
    name = os.path.splitext(os.path.basename(path))[0]
    if isinstance(data, list):
        reader.read_topological(data, [])
    elif isinstance(data, dict) and "nodes" in data:
        name = str(data.get("name") or name)
        listed = data["nodes"]
        if isinstance(listed, list) and any(isinstance(e, dict) and "node" in e for e in listed):
            reader.define(data)
            reader.read_topological(listed, ["nodes"])
        else:
            reader.read_graph(data)
    else:
        raise document.error(
            "it is not a map: there are no 'nodes'",
            [],
            "use a .tmap2 file of topological_navigation, or a graph with nodes and edges",
        )
    return reader.finished(name)


def _read_oldest(path: str, text: str) -> SiteMap:
    """Read a map in the first form of topological_navigation, which is not YAML: blocks of indented
    lines, ``node:``, ``waypoint:`` with the seven numbers of its pose, ``edges:`` with lines
    ``NODE, ACTION``, ``vertices:``."""
    nodes: List[Dict[str, Any]] = []
    lines: List[int] = []
    part = ""
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if not line:
            continue
        if line in ("node:", "waypoint:", "edges:", "vertices:"):
            part = line[:-1]
            continue
        words = [word.strip() for word in line.split(",")]
        if part == "node":
            nodes.append({"name": line, "edges": []})
            lines.append(number)
        elif part == "waypoint":
            try:
                values = [float(word) for word in words]
                x, y, z, *turned = values
                if len(turned) != 4 or not all(map(math.isfinite, values)):
                    raise ValueError
            except ValueError:
                raise InputError(
                    "a waypoint has seven numbers: x, y, z and a quaternion",
                    file=path,
                    line=number,
                    element=nodes[-1]["name"],
                ) from None
            pose = {
                "position": dict(zip("xyz", (x, y, z))),
                "orientation": dict(zip("xyzw", turned)),
            }
            nodes[-1]["pose"] = pose
        elif part == "edges":
            nodes[-1]["edges"].append({"node": words[0], "action": "".join(words[1:2])})
    reader = _Reader(_Lines(path, lines))
    reader.read_topological(nodes, [])
    return reader.finished(os.path.splitext(os.path.basename(path))[0])


class _Lines:
    """Finds the lines of nodes in a file that is not YAML."""

    def __init__(self, path: str, lines: List[int]) -> None:
        self._path, self._lines = path, lines

    def error(self, message: str, steps: Sequence[KeyOrIndex], hint: str = "") -> InputError:
        """Return the error for an element, with file and line of its node."""
        first = steps[0] if steps else None
        line = self._lines[first] if isinstance(first, int) else None
        return InputError(message, file=self._path, line=line, hint=hint or None)


class _Reader:
    def __init__(self, document: Located) -> None:
        self._document = document
        self._nodes: Dict[str, MapNode] = {}
        self._edges: List[Tuple[MapEdge, List[KeyOrIndex]]] = []
        self._closed: List[str] = []
        self._while_driving: Dict[str, int] = {}
        self._pointsets: Dict[str, None] = {}
        self._definitions = MapDefinitions({})
        self._untyped: Dict[str, int] = {}
        self._groups: Any = {}
        self._doors: Any = {}
        self._itself = 0
        self._notes: List[str] = []

    # -- topological_navigation

    def define(self, data: Mapping[str, Any]) -> None:
        self._definitions = MapDefinitions(data)

    def read_topological(self, entries: List[Any], at: List[KeyOrIndex]) -> None:
        listed: List[Tuple[str, List[Any], List[KeyOrIndex]]] = []
        for number, entry in enumerate(entries):
            where = [*at, number]
            if not isinstance(entry, dict):
                raise self._document.error("it is not a node", where)
            where = [*where, "node"] if "node" in entry else where
            node = entry.get("node", entry)
            if not isinstance(node, dict):
                raise self._document.error("it is not a node", where)
            meta = entry.get("meta")
            meta = meta if isinstance(meta, dict) else {}
            name = self._name(node.get("name", meta.get("node")), where)
            for pointset in (meta.get("pointset"), node.get("pointset")):
                if isinstance(pointset, str):
                    self._pointsets[pointset] = None
            pose = node.get("pose")
            if not isinstance(pose, dict) or not isinstance(pose.get("position"), dict):
                raise self._document.error(
                    "the node '%s' has no pose with a position" % name, [*where, "pose"]
                )
            position = pose["position"]
            x, y = (self._number(position.get(a), [*where, "pose", "position", a]) for a in "xy")
            open_, restriction = self._restriction(node, "the node %s" % name, where)
            frame = node.get("parent_frame") or node.get("nav_frame") or self._definitions.frame
            self._add(
                MapNode(
                    name,
                    x,
                    y,
                    self._whole_pose(pose, [*where, "pose"]),
                    str(self._definitions.filled(frame)),
                    self._tags(meta.get("tag"), [*at, number, "meta", "tag"]),
                    restriction,
                    said={"meta": meta, "node": node},
                ),
                where,
            )
            if not open_:
                self._closed.append(name)
            edges = node.get("edges") or []
            if not isinstance(edges, list):
                raise self._document.error("it is not a list of edges", [*where, "edges"])
            listed.append((name, edges, [*where, "edges"]))
        for name, edges, where in listed:
            for number, edge in enumerate(edges):
                self._read_edge(name, edge, [*where, number])

    def _read_edge(self, source: str, edge: Any, where: List[KeyOrIndex]) -> None:
        if not isinstance(edge, dict) or "node" not in edge:
            raise self._document.error("the edge does not say to which 'node' it leads", where)
        target = self._name(edge["node"], [*where, "node"])
        open_, restriction = self._restriction(
            edge, "the edge from %s to %s" % (source, target), where
        )
        if not open_:
            return
        name, kind = edge.get("action") or "move_base", edge.get("action_type")
        for value, key in ((name, "action"), (kind or "", "action_type")):
            if not isinstance(value, str):
                raise self._document.error("it is not the name of an action", [*where, key])
        goal = edge.get("goal")
        server, given, template = self._definitions.action(name)
        kind, goal = kind or given, goal if isinstance(goal, dict) and goal else template
        if name != "move_base" and (not kind or kind.startswith("geometry_msgs/")):
            self._untyped[name] = self._untyped.get(name, 0) + 1
            kind = None
        self._connect(
            MapEdge(
                source,
                target,
                0.0,
                speed=self._speed(edge, where),
                action=server,
                action_type=kind or MapEdge._field_defaults["action_type"],
                goal=goal,
                restriction=restriction,
            ),
            where,
        )

    def _speed(self, edge: Mapping[str, Any], where: List[KeyOrIndex]) -> Optional[float]:
        """The speed of an edge in a map of any version."""
        for path in (["top_vel"], ["config", "top_vel"], ["properties", "max_speed"]):
            found: Any = edge
            for step in path:
                found = found.get(step) if isinstance(found, dict) else None
            if found:
                return self._number(found, [*where, *path], above=0.0)
        return None

    def _restriction(
        self, element: Mapping[str, Any], what: str, where: List[KeyOrIndex]
    ) -> Tuple[bool, Optional[Restriction]]:
        """Whether any robot may use a node or an edge, and which ones."""
        found = {}
        for key in ("restrictions_planning", "restrictions_runtime"):
            value = element.get(key)
            try:
                found[key] = Restriction("True" if value is None else str(value))
            except ExpressionError as error:
                raise self._document.error(error.message, [*where, key], error.hint or "") from None
            if found[key].holds() is False:
                self._notes.append("%s is left out: %s is False" % (what, key))
                return False, None
        planning, driving = found["restrictions_planning"], found["restrictions_runtime"]
        if driving.holds() is None:
            self._while_driving[driving.text] = self._while_driving.get(driving.text, 0) + 1
        old = element.get("restrictions")
        if isinstance(old, dict):  # an early version of the format
            given = [(prefix, old.get(key)) for prefix, key in _OLD_RESTRICTIONS]
            words = ["%s_%s" % pair for pair in given if pair[1] and isinstance(pair[1], str)]
            planning = Restriction(" & ".join([*words, planning.text or "True"]))
        return True, None if planning.holds() else planning

    def _whole_pose(self, pose: Mapping[str, Any], where: List[KeyOrIndex]) -> Dict[str, Any]:
        """The pose with all fields. A quaternion of zeros, which some maps contain, counts as no
        rotation."""
        turned = pose.get("orientation")
        parts = (
            ("position", pose["position"], "xyz"),
            ("orientation", turned if isinstance(turned, dict) else {}, "xyzw"),
        )
        found = {
            part: {a: self._number(values.get(a) or 0.0, [*where, part, a]) for a in axes}
            for part, values, axes in parts
        }
        if not any(found["orientation"].values()):
            found["orientation"]["w"] = 1.0
        return found

    def _tags(self, value: Any, where: List[KeyOrIndex]) -> List[str]:
        given = [value] if isinstance(value, (str, int)) else value or []
        if not isinstance(given, list) or not all(isinstance(tag, (str, int)) for tag in given):
            raise self._document.error("it is not a list of tags", where)
        return [str(tag) for tag in given]

    # -- plain graphs

    def read_graph(self, data: Mapping[str, Any]) -> None:
        nodes, edges = data["nodes"], data.get("edges")
        if isinstance(nodes, dict):
            pairs = [(name, value, ["nodes", name]) for name, value in nodes.items()]
        elif isinstance(nodes, list):
            pairs = []
            for number, value in enumerate(nodes):
                if not isinstance(value, dict) or "name" not in value:
                    raise self._document.error(
                        "a node has a 'name', 'x' and 'y'", ["nodes", number]
                    )
                pairs.append((value["name"], value, ["nodes", number]))
        else:
            raise self._document.error("nodes are a list, or map names to positions", ["nodes"])
        for name, value, where in pairs:
            self._read_position(self._name(name, where), value, where)
        if not isinstance(edges, (list, dict)):
            raise self._document.error("the graph has no list of 'edges'", ["edges"])
        self._note_unknown(data, {"name", "nodes", "edges", "groups", "doors"}, "the graph", [])
        self._groups, self._doors = data.get("groups") or {}, data.get("doors") or {}
        for step, edge in edges.items() if isinstance(edges, dict) else enumerate(edges):
            self._read_graph_edge(edge, ["edges", step])

    def _read_position(self, name: str, value: Any, where: List[KeyOrIndex]) -> None:
        tags: List[str] = []
        slots: List[Tuple[float, float, float]] = []
        capacity = None
        if isinstance(value, dict):
            tags = self._tags(value.get("tags"), [*where, "tags"])
            capacity = self._capacity(value.get("capacity"), [*where, "capacity"])
            slots = self._slots(value.get("slots", []), [*where, "slots"])
            known = {"name", "x", "y", "yaw", "tags", "capacity", "slots"}
            self._note_unknown(value, known, "the node '%s'" % name, where)
            axes = [value.get(axis) for axis in "xy"]
            yaw = self._number(value.get("yaw", 0.0), [*where, "yaw"])
        elif isinstance(value, list) and len(value) in (2, 3):
            axes = value[:2]
            yaw = self._number(value[2], where) if len(value) == 3 else 0.0
        else:
            raise self._document.error(
                "the node '%s' has no position" % name, where, "[x, y] or {x: 1.0, y: 2.0}"
            )
        x, y = (self._number(axis, where) for axis in axes)
        turned = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
        pose = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turned}
        self._add(MapNode(name, x, y, pose, tags=tags, capacity=capacity, slots=slots), where)

    def _slots(self, value: Any, where: List[KeyOrIndex]) -> List[Tuple[float, float, float]]:
        if not isinstance(value, list) or not all(
            isinstance(slot, list) and len(slot) in (2, 3) for slot in value
        ):
            raise self._document.error("no list of poses", where, "[[x, y, yaw], ...]")
        found = []
        for number, slot in enumerate(value):
            x, y, yaw = (self._number(axis, [*where, number]) for axis in [*slot, 0.0][:3])
            found.append((x, y, yaw))
        return found

    def _note_unknown(
        self, value: Mapping[str, Any], known: Set[str], what: str, where: List[KeyOrIndex]
    ) -> None:
        for key in value:
            if key not in known:
                found = self._document.error("'%s' of %s is not used" % (key, what), [*where, key])
                self._notes.append(str(found))

    def _capacity(self, value: Any, where: List[KeyOrIndex]) -> Optional[int]:
        if value is not None and (type(value) is not int or value < 1):
            raise self._document.error("it is not a whole number above 0", where)
        return value

    def _read_graph_edge(self, edge: Any, where: List[KeyOrIndex]) -> None:
        if isinstance(edge, list) and len(edge) == 2:
            edge = {"from": edge[0], "to": edge[1]}
        if not isinstance(edge, dict) or not {"from", "to"} <= set(edge):
            raise self._document.error("an edge is [A, B] or {from: A, to: B}", where)
        unknown = set(edge) - {"from", "to", "one_way", "length", "seconds", "speed", "capacity"}
        if unknown:
            raise self._document.error(
                "an edge has no '%s'" % sorted(map(str, unknown))[0],
                where,
                "it may have: one_way, length, seconds, speed, capacity",
            )
        values = {
            key: self._number(edge[key], [*where, key], above=0.0)
            for key in ("length", "seconds", "speed")
            if key in edge
        }
        capacity = self._capacity(edge.get("capacity"), [*where, "capacity"])
        a, b = (self._name(edge[key], [*where, key]) for key in ("from", "to"))
        length, speed, seconds = (
            values.get("length", 0.0),
            values.get("speed"),
            values.get("seconds"),
        )
        for source, target in ((a, b), (b, a))[: 1 if edge.get("one_way") else 2]:
            self._connect(MapEdge(source, target, length or 0.0, speed, seconds, capacity), where)

    # -- both

    def _name(self, name: Any, where: List[KeyOrIndex]) -> str:
        if isinstance(name, bool) or not isinstance(name, (str, int)) or not str(name).strip():
            raise self._document.error("a node has no name", where)
        return str(name)

    def _number(self, value: Any, where: List[KeyOrIndex], above: Optional[float] = None) -> float:
        if is_finite_number(value) and abs(value) < 1e9 and (above is None or value > above):
            return float(value)
        raise self._document.error(
            "'%s' is not a number%s" % (value, "" if above is None else " above %g" % above), where
        )

    def _add(self, node: MapNode, where: List[KeyOrIndex]) -> None:
        if node.name in self._nodes:
            hint = "if the file has several pointsets, make a separate map of each"
            several = len(self._pointsets) > 1
            raise self._document.error(
                "the node '%s' is there twice" % node.name, where, hint if several else ""
            )
        if len(self._nodes) >= MOST_MAP_NODES:
            raise self._document.error("a map may have %d nodes" % MOST_MAP_NODES, where)
        self._nodes[node.name] = node

    def _connect(self, edge: MapEdge, where: List[KeyOrIndex]) -> None:
        if edge.source == edge.target:
            self._itself += 1
            return
        self._edges.append((edge, where))

    def finished(self, name: str) -> SiteMap:
        """Return the map. :raises InputError: an edge leads nowhere, or there is no node."""
        if not self._nodes:
            raise self._document.error("the map has no nodes", ["nodes"])
        found: Dict[Tuple[str, str], MapEdge] = {}
        doubles = 0
        for edge, where in self._edges:
            for end in (edge.source, edge.target):
                if end not in self._nodes:
                    raise self._document.error(
                        "there is no node '%s'" % end,
                        where,
                        "remove the edge from '%s' to '%s', or add the node"
                        % (edge.source, edge.target),
                    )
            if edge.source in self._closed or edge.target in self._closed:
                continue
            if (edge.source, edge.target) in found:
                doubles += 1
                continue
            a, b = self._nodes[edge.source], self._nodes[edge.target]
            length = edge.length or math.hypot(b.x - a.x, b.y - a.y)
            goal = self._filled(edge.goal, a, b, where) if edge.goal else None
            found[edge.source, edge.target] = edge._replace(length=length, goal=goal)
        if self._itself:
            self._notes.append("edges from a node to itself are left out (%d)" % self._itself)
        if doubles:
            self._notes.append(
                "of several edges between the same nodes only the first counts; left out: %d"
                % doubles
            )
        for action, times in self._untyped.items():
            self._notes.append(
                "the map gives no type for the action '%s' (%d times): on ROS it gets a goal for "
                "move_base" % (action, times)
            )
        for text, times in self._while_driving.items():
            self._notes.append(
                "the restriction '%s' (%d times) applies at run time: the plan leaves it to the "
                "navigation" % (text, times)
            )
        if len(self._pointsets) > 1:
            self._notes.append(
                "several pointsets are read as one map: %s" % ", ".join(self._pointsets)
            )
        nodes = {key: node for key, node in self._nodes.items() if key not in self._closed}
        site = SiteMap(name, nodes, list(found.values()), self._notes)
        return site._replace(
            groups=read_groups(self._groups, site, self._document),
            doors=read_doors(self._doors, site, self._document),
        )

    def _filled(self, value: Any, origin: MapNode, node: MapNode, where: List[KeyOrIndex]) -> Any:
        """Replace the words of a goal: ``$node.PATH`` is a value of the node where the edge leads,
        ``+node.PATH`` of the node where it begins (and ``meta``)."""
        if isinstance(value, dict):
            return {str(k): self._filled(v, origin, node, where) for k, v in value.items()}
        if isinstance(value, list):
            return [self._filled(part, origin, node, where) for part in value]
        if not isinstance(value, str) or _WORD_OF_GOAL.search(value) is None:
            return value if isinstance(value, (str, int, float, bool)) else None
        meant = origin if value.startswith("+") else node
        frame, given = {"parent_frame": meant.frame, "nav_frame": meant.frame}, meant.said
        known = {"name": meant.name, "pose": meant.pose, **frame}
        found: Any = {**given, "node": {**given.get("node", {}), **known}}
        for step in value[1:].split("."):
            if isinstance(found, list) and step.isdigit() and int(step) < len(found):
                found = found[int(step)]
            else:
                found = found.get(step) if isinstance(found, dict) else None
        if found is None:
            raise self._document.error(
                "'%s' in the goal of the edge from %s to %s is not understood"
                % (value, origin.name, node.name),
                [*where, "goal"],
                "$node.PATH is a value of the node where the edge leads, +node.PATH of the node "
                "where it begins; the node '%s' has %s"
                % (meant.name, ", ".join(sorted({*map(str, given.get("node", {})), *known}))),
            )
        return found
