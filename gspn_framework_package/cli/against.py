"""``gspn simulate PLAN --against OTHER_PLAN``: compares the plan with another one."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import List, Union

from gspn_framework_package.analysis.limits import DEFAULT_MEMORY
from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.analysis.simulation.against import BATCH_SECONDS, compare_plans
from gspn_framework_package.analysis.simulation.against_result import Against
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.aims import AIM_OPTIONS, objective_of
from gspn_framework_package.cli.limits import working_on
from gspn_framework_package.cli.net_input import NOMINAL, print_notes
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

_AIMS = ("reward", "mean_time_to", "cost_to", "reach", "discount", "minimise")

_OTHER = ("csv", "log", "batches", "measure", "only_net")
"""Options of the verb that do not apply here."""


AGAINST_OPTIONS: Arguments = {
    Argument("--against", "OTHER_PLAN"): (
        "simulate both plans as they run, and report whether OTHER_PLAN (the new one) is better "
        "for an aim, with a confidence interval"
    ),
    Argument("--seconds", "S", numbers.duration): (
        "with --against: how long to compute (default %g, unless --replications or --precision is "
        "given)" % BATCH_SECONDS
    ),
    **AIM_OPTIONS,
}


def refuse_aims(args: argparse.Namespace) -> None:
    """Refuse the options of a comparison. :raises UsageError: such an option is given."""
    for option in (*_AIMS, "seconds"):
        if getattr(args, option):
            raise UsageError(
                "--%s applies only to comparisons of two plans" % option.replace("_", "-"),
                hint="give --against OTHER_PLAN as well",
            )


def run_against(subject: Union[Net, Plan], notes: List[str], args: argparse.Namespace) -> int:
    """Compare the plan with the other one, and print the result.

    :raises GspnError: a plan cannot be read, or the arguments are inconsistent.
    """
    for option in _OTHER:
        if getattr(args, option):
            raise UsageError("--%s and --against exclude each other" % option.replace("_", "-"))
    if not isinstance(subject, Plan):
        raise UsageError("--against compares plans, but this is a net", file=args.net_file)
    if args.timing != RUN:
        raise UsageError("--against compares plans as they run, without --timing %s" % args.timing)
    if args.until is not None:
        if any(getattr(args, option) for option in _AIMS):
            raise UsageError(
                "--until is the aim (as with --mean-time-to), but another aim is given"
            )
        args.mean_time_to = args.until
    other = read_plan(args.against)
    notes = [*notes, *other.notes]
    if args.robots is not None:
        other = other.for_robots(args.robots)
    if args.rates == NOMINAL:
        other = other.nominal()
    seconds = args.seconds
    if seconds is None and args.replications is None and args.precision is None:
        seconds = BATCH_SECONDS
    objective = objective_of(args)
    found = working_on(
        args.on,
        lambda progress, cancel, executor: compare_plans(
            subject,
            other,
            objective,
            seconds=seconds,
            replications=args.replications,
            precision=args.precision,
            time=args.time if math.isfinite(args.time) else None,
            warmup=args.warmup if args.warmup > 0 else None,
            losses=args.losses,
            seed=args.seed,
            confidence=args.confidence,
            progress=progress,
            cancel=cancel,
            on=executor,
        ),
        DEFAULT_MEMORY,
        "",
    )
    if args.json:
        data = {**found.to_json(), "objective": found.objective.describe()}
        json.dump({**data, "notes": [*notes, *found.notes]}, sys.stdout, indent=2, allow_nan=False)
        print()
    else:
        print_notes([*notes, *found.notes])
        print("\n".join(_lines(found)))
    return 0


def _lines(found: Against) -> List[str]:
    unit = " (%s)" % found.objective.unit if found.objective.unit else ""
    length = "" if found.seconds is None else " of %.6g s" % found.seconds
    lines = [
        "aim: %s" % found.objective.describe(),
        "%s pairs of runs%s, seed %d, %s firings; intervals of %g %% confidence"
        % (
            format(found.pairs, ","),
            length,
            found.seed,
            format(found.firings, ","),
            100 * found.confidence,
        ),
    ]
    for name in ("old", "new", "difference"):
        lines.append("%-12s%s%s" % (name, getattr(found, name), unit))
    lines.append(found.text)
    return lines
