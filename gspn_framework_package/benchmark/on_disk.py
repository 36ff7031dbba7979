"""State spaces on disk beside the same in memory: ``python3 -m
gspn_framework_package.benchmark.on_disk``.

Each net is searched on disk (with 1 GB of memory) and then explored in memory, each in its own
process, so that the peak memory is its own. The exit code is 1 if the counts differ.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from typing import Any, Dict, Mapping, Optional, Sequence

import psutil

from gspn_framework_package.analysis.on_disk.search import search
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.benchmark.machine import describe_machine, machine_line, table
from gspn_framework_package.benchmark.nets import FAMILIES
from gspn_framework_package.benchmark.published import BYTES_PER_STATE

MEMORY = 1e9
"""Bytes that the search on disk may use."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Search the nets, and report whether the counts differ."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--sizes",
        type=int,
        nargs="+",
        default=[5, 6, 7],
        metavar="N",
        help="the sizes of Kanban (default: 5 6 7); in memory, only those that fit",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--worker", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.worker:
        print(json.dumps(_measure(args.worker[0], int(args.worker[1]))))
        return 0
    rows = [_row(size) for size in args.sizes]
    if args.json:
        print(json.dumps({"machine": describe_machine(), "nets": rows}, indent=2))
    else:
        print(_text(rows))
    return 0 if all(row["same"] is not False for row in rows) else 1


def _row(size: int) -> Dict[str, Any]:
    row: Dict[str, Any] = {"net": "kanban %d" % size, "load": os.getloadavg()[0]}
    row["disk"] = disk = _run("disk", size)
    row["memory"] = row["ratio"] = row["same"] = None
    if disk["states"] * BYTES_PER_STATE < psutil.virtual_memory().available:
        row["memory"] = memory = _run("memory", size)
        row["ratio"] = disk["seconds"] / memory["seconds"]
        row["same"] = all(disk[key] == memory[key] for key in ("states", "arcs"))
    return row


def _run(where: str, size: int) -> Dict[str, Any]:
    command = [sys.executable, "-m", "gspn_framework_package.benchmark.on_disk"]
    done = subprocess.run(
        [*command, "--worker", where, str(size)], stdout=subprocess.PIPE, text=True, check=True
    )
    measured: Dict[str, Any] = json.loads(done.stdout)
    return measured


def _measure(where: str, size: int) -> Dict[str, Any]:
    net = FAMILIES["kanban"](size)
    start = time.perf_counter()
    found: Dict[str, Any]
    if where == "disk":
        on_disk = search(net, MEMORY)
        counts = on_disk.counts
        found = {"states": counts.states, "arcs": counts.arcs}
        found["scratch_mb"] = on_disk.scratch.peak / 1e6
    else:
        space = explore(net, limit=10**9)
        found = {"states": len(space), "arcs": space.arcs}
    found["seconds"] = time.perf_counter() - start
    found["cpu_seconds"] = time.process_time()
    found["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return found


def _text(rows: Sequence[Mapping[str, Any]]) -> str:
    keys = ("seconds", "cpu_seconds", "peak_mb")
    head = ["net", "states", "disk: s", "CPU s", "peak MB", "MB on disk"]
    head += ["memory: s", "CPU s", "peak MB", "disk / memory", "load"]
    cells = []
    for row in rows:
        disk, memory = row["disk"], row["memory"] or {}
        cells.append(
            [row["net"], disk["states"], *(disk[key] for key in keys), disk["scratch_mb"]]
            + [memory.get(key) for key in keys]
            + [row["ratio"], row["load"]]
        )
    return "%s\n\n%s" % (machine_line(), table(head, cells))


if __name__ == "__main__":
    sys.exit(main())
