"""``gspn build``: builds a plan from a map."""

from __future__ import annotations

import argparse
import json

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.making.site_plan import build_site_plan


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    parser.add_argument(
        "map",
        metavar="MAP",
        help="a map of topological_navigation (.tmap2, .tmap), or a graph in YAML or JSON",
    )
    parser.add_argument(
        "--tasks", metavar="FILE", help="the tasks of the robots at the nodes (YAML)"
    )
    parser.add_argument(
        "--robots", type=numbers.robots, default=1, metavar="N", help="(default %(default)s)"
    )
    parser.add_argument(
        "--all-edges", action="store_true", help="keep the edges that the policy does not use"
    )
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="the folder to create")
    parser.add_argument("--json", action="store_true", help="print a JSON object")


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
