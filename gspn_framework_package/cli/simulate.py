"""``gspn simulate``: simulates many runs of a net, or of a plan under its policy."""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from pathlib import Path
from typing import Iterator, List, Tuple

from gspn_framework_package.analysis.executors import open_executor
from gspn_framework_package.analysis.plan.subnets import TITLES
from gspn_framework_package.analysis.simulation import Simulation, simulate
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.against import AGAINST_OPTIONS, refuse_aims, run_against
from gspn_framework_package.cli.continued import beginning_of, simulate_from
from gspn_framework_package.cli.continued import notes as continued_notes
from gspn_framework_package.cli.limits import ON_OPTION
from gspn_framework_package.cli.net_input import add_subject_arguments, print_notes, read_subject
from gspn_framework_package.cli.options import Argument, Arguments, add_options, repeated
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.cli.simulated_runs import RUN_OPTIONS, asked_in_arguments
from gspn_framework_package.cli.virtual_log import simulate_to_log

_OPTIONS: Arguments = {
    "--json": "print the result as one JSON object",
    Argument("--csv", "FILE"): "write the numbers to FILE: measure, name, mean, half width",
    Argument("--log", "FILE"): (
        "run a plan once, with the token game itself, and record it as an event log (a new file) "
        "for verify, replay and fit"
    ),
    **RUN_OPTIONS,
    repeated("--measure", "NAME"): (
        "with --precision: the transition (throughput) or place (mean tokens) that matters; may be "
        "repeated (default: the throughputs of at least a hundredth of the largest)"
    ),
    Argument("--batches", "N", numbers.whole(2, numbers.MOST_REPLICATIONS)): (
        "one long run of a plan, divided into N batches, instead of many runs"
    ),
    **ON_OPTION,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_subject_arguments(parser)
    parser.epilog = "RUN.jsonl@SLOT instead of NET continues from that slot of a recorded run."
    add_options(parser, _OPTIONS)
    add_options(parser.add_argument_group("compare an old plan with a new one"), AGAINST_OPTIONS)


def run(args: argparse.Namespace) -> int:
    """Simulate, and print the means."""
    beginning = beginning_of(args)
    if beginning is not None:
        refuse_aims(args)
        if args.log:
            found = list(continued_notes(beginning))
            return simulate_to_log(beginning.plan, found, args, beginning)
        return _print(simulate_from(beginning, args), [], args)
    subject, notes = read_subject(args)
    if args.against is not None:
        return run_against(subject, notes, args)
    refuse_aims(args)
    if args.log:
        return simulate_to_log(subject, notes, args)
    with open_executor(args.on) as executor, ProgressLine() as progress:
        asked = asked_in_arguments(args, args.measure)._replace(batches=args.batches)
        result = simulate(subject, progress=progress, on=executor, **asked._asdict())
    return _print(result, notes, args)


def _print(result: Simulation, notes: List[str], args: argparse.Namespace) -> int:
    try:
        if args.csv:
            with Path(args.csv).open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(("measure", "name", "mean", "half_width"))
                writer.writerows(simulated_rows(result))
    finally:  # the result is printed, even if it cannot be written
        if args.json:
            data = {**result.to_json(), "notes": [*notes, *result.notes]}
            json.dump(data, sys.stdout, indent=2, allow_nan=False)
            print()
        else:
            print_notes([*notes, *result.notes])
            print("\n".join(_text(result)))
    return 0


def simulated_rows(result: Simulation) -> Iterator[Tuple[str, str, float, float]]:
    """Yield the estimates as rows: measure, name, mean, half width of the interval."""
    means = {"mean_tokens": result.mean_tokens, "throughput": result.throughput, **result.subnets}
    for measure, values in means.items():
        for name, value in values.items():
            yield measure, name, value.mean, value.half_width
    for measure in ("end_time", "reached", "time_to_condition"):
        estimate = getattr(result, measure)
        if estimate is not None:
            yield measure, "", estimate.mean, estimate.half_width


def _text(result: Simulation) -> Iterator[str]:
    yield "%s%s, seed %d, %s firings; intervals of %g %% confidence" % (
        "%d runs" % result.replications
        if result.batches is None
        else "%d batches of a run" % result.batches,
        " of %g s" % result.time if math.isfinite(result.time) else "",
        result.seed,
        format(result.events, ","),
        100 * result.confidence,
    )
    if result.precision is not None:
        wanted, reached = result.precision["wanted"], result.precision["reached"]
        yield "relative precision: %s (requested: %g)" % (
            "%.2g" % reached if reached is not None else "none",
            wanted,
        )
    tables = [
        ("%-32s %s" % ("place", "mean tokens"), result.mean_tokens),
        ("%-32s %s" % ("transition", "throughput (1/s)"), result.throughput),
        *((TITLES[measure], values) for measure, values in result.subnets.items()),
    ]
    for title, values in tables:
        yield title
        for name, value in values.items():
            yield "%-32s %s" % (name, value)
    if result.reached is not None:
        yield "fraction of runs that reached the condition: %s" % (result.reached,)
    if result.time_to_condition is not None:
        yield "time until then, of those (s): %s" % (result.time_to_condition,)
