"""The options of the verbs that simulate runs: length, number, seed and others."""

from __future__ import annotations

import argparse
import math
from typing import Sequence

from gspn_framework_package.analysis.plan.reading import READINGS, RUN
from gspn_framework_package.analysis.simulation import Asked
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.options import Argument, Arguments, choice

RUN_OPTIONS: Arguments = {
    Argument("--time", "T", numbers.number(0.0, math.inf, above=0.0), math.inf): (
        "length of a run (s)"
    ),
    Argument("--until", "CONDITION"): 'a condition that ends a run, e.g. "done >= 3"',
    Argument("--warmup", "T", numbers.seconds, 0.0): (
        "time (s) at the start of a run to exclude from the means"
    ),
    Argument("--replications", "N", numbers.replications): (
        "number of runs (default 1000); with --precision, the maximum (default a million)"
    ),
    choice("--timing", READINGS, RUN): (
        "how to interpret a plan: as it runs (default), or as a race of its net's rates; for a net "
        "always the latter"
    ),
    Argument("--precision", "R", numbers.number(0.0, 1.0, above=0.0)): (
        "stop when the half width of every interval is at most this fraction of its mean, e.g. 0.01"
    ),
    Argument("--losses", "RATE", numbers.number(0.0, 1e6), 0.0): (
        "for a plan: rate at which each robot is lost (1/s)"
    ),
    Argument("--seed", "N", numbers.whole(0, 2**63 - 1), 0): (
        "seed of the random numbers (default 0)"
    ),
    Argument("--confidence", "P", numbers.number(0.0, 1.0, above=0.0), 0.95): (
        "level of the confidence intervals (default %(default)s)"
    ),
}


def asked_in_arguments(args: argparse.Namespace, measures: Sequence[str]) -> Asked:
    """The simulation requested by the arguments.

    :param measures: the measures whose precision counts.
    """
    return Asked(
        time=args.time,
        replications=args.replications,
        seed=args.seed,
        warmup=args.warmup,
        until=args.until,
        confidence=args.confidence,
        timing=args.timing,
        losses=args.losses,
        precision=args.precision,
        measures=tuple(measures),
    )
