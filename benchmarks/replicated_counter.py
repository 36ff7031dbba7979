"""What PySyncObj agrees on in a second, beside a team of as many robots in the same run.

``python3 -m benchmarks.replicated_counter`` (needs pysyncobj and eclipse-zenoh)

- *PySyncObj*: every process adds one to a replicated counter, again as soon as its last addition is
  there: Raft in memory, over TCP. Its period of sending is the one that was fastest here.
  What ends with an error, as when the leader changes, counts as failed.
- *Team*: ``plans/tokens`` with instant actions over Zenoh, without keys, as in
  :mod:`~benchmarks.carriers`: every robot fires again as soon as its last firing is agreed, and
  each firing is in the log of each robot.
- *Team, independent*: the same with a ring whose firings are local to a robot (partial
  synchronisation), which are agreed many at a time.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import statistics
import time
from typing import Any, Dict, List, Optional, Sequence

from benchmarks.carriers import measure
from benchmarks.command import run_command
from benchmarks.harness.ports import free_port
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.team import percentile_99, why_no_zenoh
from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.model.plan import Synchronisation

PERIOD = 0.001
"""Seconds between two messages of entries. With 0.01 s, three processes made 189 additions a second
instead of 883; with 0.1 s, 20."""

_PATIENCE = 30.0


def count(processes: int, window: float) -> Dict[str, Any]:
    """Additions of ``processes`` processes of PySyncObj during ``window`` seconds.

    :raises ExecutionError: they found no leader.
    """
    addresses = ["127.0.0.1:%d" % free_port() for _ in range(processes)]
    context = multiprocessing.get_context("spawn")
    found = context.Queue()
    workers = [
        context.Process(target=_add, args=(address, addresses, window, found), daemon=True)
        for address in addresses
    ]
    for worker in workers:
        worker.start()
    times: List[float] = []
    failed = 0
    for _ in workers:
        added, errors = found.get(timeout=window + 3 * _PATIENCE)
        times += added
        failed += errors
    for worker in workers:
        worker.terminate()
    if not times:
        raise ExecutionError("the processes of PySyncObj found no leader")
    return {
        "failed": failed,
        "per_s": round(len(times) / window),
        "median_ms": round(statistics.median(times), 2),
        "p99_ms": round(percentile_99(times), 2),
    }


def _add(own: str, addresses: Sequence[str], window: float, found: Any) -> None:
    from pysyncobj import SyncObj, SyncObjConf, SyncObjException, replicated

    class Counter(SyncObj):
        """A number that all processes have."""

        def __init__(self) -> None:
            period = SyncObjConf(autoTickPeriod=PERIOD, appendEntriesPeriod=PERIOD)
            super().__init__(own, [other for other in addresses if other != own], period)
            self.number = 0

        @replicated
        def add(self) -> int:
            """Add one; returns the number."""
            self.number += 1
            return self.number

    counter = Counter()
    deadline = time.monotonic() + _PATIENCE
    while not counter.isReady() and time.monotonic() < deadline:
        time.sleep(0.01)
    times: List[float] = []
    failed = 0
    end = time.perf_counter() + window
    while counter.isReady() and (began := time.perf_counter()) < end:
        try:
            counter.add(sync=True, timeout=_PATIENCE)
        except SyncObjException:
            failed += 1
        else:
            times.append(1000 * (time.perf_counter() - began))
    found.put((times, failed))
    time.sleep(_PATIENCE)  # the others need a quorum until their window ends


def _team(robots: int, window: float, kind: str) -> Dict[str, Any]:
    """A row about a team whose moves are all ``kind``: "coordinated" or "private"."""
    if kind == "private":
        team = measure("tcp", robots, window, "private", mode=Synchronisation.PARTIAL)
    else:
        team = measure("tcp", robots, window)
    return {
        "robots": robots,
        "what": "team, independent" if kind == "private" else "team",
        "per_s": team["firings_per_s"],
        "median_ms": team[kind + "_median_ms"],
        "p99_ms": team[kind + "_p99_ms"],
        "logs": team["logs"],
    }


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print a table or JSON; returns 1 if a log of the team is not valid."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[3, 5], metavar="N")
    parser.add_argument("--window", type=float, default=8.0, metavar="S", help="seconds (8)")
    parser.add_argument("--rounds", type=int, default=2, metavar="N", help="in turn (2)")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    reason = why_no_zenoh()
    if reason:
        raise UsageError(reason)
    try:
        import pysyncobj  # noqa: F401
    except ImportError:
        raise UsageError("there is no Python module pysyncobj (pip install pysyncobj)") from None
    end_cleanly_on_signal()
    rows: List[Dict[str, Any]] = []
    for robots in args.robots:
        for _ in range(args.rounds):
            rows.append({"robots": robots, "what": "PySyncObj", **count(robots, args.window)})
            rows.append(_team(robots, args.window, "coordinated"))
            rows.append(_team(robots, args.window, "private"))
    machine = describe_machine(("eclipse-zenoh", "pysyncobj"))
    if args.json:
        print(json.dumps({"machine": machine, "window_s": args.window, "rows": rows}))
    else:
        heads = ["what", "robots", "a second", "median [ms]", "99 % [ms]", "failed", "logs"]
        keys = ("what", "robots", "per_s", "median_ms", "p99_ms", "failed", "logs")
        print(table(heads, [[row.get(key) for key in keys] for row in rows]))
        print("\n" + machine_line(machine))
    return 0 if all(row.get("logs", "valid") == "valid" for row in rows) else 1


if __name__ == "__main__":
    run_command("replicated_counter", main)
