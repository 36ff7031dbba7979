"""Robots that wait where the next order is likely: ``python3 -m benchmarks.waiting_places``.

Two robots fetch orders from both ends of a warehouse and bring them to the counter in the middle,
where idle robots wait. In the morning most orders are for the north end, in the evening for the
south end. Of that the plan knows nothing. ``gspn fit`` finds in recorded days when orders come, and
gives the plan a clock; ``gspn optimise`` may send idle robots to either end. All policies then go
through other days in virtual time. One of them is the best for the same days with one rate for the
whole day: what the ends alone are worth.

A period of the plan takes an exponential time, so no policy knows when the next one begins; those
of the days take whole hours. Orders wait until they are picked up.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from dataclasses import replace
from typing import List, NamedTuple

import numpy as np

from benchmarks.machine import machine_line, table
from gspn_framework_package.analysis.decisions.aims import Objective, Request
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.analysis.fitting import fit_plan, with_day
from gspn_framework_package.analysis.monitoring.differences import Ratio, difference
from gspn_framework_package.cli import numbers
from gspn_framework_package.execution.log_entries import Fire
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
    for end in ENDS:
        net.place(end).place("Wait_" + end)
        for name in SECONDS:
            net.place(name % end)
    for end, other in zip(ENDS, reversed(ENDS)):
        net.exponential("order_" + end, 5 / HOUR, outputs=end, inhibitors={end: ROOM})
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
        resource_places=frozenset(ENDS),
        robots=tuple(RobotSpec("robot_%d" % k, "Counter") for k in (1, 2)),
        durations={place: Duration.gamma(10.0, seconds) for place, seconds in acts.items()},
        policy=Policy.from_table(ENDS, shipped),
        simulate_environment=True,
    ).validate()


class Day(NamedTuple):
    """A day: how long all orders waited together (s), and how many were picked up."""

    waited: float
    picked: int


class TrueDay(VirtualRun):
    """A run through a day as it is, whatever rates the plan has. If the plan has a clock, the hours
    set it: of the transitions of an order, or of the end of a period, one is enabled."""

    def begin(self, warmup: float = 0.0) -> None:
        """Start the run, with all orders of the day to come."""
        super().begin(warmup)
        draw = np.random.default_rng(self.plan.seed)
        for hour in range(len(NORTH)):
            self._fire(hour * HOUR, "after_", "_%d" % hour)
            for end, rates in zip(ENDS, (NORTH, SOUTH)):
                for when in draw.uniform(0.0, HOUR, draw.poisson(rates[hour])):
                    self._fire(hour * HOUR + when, "order_" + end)

    def _fire(self, when: float, begins: str, ends: str = "") -> None:
        for name in self.plan.net.transition_index:
            if name.startswith(begins) and name.endswith(ends):
                self._at(when, Fire(name))


def day(plan: Plan, seed: int, log: str = "") -> Day:
    """A day in virtual time, recorded in the file ``log``."""
    run = TrueDay(plan, seed=seed, environment=False)
    record = run.record_in(log, "day %d" % seed, "log %d" % seed) if log else None
    found = run.run(time=DAY)
    if record is not None:
        record.close()
    tokens = sum(found.mean_tokens[name % end] for name in WAITING for end in ENDS)
    picked = sum(n for name, n in found.firings.items() if name.startswith("picked_"))
    return Day(tokens * found.seconds, picked)


class Learned(NamedTuple):
    """The plan with one rate for each end, the plan with a clock, and when its periods begin."""

    steady: Plan
    clock: Plan
    periods: List[int]


def learned(plan: Plan, days: int, folder: str) -> Learned:
    """What ``days`` recorded days say."""
    logs = [os.path.join(folder, "%d.jsonl" % n) for n in range(days)]
    for number, log in enumerate(logs):
        day(plan, number, log)
    found = gather(logs)
    fit = fit_plan(plan, found.attempts, found.events, samples=0)
    steady = fit.apply(plan, logs)
    periods = [period.begins for period in fit.arrivals.day]
    return Learned(steady, with_day(steady, fit.arrivals, logs), periods)


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
    for name, one in (("one rate", fitted.steady), ("a clock", fitted.clock)):
        found = difference(name, "s", shipped, waits(one, best(one), args.days))
        assert found.old and found.new and found.low is not None and found.high is not None
        change = [100 * by / found.old for by in (found.new - found.old, found.low, found.high)]
        rows.append([name, "%.1f" % found.new, "%.1f %% (%.1f to %.1f)" % tuple(change)])
    print("periods begin at %s h" % ", ".join(map(str, fitted.periods)))
    print(machine_line())
    print()
    print(table(["policy", "an order waits s", "change (95 %)"], [[*r, "-"][:3] for r in rows]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
