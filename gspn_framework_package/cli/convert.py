"""``gspn convert``: converts a net to another format, or a plan to a single file."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any, Dict, List, Tuple

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.chain_export import explicit_chain
from gspn_framework_package.analysis.limits import STATE_LIMIT
from gspn_framework_package.analysis.plan.reading import READINGS, RUN
from gspn_framework_package.analysis.plan.run_net_export import run_net_of
from gspn_framework_package.analysis.plan.space import replaced_durations
from gspn_framework_package.analysis.structure.invariants import invariant_bounds
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.limits import PHASES_OPTION, check_phases
from gspn_framework_package.cli.net_input import (
    add_net_arguments,
    print_notes,
    read_net_argument,
    read_net_or_plan_argument,
)
from gspn_framework_package.cli.options import Argument, Arguments, add_options, choice, repeated
from gspn_framework_package.cli.plan_output import plan_path, refuse_existing, write_plan
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.formats import (
    FORMATS,
    Format,
    encode_net,
    format_named,
    format_of_name,
    read_net_with_notes,
    write_net,
)
from gspn_framework_package.formats.markov_chain import drn, prism_files
from gspn_framework_package.formats.plan_file import is_plan, read_plan
from gspn_framework_package.formats.plan_json import plan_to_short_json
from gspn_framework_package.formats.source import write_bytes
from gspn_framework_package.model.composition import expand_place
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

CHAINS = {"prism-chain": ".tra", "drn": ".drn"}
"""Format of a computed Markov chain -> extension of its files: PRISM's explicit files, and Storm's
DRN."""

PLAN_FORMAT = "plan"
"""The format of plans: ``plan.json`` including net and policy."""

BOUNDS_EFFORT = 200_000
"""Maximum number of candidate invariants to examine in order to find bounds."""


_OPTIONS: Arguments = {
    Argument("output", "OUT"): (
        "the file to write, or - for standard output; for a plan (or an input file of the thesis): "
        "a new .json file, or a folder for plan.json and the functions"
    ),
    Argument("--to", "FORMAT"): (
        "the format, if the file name does not show it: %s; or the Markov chain of the net, or of "
        "the plan under its policy, state by state: %s; or, for a plan, 'plan' (.json)"
        % (
            ", ".join("%s (%s)" % (f.name, f.extensions[0]) for f in FORMATS.values()),
            ", ".join("%s (%s)" % item for item in CHAINS.items()),
        )
    ),
    "--run-net": (
        "write the run net of the plan, which has the same numbers as the plan under its policy; "
        "'gspn explain --run-net' explains its places and transitions"
    ),
    **PHASES_OPTION,
    choice("--timing", READINGS): (
        "with --run-net, or for the chain of a plan: as it runs (default), or as a race of its "
        "net's rates"
    ),
    repeated("--expand", ("PLACE", "NET", "ENTRY", "EXIT"), nargs=4): (
        "replace PLACE by the net of a file: tokens enter at its place ENTRY and leave from EXIT "
        "(may be repeated)"
    ),
    repeated("--label", "NAME=CONDITION"): (
        "for a chain: label the states where CONDITION holds (may be repeated)"
    ),
    Argument("--limit", "N", numbers.markings, STATE_LIMIT): (
        "for a chain: maximum number of markings to visit (default %(default)s)"
    ),
    "--json": "print a summary as a JSON object",
}

_NO_TIMING = "--timing applies only to run nets (--run-net) and to the chains of plans"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_net_arguments(parser)
    add_options(parser, _OPTIONS)


def run(args: argparse.Namespace) -> int:
    """Convert the net."""
    if args.output == "-" and args.to is None:
        raise UsageError("--to is required when writing to standard output")
    if args.output == "-" and args.json:
        raise UsageError("--json and the net cannot both go to standard output")
    if args.run_net and args.expand:
        raise UsageError("--expand applies to nets, and --run-net to plans")
    suffix = Path(args.output).suffix.lower()
    if (
        args.to == PLAN_FORMAT
        or args.to is None
        and (suffix == ".json" or os.path.isdir(args.output))
    ):
        if args.run_net:
            raise UsageError("a run net is a net, but %s is a plan" % args.output)
        if args.timing:
            raise UsageError(_NO_TIMING)
        check_phases(args, None)
        return _write_plan(args)
    chain = args.to or next((name for name, ending in CHAINS.items() if ending == suffix), None)
    if chain in CHAINS:
        if args.expand:
            raise UsageError(
                "--expand applies only to nets", hint="write the expanded net first, then its chain"
            )
        if args.run_net:
            raise UsageError(
                "--run-net writes only nets", hint="the chain of a plan does not need it"
            )
        return _write_chain(args, chain)
    if args.timing and not args.run_net:
        raise UsageError(_NO_TIMING)
    if args.label:
        raise UsageError("--label applies only to chains: %s" % ", ".join(CHAINS.values()))
    target = format_named(args.to) if args.to else format_of_name(args.output)
    if not args.run_net:
        check_phases(args, None)
    net, notes = _read_run_net(args) if args.run_net else read_net_argument(args)
    for place, path, entry, leaving in args.expand:
        subnet, subnet_notes = read_net_with_notes(path)
        net = expand_place(net, place, subnet, entry, leaving)
        notes += subnet_notes
    if args.output == "-":
        data, losses = encode_net(net, target, bounds_for(net, target))
        sys.stdout.buffer.write(data)
    else:
        losses = write_net(net, args.output, target.name, bounds_for(net, target))
    done = {"output": args.output, "format": target.name, "net": net.name}
    sizes = {
        "places": len(net.places),
        "transitions": len(net.transitions),
        "arcs": len(net.arcs),
    }
    return _report(args, {**done, **sizes}, notes + losses)


def _read_run_net(args: argparse.Namespace) -> Tuple[Net, List[str]]:
    """Return the run net of a plan, with notes."""
    plan, notes = read_net_or_plan_argument(args)
    if not isinstance(plan, Plan):
        raise UsageError("--run-net applies to plans, but this is a net", file=args.net_file)
    check_phases(args, plan)
    literal, assumed = run_net_of(plan, args.timing or RUN, args.phases)
    return literal.net, notes + assumed


def _report(args: argparse.Namespace, done: Dict[str, Any], notes: List[str]) -> int:
    """Print what was written, as JSON, or only the notes; return 0."""
    if args.json:
        print(json.dumps({**done, "notes": notes}, indent=2, ensure_ascii=False))
    else:
        print_notes(notes)
    return 0


def bounds_for(net: Net, target: Format) -> Dict[str, int]:
    """Return upper bounds on the tokens of places, for formats that need them, as far as invariants
    provide them."""
    if not target.takes_bounds:
        return {}
    found = invariant_bounds(net, BOUNDS_EFFORT)
    return {place.name: bound for place, bound in zip(net.places, found) if bound is not None}


def _write_chain(args: argparse.Namespace, kind: str) -> int:
    """Write a computed chain: one file, or PRISM's three files side by side."""
    if args.output == "-":
        raise UsageError("a chain is not written to standard output")
    subject, notes = read_net_or_plan_argument(args)
    check_phases(args, subject)
    with ProgressLine() as progress:
        analysis = Analysis(
            subject,
            limit=args.limit,
            timing=args.timing,
            phases=args.phases,
            progress=progress,
        )
        chain = explicit_chain(analysis, _labels(args.label))
    notes += replaced_durations(analysis.space)
    empty = [label for label, states in chain.labels.items() if not states]
    unknown = (
        "; the file cannot express that, and Storm will not know the label" if kind == "drn" else ""
    )
    notes += ["no state has the label '%s'%s" % (label, unknown) for label in empty]
    files = {"drn": drn(chain)} if kind == "drn" else prism_files(chain)
    written = [str(Path(args.output).with_suffix("." + ending)) for ending in files]
    if kind == "drn":
        written = [args.output]
    for path, data in zip(written, files.values()):
        write_bytes(path, data)
    sizes = {"states": len(chain.states), "rates": len(chain.rates)}
    return _report(args, {"output": written, "format": kind, **sizes}, notes)


def _write_plan(args: argparse.Namespace) -> int:
    """Write a plan as one file, or as a folder with the functions."""
    if args.output == "-":
        raise UsageError("a plan is not written to standard output")
    if (
        args.expand
        or args.label
        or args.net
        or args.const
        or args.servers
        or args.controllable
        or args.source_format
    ):
        raise UsageError("the options of nets and chains do not apply to a plan")
    if not is_plan(args.net_file):
        raise UsageError(
            "this is a net, not a plan", file=args.net_file, hint="a plan also needs actions"
        )
    plan = read_plan(args.net_file)
    notes = list(plan.notes)
    path = plan_path(args.output)
    refuse_existing(path)
    notes += write_plan(plan, plan_to_short_json(plan), args.output)
    return _report(args, {"output": path, "format": PLAN_FORMAT, "plan": plan.name}, notes)


def _labels(words: List[str]) -> Dict[str, str]:
    labels = {}
    for word in words:
        name, equals, condition = word.partition("=")
        if not equals or not name.strip() or not condition.strip():
            raise UsageError("--label %s: expected NAME=CONDITION" % word)
        labels[name.strip()] = condition.strip()
    return labels
