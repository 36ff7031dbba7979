"""``python3 -m benchmarks.broken_plans``: plans of sites that are broken on purpose, and whether
proofs and searches find it.

Each site is broken in three ways, for teams of each size: one robot fits in a node, so that robots
block each other; the rows of a policy for a marking that a run came to are missing; nothing leads
out of a node that it came to.
Each answer has firings that were played.
"""

from __future__ import annotations

import argparse
import random
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Iterator, Optional, Sequence, Tuple

from benchmarks.machine import machine_line, table
from benchmarks.sites import SITES, site_plan
from gspn_framework_package.analysis.proofs.ladder import decide_question
from gspn_framework_package.analysis.proofs.questions import (
    CAN_MOVE,
    NO_ROW,
    MarkingQuestion,
    problem_of,
)
from gspn_framework_package.analysis.proofs.witness import played_to
from gspn_framework_package.model.net import Arc, Place
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy

COLUMNS = ("site", "robots", "broken", "verdict", "decided by", "seconds", "CPU [s]", "firings")


def visited(plan: Plan, firings: int) -> Dict[str, int]:
    """A marking that a random run comes to, in which a task is done and a robot is in a node where
    none was at first."""
    problem = problem_of(plan, MarkingQuestion(CAN_MOVE))
    draw, marking = random.Random(4), problem.net.initial_marking
    starts = {robot.place for robot in plan.robots}
    while True:
        marking = problem.net.fire(marking, draw.choice(list(problem.fires(marking))))
        firings -= 1
        named = problem.net.named(marking, zeros=False)
        somewhere_else = any(p.startswith("At_") and p not in starts for p in named)
        if firings < 0 and somewhere_else and set(plan.policy.places) - set(named):
            return named


def broken_plans(site: str, robots: int) -> Iterator[Tuple[str, Plan, MarkingQuestion]]:
    """The plans of a site, each with how it is broken and the question that finds it."""
    with tempfile.TemporaryDirectory() as folder:
        sound = site_plan(site, robots, Path(folder) / "sound")
        narrow = site_plan(site, robots, Path(folder) / "narrow", node_capacity=1)
    yield "narrow nodes", narrow, MarkingQuestion(CAN_MOVE)
    somewhere = visited(sound, 60)
    policy = sound.policy
    counts = [somewhere.get(place, 0) for place in policy.places]
    rows = [
        row
        for row in policy.rows
        if any(cell not in (None, count) for cell, count in zip(row.counts, counts))
    ]
    yield (
        "missing rows",
        replace(sound, policy=Policy(policy.places, rows), strict=True),
        MarkingQuestion(NO_ROW),
    )
    starts = {robot.place for robot in sound.robots}
    at = next(p for p in somewhere if p.startswith("At_") and p not in starts)
    node = at.rsplit("_", 1)[0]
    key = "key_to_" + node
    net = sound.net.with_place(Place(key))
    for t, inputs in enumerate(sound.net.inputs):
        if any(sound.net.places[p].name.rsplit("_", 1)[0] == node for p, _ in inputs):
            name = sound.net.transitions[t].name
            for source, target in ((key, name), (name, key)):
                net = net.with_arc(Arc(source, target))
    trapped = replace(sound, net=net, resource_places=sound.resource_places | {key})
    yield "no way out of a node", trapped, MarkingQuestion(CAN_MOVE)


def main(words: Optional[Sequence[str]] = None) -> int:
    """Break plans, ask, and print a table; return 1 if something was not found."""
    parser = argparse.ArgumentParser(prog="python3 -m benchmarks.broken_plans")
    parser.add_argument("--sites", nargs="*", default=list(SITES), choices=list(SITES))
    parser.add_argument("--robots", nargs="*", type=int, default=[2, 5, 20])
    args = parser.parse_args(words)
    print(machine_line(), flush=True)
    rows = []
    for site in args.sites:
        for robots in args.robots:
            for how, plan, question in broken_plans(site, robots):
                begun, used = time.perf_counter(), time.process_time()
                answer = decide_question(plan, question, limit=20_000)
                row: Dict[str, Any] = {
                    "site": site,
                    "robots": robots,
                    "broken": how,
                    "verdict": answer.verdict,
                    "decided by": answer.decided_by,
                    "seconds": "%.2f" % (time.perf_counter() - begun),
                    "CPU [s]": "%.2f" % (time.process_time() - used),
                }
                if answer.sequence is not None:
                    played_to(problem_of(plan, question), answer.sequence)
                    row["firings"] = len(answer.sequence)
                rows.append(row)
                print(row, flush=True)
    print(table(list(COLUMNS), ([row.get(key, "") for key in COLUMNS] for row in rows)))
    return int(any("firings" not in row for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
