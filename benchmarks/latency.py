"""How long a robot stands still between two actions, by mode of synchronisation and size of the
team.

``python3 -m benchmarks.latency`` (needs ROS)

*Latency*: the time from the result of an action in the robot's log to the goal of its next one, on
one monotonic clock. *Private* moves need no agreement (partial synchronisation); *coordinated* ones
are agreed on. The loads:

- ``light``: ``plans/tokens`` with actions of a tenth of a second;
- ``instant``: the same, with actions that return at once, so that the machine is the limit;
- ``private``: a ring in which every move is private, with actions that return at once (partial
  synchronisation only).

A move that waits for its transition to become enabled would not count, but these plans have none.
*Messages*: those that robots send each other, heartbeats included; a message to several robots
counts once.
"""

from __future__ import annotations

import argparse
import contextlib
import glob
import itertools
import json
import os
import statistics
import sys
import time
from dataclasses import replace
from typing import Any, Dict, List, Optional, Sequence, Set, Tuple

from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.plans import ring_plan, tokens_plan
from benchmarks.processes import end_cleanly_on_signal
from benchmarks.team_run import Master, TeamRun, need_ros
from gspn_framework_package.execution.event_log import EventLog, read_log
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.plan import Plan, Synchronisation
from gspn_framework_package.team.log_file import SYNC_PERIOD_NAME

BRIEF = "benchmarks.load.brief"
LOADS = ("light", "instant", "private")
RING = 7
"""Places of the ring."""


