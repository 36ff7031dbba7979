"""``gspn build``: builds a plan from a map."""

from __future__ import annotations

import argparse
import json

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.making.site_plan import build_site_plan

OPTIONS: Arguments = {
    Argument("map", "MAP"): (
        "a map of topological_navigation (.tmap2, .tmap), or a graph in YAML or JSON"
    ),
    Argument("--tasks", "FILE"): "the tasks of the robots at the nodes (YAML)",
    Argument("--robots", "N", numbers.robots, 1): "(default %(default)s)",
    "--all-edges": "keep the edges that the policy does not use",
    Argument("-o --output", "DIR", required=True): "the folder to create",
    "--json": "print a JSON object",
}


def run(args: argparse.Namespace) -> int:
    """Build the plan."""
    made = build_site_plan(args.map, args.tasks, args.robots, args.all_edges)
    files = made.write(args.output)
    if args.json:
        done = {
            "folder": args.output,
            "files": files,
            "places": len(made.net.places),
            "transitions": len(made.net.transitions),
            "robots": len(made.plan["robots"]),
            "notes": made.notes,
        }
        print(json.dumps(done, indent=2, ensure_ascii=False))
    else:
        print_notes(made.notes)
        print(
            "%s: %d places, %d transitions, %d robots"
            % (args.output, len(made.net.places), len(made.net.transitions), args.robots)
        )
        print(made.plan["description"])
    return 0
