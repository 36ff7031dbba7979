"""Reads groups of mutual exclusion, and doors, of a map or of its tasks."""

from __future__ import annotations

import functools
import json
import os
from typing import (
    Any,
    Dict,
    Mapping,
    Protocol,
    Sequence,
)

import jsonschema

from gspn_framework_package.formats.json_file import KeyOrIndex
from gspn_framework_package.making.site_elements import DoorAction, MapDoor, MapGroup, SiteMap
from gspn_framework_package.model.errors import InputError

_SCHEMA = os.path.join(os.path.dirname(os.path.abspath(__file__)), "tasks.schema.json")


class Located(Protocol):
    """A file in which the lines of elements are known."""

    def error(self, message: str, steps: Sequence[KeyOrIndex], hint: str = "") -> InputError:
        """Return the error for an element."""


@functools.lru_cache(maxsize=1)
def tasks_schema() -> Dict[str, Any]:
    """The JSON Schema of the tasks."""
    with open(_SCHEMA, encoding="utf-8") as file:
        found: Dict[str, Any] = json.load(file)
    return found


def read_groups(data: Any, site: SiteMap, document: Located) -> Dict[str, MapGroup]:
    """Return the groups of mutual exclusion in the part ``groups`` of a file.

    :raises InputError: the groups are invalid, or name something that is not in the map.
    """
    found = {}
    for name, given in data.items() if isinstance(data, dict) else [("", data)]:
        steps: Sequence[KeyOrIndex] = ["groups", str(name)]
        if isinstance(given, dict):
            given = {"nodes": [], "edges": [], "capacity": 1, **given}
        if (
            not isinstance(given, dict)
            or set(given) != {"nodes", "edges", "capacity"}
            or not isinstance(given["nodes"], list)
            or not isinstance(given["edges"], list)
            or type(given["capacity"]) is not int
            or given["capacity"] < 1
        ):
            raise document.error(
                "it is not a group of mutual exclusion",
                steps,
                "groups: {crossing: {nodes: [A], edges: [A_B], capacity: 1}}",
            )
        found[str(name)] = _group(given, site, document, steps)
    return found


def read_doors(data: Any, site: SiteMap, document: Located) -> Dict[str, MapDoor]:
    """Return the doors in the part ``doors`` of a file.

    :raises InputError: the doors are invalid, or name something that is not in the map.
    """
    schema = {**tasks_schema(), "$ref": "#/properties/doors"}
    fault = jsonschema.exceptions.best_match(jsonschema.Draft7Validator(schema).iter_errors(data))
    if fault is not None:
        raise document.error(
            fault.message,
            ["doors", *fault.absolute_path],
            "doors: {gate: {edges: [A_B], open: {seconds: 5}, close: {seconds: 5}}}",
        )
    found = {}
    for name, given in data.items():
        steps = ["doors", str(name)]
        group = _group(given, site, document, steps)
        actions = {
            word: DoorAction(float(given[word]["seconds"]), given[word].get("action"))
            for word in ("open", "close")
            if word in given
        }
        if actions and group.capacity > 1:
            raise document.error(
                "a robot would close the door before others that are in it",
                [*steps, "capacity"],
                "a door that robots open or close is for one robot at a time",
            )
        through = [(e.source, e.target) for e in site.edges]
        adjoining = [pair for pair in through if set(pair) & set(group.nodes)]
        edges = list(dict.fromkeys([*group.edges, *adjoining]))
        if not edges:
            raise document.error("no edge leads through the door", steps, "give its 'edges'")
        found[str(name)] = MapDoor(group._replace(edges=edges), **actions)
    return found


def _group(
    given: Mapping[str, Any], site: SiteMap, document: Located, steps: Sequence[KeyOrIndex]
) -> MapGroup:
    try:
        return MapGroup(
            [*map(site.node, given.get("nodes", ()))],
            [*map(site.edge, given.get("edges", ()))],
            given.get("capacity", 1),
        )
    except InputError as error:
        raise document.error(error.message, steps, error.hint or "") from None