def latencies(records: Sequence[Dict[str, Any]], since: float) -> Tuple[List[float], List[float]]:
    """The (private, coordinated) latencies (ms) in the records of one robot's log after the
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


def measure(
    master: Master,
    plan: Plan,
    window: float,
    check: bool = False,
    arguments: Sequence[str] = (),
) -> Dict[str, Any]:
    """Run a plan and report its latencies and throughput over ``window`` seconds.

    :param check: whether the history checker verifies the logs, too.
    :param arguments: further arguments of the launch file.
    """
    with TeamRun(master, plan, arguments=arguments) as run:
        if not run.wait_all_fired(120):
            return {"note": "not all robots fired"}
        time.sleep(3.0)  # exclude the connections made in the background
        sent, began = messages_sent(), time.monotonic()
        time.sleep(window)
        ended, sent = time.monotonic(), messages_sent() - sent
        folder = run.folder
    private: List[float] = []
    coordinated: List[float] = []
    moves = 0
    logs = [read_log(path) for path in sorted(glob.glob(os.path.join(folder, "*", "*.jsonl")))]
    for log in logs:
        records = [r for r in log.records if r.get("mono", 0) < began + window]
        moves += sum(1 for r in records if r["kind"] == "goal" and r["mono"] >= began)
        mine, agreed = latencies(records, began)
        private += mine
        coordinated += agreed
    violation = verify(logs).violation if check else None
    return {
        **({"verdict": "rule %d: %s" % violation if violation else "valid"} if check else {}),
        "evictions": len(evictions(logs)),
        "firings_per_s": round(moves / window, 1),
        "messages_per_firing": round(sent / (ended - began) * window / moves, 2) if moves else None,
        **_summary("private", private),
        **_summary("coordinated", coordinated),
    }


def evictions(logs: Sequence[EventLog]) -> Set[Tuple[int, str]]:
    """The evictions in these logs: (slot, robot)."""
    return {
        (record["slot"], entry["robot"])
        for log in logs
        for record in log.records
        if record["kind"] == "slot"
        for entry in record["entries"]
        if entry["entry"] == "evict"
    }


def messages_sent() -> int:
    """The number of messages that the running robots have sent each other so far."""
    from gspn_framework_package.ros.operator_client import OperatorClient

    with contextlib.closing(OperatorClient()) as client:
        return sum(status["messages_sent"] for status in client.statuses().values() if status)


def plan_of(load: str, robots: int, mode: Synchronisation) -> Plan:
    """The plan of a load (see above)."""
    if load == "private":
        return replace(ring_plan(RING, robots, instant=True), synchronisation=mode)
    plan = replace(tokens_plan(instant=True), synchronisation=mode).for_robots(robots)
    if load == "light":
        plan = replace(
            plan, actions={place: FunctionAction(BRIEF, place) for place in plan.actions}
        )
    return plan


def _summary(name: str, values: List[float]) -> Dict[str, Any]:
    if not values:
        return {}
    values.sort()
    return {
        name + "_median_ms": round(statistics.median(values), 2),
        name + "_p99_ms": round(values[min(len(values) - 1, int(len(values) * 0.99))], 2),
        name + "_count": len(values),
    }


_FSYNC = {"never": "1e9", "no": "", "yes": ""}
"""What to measure -> the seconds between two syncs; "": the default."""

COLUMNS = (
    ("load", "load"),
    ("mode", "mode"),
    ("robots", "robots"),
    ("fsync", "fsync"),
    ("firings_per_s", "firings/s"),
    ("messages_per_firing", "messages/firing"),
    ("private_median_ms", "private median [ms]"),
    ("private_p99_ms", "p99 [ms]"),
    ("coordinated_median_ms", "coordinated median [ms]"),
    ("coordinated_p99_ms", "p99 [ms]"),
    ("evictions", "evictions"),
    ("verdict", "logs"),
)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 2, 3, 5, 8], metavar="N")
    parser.add_argument(
        "--window", type=float, default=10.0, metavar="S", help="seconds for each team (10)"
    )
    parser.add_argument("--load", choices=LOADS, nargs="+", default=LOADS)
    parser.add_argument(
        "--mode", choices=[m.value for m in Synchronisation], help="only this synchronisation"
    )
    parser.add_argument(
        "--fsync",
        choices=list(_FSYNC),
        nargs="+",
        default=[""],
        help="wait for the disk (yes), have another thread sync the logs every second (no), or "
        "leave it to the system (never); default: as the plan says",
    )
    parser.add_argument(
        "--evict-after",
        type=float,
        metavar="S",
        help="seconds of silence after which a robot is evicted (as the plan says)",
    )
    parser.add_argument(
        "--verify", action="store_true", help="check the logs, too; exit code 1: a rule was broken"
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    need_ros()
    end_cleanly_on_signal()
    modes = [Synchronisation(args.mode)] if args.mode else list(Synchronisation)
    rows: List[Dict[str, Any]] = []
    interrupted = False
    try:
        with Master() as master:
            os.environ.update(master.environment)
            for load, mode, robots, fsync in itertools.product(
                args.load, modes, args.robots, args.fsync
            ):
                if load == "private" and mode is Synchronisation.FULL:
                    continue
                print(
                    "latency: %s, %s, %d robots %s ..." % (load, mode.value, robots, fsync),
                    file=sys.stderr,
                    flush=True,
                )
                plan = plan_of(load, robots, mode)
                master.environment[SYNC_PERIOD_NAME] = _FSYNC.get(fsync, "")
                if fsync:
                    plan = replace(plan, fsync=fsync == "yes")
                if args.evict_after is not None:
                    plan = replace(plan, timing=plan.timing._replace(evict_after=args.evict_after))
                measured = measure(master, plan, args.window, args.verify)
                row = {"load": load, "mode": mode.value, "robots": robots, "fsync": fsync}
                rows.append({**row, **measured})
    except KeyboardInterrupt:
        print("latency: interrupted", file=sys.stderr)
        interrupted = True
    if args.json:
        print(json.dumps({"machine": describe_machine(), "window_s": args.window, "rows": rows}))
    else:
        print(
            table(
                [head for _, head in COLUMNS],
                [[row.get(key) for key, _ in COLUMNS] for row in rows],
            )
        )
        print(machine_line())
    if any(row.get("verdict", "valid") != "valid" for row in rows):
        return 1
    return 130 if interrupted else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except GspnError as error:
        print("latency: error: %s" % error, file=sys.stderr)
        sys.exit(error.exit_code)
