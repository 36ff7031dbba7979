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
import itertools
import json
import os
import sys
import time
from dataclasses import replace
from typing import Any, Dict, List, Optional, Sequence

from benchmarks.command import run_command
from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.team import LaunchedTeam, NodeTeam
from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.plans import BRIEF, INSTANT, ring_plan, tokens_plan
from gspn_framework_package.model.plan import Plan, Synchronisation
from gspn_framework_package.team.log_file import SYNC_PERIOD_NAME

LOADS = ("light", "instant", "private")
RING = 7
"""Places of the ring."""


def measure(
    plan: Plan, window: float, check: bool = False, arguments: Sequence[str] = ()
) -> Dict[str, Any]:
    """Run a plan and report its latencies and throughput over ``window`` seconds.

    :param check: whether the history checker verifies the logs, too.
    :param arguments: further arguments of the launch file.
    :raises ExecutionError: not all robots fired.
    """
    with LaunchedTeam(plan, arguments=arguments) as team:
        team.await_steady()
        sent, began = messages_sent(team), time.monotonic()
        found = team.measure(window)
        sent, ended = messages_sent(team) - sent, time.monotonic()
        team.end()
        violation = team.verdict().violation if check else None
        evicted = {
            (record["slot"], entry["robot"])
            for log in team.logs.values()
            for record in log.of("slot")
            for entry in record["entries"]
            if entry["entry"] == "evict"
        }
    a_firing = sent / (ended - began) / found.firings_per_s if found.moves else None
    return {
        **({"verdict": "rule %d: %s" % violation if violation else "valid"} if check else {}),
        "evictions": len(evicted),
        "firings_per_s": round(found.firings_per_s, 1),
        "messages_per_firing": None if a_firing is None else round(a_firing, 2),
        **found.latencies(),
    }


def messages_sent(team: NodeTeam) -> int:
    """The number of messages that the running robots have sent each other so far."""
    return sum(status["messages_sent"] for status in team.statuses().values())


def plan_of(load: str, robots: int, mode: Synchronisation) -> Plan:
    """The plan of a load (see above)."""
    if load == "private":
        return replace(ring_plan(RING, robots, INSTANT), synchronisation=mode)
    plan = tokens_plan(BRIEF if load == "light" else INSTANT).for_robots(robots)
    return replace(plan, synchronisation=mode)


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
        with Master():
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
                os.environ[SYNC_PERIOD_NAME] = _FSYNC.get(fsync, "")
                if fsync:
                    plan = replace(plan, fsync=fsync == "yes")
                if args.evict_after is not None:
                    plan = replace(plan, timing=plan.timing._replace(evict_after=args.evict_after))
                measured = measure(plan, args.window, args.verify)
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
    run_command("latency", main)
