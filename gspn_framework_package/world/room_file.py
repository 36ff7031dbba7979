"""The room file: reads a room from YAML, so that users can describe their own.

docs/world.md lists every field; the critical room of thesis Figure 6.7 is
plans/patrol/critical_room.yaml.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union, get_type_hints

import jsonschema

from gspn_framework_package.formats.source import read_text
from gspn_framework_package.formats.yaml_file import YamlDocument, path_text
from gspn_framework_package.model.errors import InputError, closest
from gspn_framework_package.model.net import Point
from gspn_framework_package.world.faults import check_fault, read_fault
from gspn_framework_package.world.room import (
    ROBOT_TYPES,
    Area,
    Box,
    Cylinder,
    HotSpot,
    Location,
    Obstacle,
    Person,
    Pose,
    RobotType,
    Room,
    RoomFault,
    TemperatureField,
)
from gspn_framework_package.world.room_check import check_room

_NUMBER = {"type": "number", "minimum": -10_000, "maximum": 10_000}


def _numbers(count: int) -> Dict[str, Any]:
    return {"type": "array", "items": _NUMBER, "minItems": count, "maxItems": count}


def _record(required: Sequence[str], **properties: Any) -> Dict[str, Any]:
    return {
        "type": "object",
        "required": list(required),
        "properties": properties,
        "additionalProperties": False,
    }


_POINT = _numbers(2)
_POSE = {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 3}
# a smaller value is a mistake in the units
_POSITIVE = {"type": "number", "minimum": 0.001, "maximum": 10_000}
_NOT_NEGATIVE = {"type": "number", "minimum": 0, "maximum": 1_000_000}
_COLOR = {"type": "string", "pattern": "^#[0-9a-fA-F]{6}$"}
_SOLID = {"at": _POINT, "height": _POSITIVE, "color": _COLOR}
_BOX = _record(
    ["at", "size"],
    size={"type": "array", "items": _POSITIVE, "minItems": 2, "maxItems": 2},
    yaw=_NUMBER,
    **_SOLID,
)
_POINTS = {"type": "array", "items": _POINT, "minItems": 1}

ROOM_SCHEMA: Dict[str, Any] = _record(
    ["name", "walls"],
    name={"type": "string"},
    walls={"type": "array", "items": {"type": "array", "items": _POINT, "minItems": 2}},
    wall_thickness=_POSITIVE,
    wall_height=_POSITIVE,
    cylinders={"type": "array", "items": _record(["at", "radius"], radius=_POSITIVE, **_SOLID)},
    boxes={"type": "array", "items": _BOX},
    doors={"type": "object", "additionalProperties": _BOX},
    faults={"type": "array", "items": {"type": "object", "required": ["time"]}},
    locations={
        "type": "object",
        "additionalProperties": _record(
            ["area", "entry", "sweep"],
            area={"type": "array", "items": _POINT, "minItems": 2, "maxItems": 2},
            entry=_POSE,
            sweep=_POINTS,
            bay={"type": "array", "items": _POSE},
        ),
    },
    spawn={"type": "array", "items": _POSE},
    temperature=_record(
        [],
        ambient=_NUMBER,
        hot_spots={
            "type": "array",
            "items": _record(
                ["path", "excess", "radius"],
                path=_POINTS,
                excess=_NUMBER,
                radius=_POSITIVE,
                speed=_NOT_NEGATIVE,
                hot_for=_NOT_NEGATIVE,
                cold_for=_NOT_NEGATIVE,
                phase=_NOT_NEGATIVE,
            ),
        },
    ),
    people={
        "type": "array",
        "items": _record(
            ["path", "away_mean"],
            path={"type": "array", "items": _POINT, "minItems": 2},
            away_mean=_POSITIVE,
            speed=_POSITIVE,
            stands=_NOT_NEGATIVE,
            radius=_POSITIVE,
            height=_POSITIVE,
            color=_COLOR,
        ),
    },
    robot=_record(
        [],
        model={"enum": list(ROBOT_TYPES)},
        scan_rays={"type": "integer", "minimum": 1, "maximum": 10_000},
        urdf={"type": "string", "minLength": 1},
        wheel_joints={"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2},
        **{name: _POSITIVE for name, kind in get_type_hints(RobotType).items() if kind is float},
    ),
)
"""The JSON schema of a room file."""


def _is_finite_number(_checker: Any, value: Any) -> bool:
    # in YAML, .nan and .inf are numbers too
    return (
        bool(jsonschema.Draft7Validator.TYPE_CHECKER.is_type(value, "number"))
        and abs(value) < math.inf
    )


_extend: Any = jsonschema.validators.extend
_VALIDATOR = _extend(
    jsonschema.Draft7Validator,
    type_checker=jsonschema.Draft7Validator.TYPE_CHECKER.redefine("number", _is_finite_number),
)

_KINDS = {
    "array": "list",
    "object": "mapping",
    "number": "finite number",
    "integer": "whole number",
    "string": "text",
}
"""The names of the schema's types in messages."""

_LONGEST = 160  # longest message, in characters, that may quote the input


def _point(values: Sequence[float]) -> Point:
    return (float(values[0]), float(values[1]))


def _pose(values: Sequence[float]) -> Pose:
    return Pose(*(float(value) for value in values))


