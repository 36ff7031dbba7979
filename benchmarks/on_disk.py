"""State spaces and chains on disk beside the same in memory: ``python3 -m
benchmarks.on_disk``.

The states of each net are counted and its chain is built on disk (with 1 GB of memory), and then in
memory, each in its own process, so that the peak memory is its own. The exit code is 1 if the
counts differ, or the steady states by more than 1e-9.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from typing import Any, Dict, Mapping, Optional, Sequence

import psutil

from benchmarks.harness.processes import peak_mb
from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.nets import FAMILIES
from gspn_framework_package.analysis.chain import Chain
from gspn_framework_package.analysis.on_disk.chain import OnDiskChain
from gspn_framework_package.analysis.on_disk.search import search
from gspn_framework_package.analysis.on_disk.steady import steady_state_on_disk as steady_on_disk
from gspn_framework_package.analysis.solution.measures import Measures
from gspn_framework_package.analysis.solution.steady_state import steady_state
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.net import Net

MEMORY = 1e9
"""Bytes that the search and the chain on disk may use."""

_BYTES_PER_ARC = 40
"""What the chain takes in memory at its peak."""


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
    parser.add_argument("--steady", action="store_true", help="solve the steady state too")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--worker", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.worker:
        where, size = args.worker
        measure = _on_disk if where == "disk" else _in_memory
        print(json.dumps(measure(FAMILIES["kanban"](int(size)), args.steady)))
        return 0
    rows = [_row(size, args.steady) for size in args.sizes]
    if args.json:
        print(json.dumps({"machine": describe_machine(), "nets": rows}, indent=2))
    else:
        print(_text(rows))
    return 0 if all(row["same"] is not False for row in rows) else 1


def _row(size: int, steady: bool) -> Dict[str, Any]:
    row: Dict[str, Any] = {"net": "kanban %d" % size, "load": os.getloadavg()[0]}
    row["disk"] = disk = _run("disk", size, steady)
    row["memory"] = row["ratio"] = row["same"] = None
    if disk["arcs"] * _BYTES_PER_ARC < psutil.virtual_memory().available:
        row["memory"] = memory = _run("memory", size, steady)
        row["ratio"] = disk["seconds"] / memory["seconds"]
        row["same"] = all(disk[key] == memory[key] for key in ("states", "arcs", "rates"))
        if steady:
            row["difference"] = max(
                abs(value - memory["throughput"][name])
                for name, value in disk["throughput"].items()
            )
            row["same"] = row["same"] and row["difference"] <= 1e-9
    return row


def _run(where: str, size: int, steady: bool) -> Dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.on_disk"]
    command += ["--worker", where, str(size), *(["--steady"] if steady else [])]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    measured: Dict[str, Any] = json.loads(done.stdout)
    return measured


def _on_disk(net: Net, steady: bool) -> Dict[str, Any]:
    clock = _Clock()
    space = search(net, MEMORY)
    clock.lap("count")
    chain = OnDiskChain(space, MEMORY, Watch())
    clock.lap("chain")
    found: Dict[str, Any] = {"states": space.counts.states, "arcs": space.counts.arcs}
    found["rates"] = chain.entries
    if steady:
        found["throughput"] = steady_on_disk(chain, Watch())["throughput"]
        clock.lap("steady")
    found["scratch_mb"] = space.scratch.peak / 1e6
    return {**found, **clock.read()}


def _in_memory(net: Net, steady: bool) -> Dict[str, Any]:
    clock = _Clock()
    space = explore(net, limit=10**9)
    clock.lap("count")
    chain = Chain.of(space)
    clock.lap("chain")
    found: Dict[str, Any] = {"states": len(space), "arcs": space.arcs, "rates": chain.rates.nnz}
    if steady:
        found["throughput"] = Measures(chain, steady_state(chain).distribution).throughput
        clock.lap("steady")
    return {**found, **clock.read()}


class _Clock:
    """The time of each part of the work, and the memory of the process."""

    def __init__(self) -> None:
        self._laps: Dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """A part ends."""
        now = time.perf_counter()
        self._laps[name + "_seconds"] = now - self._last
        self._last = now

    def read(self) -> Dict[str, float]:
        """All that was measured."""
        return {
            **self._laps,
            "seconds": sum(self._laps.values()),
            "cpu_seconds": time.process_time(),
            "peak_mb": peak_mb(),
        }


def _text(rows: Sequence[Mapping[str, Any]]) -> str:
    keys = ("count_seconds", "chain_seconds", "steady_seconds", "cpu_seconds", "peak_mb")
    names = ["count s", "chain s", "steady s", "CPU s", "peak MB"]
    head = ["net", "states", "rates", *("disk: " + name for name in names), "MB on disk"]
    head += [*("memory: " + name for name in names), "disk / memory", "load"]
    cells = []
    for row in rows:
        disk, memory = row["disk"], row["memory"] or {}
        cells.append(
            [row["net"], disk["states"], disk["rates"], *(disk.get(key) for key in keys)]
            + [disk["scratch_mb"], *(memory.get(key) for key in keys), row["ratio"], row["load"]]
        )
    return "%s\n\n%s" % (machine_line(), table(head, cells))


if __name__ == "__main__":
    sys.exit(main())
