"""Makes a room file of solid bodies that another file describes: a map, or a world of Gazebo."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
import yaml
from scipy import ndimage

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.grid import RESOLUTION, Grid
from gspn_framework_package.world.room import ROBOT_TYPES, Box, Obstacle, Pose, Room
from gspn_framework_package.world.room_check import LARGEST_FLOOR
from gspn_framework_package.world.room_file import parse_room

MOST_SOLIDS = 4_000
"""Maximum number of solid bodies; the grid of a room takes time for each."""

ROOMY = 0.1
"""Metres that a robot has around it where it starts."""

BETWEEN_STARTS = 0.15
"""Metres between two robots where they start."""


def room_text(
    source: str,
    solids: Sequence[Obstacle],
    robots: Optional[int] = None,
    model: str = "burger",
) -> str:
    """The text of a room file with these bodies, in which robots can start.

    :param source: the file that describes the bodies; the room is named after it.
    :param robots: how many robots start; None for up to four.
    :param model: the type of the robots.
    :raises InputError: there are no bodies or too many, the room is too large, or so many robots
        do not fit.
    """
    if not solids:
        raise InputError(
            "nothing solid is in it", file=source, hint="a room ends at its outermost bodies"
        )
    if len(solids) > MOST_SOLIDS:
        raise InputError(
            "it has %d separate solid parts" % len(solids),
            file=source,
            hint="a room may have %d; remove speckles from it" % MOST_SOLIDS,
        )
    room = Room(name=Path(source).stem, walls=(), obstacles=tuple(solids), robot=ROBOT_TYPES[model])
    bounds = room.bounds()
    wide, high = (b - a for a, b in zip(bounds.low, bounds.high))
    if wide * high > LARGEST_FLOOR:
        raise InputError(
            "the room is too large: %.0f m x %.0f m" % (wide, high),
            file=source,
            hint="up to %.0f square metres can be simulated" % LARGEST_FLOOR,
        )
    spawn = _starts(room, robots or 4)
    if len(spawn) < (robots or 1):
        raise InputError(
            "only %d robots fit into its largest free area" % len(spawn),
            file=source,
            hint="ask for fewer robots" if spawn else "a %s does not fit" % model,
        )
    text = _written(replace(room, spawn=spawn), model)
    parse_room(text)
    return text


def _starts(room: Room, robots: int) -> Tuple[Pose, ...]:
    """Poses around the most open spot of the largest free area; fewer if no more fit."""
    grid = Grid(room)
    shape = (grid.rows, grid.columns)
    areas, count = ndimage.label(grid.free.reshape(shape))
    if count == 0:
        return ()
    area = areas.ravel() == 1 + np.argmax(np.bincount(areas.ravel())[1:])
    inside = np.where(area, np.minimum(grid.clearance, _to_border(shape)), -1.0)
    centre = int(np.argmax(inside))
    away = np.hypot(grid.xs - grid.xs[centre], grid.ys - grid.ys[centre])
    open_ = np.flatnonzero(inside > room.robot.radius + ROOMY)
    chosen: List[Pose] = []
    for cell in open_[np.argsort(away[open_], kind="stable")]:
        pose = Pose(round(float(grid.xs[cell]), 3), round(float(grid.ys[cell]), 3))
        if all(pose.distance(other) >= 2 * room.robot.radius + BETWEEN_STARTS for other in chosen):
            chosen.append(pose)
            if len(chosen) == robots:
                break
    return tuple(chosen)


def _to_border(shape: Tuple[int, int]) -> np.ndarray:
    """Metres from each cell to the border of the grid."""
    rows, columns = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in shape)
    return np.minimum.outer(rows, columns).ravel() * RESOLUTION


def _written(room: Room, model: str) -> str:
    """The room as YAML, with a line for each body."""
    lines: Dict[str, List[Any]] = {"boxes": [], "cylinders": []}
    for solid in room.obstacles:
        default = type(solid).__dataclass_fields__
        data = {
            key: _rounded(value)
            for key, value in asdict(solid).items()
            if value != default[key].default
        }
        lines["boxes" if isinstance(solid, Box) else "cylinders"].append(data)
    lines["spawn"] = [[pose.x, pose.y, pose.yaw] for pose in room.spawn]
    text = yaml.safe_dump({"name": room.name}, allow_unicode=True) + "walls: []\n"
    for key, entries in lines.items():
        if entries:
            text += key + ":\n"
            for entry in entries:
                line = yaml.safe_dump(entry, default_flow_style=True, width=10_000, sort_keys=False)
                text += "  - " + line
    if model != "burger":
        text += "robot: {model: %s}\n" % model
    return text


def _rounded(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_rounded(each) for each in value]
    return round(float(value), 4) if isinstance(value, (int, float)) else value
