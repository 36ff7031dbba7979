"""The tasks of robots at the nodes of a map: ``tasks.yaml``."""

from __future__ import annotations

from typing import (
    Any,
    Callable,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
)

import jsonschema

from gspn_framework_package.formats.json_file import KeyOrIndex
from gspn_framework_package.formats.yaml_file import YamlDocument, read_yaml
from gspn_framework_package.making.site_elements import MapDoor, MapGroup, SiteMap
from gspn_framework_package.making.site_groups import read_doors, read_groups, tasks_schema
from gspn_framework_package.model.errors import InputError

_Found = TypeVar("_Found")

TAG = "tag:"
"""Prefix of a tag, which selects nodes by tag instead of by name."""


class SiteTask(NamedTuple):
    """A task: its nodes, mean ``seconds``, the mean time in seconds until it is due again
    (``again_after``), and its ``action`` on ROS (as in a plan file), if any."""

    at: Sequence[str]
    seconds: float
    again_after: float = 60.0
    action: Any = None


class BatteryTopic(NamedTuple):
    """Where robots on ROS read their batteries.

    :ivar topic: relative to the namespace of the robot.
    :ivar type: of its messages.
    :ivar field: the charge in a message.
    :ivar below: level, all but the first -> the charge below which it begins.
    :ivar empty: the charge below which a robot is stranded; None if that is not detected.
    :ivar charged: the charge above which charging ends.
    """

    below: Mapping[str, float]
    topic: str = "battery"
    type: str = "sensor_msgs/BatteryState"
    field: str = "percentage"
    empty: Optional[float] = None
    charged: float = 0.95

    def event(self, charge: float) -> Dict[str, str]:
        """Return the event that the charge falls below a value."""
        when = "%s < %g" % (self.field, charge)
        return {"topic": self.topic, "type": self.type, "when": when}


class SiteTasks(NamedTuple):
    """The content of the file, with its defaults.

    :ivar edges: (node, node) -> capacity and seconds that the file gives that edge, in both
        directions; a capacity of None is any number.
    :ivar node_capacity: how many robots may be in a node by default; None for any number.
    :ivar nodes: node -> how many robots may be there; None for any number.
    :ivar diameter: of the robots (m): a node without room for two of them holds one by default;
        None if it is not known.
    :ivar groups: the groups of mutual exclusion, including the map's; likewise the ``doors``.
    :ivar parking: the nodes where robots wait while nothing is due; empty: at the docks.
    :ivar battery: level, from full to low -> probability that it ends on an edge; empty: robots do
        not need to charge.
    :ivar docks: node -> how many robots can charge there at a time.
    :ivar types: the types of the robots, in turn, for the restrictions of the map.
    :ivar conditions: name in restrictions -> whether it holds.
    """

    plan: Optional[str] = None
    start: Sequence[str] = ()
    speed: float = 0.5
    shape: float = 16.0
    capacity: Optional[int] = 1
    node_capacity: Optional[int] = None
    nodes: Mapping[str, Optional[int]] = {}
    diameter: Optional[float] = None
    groups: Mapping[str, MapGroup] = {}
    doors: Mapping[str, MapDoor] = {}
    parking: Sequence[str] = ()
    edges: Mapping[Tuple[str, str], Mapping[str, Any]] = {}
    tasks: Mapping[str, SiteTask] = {}
    battery: Mapping[str, float] = {}
    docks: Mapping[str, int] = {}
    charge: float = 60.0
    stranded: float = 600.0
    types: Sequence[str] = ()
    conditions: Mapping[str, bool] = {}
    battery_topic: Optional[BatteryTopic] = None


