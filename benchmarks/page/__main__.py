"""The page under load.

    python3 -m benchmarks.page [render] [viewers] [memory] [edit] [log]
    [team] [--json]

*render*: first render, frames per second and firing to frame, in Chromium. *edit*: the time that
the editor takes for an edit of a large net, with its panels open. *viewers*: many headless
viewers. *memory*: memory of the server, with a viewer that has stalled. *log*: opening a long event
log. *team*: the cost of the page to five robots at full speed (needs ROS). By default, the first
three run.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from typing import Any, Dict, Iterator, Tuple

from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.machine import describe_machine, machine_line
from benchmarks.page.editing import measure_editing
from benchmarks.page.long_log import measure_log
from benchmarks.page.rendering import measure_page
from benchmarks.page.team import ARRANGEMENTS, measure_team
from benchmarks.page.viewers import measure_memory, measure_viewers
from gspn_framework_package.model.errors import GspnError

WORDS = ("render", "viewers", "memory", "edit", "log", "team")


def main() -> int:
    """Measure, and print the results."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.page", description="Measure the page under load."
    )
    parser.add_argument(
        "what", nargs="*", metavar="WHAT", help="%s (default: the first three)" % ", ".join(WORDS)
    )
    parser.add_argument(
        "--nodes",
        type=int,
        nargs="+",
        default=[100, 1000, 5000],
        help="sizes that are rendered and edited",
    )
    parser.add_argument("--rate", type=float, default=100.0, help="firings a second")
    parser.add_argument("--seconds", type=float, default=10.0, help="length of a measurement")
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument(
        "--events", type=int, default=200_000, help="events over which memory is watched"
    )
    parser.add_argument(
        "--entries", type=int, default=1_000_000, help="length of the log that is opened"
    )
    parser.add_argument(
        "--log", metavar="FILE", help="where that log is, or is written (default: a temporary file)"
    )
    parser.add_argument("--robots", type=int, default=5, help="size of the team")
    parser.add_argument(
        "--rounds", type=int, default=4, help="times that the page comes and goes beside the team"
    )
    parser.add_argument(
        "--where",
        choices=ARRANGEMENTS,
        nargs="+",
        default=list(ARRANGEMENTS),
        help="on which processors the page runs beside the team",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    end_cleanly_on_signal()
    for word in args.what:
        if word not in WORDS:
            parser.error("there is no '%s'; there are: %s" % (word, ", ".join(WORDS)))
    result: Dict[str, Any] = {
        "machine": describe_machine(("flask", "waitress", "playwright", "psutil", "rospy"))
    }
    try:
        for name, found in _measurements(args, args.what or list(WORDS[:3])):
            result.setdefault(name, []).append(found)
            if not args.json:
                print(name, json.dumps(found), flush=True)
    except GspnError as error:
        print("benchmarks.page: error: %s" % error, file=sys.stderr)
        return error.exit_code
    print(json.dumps(result, indent=2) if args.json else machine_line(result["machine"]))
    return 0


def _measurements(
    args: argparse.Namespace, what: list[str]
) -> Iterator[Tuple[str, Dict[str, Any]]]:
    if "render" in what:
        for nodes in args.nodes:
            yield "render", measure_page(nodes, args.rate, args.seconds)
    if "viewers" in what:
        yield "viewers", measure_viewers(args.viewers, args.rate, args.seconds)
    if "memory" in what:
        yield "memory", measure_memory(args.events)
    if "edit" in what:
        for nodes in args.nodes:
            yield "edit", measure_editing(nodes, args.seconds)
    if "log" in what:
        with tempfile.TemporaryDirectory() as folder:
            yield "log", measure_log(args.entries, args.log or os.path.join(folder, "long.jsonl"))
    if "team" in what:
        for where in args.where:
            yield "team", measure_team(args.robots, where, args.rounds, args.seconds)


if __name__ == "__main__":
    sys.exit(main())
