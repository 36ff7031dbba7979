"""How long a robot stands still between two actions, by mode of synchronisation and size of the team.

``python3 -m gspn_framework_package.benchmark.latency`` (needs ROS)

*Latency*: from the result of an action in the robot's log to the goal of its next one there, on one monotonic clock.
*Private* moves ask nobody (partial synchronisation); *coordinated* ones are agreed on. Twice for each team: with
actions of a tenth of a second (``light``), and with actions that return at once (``instant``), where what limits is the
machine. A move that waits for its transition to become enabled is not counted: the plan has none.
"""

from __future__ import annotations

import argparse
import glob
import json
import os
import statistics
import sys
import time
from dataclasses import replace
from typing import Any, Dict, List, Optional, Sequence, Tuple

from gspn_framework_package.benchmark.machine import describe_machine, machine_line, table
from gspn_framework_package.benchmark.plans import tokens_plan
from gspn_framework_package.benchmark.team_run import Master, TeamRun, need_ros
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.plan import FunctionAction, Plan, Synchronisation

BRIEF = "gspn_framework_package.benchmark.load.brief"


def latencies(records: Sequence[Dict[str, Any]], since: float) -> Tuple[List[float], List[float]]:
    """(private, coordinated) latencies in milliseconds in the records of one robot's log after the
    monotonic time ``since``."""
    private: List[float] = []
    coordinated: List[float] = []
    done: Optional[Tuple[int, float, bool]] = None
    for record in records:
        kind = record["kind"]
        if kind in ("invoked", "private") and record["entry"]["entry"] == "done":
            done = record["entry"]["visit"], record["mono"], kind == "private"
        elif kind == "goal" and done is not None and record["visit"] == done[0] + 1:
            if done[1] >= since:
                (private if done[2] else coordinated).append((record["mono"] - done[1]) * 1000)
            done = None
    return private, coordinated


def measure(master: Master, plan: Plan, window: float) -> Dict[str, Any]:
    """Run a plan and tell its latencies and throughput over ``window`` seconds."""
    with TeamRun(master, plan) as run:
        if not run.wait_all_fired(120):
            return {"note": "not all robots fired"}
        time.sleep(3.0)  # connections that follow in the background are not what is measured
        began = time.monotonic()
        time.sleep(window)
        folder = run.folder
    private: List[float] = []
    coordinated: List[float] = []
    moves = 0
    for path in sorted(glob.glob(os.path.join(folder, "*", "*.jsonl"))):
        records = [r for r in read_log(path).records if r.get("mono", 0) < began + window]
        moves += sum(1 for r in records if r["kind"] == "goal" and r["mono"] >= began)
        mine, agreed = latencies(records, began)
        private += mine
        coordinated += agreed
    return {
        "firings_per_s": round(moves / window, 1),
        **_summary("private", private),
        **_summary("coordinated", coordinated),
    }


def _summary(name: str, values: List[float]) -> Dict[str, Any]:
    if not values:
        return {}
    values.sort()
    return {
        name + "_median_ms": round(statistics.median(values), 2),
        name + "_p99_ms": round(values[min(len(values) - 1, int(len(values) * 0.99))], 2),
        name + "_count": len(values),
    }


COLUMNS = (
    ("load", "load"), ("mode", "mode"), ("robots", "robots"), ("firings_per_s", "firings/s"),
    ("private_median_ms", "private median [ms]"), ("private_p99_ms", "p99 [ms]"),
    ("coordinated_median_ms", "coordinated median [ms]"), ("coordinated_p99_ms", "p99 [ms]"),
)  # fmt: skip


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 2, 3, 5, 8], metavar="N")
    parser.add_argument("--window", type=float, default=10.0, metavar="S", help="seconds for each team (10)")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    need_ros()
    rows = []
    with Master() as master:
        for load in ("light", "instant"):
            for mode in Synchronisation:
                for robots in args.robots:
                    plan = replace(tokens_plan(instant=True), synchronisation=mode).for_robots(robots)
                    if load == "light":
                        actions = {p: FunctionAction(BRIEF, p) for p in plan.actions}
                        plan = replace(plan, actions=actions)
                    print("latency: %s, %s, %d robots ..." % (load, mode.value, robots), file=sys.stderr)
                    measured = measure(master, plan, args.window)
                    rows.append({"load": load, "mode": mode.value, "robots": robots, **measured})
    if args.json:
        print(json.dumps({"machine": describe_machine(), "window_s": args.window, "rows": rows}))
    else:
        print(table([head for _, head in COLUMNS], [[row.get(key) for key, _ in COLUMNS] for row in rows]))
        print(machine_line())
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except GspnError as error:
        print("latency: error: %s" % error, file=sys.stderr)
        sys.exit(error.exit_code)
