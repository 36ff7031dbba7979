"""``gspn import``: makes a plan of a behaviour tree of another tool."""

from __future__ import annotations

import argparse
import json

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.making.behaviour_tree import import_tree

OPTIONS: Arguments = {
    Argument("tree_file", "TREE"): "a behaviour tree of BehaviorTree.CPP 4 (.xml)",
    Argument("-o --output", "DIR", required=True): "the folder to create",
    Argument("--robots", "N", numbers.robots, 1): (
        "number of robots, each of which runs the tree (default %(default)s)"
    ),
    Argument("--tree", "ID"): "the tree to begin with (default: the one that the file says)",
    "--json": "print a JSON object",
}

EPILOG = "Exit codes: 0 the plan was written, 2 the file has what a plan cannot express."


def run(args: argparse.Namespace) -> int:
    """Make the plan."""
    made = import_tree(args.tree_file, args.robots, args.tree)
    files = made.write(args.output)
    if args.json:
        done = {
            "folder": args.output,
            "files": files,
            "places": len(made.net.places),
            "transitions": len(made.net.transitions),
            "notes": made.notes,
        }
        print(json.dumps(done, indent=2, ensure_ascii=False))
        return 0
    print_notes(made.notes)
    print(
        "%s: %d places, %d transitions; actions.py has a function for each leaf: %s"
        % (
            args.output,
            len(made.net.places),
            len(made.net.transitions),
            ", ".join(made.functions.values()),
        )
    )
    return 0
