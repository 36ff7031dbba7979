"""``gspn explain``: plays a firing sequence step by step, such as the one that a finding of ``gspn
check`` refers to; or says what the places and transitions of a run net stand for."""

from __future__ import annotations

import argparse
import json
from typing import Any, Dict, List, Sequence

from gspn_framework_package.analysis.plan.edited_nets import with_losses
from gspn_framework_package.analysis.plan.reading import READINGS, RUN
from gspn_framework_package.analysis.plan.run_net_export import run_net_of
from gspn_framework_package.analysis.plan.witness import play_sequence
from gspn_framework_package.analysis.preflight import MARKING_LIMIT
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.limits import PHASES_OPTION, check_phases
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.options import MODULES_OPTION, Argument, Arguments, choice
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.check_all import check_all

OPTIONS: Arguments = {
    Argument("plan", "PLAN"): "a plan file, or a folder with a plan.json",
    Argument("transitions", "TRANSITION", nargs="*"): (
        "the transitions to fire, in order; by default the firing sequences found by 'gspn check'"
    ),
    "--run-net": (
        "instead explain each place and transition of the run net that 'gspn convert --run-net' "
        "writes"
    ),
    choice("--timing", READINGS): (
        "with --run-net: as the plan runs (default), or as a race of its net's rates"
    ),
    **PHASES_OPTION,
    Argument("--robots", "N", numbers.robots): "for a team of N robots",
    Argument("--limit", "N", numbers.markings, MARKING_LIMIT): (
        "maximum number of markings that the check visits (default %(default)s)"
    ),
    "--json": "print the steps as one JSON object",
    **MODULES_OPTION,
}

EPILOG = (
    "Exit codes: 0 every transition could fire, 1 one could not, 2 wrong input. Sequences "
    "found by the check always give 0."
)


def run(args: argparse.Namespace) -> int:
    """Play the sequences and print them."""
    plan = read_plan(args.plan)
    if args.robots is not None:
        plan = plan.for_robots(args.robots)
    if args.timing and not args.run_net:
        raise UsageError("--timing requires --run-net")
    check_phases(args, plan, args.run_net)
    if args.run_net:
        return _explain_run_net(plan, args)
    shown = [{"text": "", "sequence": args.transitions}] if args.transitions else _found(plan, args)
    net = with_losses(plan.net, plan, set())  # as in the check, robots may be lost
    for each in shown:
        played = play_sequence(net, each.pop("sequence"))
        each.update(played.to_json(), enabled_at_the_end=_enabled(plan, played.markings[-1]))
    if args.json:
        print(json.dumps({"plan": plan.name, "sequences": shown}, indent=2, ensure_ascii=False))
    elif shown:
        print("\n\n".join(_text(each) for each in shown))
    else:
        print("no finding of the check has a firing sequence")
    return int(any(each["stopped_by"] for each in shown))


def _explain_run_net(plan: Plan, args: argparse.Namespace) -> int:
    """Print what the places and transitions of the run net stand for."""
    if args.transitions:
        raise UsageError("--run-net fires no transitions")
    literal, notes = run_net_of(plan, args.timing or RUN, args.phases)
    if args.json:
        shown = {
            "plan": plan.name,
            "places": {name: {"of": m.of, "text": m.text} for name, m in literal.places.items()},
            "transitions": {name: m._asdict() for name, m in literal.transitions.items()},
            "notes": notes,
        }
        print(json.dumps(shown, indent=2, ensure_ascii=False))
        return 0
    print_notes(notes)
    for what, explained in (("places", literal.places), ("transitions", literal.transitions)):
        print("%d %s:" % (len(explained), what))
        width = max(map(len, explained), default=0)
        for name, meaning in explained.items():
            print("  %-*s  %s" % (width, name, meaning.text))
    return 0


def _found(plan: Plan, args: argparse.Namespace) -> List[Dict[str, Any]]:
    """The findings of the check that have a firing sequence."""
    with ProgressLine() as progress:
        report = check_all(plan, limit=args.limit, progress=progress)
    return [
        {
            "check": item.check,
            "severity": item.severity.value,
            "text": item.text,
            "sequence": item.details["sequence"],
        }
        for item in report.items
        if item.severity is not Severity.OK and item.details.get("sequence") is not None
    ]


def _enabled(plan: Plan, marking: Sequence[int]) -> List[str]:
    """The enabled transitions of the plan, without the loss of a robot, which is always
    possible."""
    return [plan.net.transitions[t].name for t in plan.net.enabled(marking)]


def _text(shown: Dict[str, Any]) -> str:
    lines = (
        ["%s %s: %s" % (shown["severity"], shown["check"], shown["text"])] if shown["text"] else []
    )
    lines.append("at the start: %s" % _marking(shown["start"]))
    for number, step in enumerate(shown["steps"], 1):
        lines.append("%3d  %s: %s" % (number, step["transition"], _marking(step["marking"])))
    enabled = shown["enabled_at_the_end"]
    lines.append(
        shown["stopped_by"] or "then enabled: %s" % (", ".join(enabled) if enabled else "nothing")
    )
    return "\n".join(lines)


def _marking(named: Dict[str, int]) -> str:
    return ", ".join("%s %d" % item for item in named.items()) or "no token"
