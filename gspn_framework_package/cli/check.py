"""``gspn check``: runs only the check that precedes every run."""

from __future__ import annotations

import argparse
import json
import os
from typing import List

from gspn_framework_package.analysis.preflight import MARKING_LIMIT, check
from gspn_framework_package.analysis.preflight.report import CheckItem, Severity, names
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.execution.actions import missing_function
from gspn_framework_package.execution.breakpoints import BreakpointFile
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.plan import Plan


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    parser.add_argument("plan", metavar="PLAN", help="a plan file, or a folder with a plan.json")
    parser.add_argument("--json", action="store_true", help="print the report as one JSON object")
    parser.add_argument(
        "--limit",
        type=numbers.markings,
        default=MARKING_LIMIT,
        metavar="N",
        help="maximum number of markings to visit if structure cannot decide (default %(default)s)",
    )
    parser.add_argument(
        "--robots", type=numbers.robots, metavar="N", help="check it for a team of N robots"
    )
    parser.add_argument(
        "--standalone",
        action="store_true",
        help="check it for agents, which transitions may create and destroy",
    )
    parser.epilog = "Exit codes: 0 the plan may run (read the warnings), 1 refused, 2 not a plan."


def run(args: argparse.Namespace) -> int:
    """Check the plan and print the report."""
    plan = read_plan(args.plan)
    if args.robots is not None:
        plan = plan.for_robots(args.robots)
    with ProgressLine() as progress:
        report = check(plan, limit=args.limit, standalone=args.standalone, progress=progress)
    report = report._replace(
        items=(
            *_name_subnets(plan),
            *_look_at_functions(plan),
            *_look_at_types(plan),
            *_look_at_events(plan),
            *_look_at_breakpoints(plan),
            *report.items,
        )
    )
    if args.json:
        data = report.to_json()
        data["notes"] = list(plan.notes)
        print(json.dumps(data, indent=2))
    else:
        for note in plan.notes:
            print("note     %s" % note)
        print(report)
    return report.exit_code


def _name_subnets(plan: Plan) -> List[CheckItem]:
    """Say which parts of the net are plans of their own."""
    return [
        CheckItem(
            "subnets",
            Severity.OK,
            "%s is the plan '%s': robots enter %s and leave from %s"
            % (name, subnet.plan, subnet.entry, subnet.exit),
            {"subnet": name, **subnet.to_json()},
        )
        for name, subnet in plan.subnets.items()
    ]


def _look_at_functions(plan: Plan) -> List[CheckItem]:
    """Report missing functions, as far as the source shows without running it."""
    places = {
        action.function: place
        for place, action in plan.bindings()
        if isinstance(action, FunctionAction)
    }
    items = []
    for function, place in places.items():
        text = missing_function(plan.folder, function)
        if text:
            text = "%s in %s: %s" % (function, place, text)
            items.append(CheckItem("functions", Severity.REFUSED, text, {"place": place}))
    for transition, source in plan.events.items():
        text = missing_function(plan.folder, source.function) if source.function else ""
        if text:
            text = "%s for the event '%s': %s" % (source.function, transition, text)
            items.append(CheckItem("functions", Severity.REFUSED, text, {"transition": transition}))
    return items


def _look_at_breakpoints(plan: Plan) -> List[CheckItem]:
    """Warn of breakpoints that are kept beside the plan: they halt robots in every run."""
    file = BreakpointFile(plan)
    try:
        file.changed()
    except InputError as error:
        text = "%s; robots ignore it" % error
        return [CheckItem("breakpoints", Severity.WARNING, text, {"file": file.path})]
    if not any(file.breakpoints):
        return []
    text = "robots halt at %s in every run of this plan here: %s says so" % (
        file.breakpoints.told,
        os.path.basename(file.path),
    )
    return [CheckItem("breakpoints", Severity.WARNING, text, file.breakpoints.to_json())]


def _look_at_types(plan: Plan) -> List[CheckItem]:
    """Report goals, requests, messages and conditions of actions that do not fit their types, if
    this shell has ROS, which knows these."""
    if all(isinstance(action, (FunctionAction, type(None))) for _, action in plan.bindings()):
        return []
    try:
        from gspn_framework_package.ros.action_kinds import look_at_actions
    except ImportError:
        return []
    found = look_at_actions(plan)
    items = [
        CheckItem("goals", Severity.REFUSED, "%s: %s" % (where, text), {"where": where})
        for where, text in found.misfits.items()
    ]
    for text in sorted(set(found.unknown.values())):
        places = [where for where, said in found.unknown.items() if said == text]
        items.append(
            CheckItem(
                "goals",
                Severity.WARNING,
                "%s; its fields were not looked at (%s)" % (text, names(places)),
                {"where": places},
            )
        )
    return items


def _look_at_events(plan: Plan) -> List[CheckItem]:
    """Report topics, fields and conditions of events that do not fit their messages, if this shell
    has ROS, which knows their types."""
    if not any(source.topic for source in plan.events.values()):
        return []
    try:
        from gspn_framework_package.ros.event_sources import look_at_events
    except ImportError:
        return []
    found = look_at_events(plan)
    items = [
        CheckItem("sources", Severity.REFUSED, "event '%s': %s" % (t, text), {"transition": t})
        for t, text in found.misfits.items()
    ]
    for t, text in found.unknown.items():
        text = "event '%s': %s; its messages were not looked at" % (t, text)
        items.append(CheckItem("sources", Severity.WARNING, text, {"transition": t}))
    return items
