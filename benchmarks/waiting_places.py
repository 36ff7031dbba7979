"""Robots that wait where the next order is likely: ``python3 -m benchmarks.waiting_places``.

Two robots fetch orders from both ends of a warehouse and bring them to the counter in the middle,
where idle robots wait. In the morning most orders are for the north end, in the evening for the
south end. The net counts the hours, so that each has its own rates of orders, which ``gspn fit``
learns from recorded days; ``gspn optimise`` may send idle robots to either end. All policies then
go through other days in virtual time, of which none of them knows anything. One of them is the best
for the same days with one rate for the whole day: what the ends alone are worth.

An hour of the net takes an exponential time: no policy knows when the next one begins. Orders wait
until they are picked up.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from dataclasses import replace
from typing import Dict, List, NamedTuple

import numpy as np

from benchmarks.machine import machine_line, table
from benchmarks.replayed import record
from gspn_framework_package.analysis.decisions.aims import Objective, Request
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.analysis.fitting import fit_plan
from gspn_framework_package.analysis.monitoring.differences import Ratio, difference
from gspn_framework_package.cli import numbers
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy

NORTH = (2, 2, 20, 20, 3, 3, 3, 2)
"""Orders for the north end, per hour, in each hour of the day."""

SOUTH = (2, 3, 3, 3, 20, 20, 2, 2)
"""Orders for the south end."""

HOUR = 3_600.0
DAY = len(NORTH) * HOUR
ROOM = 3
"""Orders that an end has room for; more are turned away."""

SECONDS = {
    "Fetch_%s": 40.0,  # from the counter to the end
    "To_%s": 40.0,  # the same, to wait there
    "Near_%s": 8.0,  # at the end already
    "Across_%s": 75.0,  # from the other end
    "Bring_%s": 40.0,  # to the counter
}
"""Action place of an end -> how long its action takes on average (s)."""

WAITING = ("%s", "Fetch_%s", "Near_%s", "Across_%s")
"""Where a token is an order that has not been picked up."""

ENDS = ("north", "south")


def warehouse() -> Plan:
    """The plan as it is shipped: idle robots wait at the counter."""
    net = NetBuilder("waiting_places").place("Counter", tokens=2)
    for hour in range(len(NORTH)):
        net.place("hour_%d" % hour, tokens=int(hour == 0))
    for hour in range(len(NORTH)):
        following = "hour_%d" % ((hour + 1) % len(NORTH))
        net.exponential("after_%d" % hour, 1 / HOUR, inputs="hour_%d" % hour, outputs=following)
    for end in ENDS:
        net.place(end).place("Wait_" + end)
        for name in SECONDS:
            net.place(name % end)
    for end, other, rates in zip(ENDS, reversed(ENDS), (NORTH, SOUTH)):
        for hour, rate in enumerate(rates):
            now = "hour_%d" % hour
            net.exponential(
                "%s_%d" % (end, hour),
                rate / HOUR,
                inputs=now,
                outputs=[now, end],
                inhibitors={end: ROOM},
            )
        net.immediate("fetch_" + end, inputs=["Counter", end], outputs="Fetch_" + end)
        net.immediate("wait_" + end, inputs="Counter", outputs="To_" + end)
        net.immediate("near_" + end, inputs=["Wait_" + end, end], outputs="Near_" + end)
        net.immediate("across_" + end, inputs=["Wait_" + other, end], outputs="Across_" + end)
        net.exponential("there_" + end, inputs="To_" + end, outputs="Wait_" + end)
        for name in ("Fetch_", "Near_", "Across_"):
            net.exponential("picked_%s%s" % (name, end), inputs=name + end, outputs="Bring_" + end)
        net.exponential("brought_" + end, inputs="Bring_" + end, outputs="Counter")
    acts = {name % end: seconds for name, seconds in SECONDS.items() for end in ENDS}
    shipped = [
        ((">= 1", "-"), {"fetch_north": 1}),
        ((0, ">= 1"), {"fetch_south": 1}),
        ((0, 0), {}),
    ]
    return Plan(
        net=net.build(),
        name="waiting_places",
        actions={
            "Counter": None,
            **{"Wait_" + end: None for end in ENDS},
            **{place: FunctionAction("actions.act", place) for place in acts},
        },
        resource_places=frozenset([*ENDS, *("hour_%d" % hour for hour in range(len(NORTH)))]),
        robots=tuple(RobotSpec("robot_%d" % k, "Counter") for k in (1, 2)),
        durations={place: Duration.gamma(10.0, seconds) for place, seconds in acts.items()},
        policy=Policy.from_table(ENDS, shipped),
        simulate_environment=True,
    ).validate()


class Day(NamedTuple):
    """A day: how long all orders waited together (s), and how many were picked up."""

    waited: float
    picked: int


def day(plan: Plan, seed: int) -> Day:
    """A day in virtual time."""
    found = VirtualRun(plan, seed=seed, agents=True).run(time=DAY)
    tokens = sum(found.mean_tokens[name % end] for name in WAITING for end in ENDS)
    picked = sum(n for name, n in found.firings.items() if name.startswith("picked_"))
    return Day(tokens * found.seconds, picked)


def learned(plan: Plan, days: int, folder: str) -> Plan:
    """The plan with the rates of ``days`` recorded days, which nobody knew."""
    orders = [t.name for t in plan.net.transitions if t.name.startswith(ENDS)]
    blank = replace(plan, net=plan.net.with_rates(dict.fromkeys(orders, 5 / HOUR)))
    logs = [record(plan, n, DAY, os.path.join(folder, "%d.jsonl" % n)) for n in range(days)]
    found = gather(logs)
    return fit_plan(blank, found.attempts, found.events, samples=0).apply(blank, logs)


def steady(plan: Plan) -> Plan:
    """The plan with one rate for the whole day, at each end."""
    rates: Dict[str, float] = {}
    for end in ENDS:
        hours = [t for t in plan.net.transitions if t.name.startswith(end)]
        mean = sum(t.number for t in hours) / len(hours)
        rates.update({t.name: mean for t in hours})
    return plan.with_rates(rates)


def best(plan: Plan) -> Policy:
    """The policy with which orders wait least; idle robots may wait anywhere."""
    costs = {name % end: -1.0 for name in WAITING for end in ENDS}
    may_wait = frozenset({"Counter", *("Wait_" + end for end in ENDS)})
    request = Request(Objective.long_run(costs), may_wait=may_wait, team_sizes=(2,))
    found = optimise(plan, request, simulated=0).plan
    assert found is not None
    return found.policy


def waits(plan: Plan, policy: Policy, days: int) -> Ratio:
    """How long an order waits on average, with a policy, on days from 1,000 on."""
    one = replace(plan, policy=policy).validate()
    found = np.array([day(one, seed) for seed in range(1_000, 1_000 + days)])
    return Ratio(found[:, 0], found[:, 1])


def main() -> int:
    """Learn, improve, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--learn", type=numbers.whole(1, 1_000), default=10, help="recorded days")
    parser.add_argument("--days", type=numbers.whole(2, 10_000), default=20, help="other days")
    args = parser.parse_args()
    plan = warehouse()
    with tempfile.TemporaryDirectory() as folder:
        fitted = learned(plan, args.learn, folder)
    shipped = waits(plan, plan.policy, args.days)
    rows: List[List[object]] = [["shipped", "%.1f" % (shipped.value or 0.0)]]
    for name, policy in (("one rate", best(steady(fitted))), ("hours", best(fitted))):
        found = difference(name, "s", shipped, waits(plan, policy, args.days))
        assert found.old and found.new and found.low is not None and found.high is not None
        change = [100 * by / found.old for by in (found.new - found.old, found.low, found.high)]
        rows.append([name, "%.1f" % found.new, "%.1f %% (%.1f to %.1f)" % tuple(change)])
    print(machine_line())
    print()
    print(table(["policy", "an order waits s", "change (95 %)"], [[*r, "-"][:3] for r in rows]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
