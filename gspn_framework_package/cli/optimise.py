"""``gspn optimise``: computes the best policy of a plan, or of a net of decisions, for an aim, and
writes the plan with it."""

from __future__ import annotations

import argparse
import json
import os
from typing import List, Optional, Tuple

from gspn_framework_package.analysis.decisions.aims import AIM_WIDTH, NARROWEST, AtLeast, Request
from gspn_framework_package.analysis.decisions.net_choices import plan_of_choices
from gspn_framework_package.analysis.decisions.optimise import SIMULATED, optimise
from gspn_framework_package.analysis.decisions.report import Report
from gspn_framework_package.analysis.plan.reading import NET, READINGS, RUN
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.aims import AIM_OPTIONS, objective_of, pairs
from gspn_framework_package.cli.limits import LIMIT_OPTIONS, ON_OPTION, limits_of, working_on
from gspn_framework_package.cli.net_input import (
    FITTED,
    RATES_OPTION,
    READING_OF_NETS,
    print_notes,
    read_net_or_plan_argument,
)
from gspn_framework_package.cli.options import Argument, Arguments, add_options, choice, repeated
from gspn_framework_package.cli.plan_output import plan_path, refuse_existing, write_plan
from gspn_framework_package.formats.plan_file import plan_document
from gspn_framework_package.formats.plan_json import plan_to_short_json
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan

_OWN, _STORM = "own", "storm"

_OPTIONS: Arguments = {
    Argument("net_file", "PLAN"): (
        "a plan file, a folder with a plan.json, or a net whose immediate transitions of weight 0 "
        "are choices"
    ),
    Argument("-o --output", "NEW_PLAN"): (
        "the plan with the computed policy: a new .json file, or a folder for plan.json and the "
        "functions; by default nothing is written"
    ),
    "--force": "overwrite NEW_PLAN if it exists",
    "--json": "print the report as one JSON object",
    Argument("--robots", "N", numbers.robots): "for a team of N robots",
    **ON_OPTION,
}

_CONSTRAINTS: Arguments = {
    repeated("--never", "CONDITION"): (
        "this must never hold, whichever robots are lost; may be repeated"
    ),
    repeated("--at-least", "'NAME>=X'"): (
        "in the long run a transition must fire at least X times a second, or a place must hold at "
        "least X tokens on average; may be repeated"
    ),
    repeated("--may-wait", "PLACE"): (
        "robots in this place may wait although they could leave; a name, or a pattern as for "
        "files ('At_*'); may be repeated"
    ),
}

_READING: Arguments = {
    choice("--timing", READINGS, RUN): (
        "interpret the plan as it runs (default), or as a race of its net's rates"
    ),
    **RATES_OPTION,
    repeated("--uncertain", "TRANSITION=LOW..HIGH"): (
        "the rate is only known to be in this interval: find the best policy for the worst case; "
        "may be repeated"
    ),
    choice("--engine", (_OWN, _STORM), _OWN): (
        "storm: Storm (pip install stormpy) computes the value, too, as a check (default "
        "%(default)s)"
    ),
    Argument("--team-sizes", "SIZES"): (
        "the numbers of robots to compute choices for: own, all, N or N..M (default: own, and "
        "smaller ones if the plan lets robots be evicted)"
    ),
    Argument("--width", "W", numbers.number(NARROWEST, 0.5), AIM_WIDTH): (
        "width of the certified interval, relative to its value (default %(default)g)"
    ),
    Argument("--simulate", "S", numbers.seconds, SIMULATED): (
        "computing time in seconds for simulating the old and the new plan as they run; 0 for no "
        "simulation (default %(default)g)"
    ),
    Argument("--seed", "N", numbers.whole(0, 2**63 - 1), 0): (
        "seed of the simulation (default %(default)s)"
    ),
}


def add_request_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of a request, ``--simulate`` and ``--seed``."""
    add_options(parser.add_argument_group("the aim"), AIM_OPTIONS)
    add_options(parser.add_argument_group("constraints"), _CONSTRAINTS)
    add_options(parser.add_argument_group("how to interpret the plan"), _READING)
    add_options(parser.add_argument_group("limits"), LIMIT_OPTIONS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_options(parser, _OPTIONS)
    add_request_arguments(parser)
    add_options(parser.add_argument_group("reading a net"), READING_OF_NETS)
    parser.epilog = (
        "Exit codes: 0 there is an answer, 1 there is none (the constraints cannot be met, or a "
        "limit was reached), or a later step failed, such as the simulation, 2 neither a plan nor "
        "a net, or wrong usage."
    )


def run(args: argparse.Namespace) -> int:
    """Compute the policy, write the plan with it, and print the report."""
    plan, read_notes = _subject(args)
    print_notes(read_notes)
    request = request_in_arguments(args, len(plan.robots))
    request.resolved(plan.net)  # report errors before reading or computing anything
    path = None
    if args.output is not None:
        path = plan_path(args.output)
        if not args.force:
            refuse_existing(path, "give the name of a new file, or --force")
    report = optimised(plan, request, args)
    notes: List[str] = []
    try:
        if path is not None:
            folder = os.path.dirname(os.path.abspath(path))
            if plan.file is None:  # a net
                data = plan_to_short_json(report.plan)
            else:
                data = plan_document(args.net_file, report.plan, folder)
            notes = write_plan(report.plan, data, args.output)
    finally:  # the answer is printed even if it cannot be written
        if args.json:
            print(json.dumps({**report.to_json(), "notes": notes}, indent=2, ensure_ascii=False))
        else:
            print("\n".join(report.lines()))
            print_notes(notes)
    return max((failure.exit_code for failure in report.failures), default=0)


def _subject(args: argparse.Namespace) -> Tuple[Plan, List[str]]:
    """The plan, or that of the choices of a net, which has no run to simulate; and notes."""
    subject, notes = read_net_or_plan_argument(args)
    if isinstance(subject, Plan):
        return (subject if args.robots is None else subject.for_robots(args.robots)), notes
    if args.robots is not None or args.team_sizes is not None or args.rates != FITTED:
        raise UsageError("--robots, --team-sizes and --rates are for plans; this is a net")
    args.timing, args.simulate = NET, 0.0
    return plan_of_choices(subject), notes


def optimised(plan: Plan, request: Request, args: argparse.Namespace) -> Report:
    """The best policy, with a progress line; an interrupt ends it."""
    return working_on(
        args.on,
        lambda progress, cancel, executor: optimise(
            plan,
            request,
            simulated=args.simulate,
            seed=args.seed,
            progress=progress,
            cancel=cancel,
            on=executor,
            storm=args.engine == _STORM,
        ),
        request.limits.memory,
    )


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
