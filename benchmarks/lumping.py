"""Nets with equal parts, analysed as a whole and with the parts exchanged: ``python3 -m
benchmarks.lumping [--largest N] [--json]``

Times are what a clock on the wall says, from the net to its deadlocks and its throughput. A whole
of more than ``--largest`` markings is not visited; its size follows from the orbits. The exit code
is 1 if a number of markings or a throughput differs between the two.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from benchmarks.machine import machine_line, table
from benchmarks.nets import machines, philosophers
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.symmetry.symmetry import Symmetry
from gspn_framework_package.model.net import Net

NETS: Sequence[Tuple[Callable[[int], Net], str, Sequence[int]]] = (
    (philosophers, "put1", (8, 12, 14, 16, 18)),
    (machines, "end1", (5, 8, 10, 12, 20, 60)),
)
"""Each net, with the transition whose throughput is compared, and the sizes."""

_LARGEST = 2_000_000


class Timed(NamedTuple):
    """What an analysis found: ``visited`` markings of ``total``, the number of ``deadlocks`` among
    all, the ``throughput`` (1/s), and the ``seconds`` that it took."""

    visited: int
    total: int
    deadlocks: int
    throughput: float
    seconds: float


def main(arguments: Optional[List[str]] = None) -> int:
    """Measure, print, and return the exit code."""
    parser = argparse.ArgumentParser(description="Nets with equal parts, whole and lumped.")
    parser.add_argument("--largest", type=int, default=_LARGEST, help="most markings of a whole")
    parser.add_argument("--json", action="store_true", help="print JSON")
    args = parser.parse_args(arguments)
    rows = []
    for make, transition, sizes in NETS:
        for size in sizes:
            row = _compared(make(size), transition, args.largest)
            rows.append(row)
            print("%s: %s" % (row["net"], row["verdict"]), file=sys.stderr, flush=True)
    if args.json:
        print(json.dumps(rows, indent=2))
    else:
        print(_markdown(rows))
    return int(any(row["verdict"] == "differs" for row in rows))


def _compared(net: Net, transition: str, largest: int) -> Dict[str, Any]:
    lumped = timed(net, transition, lump=())
    whole = timed(net, transition) if lumped.total <= largest else None
    row: Dict[str, Any] = {
        "net": net.name.replace("_", " "),
        "total": str(lumped.total) if lumped.total > 10**15 else lumped.total,
        "visited": lumped.visited,
        "permutations": "%.3g" % Symmetry(net).order,
        "seconds": lumped.seconds,
        "seconds_whole": whole and whole.seconds,
        "difference": None,
        "verdict": "not compared",
    }
    if whole is not None:
        row["difference"] = abs(whole.throughput - lumped.throughput)
        counts = [(found.total, found.deadlocks) for found in (whole, lumped)]
        same = counts[0] == counts[1] and row["difference"] <= 1e-9
        row["verdict"] = "the same" if same else "differs"
    return row


def timed(net: Net, transition: str, lump: Optional[Sequence[str]] = None) -> Timed:
    """Analyse a net, and take the time."""
    begin = time.monotonic()
    analysis = Analysis(net, limits=Limits(states=100 * _LARGEST), structure=False, lump=lump)
    space = analysis.space
    throughput = analysis.measures.throughput[transition]
    deadlocks = space.count(space.deadlocks)
    return Timed(
        len(space), space.count(slice(None)), deadlocks, throughput, time.monotonic() - begin
    )


def _markdown(rows: Sequence[Dict[str, Any]]) -> str:
    head = ("net", "markings", "visited", "permutations", "whole s", "lumped s", "difference 1/s")
    keys = ("net", "total", "visited", "permutations", "seconds_whole", "seconds", "difference")
    return "%s; load %.1f\n\n%s" % (
        machine_line(),
        os.getloadavg()[0],
        table(head, ([row[key] for key in keys] for row in rows)),
    )


if __name__ == "__main__":
    sys.exit(main())
