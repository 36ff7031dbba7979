"""What agreement costs, counted in one-way delays and messages, in a simulated network where every
message takes the same time and nothing is lost.

``python3 -m gspn_framework_package.benchmark.agreement_cost``
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from typing import Any, Dict, List, Optional

from gspn_framework_package.benchmark.team import world as world_module
from gspn_framework_package.benchmark.team.plans import make_plan
from gspn_framework_package.benchmark.team.world import Weather, World

DELAY = 0.005
"""Seconds that a message takes."""

TOKENS = 2
"""The net of thesis Figure 6.1."""


def measure(robots: int, partial: bool, saturated: bool, seconds: float = 6.0) -> Dict[str, Any]:
    """Delays and messages per fact.

    :param saturated: actions end at once; otherwise each takes 40 to 120 delays, so that one fact
        is under way at a time, mostly.
    """
    times = (0.1 * DELAY, 0.2 * DELAY) if saturated else (40 * DELAY, 120 * DELAY)
    plan = make_plan(TOKENS, robots, partial, 0.0, 0.0, False)
    world = World(plan, 1, Weather(DELAY, DELAY), action_time=times)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(0.2)
    before = world.protocol_messages
    begin = world.now
    world.run(begin + seconds)
    messages = world.protocol_messages - before
    delays = _delays(world, begin)
    firings = sum(1 for time, _ in world.published if time > begin)
    return {
        "robots": robots,
        "mode": "partial" if partial else "full",
        "load": "saturated" if saturated else "light",
        "delays_median": round(statistics.median(delays), 1) if delays else None,
        "delays_mean": round(statistics.mean(delays), 1) if delays else None,
        "messages_per_fact": round(messages / len(delays), 1) if delays else None,
        "messages_per_firing": round(messages / firings, 1) if firings else None,
        "firings": firings,
    }


def _delays(world: World, begin: float) -> List[float]:
    """For each coordinated fact: one-way delays until its robot has it in the log."""
    found = []
    for node in world.nodes.values():
        assert node.disk is not None
        invoked: Dict[Any, float] = {}
        for record in node.disk.records():
            if record["kind"] == "invoked" and record["mono"] > begin:
                invoked[tuple(record["origin"])] = record["mono"]
            elif record["kind"] == "slot":
                for origin in record["origins"]:
                    time = invoked.pop(tuple(origin), None)
                    if time is not None:
                        found.append((record["mono"] - time) / DELAY)
    return found


def main(arguments: Optional[List[str]] = None) -> int:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 2, 3, 5, 8], metavar="N")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")
    args = parser.parse_args(arguments)
    world_module.PACE = world_module.PACE._replace(retry=20 * DELAY, takeover=60 * DELAY, backoff=4 * DELAY)
    if not args.json:
        titles = ("mode", "robots", "load", "delays, median", "delays, mean", "messages a fact", "messages a firing")
        print("%-8s %-6s %-10s %14s %14s %16s %18s" % titles)
    for partial in (False, True):
        for robots in args.robots:
            for saturated in (False, True):
                if robots == 1 and saturated:
                    continue
                row = measure(robots, partial, saturated)
                if args.json:
                    print(json.dumps(row), flush=True)
                else:
                    print("%(mode)-8s %(robots)-6d %(load)-10s %(delays_median)14s %(delays_mean)14s "
                          "%(messages_per_fact)16s %(messages_per_firing)18s" % row, flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
