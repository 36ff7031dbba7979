"""Checks that robots can use a room, beyond what a schema can express.

Every pose for a robot to stand in must be free, as must every point of a person's path; locations
have an interior, their sweeps lie inside and their waiting poses outside; the poses of one group do
not overlap; and a path leads from every pose to every other.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import List, Tuple

from gspn_framework_package.formats.json_file import KeyOrIndex
from gspn_framework_package.formats.yaml_file import YamlDocument, path_text
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.grid import Grid
from gspn_framework_package.world.room import Location, Pose, Room

LARGEST_FLOOR = 1_600.0
"""Maximum floor area in square metres; the grid of a larger one would take too much memory and
time."""

_Path = Tuple[KeyOrIndex, ...]


def check_room(room: Room, document: YamlDocument) -> None:
    """Reject a room that robots cannot use.

    :param document: the document that it was read from, for the position of an error.
    :raises InputError: the first error.
    """
    bounds = room.bounds()
    size = [high - low for low, high in zip(bounds.low, bounds.high)]
    if size[0] * size[1] > LARGEST_FLOOR:
        raise InputError(
            "the room is too large: %.0f m x %.0f m" % (size[0], size[1]),
            file=document.file,
            line=document.line(("walls",)),
            hint="up to %.0f square metres can be simulated" % LARGEST_FLOOR,
        )
    poses: List[Tuple[_Path, Pose]] = [(("spawn", i), pose) for i, pose in enumerate(room.spawn)]
    for place in room.locations.values():
        poses += _check_location(room, place, document)
    for path, pose in poses:
        _check_fits(room, path, pose, document)
    _check_apart(room, ("spawn",), room.spawn, document)
    for name, place in room.locations.items():
        _check_apart(room, ("locations", name, "bay"), place.bay, document)
    _check_ways(room, poses, document)
    for number, person in enumerate(room.people):
        points: List[Tuple[_Path, Pose]] = [
            (("people", number, "path", i), Pose(*p)) for i, p in enumerate(person.path)
        ]
        wide = replace(room, robot=replace(room.robot, radius=person.radius))
        for path, pose in points:
            _check_fits(wide, path, pose, document, "a person")
        _check_ways(wide, points, document, "a person")


def _check_location(
    room: Room, place: Location, document: YamlDocument
) -> List[Tuple[_Path, Pose]]:
    """Check the shape of a location; return the poses for robots to stand in."""
    where: _Path = ("locations", place.name)
    radius = room.robot.radius
    if place.area.low[0] >= place.area.high[0] or place.area.low[1] >= place.area.high[1]:
        raise InputError(
            "the area has no interior",
            file=document.file,
            line=document.line((*where, "area")),
            element=path_text(where),
            hint="give its south-west corner, then its north-east corner",
        )
    outside: List[Tuple[_Path, Pose]] = [((*where, "entry"), place.entry)]
    outside += [((*where, "bay", i), slot) for i, slot in enumerate(place.bay)]
    for path, pose in outside:
        if place.area.distance((pose.x, pose.y)) < radius:
            raise document.error(
                "a robot that waits there would be in the area",
                path,
                "move it away from the area by the radius of a robot, %g m, or more" % radius,
            )
    sweep: List[Tuple[_Path, Pose]] = [
        ((*where, "sweep", i), Pose(*point)) for i, point in enumerate(place.sweep)
    ]
    for path, pose in sweep:
        if place.area.distance((pose.x, pose.y)) > 0.0:
            raise document.error(
                "the point is not in the area to sweep",
                path,
                "the area goes from %s to %s" % (list(place.area.low), list(place.area.high)),
            )
    return outside + sweep


def _check_fits(
    room: Room, path: _Path, pose: Pose, document: YamlDocument, who: str = "a robot"
) -> None:
    clearance = float(room.clearance(pose.x, pose.y))
    if clearance < room.robot.radius:
        raise document.error(
            "%s does not fit there: the nearest wall or obstacle is %.3f m away"
            % (who, max(clearance, 0.0)),
            path,
            "%s needs %g m" % (who, room.robot.radius),
        )


def _check_apart(
    room: Room, group: _Path, members: Tuple[Pose, ...], document: YamlDocument
) -> None:
    for i, pose in enumerate(members):
        for j, other in enumerate(members[:i]):
            if pose.distance(other) < 2 * room.robot.radius:
                raise InputError(
                    "poses %d and %d overlap: they are %.3f m apart" % (j, i, pose.distance(other)),
                    file=document.file,
                    line=document.line((*group, i)),
                    element=path_text(group),
                    hint="two robots need %g m" % (2 * room.robot.radius),
                )


def _check_ways(
    room: Room, poses: List[Tuple[_Path, Pose]], document: YamlDocument, who: str = "a robot"
) -> None:
    """Check that a path leads from each pose to the first one, which suffices since paths work both
    ways."""
    if len(poses) < 2:
        return
    (first, goal), others = poses[0], poses[1:]
    field = Grid(room).field((goal.x, goal.y))
    for path, pose in others:
        if math.isinf(field.cost((pose.x, pose.y))):
            raise document.error(
                "no path leads from there to %s" % path_text(first),
                path,
                "%s needs gaps of %g m and more" % (who, 2 * room.robot.radius + 0.1),
            )
