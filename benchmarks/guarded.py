"""What the key of a team on ROS costs, and what a flood does to a team with and without one.

``python3 -m benchmarks.guarded`` (needs ROS)

The load is that of ``benchmarks.latency`` with actions that return at once. *Flooded*: a node
without the key publishes 10,000 messages a second of 0.5 KB on the topic of the agreement, in the
name of a robot, on the same machine. With ``--verify`` the logs are checked as well.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from typing import Any, Dict, Iterator, List, Optional, Sequence

from benchmarks.command import run_command
from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.team import RUN
from benchmarks.latency import measure, plan_of
from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.execution.agreement.messages import PROTOCOL_VERSION
from gspn_framework_package.model.plan import Synchronisation
from gspn_framework_package.team.seal import make_team_key

RATE = 10_000
"""Messages a second of a flood."""

_SIZE = 500
_PART = 0.01


def flood(run: str) -> int:
    """Publish messages of a run as fast as wanted until we are asked to stop; print how many there
    were a second."""
    import rospy

    from gspn_framework_package.msg import Agreement
    from gspn_framework_package.ros.links import AGREEMENT_TOPIC

    rospy.init_node("flooder", anonymous=True, disable_signals=True)
    out = rospy.Publisher(AGREEMENT_TOPIC, Agreement, queue_size=100)
    body = json.dumps(
        {"from": "robot_1", "version": PROTOCOL_VERSION, "kind": "pull", "x": "x" * _SIZE}
    )
    over: List[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: over.append(number))
    began, sent = time.monotonic(), 0
    while not over:
        due = int((time.monotonic() - began) * RATE) - sent
        for _ in range(due):
            out.publish(Agreement(run=run, sender="robot_1", body=body))
            sent += 1
        time.sleep(_PART)
    print(round(sent / (time.monotonic() - began)), flush=True)
    return 0


@contextlib.contextmanager
def flooded(run: str, told: Dict[str, Any]) -> Iterator[None]:
    """A flood during the block, of messages of ``run``, unless that is ""; ``told`` receives how
    many it sent a second."""
    if not run:
        yield
        return
    words = [sys.executable, "-m", __spec__.name if __spec__ else __name__, "--flooder", run]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        yield
    finally:
        process.terminate()
        with contextlib.suppress(ValueError):
            told["flood_per_s"] = int(process.communicate(timeout=30)[0].split()[-1])


COLUMNS = (
    ("key", "key"),
    ("robots", "robots"),
    ("flood_per_s", "flood/s"),
    ("firings_per_s", "firings/s"),
    ("coordinated_median_ms", "coordinated median [ms]"),
    ("coordinated_p99_ms", "p99 [ms]"),
    ("verdict", "logs"),
)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robots", type=int, default=5, metavar="N")
    parser.add_argument("--window", type=float, default=10.0, metavar="S", help="seconds (10)")
    parser.add_argument("--rounds", type=int, default=1, metavar="N", help="of all four teams (1)")
    parser.add_argument("--verify", action="store_true", help="check the logs, too")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--flooder", metavar="RUN", help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.flooder:
        return flood(args.flooder)
    end_cleanly_on_signal()
    need_ros()
    rows: List[Dict[str, Any]] = []
    with Master() as master:
        key = os.path.join(master.folder, "team.key")
        make_team_key(key)
        plan = plan_of("instant", args.robots, Synchronisation.FULL)
        for number in range(4 * args.rounds):
            keyed, under_flood = number % 2 == 1, number % 4 > 1
            print("guarded: %d of %d ..." % (number + 1, 4 * args.rounds), file=sys.stderr)
            row: Dict[str, Any] = {"key": "yes" if keyed else "no", "robots": args.robots}
            words = ["team_key_file:=" + key] if keyed else []
            with flooded(RUN if under_flood else "", row):
                row.update(measure(plan, args.window, args.verify, words))
            rows.append(row)
    if args.json:
        print(json.dumps({"machine": describe_machine(), "window_s": args.window, "rows": rows}))
    else:
        names = [head for _, head in COLUMNS]
        print(table(names, [[row.get(key) for key, _ in COLUMNS] for row in rows]))
        print(machine_line())
    return 0 if all(row.get("verdict", "valid") == "valid" for row in rows) else 1


if __name__ == "__main__":
    run_command("guarded", main)
