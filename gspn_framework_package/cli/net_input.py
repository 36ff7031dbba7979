"""Arguments for the verbs that work on a net or a plan: which one, how to read it, and for what
team."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Dict, List, Tuple, Union

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.interrupts import interruptible
from gspn_framework_package.cli.options import Argument, Arguments, add_options, choice, repeated
from gspn_framework_package.formats import FORMATS, ReadOptions, plan_file
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

FITTED, NOMINAL = "fitted", "nominal"

_NET: Arguments = {
    Argument("net_file", "NET"): (
        "a net (%s), or a plan, whose net is used"
        % ", ".join(f.title for f in FORMATS.values() if f.reader is not None)
    ),
}

READING_OF_NETS: Arguments = {
    Argument("--from", "FORMAT", dest="source_format"): (
        "the format of NET (default: recognised by the content)"
    ),
    Argument("--net", "NAME"): "the net to use, if the file has several",
    repeated("--const", "NAME=VALUE"): "set the value of a constant of the file (may be repeated)",
    choice("--servers", ("single", "infinite")): (
        "server semantics of exponential transitions if the file does not specify it (default: "
        "infinite for PNPRO, single for others)"
    ),
    "--controllable": (
        "immediate transitions whose file gives no weight are controllable (weight 0)"
    ),
}

RATES_OPTION: Arguments = {
    choice("--rates", (FITTED, NOMINAL), FITTED): (
        "for a plan: use what was learned from runs (default), or the rates in its net's file"
    ),
}
"""Which times of a plan to use."""

_SUBJECT: Arguments = {
    "--only-net": "analyse a plan's net by its weights instead of the policy",
    Argument("--robots", "N", numbers.robots): "for a plan: assume a team of N robots",
    **RATES_OPTION,
}


def add_net_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the net and the options for reading it."""
    add_options(parser, _NET)
    add_options(parser.add_argument_group("reading the net"), READING_OF_NETS)


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
    add_options(parser, _SUBJECT)


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
