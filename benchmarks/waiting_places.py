"""Robots that wait where the next order is likely: ``python3 -m benchmarks.waiting_places``.

Two robots fetch orders from both ends of a warehouse and bring them to the counter in the middle,
where idle robots wait. In the morning most orders are for the north end, in the evening for the
south end. The plan does not model that. ``gspn fit`` finds in recorded days when orders come, and
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
from functools import partial
from typing import Any, Callable, List, NamedTuple, Tuple

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
from gspn_framework_package.model.errors import ExecutionError
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
    """A run through a day as it is, whatever rates the plan has."""

    def begin(self, warmup: float = 0.0) -> None:
        """Start the run, with all orders of the day to come."""
        super().begin(warmup)
        for when, order in orders(self.plan.seed):
            self._at(when, order)


def orders(seed: int, hour: float = HOUR) -> List[Tuple[float, Fire]]:
    """When which orders come on a day (s), in order.

    :param hour: how long its hours are (s).
    """
    draw, found = np.random.default_rng(seed), []
    for number in range(len(NORTH)):
        for end, rates in zip(ENDS, (NORTH, SOUTH)):
            count = draw.poisson(rates[number] * hour / HOUR)
            begins = number * hour
            found += [(begins + t, Fire("order_" + end)) for t in draw.uniform(0.0, hour, count)]
    return sorted(found)


def day(plan: Plan, seed: int, log: str = "") -> Day:
    """A day in virtual time, recorded in the file ``log``."""
    run = TrueDay(plan, seed=seed, environment=False)
    record = run.record_in(log, "day %d" % seed, "log %d" % seed) if log else None
    found = run.run(time=DAY)
    if record is not None:
        record.close()
    tokens = sum(found.mean_tokens[name] for name in _waiting())
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
    costs = dict.fromkeys(_waiting(), -1.0)
    may_wait = frozenset({"Counter", *("Wait_" + end for end in ENDS)})
    request = Request(Objective.long_run(costs), may_wait=may_wait, team_sizes=(2,))
    found = optimise(plan, request, simulated=0).plan
    assert found is not None
    return found.policy


ROOM_FILE = """\
name: two ends
walls:
  - [[-1.5, -10.0], [1.5, -10.0], [1.5, 10.0], [-1.5, 10.0], [-1.5, -10.0]]
boxes:
  - {at: [0.0, 9.7], size: [1.6, 0.4]}
  - {at: [0.0, -9.7], size: [1.6, 0.4]}
  - {at: [1.3, 0.0], size: [0.2, 1.2]}
spawn:
  - [-1.0, 0.5, 0.0]
  - [-1.0, -0.5, 0.0]
"""
"""The room: a hall of 20 m with the ends, and the counter in its middle."""

SLOTS = {
    "Bring": ((0.9, 0.4, 0.0), (0.9, -0.4, 0.0)),
    "To_north": ((1.0, 7.6, 1.57), (-1.0, 7.6, 1.57)),
    "To_south": ((1.0, -7.6, -1.57), (-1.0, -7.6, -1.57)),
    "north": ((0.5, 9.0, 1.57), (-0.5, 9.0, 1.57)),
    "south": ((0.5, -9.0, -1.57), (-0.5, -9.0, -1.57)),
}
"""Where robots stand, one in each: at the counter, where they wait, and at the ends."""


def _steps(robot: Any, room: Any, place: str) -> Any:
    """What robots do in the room: they drive to a free slot."""
    from gspn_framework_package.world import patrol
    from gspn_framework_package.world.room import Pose

    action, end = place.split("_")
    slots = SLOTS.get(place) or SLOTS.get(action) or SLOTS[end]
    poses = [Pose(*slot) for slot in slots]
    return patrol.park(robot, poses, patrol.preferred_slot(robot.name), room.robot.radius)


def day_in_room(plan: Plan, seed: int, minutes: float) -> Day:
    """A day of ``minutes``, in PyBullet: as many orders an hour as on a long one, but each hour of
    the clock is shorter.

    :raises ExecutionError: a robot did not arrive.
    """
    from benchmarks.room_run import RoomRun
    from gspn_framework_package.world.room_file import parse_room

    hour = minutes * 60.0 / len(NORTH)
    run = RoomRun(
        plan,
        parse_room(ROOM_FILE),
        seed,
        steps=_steps,
        comes=orders(seed, hour),
        day=HOUR / hour,
    )
    run.run(minutes * 60.0)
    run.close()
    if run.failures:
        raise ExecutionError("; ".join(run.failures[:3]))
    tokens = sum(run.token_seconds[plan.net.place_number(name)] for name in _waiting())
    return Day(tokens, sum(n for name, n in run.fired.items() if name.startswith("picked_")))


def _waiting() -> List[str]:
    return [name % end for name in WAITING for end in ENDS]


def waits(plan: Plan, policy: Policy, days: int, passed: Callable[[Plan, int], Day] = day) -> Ratio:
    """How long an order waits on average, with a policy, on days from 1,000 on."""
    one = replace(plan, policy=policy).validate()
    found = np.array([passed(one, seed) for seed in range(1_000, 1_000 + days)])
    return Ratio(found[:, 0], found[:, 1])


def main() -> int:
    """Learn, improve, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--learn", type=numbers.whole(1, 1_000), default=10, help="recorded days")
    parser.add_argument("--days", type=numbers.whole(2, 10_000), default=20, help="other days")
    parser.add_argument("--room", type=float, metavar="MINUTES", help="days in PyBullet, so long")
    args = parser.parse_args()
    plan, passed = warehouse(), day
    if args.room:
        passed = partial(day_in_room, minutes=args.room)
    with tempfile.TemporaryDirectory() as folder:
        fitted = learned(plan, args.learn, folder)
    shipped = waits(plan, plan.policy, args.days, passed)
    rows: List[List[object]] = [["shipped", "%.1f" % (shipped.value or 0.0)]]
    for name, one in (("one rate", fitted.steady), ("a clock", fitted.clock)):
        found = difference(name, "s", shipped, waits(one, best(one), args.days, passed))
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
