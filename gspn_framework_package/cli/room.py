"""``gspn room``: makes a room for simulated robots from a map or a Gazebo world."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any, List, Sequence, Tuple

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.options import Argument, Arguments, choice
from gspn_framework_package.cli.plan_output import refuse_existing
from gspn_framework_package.formats.source import write_bytes
from gspn_framework_package.model.errors import UsageError

SDF_ENDINGS = (".world", ".sdf")
"""The endings of the names of Gazebo's worlds."""

OPTIONS: Arguments = {
    Argument("source", "SOURCE"): (
        "the YAML file of a map of map_server, or a world of Gazebo (%s)" % ", ".join(SDF_ENDINGS)
    ),
    Argument("-o --output", "ROOM"): "the room file to write; without it, standard output",
    Argument("--robots", "N", numbers.whole(1, 100)): (
        "how many robots can start in it (as many as fit, up to 4)"
    ),
    choice("--model", ("burger", "waffle"), "burger"): "the type of the robots (burger)",
    "--json": "print a summary as a JSON object",
}


def run(args: argparse.Namespace) -> int:
    """Write the room."""
    if args.json and args.output is None:
        raise UsageError("--json and the room cannot both go to standard output", hint="give -o")
    if args.output is not None:
        refuse_existing(args.output)
    from gspn_framework_package.world.made_room import room_text

    solids, notes = _solids(args.source)
    text = room_text(args.source, solids, args.robots, args.model)
    if args.output is None:
        sys.stdout.write(text)
    else:
        write_bytes(args.output, text.encode())
    if args.json:
        done = {"output": args.output, "solids": len(solids), "notes": notes}
        print(json.dumps(done, indent=2, ensure_ascii=False))
    else:
        print_notes(notes)
    return 0


def _solids(source: str) -> Tuple[Sequence[Any], List[str]]:
    """The solid bodies of a map or a world, and notes on what was left out."""
    if source.lower().endswith(SDF_ENDINGS):
        from gspn_framework_package.world.sdf_world import read_world

        return read_world(source)
    from gspn_framework_package.world.map_room import read_occupancy_map

    return read_occupancy_map(source), []
