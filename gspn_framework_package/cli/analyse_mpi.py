"""``gspn analyse --on mpi``: the analysis by all processes that ``mpiexec`` started."""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from typing import Any, Dict, Iterator, List, Mapping, Tuple

from gspn_framework_package.analysis.distributed import DistributedAnalysis
from gspn_framework_package.analysis.distributed.growth import NetToVisit, growth
from gspn_framework_package.analysis.distributed.mpi_ranks import MpiRanks
from gspn_framework_package.analysis.report import open_questions, plain, uncounted
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli.analysis_text import (
    analysis_text,
    bounds_text,
    subject_text,
    time_text,
)
from gspn_framework_package.cli.limits import limits_of, working
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.subject import read_subject
from gspn_framework_package.model.errors import GspnError, LimitError, RefusedError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

_ANSWERED = frozenset(
    {
        *("verb", "run", "parser", "debug", "on", "json", "no_structure", "no_time"),
        *("net_file", "source_format", "net", "const", "servers", "controllable"),
        *("only_net", "robots", "rates", "limit", "limit_time", "limit_memory"),
    }
)
"""The arguments that this analysis takes."""

_FAILED = 70
"""The exit code of an internal error."""

_EVERY = 5.0
"""Time (s) between two lines of progress."""


def run_on_mpi(args: argparse.Namespace) -> int:
    """Analyse a net together with the other ranks; rank 0 prints the answers."""
    ranks = MpiRanks()
    try:
        return _run(args, ranks)
    except GspnError as error:
        # all have the same error, and mpiexec ends all of them as soon as one has left
        if ranks.rank == 0:
            print("gspn: error: %s" % error, file=sys.stderr, flush=True)
        ranks.gather(None)
        return error.exit_code
    except Exception:
        # the others would wait for this rank without end
        print("gspn: rank %d of %d failed" % (ranks.rank, ranks.size), file=sys.stderr)
        traceback.print_exc()
        sys.stderr.flush()
        ranks.abort(_FAILED)


def _run(args: argparse.Namespace, ranks: MpiRanks) -> int:
    for name, value in sorted(vars(args).items()):
        if name not in _ANSWERED and value != args.parser.get_default(name):
            raise UsageError(
                "--on mpi does not take --%s" % name.replace("_", "-"),
                hint="it counts the states of a net and solves for its steady state; leave --on "
                "out for the rest",
            )
    limits = limits_of(args)
    # only rank 0 reads, so the file need not be on every machine
    read = ranks.agreed(lambda: [] if ranks.rank else [_net(args)])
    net, notes = read[0][0]

    timing = not args.no_time

    def analyse(_: Progress, cancel: Cancel) -> Dict[str, Any]:
        told = None if ranks.rank else _Lines()

        def begin() -> List[NetToVisit]:
            if ranks.rank:
                return []
            return [growth(net, limits, timing=timing, progress=told, cancel=cancel)]

        try:
            grown = ranks.agreed(begin)[0][0]
            if grown.report is not None:
                return grown.report
            analysis = DistributedAnalysis(
                grown.net, ranks, bounds=grown.bounds, limits=limits, progress=told, cancel=cancel
            )
            return _answers(net, analysis, grown, timing=timing)
        except MemoryError:
            print("gspn: error: %s" % ranks.too_little_memory(), file=sys.stderr, flush=True)
            ranks.abort(LimitError.exit_code)

    data = working(analyse, limits.memory)
    data["notes"] = notes
    decided = not open_questions(data)
    if ranks.rank == 0:
        if args.json:
            if args.no_time:
                data["steady_state"] = None
                data["undecided"]["steady_state"] = "left out, as asked"
            print(json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False))
        else:
            print_notes(notes)
            # of an unbounded net, one process has answered what can be
            lines = [*_text(data), *time_text(data)] if "ranks" in data else analysis_text(data)
            print("\n".join(lines))
    return 0 if decided else 1


def _net(args: argparse.Namespace) -> Tuple[Net, List[str]]:
    subject, notes = read_subject(args)
    if isinstance(subject, Plan):
        raise UsageError(
            "--on mpi analyses nets, not plans under their policy",
            hint="add --only-net, or leave --on out",
        )
    return subject, notes


class _Lines:
    """Progress as lines of standard error, which ``mpiexec`` passes on: it is no terminal."""

    def __init__(self) -> None:
        self._next = time.monotonic() + _EVERY

    def __call__(self, what: str, count: int, seconds: float) -> None:
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + _EVERY
            print(
                "%s %s, %.0f s" % (format(count, ","), what, seconds), file=sys.stderr, flush=True
            )


def _answers(
    net: Net, analysis: DistributedAnalysis, grown: NetToVisit, *, timing: bool
) -> Dict[str, Any]:
    steady = None
    undecided = {}
    if timing:
        try:
            steady = plain(analysis.steady_state())
        except (LimitError, RefusedError) as error:  # all ranks have the same
            undecided["steady_state"] = str(error)
        else:
            undecided.update(uncounted(grown.left_out))
    bounds = {**analysis.bounds(), **grown.left_out_bounds}
    if grown.bounded is None:
        undecided.update(bounded=grown.reason, bounds=grown.reason)
    return {
        "name": net.name,
        "kind": "net",
        "places": len(net.places),
        "transitions": len(net.transitions),
        "arcs": len(net.arcs),
        "tokens": sum(net.initial_marking),
        "states": analysis.counts(),
        "left_out": list(grown.left_out),
        "engine": "mpi",
        "bounded": grown.bounded,
        "bounds": {place.name: bounds[place.name] for place in net.places},
        "deadlocks": analysis.deadlocks(),
        "steady_state": steady,
        "ranks": analysis.shares(),
        "undecided": undecided,
    }


def _text(data: Mapping[str, Any]) -> Iterator[str]:
    yield subject_text(data)
    states = data["states"]
    yield "states: %s (%s tangible, %s vanishing), %s arcs" % tuple(
        format(states[key], ",") for key in ("total", "tangible", "vanishing", "arcs")
    )
    for share in data["ranks"]:
        yield "    rank %d: %s states, %.1f MB for them, %.1f MB at most" % (
            share["rank"],
            format(share["states"], ","),
            share["memory_bytes"] / 1e6,
            share["peak_bytes"] / 1e6,
        )
    yield from bounds_text(data)
    dead = data["deadlocks"]
    yield "deadlocks: %s" % (dead["count"] or "none")
