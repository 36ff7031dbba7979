"""``gspn optimise``: computes the best policy of a plan for an aim, and writes the plan with it."""

from __future__ import annotations

import argparse
import json
import os
from typing import List, Optional, Tuple

from gspn_framework_package.analysis.decisions.aims import AIM_WIDTH, NARROWEST, AtLeast, Request
from gspn_framework_package.analysis.decisions.optimise import SIMULATED, optimise
from gspn_framework_package.analysis.plan.reading import READINGS, RUN
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.aims import add_aim_arguments, objective_of, pairs
from gspn_framework_package.cli.limits import add_limit_arguments, limits_of
from gspn_framework_package.cli.net_input import FITTED, add_rates_argument, print_notes
from gspn_framework_package.cli.on import add_on_argument, working_on
from gspn_framework_package.cli.plan_output import plan_path, refuse_existing, write_plan
from gspn_framework_package.formats.plan_file import plan_document, read_plan
from gspn_framework_package.model.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    parser.add_argument("plan", metavar="PLAN", help="a plan file, or a folder with a plan.json")
    parser.add_argument(
        "-o",
        "--output",
        metavar="NEW_PLAN",
        help="the plan with the computed policy: a new .json file, or a folder for plan.json and "
        "the functions; by default nothing is written",
    )
    parser.add_argument("--force", action="store_true", help="overwrite NEW_PLAN if it exists")
    parser.add_argument("--json", action="store_true", help="print the report as one JSON object")
    parser.add_argument("--robots", type=numbers.robots, metavar="N", help="for a team of N robots")
    add_on_argument(parser)
    add_aim_arguments(parser.add_argument_group("the aim"))
    _add_constraints(parser.add_argument_group("constraints"))
    _add_reading(parser.add_argument_group("how to interpret the plan"))
    add_limit_arguments(parser.add_argument_group("limits"))
    parser.epilog = (
        "Exit codes: 0 there is an answer, 1 there is none (the constraints cannot be met, or a "
        "limit was reached), or a later step failed, such as the simulation, 2 not a plan, or "
        "wrong usage."
    )


def _add_constraints(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--never",
        action="append",
        default=[],
        metavar="CONDITION",
        help="this must never hold, whichever robots are lost; may be repeated",
    )
    group.add_argument(
        "--at-least",
        action="append",
        default=[],
        metavar="'NAME>=X'",
        help="in the long run a transition must fire at least X times a second, or a place must "
        "hold at least X tokens on average; may be repeated",
    )
    group.add_argument(
        "--may-wait",
        action="append",
        default=[],
        metavar="PLACE",
        help="robots in this place may wait although they could leave; a name, or a pattern as "
        "for files ('At_*'); may be repeated",
    )


def _add_reading(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--timing",
        choices=READINGS,
        default=RUN,
        help="interpret the plan as it runs (default), or as a race of its net's rates",
    )
    add_rates_argument(group)
    group.add_argument(
        "--uncertain",
        action="append",
        default=[],
        metavar="TRANSITION=LOW..HIGH",
        help="the rate is only known to be in this interval: find the best policy for the worst "
        "case; may be repeated",
    )
    group.add_argument(
        "--team-sizes",
        metavar="SIZES",
        help="the numbers of robots to compute choices for: own, all, N or N..M (default: own, and "
        "smaller ones if the plan lets robots be evicted)",
    )
    group.add_argument(
        "--width",
        type=numbers.number(NARROWEST, 0.5),
        default=AIM_WIDTH,
        metavar="W",
        help="width of the certified interval, relative to its value (default %(default)g)",
    )
    group.add_argument(
        "--simulate",
        type=numbers.seconds,
        default=SIMULATED,
        metavar="S",
        help="computing time in seconds for simulating the old and the new plan as they run; 0 "
        "for no simulation (default %(default)g)",
    )
    group.add_argument(
        "--seed",
        type=numbers.whole(0, 2**63 - 1),
        default=0,
        metavar="N",
        help="seed of the simulation (default %(default)s)",
    )


def run(args: argparse.Namespace) -> int:
    """Compute the policy, write the plan with it, and print the report."""
    plan = read_plan(args.plan)
    if args.robots is not None:
        plan = plan.for_robots(args.robots)
    request = request_in_arguments(args, len(plan.robots))
    request.resolved(plan.net)  # report errors before reading or computing anything
    path = None
    if args.output is not None:
        path = plan_path(args.output)
        if not args.force:
            refuse_existing(path, "give the name of a new file, or --force")
    report = working_on(
        args.on,
        lambda progress, cancel, executor: optimise(
            plan,
            request,
            simulated=args.simulate,
            seed=args.seed,
            progress=progress,
            cancel=cancel,
            on=executor,
        ),
        request.limits.memory,
    )
    notes: List[str] = []
    try:
        if path is not None:
            data = plan_document(args.plan, report.plan, os.path.dirname(os.path.abspath(path)))
            notes = write_plan(report.plan, data, args.output)
    finally:  # the answer is printed even if it cannot be written
        if args.json:
            print(json.dumps({**report.to_json(), "notes": notes}, indent=2, ensure_ascii=False))
        else:
            print("\n".join(report.lines()))
            print_notes(notes)
    return max((failure.exit_code for failure in report.failures), default=0)


def request_in_arguments(args: argparse.Namespace, robots: int) -> Request:
    """The request in the arguments, for a plan of ``robots`` robots.

    :raises UsageError: they are inconsistent.
    """
    return Request(
        objective_of(args),
        never=tuple(args.never),
        at_least=tuple(AtLeast.parse(text) for text in args.at_least),
        may_wait=frozenset(args.may_wait),
        reading=args.timing,
        fitted=args.rates == FITTED,
        uncertain=pairs(args.uncertain, "--uncertain", _interval, "TRANSITION=LOW..HIGH"),
        team_sizes=_team_sizes(args.team_sizes, robots),
        width=args.width,
        limits=limits_of(args),
    )


def _interval(text: str) -> Tuple[float, float]:
    low, dots, high = text.partition("..")
    if not dots:
        raise ValueError
    return float(low), float(high)


def _team_sizes(text: Optional[str], robots: int) -> Optional[Tuple[int, ...]]:
    """The sizes of teams, the largest first; None for the plan's choice."""
    if text is None:
        return None
    if text == "own":
        return (robots,)
    if text == "all":
        return tuple(range(robots, 0, -1))
    low, _, high = text.partition("..")
    try:
        first, last = int(low), int(high or low)
    except ValueError:
        first, last = 0, 0
    if not 1 <= first <= last <= robots:
        raise UsageError(
            "--team-sizes '%s'" % text,
            hint="write own, all, N or N..M with at most %d robots" % robots,
        )
    return tuple(range(last, first - 1, -1))
