"""State counts of the literature, reproduced: ``python3 -m
benchmarks.published``.

Every net is explored in its own process, so that its peak memory is its own. A count that differs
from the published one is reported, and the exit code is 1. The largest nets (Kanban 6 and 7) take
minutes on a small machine and about 5 GB of memory: a net that would not fit into the free memory
is left out, with a message.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence

import psutil

from benchmarks.harness.processes import peak_mb
from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.nets import FAMILIES
from gspn_framework_package.analysis.state_space import ENGINES, explore
from gspn_framework_package.model.net import Net


class Published(NamedTuple):
    """The number of markings of a net, in total and tangible (None: not published), and the
    ``source``."""

    family: str
    size: int
    states: Optional[int]
    tangible: Optional[int]
    source: str


def _all_tangible(family: str, counts: Mapping[int, int], source: str) -> List[Published]:
    return [Published(family, size, count, count, source) for size, count in counts.items()]


COUNTS: Sequence[Published] = (
    *_all_tangible(
        "kanban",
        {1: 160, 2: 4_600, 3: 58_400, 4: 454_475, 5: 2_546_432, 6: 11_261_376, 7: 41_644_800},
        "Ciardo and Tilgner (1996)",
    ),
    *(
        Published("fms", size, None, count, "Ciardo and Trivedi (1993)")
        for size, count in {1: 54, 2: 810, 3: 6_520, 4: 35_910, 5: 152_712, 6: 537_768}.items()
    ),
    *_all_tangible(
        "philosophers",
        {4: 34, 12: 39_202, 16: 1_331_714},
        "Quantitative Verification Benchmark Set",
    ),
    *_all_tangible(
        "polling",
        {n: 3 * n * 2 ** (n - 1) for n in (5, 10, 15)},
        "Ibe and Trivedi (1990): 3 n 2^(n-1)",
    ),
    Published("courier", 1, 29_010, 11_700, "Woodside and Li (1991)"),
    Published("courier", 3, None, 419_400, "APNN toolbox"),
)

BYTES_PER_STATE = 120
"""Peak memory per state, measured on the largest nets; used to estimate the memory of a net before
exploring it."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Explore the nets, and report the counts that differ."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--largest", type=int, default=10**18, metavar="N", help="leave out nets of more markings"
    )
    parser.add_argument(
        "--engine", choices=ENGINES, default="auto", help="who explores (default: auto)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--worker", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.worker:
        family, size = args.worker
        print(json.dumps(_explore(FAMILIES[family](int(size)), args.engine)))
        return 0
    rows = []
    for entry in COUNTS:
        if (entry.states or entry.tangible or 0) <= args.largest:
            rows.append(_check(entry, args.engine))
            print("%(net)s: %(verdict)s" % rows[-1], file=sys.stderr, flush=True)
    if args.json:
        print(json.dumps({"machine": describe_machine(), "nets": rows}, indent=2))
    else:
        print(_text(rows))
    return 1 if any(row["verdict"] == "differs" for row in rows) else 0


def _check(entry: Published, engine: str) -> Dict[str, Any]:
    row: Dict[str, Any] = {"net": "%s %d" % entry[:2], "published": entry._asdict()}
    expected = BYTES_PER_STATE * (entry.states or entry.tangible or 0)
    if expected > psutil.virtual_memory().available:
        return {**row, "verdict": "left out: it takes about %.0f GB of memory" % (expected / 1e9)}
    command = [
        sys.executable,
        "-m",
        "benchmarks.published",
        "--engine",
        engine,
    ]
    done = subprocess.run(
        [*command, "--worker", entry.family, str(entry.size)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    row.update(json.loads(done.stdout))
    same = all(
        known in (None, row[key])
        for key, known in (("states", entry.states), ("tangible", entry.tangible))
    )
    return {**row, "verdict": "as published" if same else "differs"}


def _explore(net: Net, engine: str) -> Dict[str, Any]:
    start = time.perf_counter()
    space = explore(net, engine=engine, limit=10**9)
    seconds = time.perf_counter() - start
    found = {"states": len(space), "arcs": space.arcs, "engine": space.engine, "seconds": seconds}
    vanishing = int(space.is_vanishing.sum()) if any(not t.timed for t in net.transitions) else 0
    return {
        **found,
        "tangible": len(space) - vanishing,
        "mb": space.memory / 1e6,
        "peak_mb": peak_mb(),
    }


def _text(rows: Sequence[Mapping[str, Any]]) -> str:
    head = (
        "net",
        "states",
        "tangible",
        "arcs",
        "seconds",
        "MB of the result",
        "MB at the peak",
        "verdict",
        "source",
    )
    keys = ("net", "states", "tangible", "arcs", "seconds", "mb", "peak_mb", "verdict")
    cells = [[row.get(key) for key in keys] + [row["published"]["source"]] for row in rows]
    return "%s\n\n%s" % (machine_line(), table(head, cells))


if __name__ == "__main__":
    sys.exit(main())
