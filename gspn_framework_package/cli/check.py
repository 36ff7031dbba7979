"""``gspn check``: runs the check that precedes every run."""

from __future__ import annotations

import argparse
import json

from gspn_framework_package.analysis.preflight import MARKING_LIMIT
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import MODULES_OPTION, Argument, Arguments
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.ros.check_all import check_all

OPTIONS: Arguments = {
    Argument("plan", "PLAN"): "a plan file, or a folder with a plan.json",
    "--json": "print the report as one JSON object",
    Argument("--limit", "N", numbers.markings, MARKING_LIMIT): (
        "maximum number of markings to visit if structure cannot decide (default %(default)s)"
    ),
    Argument("--robots", "N", numbers.robots): "check the plan for a team of N robots",
    "--standalone": "check the plan for agents, which transitions may create and destroy",
    **MODULES_OPTION,
}

EPILOG = "Exit codes: 0 the plan may run (read the warnings), 1 refused, 2 not a plan."


def run(args: argparse.Namespace) -> int:
    """Check the plan and print the report."""
    plan = read_plan(args.plan)
    if args.robots is not None:
        plan = plan.for_robots(args.robots)
    with ProgressLine() as progress:
        report = check_all(plan, limit=args.limit, standalone=args.standalone, progress=progress)
    if args.json:
        data = report.to_json()
        data["notes"] = list(plan.notes)
        print(json.dumps(data, indent=2))
    else:
        for note in plan.notes:
            print("note     %s" % note)
        print(report)
    return report.exit_code
