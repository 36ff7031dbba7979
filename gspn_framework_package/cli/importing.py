"""``gspn import``: makes a plan of a behaviour tree or a state machine of another tool."""

from __future__ import annotations

import argparse
import json
import shlex

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.making.behaviour_tree import import_tree
from gspn_framework_package.making.python_file import import_python
from gspn_framework_package.model.errors import UsageError

OPTIONS: Arguments = {
    Argument(
        "tree_file", "TREE"
    ): "a BehaviorTree.CPP 4 tree (.xml), a py_trees tree (.py), or a SMACH machine (.py)",
    Argument("-o --output", "DIR", required=True): "the folder to create",
    Argument("--robots", "N", numbers.robots, 1): (
        "number of robots, each of which runs the tree (default %(default)s)"
    ),
    Argument("--tree", "ID"): (
        "the root tree (default: the one that the file names); for a Python file, the function "
        "that makes or runs it, or the variable that holds it"
    ),
    "--ticks": "for py_trees: each tick of a leaf is an action, which nodes without memory require",
    "--run-file": "run the Python file to find out what it makes",
    "--json": "print a JSON object",
}

EPILOG = "Exit codes: 0 the plan was written, 2 a plan cannot express the file."


def run(args: argparse.Namespace) -> int:
    """Make the plan."""
    if args.tree_file.endswith(".py"):
        made = import_python(
            args.tree_file, args.robots, args.tree or "", args.run_file, args.ticks
        )
    elif args.ticks:
        raise UsageError("--ticks is for trees of py_trees")
    else:
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
        "%s: %d places, %d transitions; %s"
        % (args.output, len(made.net.places), len(made.net.transitions), made.actions)
    )
    print("Next: gspn check %s" % shlex.quote(args.output))
    return 0
