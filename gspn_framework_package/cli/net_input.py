"""Arguments for the verbs that work on a net or a plan: which one, how to read it, and for what
team."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, Dict, List, Tuple, Union

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.interrupts import interruptible
from gspn_framework_package.formats import FORMATS, ReadOptions, plan_file
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

FITTED, NOMINAL = "fitted", "nominal"


def add_net_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the net and the options for reading it."""
    parser.add_argument(
        "net_file",
        metavar="NET",
        help="a net (%s), or a plan, whose net is used"
        % ", ".join(f.title for f in FORMATS.values() if f.reader is not None),
    )
    reading = parser.add_argument_group("reading the net")
    reading.add_argument(
        "--from",
        dest="source_format",
        metavar="FORMAT",
        help="the format of NET (default: recognised by the content)",
    )
    reading.add_argument("--net", metavar="NAME", help="the net to use, if the file has several")
    reading.add_argument(
        "--const",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="set the value of a constant of the file (may be repeated)",
    )
    reading.add_argument(
        "--servers",
        choices=("single", "infinite"),
        help="server semantics of exponential transitions if the file does not specify it "
        "(default: infinite for PNPRO, single for others)",
    )
    reading.add_argument(
        "--controllable",
        action="store_true",
        help="immediate transitions whose file gives no weight are controllable (weight 0)",
    )


def read_net_argument(args: argparse.Namespace) -> Tuple[Net, List[str]]:
    """Return the net that the arguments name (for a plan, its net), and the reader's notes.

    :raises GspnError: the net cannot be read, or the arguments are inconsistent.
    """
    subject, notes = read_net_or_plan_argument(args)
    return (subject.net if isinstance(subject, Plan) else subject), notes


def read_net_or_plan_argument(args: argparse.Namespace) -> Tuple[Union[Net, Plan], List[str]]:
    """Return the net or plan that the arguments name, and the reader's notes.

    :raises GspnError: it cannot be read, or the arguments are inconsistent.
    """
    options = ReadOptions(
        format=args.source_format,
        net=args.net,
        constants=_constants(args.const),
        infinite_servers=None if args.servers is None else args.servers == "infinite",
        missing_weight=0.0 if args.controllable else 1.0,
    )
    found = interruptible(lambda: plan_file.read_net_or_plan(args.net_file, options))
    return found.plan or found.net, list(found.notes)


def add_subject_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the net or plan, and the options for reading it."""
    add_net_arguments(parser)
    parser.add_argument(
        "--only-net",
        action="store_true",
        help="analyse a plan's net by its weights instead of the policy",
    )
    parser.add_argument(
        "--robots", type=numbers.robots, metavar="N", help="of a plan: for a team of N robots"
    )
    add_rates_argument(parser)


def add_rates_argument(parser: Any) -> None:
    """Declare which times of a plan count, on a parser or on a group of its arguments."""
    parser.add_argument(
        "--rates",
        choices=(FITTED, NOMINAL),
        default=FITTED,
        help="of a plan: what was learned from runs counts (default), or the rates of its net's "
        "file do",
    )


def read_subject(args: argparse.Namespace) -> Tuple[Union[Net, Plan], List[str]]:
    """Return the net or plan that the arguments name, and the reader's notes.

    :raises GspnError: it cannot be read, or the arguments make no sense.
    """
    subject, notes = read_net_or_plan_argument(args)
    if not isinstance(subject, Plan):
        if args.robots is not None or args.only_net or args.rates == NOMINAL:
            raise UsageError("--robots, --only-net and --rates are for plans")
        return subject, notes
    if args.rates == NOMINAL:
        subject = subject.nominal()
    if args.robots is not None:
        subject = subject.for_robots(args.robots)
    return (subject.net if args.only_net else subject), notes


def print_notes(notes: List[str]) -> None:
    """Print the notes of a reader or writer on standard error."""
    for note in notes:
        print("gspn: note: %s" % note, file=sys.stderr)


def _constants(words: List[str]) -> Dict[str, float]:
    constants = {}
    for word in words:
        name, equals, value = word.partition("=")
        try:
            constants[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals or not name.strip() or not math.isfinite(constants[name.strip()]):
            raise UsageError("--const %s: expected NAME=NUMBER" % word)
    return constants