def read_tasks(path: str, site: SiteMap) -> SiteTasks:
    """Read the file for a map.

    :raises InputError: the file does not fit the schema or the map; with file, line and element.
    """
    document = read_yaml(path)
    data = document.data
    validator = jsonschema.Draft7Validator(tasks_schema())
    fault = jsonschema.exceptions.best_match(validator.iter_errors(data))
    if fault is not None:
        raise document.error(fault.message, list(fault.absolute_path), "see docs/building_plans.md")
    reader = _Names(document, site)
    tasks = {
        name: SiteTask(
            reader.nodes(task["at"], ["tasks", name, "at"]),
            float(task["seconds"]),
            float(task.get("again_after", SiteTask._field_defaults["again_after"])),
            task.get("action"),
        )
        for name, task in data.get("tasks", {}).items()
    }
    docks: Dict[str, int] = {}
    for given, places in data.get("docks", {}).items():
        for node in reader.meant(given, ["docks", str(given)]):
            docks.setdefault(node, places)
    battery = {str(level): float(share) for level, share in data.get("battery", {}).items()}
    if battery and not docks:
        raise document.error(
            "the robots have batteries, and nowhere to charge", ["battery"], "give 'docks' too"
        )
    topic = BatteryTopic(**data["battery_topic"]) if "battery_topic" in data else None
    if topic is not None:
        if set(topic.below) != set(list(battery)[1:]):
            raise document.error(
                "it does not say where each level but the first begins",
                ["battery_topic", "below"],
                "the levels are %s" % (", ".join(battery) or "given as 'battery'"),
            )
        charges = [topic.charged, *(topic.below[level] for level in list(battery)[1:])]
        charges += [] if topic.empty is None else [topic.empty]
        if sorted(set(charges), reverse=True) != charges:
            raise document.error(
                "the charges do not fall from 'charged' through the levels to 'empty'",
                ["battery_topic"],
            )
    simple = {key: data[key] for key in ("plan",) if key in data}
    for key in ("speed", "shape", "charge", "stranded", "diameter"):
        if key in data:
            simple[key] = float(data[key])
    for key in ("capacity", "node_capacity"):
        if key in data:
            simple[key] = data[key]
    nodes = {
        node: given["capacity"]
        for name, given in data.get("nodes", {}).items()
        for node in reader.meant(name, ["nodes", str(name)])
    }
    return SiteTasks(
        start=reader.nodes(data.get("start", []), ["start"]),
        edges=reader.edges(data.get("edges", {})),
        nodes=nodes,
        groups={**site.groups, **read_groups(data.get("groups", {}), site, document)},
        doors={**site.doors, **read_doors(data.get("doors", {}), site, document)},
        parking=reader.nodes(data.get("parking", []), ["parking"]),
        tasks=tasks,
        battery=battery,
        docks=docks,
        battery_topic=topic,
        types=data.get("types", []),
        conditions=data.get("conditions", {}),
        **simple,
    )


class _Names:
    """Looks up nodes and edges of the map."""

    def __init__(self, document: YamlDocument, site: SiteMap) -> None:
        self._document = document
        self._site = site

    def meant(self, name: Any, where: List[KeyOrIndex]) -> List[str]:
        """The node of that name; of ``tag:TAG`` those with the tag."""
        if not str(name).startswith(TAG) or name in self._site.nodes:
            return [self._found(self._site.node, name, where)]
        tag = str(name)[len(TAG) :].strip()
        found = [node.name for node in self._site.nodes.values() if tag in node.tags]
        if not found:
            tags = dict.fromkeys(t for node in self._site.nodes.values() for t in node.tags)
            raise self._document.error(
                "no node of the map has the tag '%s'" % tag,
                where,
                "its tags are %s" % ", ".join(list(tags)[:8]) if tags else "it has no tags",
            )
        return found

    def nodes(self, names: Sequence[Any], where: List[KeyOrIndex]) -> List[str]:
        for number, name in enumerate(names):
            if str(name) in map(str, names[:number]):
                raise self._document.error("'%s' is there twice" % name, [*where, number])
        found = [self.meant(name, [*where, number]) for number, name in enumerate(names)]
        return list(dict.fromkeys(node for nodes in found for node in nodes))

    def edges(self, data: Mapping[Any, Any]) -> Dict[Tuple[str, str], Mapping[str, Any]]:
        found: Dict[Tuple[str, str], Mapping[str, Any]] = {}
        for name, given in data.items():
            a, b = self._found(self._site.edge, name, ["edges", str(name)])
            found[a, b] = found[b, a] = given
        return found

    def _found(
        self, look_up: Callable[[Any], _Found], name: Any, where: List[KeyOrIndex]
    ) -> _Found:
        try:
            return look_up(name)
        except InputError as error:
            raise self._document.error(error.message, where, error.hint or "") from None
