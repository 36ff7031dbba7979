"""``gspn film``: films robots in a room, without a display."""

from __future__ import annotations

import argparse
import json
import re
import time
from pathlib import Path
from typing import Any, Dict, Iterator, Tuple

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import Argument, Arguments, choice
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.model.errors import InputError, UsageError

OPTIONS: Arguments = {
    Argument("film", "FILM"): "output: .mp4 (needs ffmpeg), .gif, .webp, or a folder",
    Argument("--recording", "FILE"): "film this recording (of patrol.launch record:=FILE)",
    Argument("--room", "FILE"): "without a recording: the room file of the patrol",
    Argument("--robots", "N", numbers.whole(1, 100), 4): "without a recording: robots (4)",
    Argument("--seed", kind=numbers.seed, default=0): "without a recording: random seed (0)",
    Argument("--seconds", "S", numbers.duration, 120): (
        "length of the run to film, in seconds (120)"
    ),
    Argument("--from", "S", numbers.seconds, 0, dest="start"): (
        "start time in the run, in seconds (0)"
    ),
    Argument("--speed", "X", numbers.number(0.0, 1e4, above=0.0), 8): (
        "speed relative to the run (8)"
    ),
    Argument("--rate", "N", numbers.number(0.0, 1e3, above=0.0), 20): "frames per second (20)",
    choice("--view", ("corner", "top"), "corner"): "point of view (corner)",
    Argument("--size", "WxH", default="960x720"): "pixels (960x720)",
    "--json": "print the result as JSON",
}


def run(args: argparse.Namespace) -> int:
    """Film the run and report how it went."""
    width, height = _size(args.size)
    from gspn_framework_package.world.camera import Camera
    from gspn_framework_package.world.film import Film

    step = args.speed / args.rate
    physics, moments = _recorded(args, step) if args.recording else _simulated(args, step)
    camera = Camera(physics, width, height, args.view)
    film = Film(Path(args.film), width, height, args.rate)
    begin = time.monotonic()
    total = int(args.seconds / step) + 1
    try:
        with ProgressLine() as progress:
            for moment, poses in moments:
                for name, pose in poses.items():
                    physics.show(name, pose)
                film.add(camera.picture(moment, "%g times as fast" % args.speed))
                progress(
                    "of %s pictures" % format(total, ","), film.count, time.monotonic() - begin
                )
    finally:
        film.close()
    result = {
        "film": args.film,
        "pictures": film.count,
        "seconds": round(time.monotonic() - begin, 1),
    }
    if args.json:
        print(json.dumps(result))
    else:
        print("%s: %d pictures in %.0f s" % (args.film, film.count, result["seconds"]))
    return 0


Moments = Iterator[Tuple[float, Dict[str, Any]]]
"""Times with the poses to show; no poses if the bodies are already in place."""


def _size(text: str) -> Tuple[int, int]:
    match = re.match(r"^(\d{2,4})x(\d{2,4})$", text)
    if match is None:
        raise UsageError("--size: '%s' is not a size" % text, hint="write 960x720")
    # video formats need even dimensions
    return (int(match.group(1)) // 2 * 2, int(match.group(2)) // 2 * 2)


def _simulated(args: argparse.Namespace, step: float) -> Tuple[Any, Moments]:
    from gspn_framework_package.formats.example_plans import plans_folder
    from gspn_framework_package.world.room_file import load_room
    from gspn_framework_package.world.traffic import Patrol

    file = args.room or str(Path(plans_folder()) / "patrol" / "critical_room.yaml")
    room = load_room(file)
    if args.robots > len(room.spawn):
        raise InputError("only %d robots can start in this room" % len(room.spawn), file=file)
    patrol = Patrol(room, ["robot_%d" % (i + 1) for i in range(args.robots)], args.seed)

    def moments() -> Moments:
        patrol.run(args.start)
        while patrol.team.time <= args.start + args.seconds:
            yield patrol.team.time, {}
            patrol.run(step)

    return patrol.team.physics, moments()


def _recorded(args: argparse.Namespace, step: float) -> Tuple[Any, Moments]:
    from gspn_framework_package.world.physics import Physics
    from gspn_framework_package.world.recording import read_recording

    recording = read_recording(args.recording)
    if not recording.moments:
        raise InputError("the recording is empty", file=args.recording)
    physics = Physics(recording.room, recording.robots, recording.moments[0][1])

    def moments() -> Moments:
        for moment, poses in recording.every(step):
            if args.start <= moment <= args.start + args.seconds:
                for number, at in enumerate(recording.people.get(moment, ())):
                    physics.place_person(number, at)
                yield moment, poses

    return physics, moments()
