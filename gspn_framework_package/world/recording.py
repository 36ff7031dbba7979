"""Recorded runs of the world: JSON lines, the first with the room and the robots, then one per
moment: the time, the poses of the robots, in a room with people their positions (null for absent),
and the time of the wall clock, which relates each moment to the log of the run."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, TextIO, Tuple, Union

from gspn_framework_package.formats.source import read_text
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.net import Point
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.room import Pose, Room
from gspn_framework_package.world.room_file import parse_room

RECORDING_FORMAT = "gspn_world_1"


class Recorder:
    """Records the motion of a team in a file; a context manager.

    :param file: the file to write; an existing one is replaced.
    :param room_text: the text of the room file, so that the recording needs no other file.
    :raises InputError: the file cannot be written.
    """

    def __init__(self, file: Union[str, Path], room_text: str, team: DrivingTeam) -> None:
        self._team = team
        try:
            self._out: TextIO = open(file, "w", encoding="utf-8")  # noqa: SIM115  # closed by close()
        except OSError as error:
            raise InputError(
                "cannot write the recording: %s" % error.strerror, file=str(file)
            ) from None
        head: Dict[str, Any] = {
            "format": RECORDING_FORMAT,
            "robots": list(team.robots),
            "room": room_text,
            "wall": True,  # moments have it; those of earlier versions do not
        }
        self._out.write(json.dumps(head) + "\n")

    def record(self) -> None:
        """Write the current poses of all robots, and where people are."""
        poses = [self._team.physics.pose(name) for name in self._team.robots]
        line = [[round(p.x, 4), round(p.y, 4), round(p.yaw, 4)] for p in poses]
        moment: List[Any] = [round(self._team.time, 3), line]
        if self._team.people:
            where = [walker.at for walker in self._team.people]
            moment.append([at and [round(at[0], 4), round(at[1], 4)] for at in where])
        moment.append(round(time.time(), 3))
        self._out.write(json.dumps(moment) + "\n")

    def close(self) -> None:
        """End the recording."""
        self._out.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


@dataclass(frozen=True)
class RoomRecording:
    """A recorded run.

    :param robots: names of the robots, in the order of the poses.
    :param moments: pairs of time in seconds and poses, sorted by time.
    :param people: time -> position of each person of the room; None for absent.
    :param wall: for each moment the time of the wall clock (s since 1970); empty if unknown.
    """

    room: Room
    robots: Tuple[str, ...]
    moments: Tuple[Tuple[float, Tuple[Pose, ...]], ...]
    people: Mapping[float, Tuple[Optional[Point], ...]] = field(default_factory=dict)
    wall: Tuple[float, ...] = ()

    def every(self, seconds: float) -> Iterator[Tuple[float, Dict[str, Pose]]]:
        """Yield the latest recorded moment at regular intervals of ``seconds``."""
        due = self.moments[0][0] if self.moments else 0.0
        for (moment, poses), after in zip(self.moments, [*self.moments[1:], None]):
            if after is None or after[0] > due:
                yield moment, dict(zip(self.robots, poses))
                due += seconds


def read_recording(file: Union[str, Path]) -> RoomRecording:
    """Read a recording; an incomplete last line is ignored.

    :raises InputError: it cannot be read, or is not a recording.
    """
    try:
        lines = read_text(str(file)).splitlines()
    except InputError as error:
        raise InputError("cannot read the recording: %s" % error, file=str(file)) from None
    moments: List[Tuple[float, Tuple[Pose, ...]]] = []
    people: Dict[float, Tuple[Optional[Point], ...]] = {}
    walls: List[float] = []
    number = 1
    try:
        head = json.loads(lines[0])
        if head["format"] != RECORDING_FORMAT:
            raise ValueError("the format is %r" % head["format"])
        robots = tuple(str(name) for name in head["robots"])
        room = parse_room(head["room"], str(file))
        for number, line in enumerate(lines[1:], 2):
            try:
                moment, poses, *where = json.loads(line)
            except ValueError:
                if number == len(lines):
                    break  # cut off when the run ended
                raise
            if len(poses) != len(robots):
                raise ValueError("%d poses of %d robots" % (len(poses), len(robots)))
            if head.get("wall"):
                walls.append(float(where.pop()))
            moments.append((float(moment), tuple(Pose(*map(float, pose)) for pose in poses)))
            if room.people:
                (seen,) = where
                if len(seen) != len(room.people):
                    raise ValueError("%d places of %d people" % (len(seen), len(room.people)))
                people[float(moment)] = tuple(at and (float(at[0]), float(at[1])) for at in seen)
    except (RecursionError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(
            "not a recording of a world: %s" % error,
            file=str(file),
            line=number,
            hint="record one with world.launch record:=FILE",
        ) from None
    return RoomRecording(room, robots, tuple(moments), people, tuple(walls))
