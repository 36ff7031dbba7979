"""``gspn breakpoints``: shows or sets the places and transitions at which a robot stops until it is
resumed."""

from __future__ import annotations

import argparse
import json

from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.cli.team_client import TEAM_OPTIONS, team_client
from gspn_framework_package.execution.breakpoints import BreakpointFile, Breakpoints
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.team.orders import ORDERS

OPTIONS: Arguments = {
    Argument("names", "NAME", nargs="*"): (
        "places and transitions, replacing those set before; if none are given, the present ones "
        "are shown"
    ),
    "--clear": "remove all breakpoints",
    Argument("--plan", "PLAN"): (
        "for runs of this plan on this machine; default: for the team running on ROS"
    ),
    **TEAM_OPTIONS,
}

EPILOG = (
    "A robot stops before its action in a place starts, or before it asks for a transition; "
    "'gspn resume ROBOT' (on the page: Resume) releases it. They are stored in "
    "breakpoints.json next to the plan; runs reread it when it changes. Exit codes: 0 done, "
    "1 a node did not accept them, 2 a name does not occur in the plan."
)


def run(args: argparse.Namespace) -> int:
    """Show or set the breakpoints; return 0 if every node did so."""
    if args.names and args.clear:
        raise UsageError("give names or --clear, not both")
    if args.plan:
        return _of_plan(args)
    names = args.names if args.names or args.clear else None
    argument = ORDERS["breakpoints"].argument({"names": names})
    answers = team_client(args).breakpoints(argument, args.run_name)
    if args.json:
        result = {n: {"done": a.success, "message": a.message} if a else a for n, a in answers}
        print(json.dumps(result))
    else:
        for namespace, answer in answers:
            print("%s: %s" % (namespace, answer.message if answer else "does not answer"))
    return 0 if all(answer is not None and answer.success for _, answer in answers) else 1


def _of_plan(args: argparse.Namespace) -> int:
    plan = read_plan(args.plan)
    file = BreakpointFile(plan)
    if args.names or args.clear:
        file.write(Breakpoints.of_names(args.names, plan))
    else:
        file.changed()
    found = file.breakpoints
    print(json.dumps(found.to_json()) if args.json else found.in_words)
    return 0
