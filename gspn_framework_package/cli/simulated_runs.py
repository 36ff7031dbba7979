"""The options of the verbs that simulate runs: length, number, seed and others."""

from __future__ import annotations

import argparse
import math
from typing import Any, Sequence

from gspn_framework_package.analysis.plan.reading import READINGS, RUN
from gspn_framework_package.analysis.simulation import Asked
from gspn_framework_package.cli import numbers


def add_run_arguments(parser: Any) -> None:
    """Declare the options, on a parser or on a group of its arguments."""
    parser.add_argument(
        "--time",
        type=numbers.number(0.0, math.inf, above=0.0),
        default=math.inf,
        metavar="T",
        help="length of a run (s)",
    )
    parser.add_argument(
        "--until", metavar="CONDITION", help='a condition that ends a run, e.g. "done >= 3"'
    )
    parser.add_argument(
        "--warmup",
        type=numbers.seconds,
        default=0.0,
        metavar="T",
        help="time (s) at the start of a run to exclude from the means",
    )
    parser.add_argument(
        "--replications",
        type=numbers.replications,
        metavar="N",
        help="number of runs (default 1000); with --precision, the maximum (default a million)",
    )
    parser.add_argument(
        "--timing",
        choices=READINGS,
        default=RUN,
        help="how to interpret a plan: as it runs (default), or as a race of its net's rates; "
        "for a net always the latter",
    )
    parser.add_argument(
        "--precision",
        type=numbers.number(0.0, 1.0, above=0.0),
        metavar="R",
        help="stop when the half width of every interval is at most this fraction of its mean, "
        "e.g. 0.01",
    )
    parser.add_argument(
        "--losses",
        type=numbers.number(0.0, 1e6),
        default=0.0,
        metavar="RATE",
        help="for a plan: rate at which each robot is lost (1/s)",
    )
    parser.add_argument(
        "--seed",
        type=numbers.whole(0, 2**63 - 1),
        default=0,
        metavar="N",
        help="seed of the random numbers (default 0)",
    )
    parser.add_argument(
        "--confidence",
        type=numbers.number(0.0, 1.0, above=0.0),
        default=0.95,
        metavar="P",
        help="level of the confidence intervals (default %(default)s)",
    )


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
