"""The room file: reads a room from YAML, so that users describe their own.

docs/world.md lists every field; the critical room of thesis Figure 6.7 is plans/patrol/critical_room.yaml.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple, Union

import jsonschema
import yaml

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.room import (
    Area,
    Box,
    Cylinder,
    HotSpot,
    Location,
    Obstacle,
    Point,
    Pose,
    RobotType,
    Room,
    TemperatureField,
)


def _numbers(count: int) -> Dict[str, Any]:
    return {"type": "array", "items": {"type": "number"}, "minItems": count, "maxItems": count}


def _record(required: Sequence[str], **properties: Any) -> Dict[str, Any]:
    return {
        "type": "object",
        "required": list(required),
        "properties": properties,
        "additionalProperties": False,
    }


_POINT = _numbers(2)
_POSE = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}
_POSITIVE = {"type": "number", "exclusiveMinimum": 0}
_NOT_NEGATIVE = {"type": "number", "minimum": 0}
_COLOR = {"type": "string", "pattern": "^#[0-9a-fA-F]{6}$"}
_SOLID = {"at": _POINT, "height": _POSITIVE, "color": _COLOR}
_POINTS = {"type": "array", "items": _POINT, "minItems": 1}

SCHEMA: Dict[str, Any] = _record(
    ["name", "walls"],
    name={"type": "string"},
    walls={"type": "array", "items": {"type": "array", "items": _POINT, "minItems": 2}},
    wall_thickness=_POSITIVE,
    wall_height=_POSITIVE,
    cylinders={"type": "array", "items": _record(["at", "radius"], radius=_POSITIVE, **_SOLID)},
    boxes={
        "type": "array",
        "items": _record(
            ["at", "size"],
            size={"type": "array", "items": _POSITIVE, "minItems": 2, "maxItems": 2},
            yaw={"type": "number"},
            **_SOLID,
        ),
    },
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
        ambient={"type": "number"},
        hot_spots={
            "type": "array",
            "items": _record(
                ["path", "excess", "radius"],
                path=_POINTS,
                excess={"type": "number"},
                radius=_POSITIVE,
                speed=_NOT_NEGATIVE,
                hot_for=_NOT_NEGATIVE,
                cold_for=_NOT_NEGATIVE,
                phase=_NOT_NEGATIVE,
            ),
        },
    ),
    robot=_record(
        [],
        scan_rays={"type": "integer", "minimum": 1},
        **{name: _POSITIVE for name in RobotType.__dataclass_fields__ if name != "scan_rays"},
    ),
)
"""The JSON schema of a room file."""


def _line_of(node: Optional[yaml.Node], path: Iterable[Union[str, int]]) -> Optional[int]:
    """The line of the element at ``path`` (keys and indices), or of the nearest one around it that exists."""
    if node is None:
        return None
    line = node.start_mark.line + 1
    for step in path:
        child = None
        if isinstance(node, yaml.MappingNode):
            child = next((value for key, value in node.value if key.value == step), None)
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int):
            child = node.value[step] if step < len(node.value) else None
        if child is None:
            break
        node, line = child, child.start_mark.line + 1
    return line


def _path_text(path: Iterable[Union[str, int]]) -> str:
    text = ""
    for step in path:
        text += "[%d]" % step if isinstance(step, int) else ("." if text else "") + str(step)
    return text


def _point(values: Sequence[float]) -> Point:
    return (float(values[0]), float(values[1]))


def _pose(values: Sequence[float]) -> Pose:
    return Pose(*(float(value) for value in values))


def parse_room(text: str, file: Optional[str] = None) -> Room:
    """Read a room from the text of a room file.

    :param text: YAML.
    :param file: the name to tell in errors.
    :raises InputError: not YAML, not what the schema asks for, or a room that robots cannot use: an obstacle on a
        spawn pose, an entry inside its own area.
    """
    try:
        # PyYAML's safe loaders build plain data only
        tree = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        raise InputError(
            "not YAML: %s" % (getattr(error, "problem", None) or error),
            file=file,
            line=mark.line + 1 if mark is not None else None,
        ) from None
    problems = sorted(
        jsonschema.Draft7Validator(SCHEMA).iter_errors(data),
        # a misspelt name is also a missing one: tell the misspelling first
        key=lambda p: (p.validator != "additionalProperties", [str(step) for step in p.path]),
    )
    if problems:
        first = problems[0]
        raise InputError(
            first.message,
            file=file,
            line=_line_of(tree, first.path),
            element=_path_text(first.path) or "room",
            hint="%d more" % (len(problems) - 1) if len(problems) > 1 else "see docs/world.md",
        )
    room = _build(data)
    _check(room, file, tree)
    return room


def load_room(file: Union[str, Path]) -> Room:
    """Read a room file.

    :raises InputError: as :func:`parse_room`, or a file that cannot be read.
    """
    try:
        text = Path(file).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("cannot read the room: %s" % error, file=str(file)) from None
    return parse_room(text, str(file))


def _build(data: Mapping[str, Any]) -> Room:
    obstacles: List[Obstacle] = [
        Cylinder(**{**entry, "at": _point(entry["at"])}) for entry in data.get("cylinders", [])
    ]
    for entry in data.get("boxes", []):
        obstacles.append(Box(**{**entry, "at": _point(entry["at"]), "size": _point(entry["size"])}))
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
        robot=RobotType(**data.get("robot", {})),
    )


def _check(room: Room, file: Optional[str], tree: Optional[yaml.Node]) -> None:
    """What a schema cannot say: every pose that a robot is to stand in is free."""
    poses: List[Tuple[Tuple[Union[str, int], ...], Pose]] = [
        (("spawn", i), pose) for i, pose in enumerate(room.spawn)
    ]
    for name, place in room.locations.items():
        where: Tuple[Union[str, int], ...] = ("locations", name)
        if place.area.low[0] >= place.area.high[0] or place.area.low[1] >= place.area.high[1]:
            raise InputError(
                "the area has no inside",
                file=file,
                line=_line_of(tree, (*where, "area")),
                element=_path_text(where),
                hint="give its south-west corner, then its north-east corner",
            )
        outside: List[Tuple[Tuple[Union[str, int], ...], Pose]] = []
        outside.append(((*where, "entry"), place.entry))
        outside += [((*where, "bay", i), slot) for i, slot in enumerate(place.bay)]
        for path, pose in outside:
            if place.area.distance((pose.x, pose.y)) < room.robot.radius:
                raise InputError(
                    "a robot that waits there would be in the area",
                    file=file,
                    line=_line_of(tree, path),
                    element=_path_text(path),
                    hint="move it away from the area by the radius of a robot, %g m, or more"
                    % room.robot.radius,
                )
        poses += outside
        poses += [((*where, "sweep", i), Pose(*point)) for i, point in enumerate(place.sweep)]
    for path, pose in poses:
        clearance = float(room.clearance(pose.x, pose.y))
        if clearance < room.robot.radius:
            raise InputError(
                "a robot does not fit there: the nearest wall or obstacle is %.3f m away"
                % max(clearance, 0.0),
                file=file,
                line=_line_of(tree, path),
                element=_path_text(path),
                hint="a robot needs %g m" % room.robot.radius,
            )
    for group, members in [("spawn", room.spawn)] + [
        ("locations.%s.bay" % name, place.bay) for name, place in room.locations.items()
    ]:
        for i, pose in enumerate(members):
            for j, other in enumerate(members[:i]):
                if pose.distance(other) < 2 * room.robot.radius:
                    raise InputError(
                        "poses %d and %d overlap: they are %.3f m apart"
                        % (j, i, pose.distance(other)),
                        file=file,
                        line=_line_of(tree, (*group.split("."), i)),
                        element=group,
                        hint="two robots need %g m" % (2 * room.robot.radius),
                    )