def parse_room(text: str, file: Optional[str] = None) -> Room:
    """Read a room from the text of a room file.

    :param text: YAML.
    :param file: the name for error messages.
    :raises InputError: it is not YAML, does not match the schema, or is a room that robots cannot
        use (:mod:`.room_check`).
    """
    document = YamlDocument(text, file)
    problems = list(_VALIDATOR(ROOM_SCHEMA).iter_errors(document.data))
    if problems:
        # a misspelt name is also a missing one: report the misspelling first
        first = min(
            problems, key=lambda p: (p.validator != "additionalProperties", document.line(p.path))
        )
        raise _refusal(first, document, len(problems) - 1)
    data = document.data
    room = replace(_build(data), robot=_robot(data.get("robot", {}), document))
    room = replace(room, faults=_faults(room, document))
    check_room(room, document)
    return room


def _robot(data: Mapping[str, Any], document: YamlDocument) -> RobotType:
    given = dict(data)
    kind = ROBOT_TYPES[given.pop("model", "burger")]
    if "wheel_joints" in given:
        given["wheel_joints"] = tuple(given["wheel_joints"])
    if "urdf" not in given:
        return replace(kind, **given)
    # it needs PyBullet, which other rooms do not
    try:
        from gspn_framework_package.world.urdf_robot import measured
    except ImportError:
        raise document.error("a robot of your own needs PyBullet", ("robot", "urdf")) from None
    given["urdf"] = str(Path(document.file or "").parent / given["urdf"])
    return measured(replace(kind, **given), given)


def _faults(room: Room, document: YamlDocument) -> Tuple[RoomFault, ...]:
    faults = []
    for number, data in enumerate(document.data.get("faults", [])):
        try:
            faults.append(read_fault(data))
            check_fault(faults[-1], room)
        except ValueError as error:
            raise document.error(str(error), ("faults", number), "see docs/world.md") from None
    return tuple(faults)


def _refusal(problem: Any, document: YamlDocument, more: int) -> InputError:
    """The error for a violation of the schema, in plain words."""
    message, key, rule = problem.message, None, problem.validator_value
    hint = "see docs/world.md"
    if problem.validator == "additionalProperties":
        known = list(problem.schema["properties"])
        key = next(name for name in problem.instance if name not in known)
        message = "there is no key '%s' here" % key
        meant = closest(key, known)
        hint = "did you mean '%s'?" % meant if meant else "the keys are %s" % ", ".join(known)
    elif problem.validator == "required":
        missing = next(name for name in rule if name not in problem.instance)
        message = "the key '%s' is missing" % missing
    elif problem.validator in ("minItems", "maxItems"):
        few = problem.schema.get("minItems", 0)
        most = problem.schema.get("maxItems")
        wanted = (
            "%d or more" % few
            if most is None
            else "%d" % few
            if few == most
            else "%d to %d" % (few, most)
        )
        message = "it has %d entries, and needs %s" % (len(problem.instance), wanted)
    elif problem.validator == "type":
        message = "%r is not a %s" % (problem.instance, _KINDS[rule])
    elif problem.validator == "pattern":
        message = "%r is not a colour such as #ffcc00" % problem.instance
    if len(message) > _LONGEST:
        message = message[: _LONGEST // 2] + " ... " + message[-_LONGEST // 2 :]
    if more:
        hint += "; %d more" % more
    line = document.line(problem.path, None if key is None else str(key))
    element = path_text(problem.path) or "room"
    return InputError(message, file=document.file, line=line, element=element, hint=hint)


def load_room(file: Union[str, Path]) -> Room:
    """Read a room file.

    :raises InputError: as :func:`parse_room`, or the file cannot be read.
    """
    try:
        text = read_text(str(file))
    except InputError as error:
        hint = None if Path(file).is_absolute() else "the path begins in %s" % Path.cwd()
        raise InputError("cannot read the room: %s" % error, file=str(file), hint=hint) from None
    return parse_room(text, str(file))


def _box(entry: Mapping[str, Any]) -> Box:
    return Box(**{**entry, "at": _point(entry["at"]), "size": _point(entry["size"])})


def _build(data: Mapping[str, Any]) -> Room:
    obstacles: List[Obstacle] = [
        Cylinder(**{**entry, "at": _point(entry["at"])}) for entry in data.get("cylinders", [])
    ]
    obstacles += [_box(entry) for entry in data.get("boxes", [])]
    locations = {
        name: Location(
            name=name,
            area=Area(_point(entry["area"][0]), _point(entry["area"][1])),
            entry=_pose(entry["entry"]),
            sweep=tuple(_point(point) for point in entry["sweep"]),
            bay=tuple(_pose(pose) for pose in entry.get("bay", [])),
        )
        for name, entry in data.get("locations", {}).items()
    }
    heat = data.get("temperature", {})
    return Room(
        name=data["name"],
        walls=tuple(tuple(_point(point) for point in line) for line in data["walls"]),
        wall_thickness=data.get("wall_thickness", 0.1),
        wall_height=data.get("wall_height", 0.3),
        obstacles=tuple(obstacles),
        locations=locations,
        spawn=tuple(_pose(pose) for pose in data.get("spawn", [])),
        temperature=TemperatureField(
            ambient=heat.get("ambient", 21.0),
            hot_spots=tuple(
                HotSpot(**{**entry, "path": tuple(_point(point) for point in entry["path"])})
                for entry in heat.get("hot_spots", [])
            ),
        ),
        doors={name: _box(entry) for name, entry in data.get("doors", {}).items()},
        people=tuple(
            Person(**{**entry, "path": tuple(_point(point) for point in entry["path"])})
            for entry in data.get("people", [])
        ),
    )
