"""``gspn draw``: draws a net, its coverability tree or its Markov chain."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import List, Optional, Union

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.drawing import chain_graph, note_of_rates_left_out, tree_graph
from gspn_framework_package.analysis.limits import DEFAULT_MEMORY
from gspn_framework_package.analysis.plan.space import replaced_durations
from gspn_framework_package.analysis.state_space.coverability import CoverabilityTree
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.limits import PHASES_OPTION, check_phases, working
from gspn_framework_package.cli.net_input import (
    add_net_arguments,
    print_notes,
    read_net_or_plan_argument,
)
from gspn_framework_package.cli.options import Argument, Arguments, add_options, choice
from gspn_framework_package.formats.dot import IMAGE_FORMATS, Graph, net_graph, render
from gspn_framework_package.formats.source import write_bytes
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

DEFAULT_LIMIT = 500
"""Default maximum number of nodes in a drawn tree or chain; a larger picture is unreadable."""

DRAWINGS = ("net", "coverability", "chain")

_OPTIONS: Arguments = {
    Argument("-o --output", "OUT", required=True): (
        "the picture to write: .%s, or .dot for Graphviz" % ", .".join(IMAGE_FORMATS)
    ),
    choice("--what", DRAWINGS, "net"): (
        "what to draw (default: net); for a plan, the chain under its policy"
    ),
    Argument("--limit", "N", numbers.markings, DEFAULT_LIMIT): (
        "maximum number of markings to draw (default: %(default)s)"
    ),
    Argument("--timeout", "S", numbers.duration, 60.0): (
        "time limit for Graphviz, in seconds (default: %(default)g)"
    ),
    **PHASES_OPTION,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_net_arguments(parser)
    add_options(parser, _OPTIONS)


def run(args: argparse.Namespace) -> int:
    """Draw the picture."""
    image = Path(args.output).suffix.lower().lstrip(".")
    if image not in (*IMAGE_FORMATS, "dot", "gv"):
        raise UsageError(
            "the name '%s' does not indicate a picture format" % args.output,
            hint="use the ending .%s or .dot" % ", .".join(IMAGE_FORMATS),
        )
    subject, notes = read_net_or_plan_argument(args)
    check_phases(args, subject, args.what == "chain")
    is_text = image in ("dot", "gv")

    def make(progress: Progress, cancel: Cancel) -> Graph:
        return graph_of(
            subject, args.what, args.limit, notes, is_text, progress, cancel, args.phases
        )

    graph = working(make, DEFAULT_MEMORY, "")
    text = graph.text()
    if is_text:
        write_bytes(args.output, text.encode("utf-8"))
    else:
        write_bytes(args.output, render(text, image, args.timeout))
    print_notes(notes)
    return 0


def graph_of(
    subject: Union[Net, Plan],
    what: str = "net",
    limit: int = DEFAULT_LIMIT,
    notes: Optional[List[str]] = None,
    everything: bool = False,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    phases: Optional[int] = None,
) -> Graph:
    """The graph to draw.

    :param what: one of :data:`DRAWINGS`.
    :param limit: the most markings to draw.
    :param notes: receives remarks on what was left out.
    :param everything: leave nothing out.
    :param phases: the most phases of each duration of a plan.
    :raises GspnError: it was not computed.
    """
    net = subject.net if isinstance(subject, Plan) else subject
    if what == "net":
        if isinstance(subject, Plan):
            return net_graph(net, subnets=subject.subnets, groups=subject.group_nodes)
        return net_graph(net)
    if what == "coverability":
        tree = CoverabilityTree(
            net, limit=limit, progress=progress, cancel=cancel, memory=DEFAULT_MEMORY
        )
        return tree_graph(tree)
    analysis = Analysis(subject, limit=limit, phases=phases, progress=progress, cancel=cancel)
    chain = analysis.chain
    note = "" if everything else note_of_rates_left_out(chain)
    if notes is not None:
        notes += [*replaced_durations(analysis.space), *filter(None, [note])]
    return chain_graph(chain, note)
