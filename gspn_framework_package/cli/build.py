"""``gspn build``: builds a plan from a map."""

from __future__ import annotations

import argparse
import json
from functools import partial
from typing import TYPE_CHECKING, Optional

from gspn_framework_package.analysis.preflight import PROOF_SECONDS
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.making.plan_folder import refuse_existing_folder
from gspn_framework_package.making.site_plan import build_site_plan

if TYPE_CHECKING:
    from gspn_framework_package.cli.deadlock_free import FreePlan

OPTIONS: Arguments = {
    Argument("map", "MAP"): (
        "a map of topological_navigation (.tmap2, .tmap), or a graph in YAML or JSON"
    ),
    Argument("--tasks", "FILE"): "the tasks of the robots at the nodes (YAML)",
    Argument("--robots", "N", numbers.robots, 1): "(default %(default)s)",
    "--all-edges": "keep the edges that the policy does not use",
    "--deadlock-free": (
        "add groups of mutual exclusion until robots are proven never to block each other for good"
    ),
    Argument("--seconds", "S", numbers.number(0, 1e6), PROOF_SECONDS): (
        "with --deadlock-free: time for each question about the plan (default %(default)g)"
    ),
    Argument("-o --output", "DIR", required=True): "the folder to create",
    "--json": "print a JSON object",
}


def run(args: argparse.Namespace) -> int:
    """Build the plan."""
    build = partial(build_site_plan, args.map, args.tasks, args.robots, args.all_edges)
    free: Optional[FreePlan] = None
    if args.deadlock_free:
        # without it, nothing of the analysis is imported
        from gspn_framework_package.cli.deadlock_free import deadlock_free

        refuse_existing_folder(args.output)
        with ProgressLine() as progress:
            free = deadlock_free(build, args.robots, args.seconds, progress)
    made = build() if free is None else free.made
    files = made.write(args.output)
    if args.json:
        done = {
            "folder": args.output,
            "files": files,
            "places": len(made.net.places),
            "transitions": len(made.net.transitions),
            "robots": len(made.plan["robots"]),
            "notes": made.notes,
            **({} if free is None else {"deadlock_free": free.to_json()}),
        }
        print(json.dumps(done, indent=2, ensure_ascii=False))
    else:
        print_notes(made.notes)
        print(
            "%s: %d places, %d transitions, %d robots"
            % (args.output, len(made.net.places), len(made.net.transitions), args.robots)
        )
        print(made.plan["description"])
        if free is not None:
            print("\n".join(free.text()))
    return 0
