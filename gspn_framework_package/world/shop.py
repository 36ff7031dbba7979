"""Simulates the surroundings of the robots in plans/warehouse: customers order, and batteries run
down.

Independent of ROS and of any clock; :mod:`.shop_node` connects it to the robots.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Tuple

import jsonschema

from gspn_framework_package.formats.source import read_text
from gspn_framework_package.formats.yaml_file import YamlDocument, path_text
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.room import Pose

_POSITIVE = {"type": "number", "exclusiveMinimum": 0, "maximum": 1e9}


def _numbers(count: int) -> Dict[str, Any]:
    number = {"type": "number", "minimum": -10_000, "maximum": 10_000}
    return {"type": "array", "items": number, "minItems": count, "maxItems": count}


def _record(**properties: Any) -> Dict[str, Any]:
    return {
        "type": "object",
        "required": list(properties),
        "properties": properties,
        "additionalProperties": False,
    }


_SCHEMA = _record(
    shelves={"type": "object", "minProperties": 1, "additionalProperties": _numbers(3)},
    orders=_record(mean=_POSITIVE, repeat_after=_POSITIVE),
    battery=_record(
        range=_POSITIVE, charger=_numbers(2), reach=_POSITIVE, charge_seconds=_POSITIVE
    ),
)
"""The JSON schema of ``shop.yaml``."""


@dataclass(frozen=True)
class CustomerOrder:
    """An order from the shelf ``shelf``, which a robot reaches at ``pose``."""

    id: str
    shelf: str
    pose: Pose

    def to_json(self) -> Dict[str, Any]:
        """The order as a customer sends it, with the pose as a ROS message in JSON."""
        half = self.pose.yaw / 2
        return {
            "id": self.id,
            "shelf": self.shelf,
            "pose": {
                "position": {"x": self.pose.x, "y": self.pose.y},
                "orientation": {"z": math.sin(half), "w": math.cos(half)},
            },
        }


class Shop:
    """The customers and the batteries.

    :param settings: an object that fits :data:`_SCHEMA`.
    :param seed: seed of all random numbers.
    :param run: prefix of the ids of the orders.

    :ivar ordered: the ids of all orders so far.
    """

    def __init__(self, settings: Mapping[str, Any], seed: int = 0, run: str = "order") -> None:
        self._settings = settings
        self._random = random.Random(seed)
        self._run = run
        self._levels: Dict[str, float] = {}
        self._seen: Dict[str, Tuple[Pose, float]] = {}
        self._due: List[Tuple[float, CustomerOrder]] = []
        self._next_order = self._after(0.0)
        self.ordered: List[str] = []

    def _after(self, now: float) -> float:
        return now + self._random.expovariate(1.0 / self._settings["orders"]["mean"])

    def orders(self, now: float, is_open: bool = True) -> List[CustomerOrder]:
        """The orders to send at a time (s). Each is sent twice; new ones arrive only while the shop
        is open."""
        repeated = [order for when, order in self._due if when <= now]
        self._due = [(when, order) for when, order in self._due if when > now]
        new = []
        while is_open and self._next_order <= now:
            self._next_order = self._after(self._next_order)
            name = self._random.choice(sorted(self._settings["shelves"]))
            number = len(self.ordered) + 1
            pose = Pose(*self._settings["shelves"][name])
            new.append(CustomerOrder("%s_%d" % (self._run, number), name, pose))
            self.ordered.append(new[-1].id)
            self._due.append((now + self._settings["orders"]["repeat_after"], new[-1]))
        return repeated + new

    def battery(self, robot: str, pose: Pose, now: float) -> float:
        """The level of a robot's battery, from 0 to 1, after the robot was seen at ``pose``."""
        settings = self._settings["battery"]
        level = self._levels.get(robot, 1.0)
        last, when = self._seen.get(robot, (pose, now))
        charger = Pose(*settings["charger"])
        level -= last.distance(pose) / settings["range"]
        if max(charger.distance(pose), charger.distance(last)) <= settings["reach"]:
            level += (now - when) / settings["charge_seconds"]
        self._seen[robot] = (pose, now)
        self._levels[robot] = min(max(level, 0.0), 1.0)
        return self._levels[robot]


def load_settings(file: str) -> Dict[str, Any]:
    """Read a file such as plans/warehouse/shop.yaml.

    :raises InputError: it cannot be read, or does not fit :data:`_SCHEMA`.
    """
    try:
        text = read_text(file)
    except InputError as error:
        raise InputError("cannot read the shop: %s" % error, file=file) from None
    document = YamlDocument(text, file)
    for problem in jsonschema.Draft7Validator(_SCHEMA).iter_errors(document.data):
        raise InputError(
            problem.message[:200],
            file=file,
            line=document.line(problem.path),
            element=path_text(problem.path) or "shop",
            hint="see plans/warehouse/shop.yaml",
        )
    settings: Dict[str, Any] = document.data
    return settings
