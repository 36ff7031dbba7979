"""How the cost of a decision grows with the team: messages and bytes in a simulated network.

``python3 -m benchmarks.agreement_size``

A decision is a slot of the log. *Single*: actions so long that a slot usually holds one firing, so
its cost is that of a decision for a team of that size. *Busy*: every robot acts for 50 to 100 ms;
slots hold what came together, so the columns are for a firing. Greetings are counted apart, by the
second.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from agreement.plans import make_plan
from agreement.world import Weather, World
from benchmarks.machine import machine_line, table
from gspn_framework_package.execution.agreement.replica import Pace

ROBOTS = (5, 10, 20, 50, 100, 200)
DELAY = 0.002
"""Seconds that a message takes."""

TOKENS = 2
"""The net of thesis Figure 6.1."""

SINGLE = 0.06
"""Mean seconds between two firings of the team with single decisions."""

BUSY = (0.05, 0.1)
"""Seconds of an action of a busy robot."""

STARTS_WITHIN = 60.0


class _Counts(NamedTuple):
    """What was sent so far: messages of the protocol but for greetings, and greetings."""

    messages: int
    bytes: int
    greetings: int
    slots: int
    firings: int


class CountingWorld(World):
    """A simulated team whose messages are counted as they would go out to each robot."""

    bytes = 0
    greetings = 0

    def _carry(self, sender: str, to: str, text: str, request: str) -> None:
        if '"kind":"hello"' in text[:60]:  # as compact() writes it
            self.greetings += 1
        else:
            self.bytes += len(text)
        super()._carry(sender, to, text, request)

    def counts(self) -> _Counts:
        """What was sent so far."""
        firings = len(self.published)
        return _Counts(self.protocol_messages, self.bytes, self.greetings, self.length(), firings)


def measure(robots: int, partial: bool, busy: bool, decisions: int = 60) -> Dict[str, Any]:
    """The cost of ``decisions`` slots, or so many firings of a busy team, once all have fired.

    :returns: the row of the table; ``start_s``: simulated seconds until all robots have fired.
    """
    mean = SINGLE * robots
    world = CountingWorld(
        make_plan(TOKENS, robots, partial, 0.0, 0.0, False),
        1,
        Weather(DELAY, DELAY),
        action_time=BUSY if busy else (0.5 * mean, 1.5 * mean),
    )
    world.pace = Pace()
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(STARTS_WITHIN, lambda: len(world.published) >= robots)
    started, before = world.now, world.counts()

    def is_enough() -> bool:
        if busy:
            return len(world.published) >= before.firings + max(decisions, 3 * robots)
        return world.length() >= before.slots + decisions

    world.run(world.now + STARTS_WITHIN, is_enough)
    after, seconds = world.counts(), world.now - started
    parts = after.firings - before.firings if busy else after.slots - before.slots
    firings = after.firings - before.firings
    return {
        "load": "busy" if busy else "single",
        "mode": "partial" if partial else "full",
        "robots": robots,
        "start_s": round(started, 2),
        "firings_per_slot": round(firings / max(1, after.slots - before.slots), 2),
        "messages": round((after.messages - before.messages) / max(1, parts), 1),
        "bytes": round((after.bytes - before.bytes) / max(1, parts)),
        "greetings_per_s": round((after.greetings - before.greetings) / seconds),
    }


def linear_fit(sizes: Sequence[int], values: Sequence[float]) -> Tuple[float, float, float]:
    """The line through the values: its slope, its value at 0, and the largest residual as a part of
    the value that it is off."""
    slope, at_zero = np.polyfit(np.asarray(sizes, float), np.asarray(values, float), 1)
    residuals = [
        abs(slope * size + at_zero - value) / value for size, value in zip(sizes, values) if value
    ]
    return float(slope), float(at_zero), max(residuals, default=0.0)


def fits(rows: List[Dict[str, Any]]) -> List[Dict[str, Any]]:
    """The linear fits of what grows, for each load and mode."""
    found = []
    for load, mode in sorted({(row["load"], row["mode"]) for row in rows}):
        mine = [row for row in rows if (row["load"], row["mode"]) == (load, mode)]
        for what in ("messages", "bytes"):
            slope, at_zero, residual = linear_fit(
                [row["robots"] for row in mine], [row[what] for row in mine]
            )
            found.append(
                {
                    "load": load,
                    "mode": mode,
                    "of": what,
                    "per_robot": round(slope, 2),
                    "at_zero": round(at_zero, 1),
                    "largest_residual": round(residual, 3),
                }
            )
    return found


COLUMNS = (
    "load", "mode", "robots", "start_s", "firings_per_slot", "messages", "bytes", "greetings_per_s",
)  # fmt: skip
FIT_COLUMNS = ("load", "mode", "of", "per_robot", "at_zero", "largest_residual")


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, and print tables or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--robots", type=int, nargs="+", default=list(ROBOTS), metavar="N")
    parser.add_argument("--load", choices=["single", "busy"], nargs="+", default=["single", "busy"])
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    rows = []
    for load in args.load:
        for partial in (False, True):
            for robots in args.robots:
                rows.append(measure(robots, partial, load == "busy"))
                print("agreement_size: %s" % rows[-1], file=sys.stderr, flush=True)
    fitted = fits(rows) if len(args.robots) > 2 else []
    if args.json:
        print(json.dumps({"rows": rows, "fits": fitted}))
        return 0
    for columns, found in ((COLUMNS, rows), (FIT_COLUMNS, fitted)):
        heads = [name.replace("_", " ") for name in columns]
        print(table(heads, [[row[column] for column in columns] for row in found]) + "\n")
    print(machine_line())
    return 0


if __name__ == "__main__":
    sys.exit(main())
