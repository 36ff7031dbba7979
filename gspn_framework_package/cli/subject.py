"""The subject of the analysis verbs: a net, or a plan under its policy for a team of any size."""

from __future__ import annotations

import argparse
from typing import Any, List, Tuple, Union

from gspn_framework_package.cli import net_input, numbers
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

FITTED, NOMINAL = "fitted", "nominal"


def add_subject_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the net or plan, and the options for reading it."""
    net_input.add_net_arguments(parser)
    parser.add_argument(
        "--only-net",
        action="store_true",
        help="analyse a plan's net by its weights instead of the policy",
    )
    parser.add_argument(
        "--robots", type=numbers.robots, metavar="N", help="for a plan: size of the team"
    )
    add_rates_argument(parser)


def add_rates_argument(parser: Any) -> None:
    """Declare which rates of a plan to use, on a parser or on a group of its arguments."""
    parser.add_argument(
        "--rates",
        choices=(FITTED, NOMINAL),
        default=FITTED,
        help="for a plan: use the rates learned from runs (default), or those in its net's file",
    )


def read_subject(args: argparse.Namespace) -> Tuple[Union[Net, Plan], List[str]]:
    """Return the net or plan that the arguments name, and the reader's notes.

    :raises GspnError: it cannot be read, or the arguments are inconsistent.
    """
    subject, notes = net_input.read_net_or_plan_argument(args)
    if not isinstance(subject, Plan):
        if args.robots is not None or args.only_net or args.rates == NOMINAL:
            raise UsageError("--robots, --only-net and --rates apply only to plans")
        return subject, notes
    if args.rates == NOMINAL:
        subject = subject.nominal()
    if args.robots is not None:
        subject = subject.for_robots(args.robots)
    return (subject.net if args.only_net else subject), notes
