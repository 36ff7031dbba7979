"""What agreement costs, counted in one-way delays and messages, in a simulated network where every
message takes the same time and nothing is lost.

``python3 -m benchmarks.agreement_cost`` uses waits that suit the delay;
``--delay 0.05`` uses those of real nodes in a network with that delay, and actions of a twentieth
of a second.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from typing import Any, Dict, List, Optional, Tuple

from agreement import world as world_module
from agreement.plans import make_plan
from agreement.world import Weather, World
from gspn_framework_package.execution.agreement.replica import Pace

DELAY = 0.005
"""Default time (s) that a message takes."""

LOADS = {"light": (40.0, 120.0), "saturated": (0.1, 0.2)}
"""Load -> shortest and longest duration of an action, in delays; with the first, usually one
proposal at a time is in progress."""

BUSY = (0.03, 0.07)
"""Duration (s) of an action if the delay is given by ``--delay``."""

TOKENS = 2
"""The net of thesis Figure 6.1."""


def measure(
    robots: int,
    partial: bool,
    load: str,
    action: Tuple[float, float],
    delay: float = DELAY,
    seconds: float = 6.0,
) -> Dict[str, Any]:
    """Delays and messages per proposal.

    :param load: name of the load in the results.
    :param action: shortest and longest duration (s) of an action.
    :param delay: time (s) that a message takes.
    :param seconds: simulated time (s).
    """
    plan = make_plan(TOKENS, robots, partial, 0.0, 0.0, False)
    world = World(plan, 1, Weather(delay, delay), action_time=action)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(40 * delay)
    before = world.protocol_messages
    begin = world.now
    world.run(begin + seconds)
    messages = world.protocol_messages - before
    delays = _delays(world, begin, delay)
    firings = sum(1 for time, _ in world.published if time > begin)
    return {
        "robots": robots,
        "mode": "partial" if partial else "full",
        "load": load,
        "delay_ms": round(delay * 1000, 1),
        "delays_median": round(statistics.median(delays), 1) if delays else None,
        "delays_mean": round(statistics.mean(delays), 1) if delays else None,
        "messages_per_fact": round(messages / len(delays), 1) if delays else None,
        "messages_per_firing": round(messages / firings, 1) if firings else None,
        "firings": firings,
    }


def _delays(world: World, begin: float, delay: float) -> List[float]:
    """For each coordinated proposal, the number of one-way delays until it is in its robot's
    log."""
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
                        found.append((record["mono"] - time) / delay)
    return found


def main(arguments: Optional[List[str]] = None) -> int:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 2, 3, 5, 8], metavar="N")
    parser.add_argument("--delay", type=float, metavar="S", help="seconds that a message takes")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")
    args = parser.parse_args(arguments)
    delay = args.delay or DELAY
    if args.delay:
        loads = {"busy": BUSY}
        world_module.PACE = Pace()
    else:
        loads = {load: (least * DELAY, most * DELAY) for load, (least, most) in LOADS.items()}
        world_module.PACE = world_module.PACE._replace(
            retry=20 * DELAY, takeover=60 * DELAY, backoff=4 * DELAY
        )
    if not args.json:
        titles = (
            "mode",
            "robots",
            "load",
            "delays, median",
            "delays, mean",
            "messages a proposal",
            "messages a firing",
        )
        print("%-8s %-6s %-10s %14s %14s %16s %18s" % titles)
    for partial in (False, True):
        for robots in args.robots:
            for load, action in loads.items():
                if robots == 1 and load == "saturated":
                    continue
                row = measure(robots, partial, load, action, delay, max(6.0, 600 * delay))
                if args.json:
                    print(json.dumps(row), flush=True)
                else:
                    print(
                        "%(mode)-8s %(robots)-6d %(load)-10s %(delays_median)14s %(delays_mean)14s "
                        "%(messages_per_fact)16s %(messages_per_firing)18s" % row,
                        flush=True,
                    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
