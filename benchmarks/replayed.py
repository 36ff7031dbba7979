"""What can be expected of learning from logs: ``python3 -m benchmarks.replayed PART``.

``speed``: 1,000 recorded robot-hours on another plan (``gspn compare --replay``), in seconds.
``gain``: ten pairs of plans; the gain that a replay of runs of the old one promises, beside the
gain of other runs, of which it knows nothing.
``coverage``: pairs of runs; one is learned from, and the intervals that ``gspn compare`` predicts
from it are held against the other.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
import time
from dataclasses import replace
from typing import Any, Dict, Iterator, List, NamedTuple, Tuple

from benchmarks.fit_coverage import truth
from benchmarks.history import patrol
from benchmarks.machine import machine_line, table
from gspn_framework_package.analysis.executors import (
    LocalExecutor,
    WorkItem,
    Workload,
    open_executor,
)
from gspn_framework_package.analysis.fitting import fit_plan
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.compare import compare_logs
from gspn_framework_package.cli.on_history import on_history
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy

ROBOTS, LOGS, HOURS = 10, 10, 10.0
"""Robots of a run, runs, and hours of each, of ``speed``: 1,000 robot-hours."""

PAIRS = 10
"""Pairs of plans of ``gain``."""

WRONG = 3.0
"""The mean that the plans of ``gain`` give every duration (s); the truth is 5 to 30 s."""


def record(plan: Plan, seed: int, seconds: float, path: str) -> str:
    """Record a run in virtual time."""
    run = VirtualRun(plan, seed=seed, agents=True)
    log = run.record_in(path, "run %d" % seed, "log %d" % seed)
    run.run(time=seconds)
    log.close()
    return path


def _quiet(what: str, count: int, seconds: float) -> None:
    """Show no progress."""


# -- speed -----------------------------------------------------------------------------------------


class Speed(NamedTuple):
    """How long a replay took: robot-hours, megabytes of logs, firings of both plans, seconds."""

    robot_hours: float
    megabytes: float
    firings: int
    seconds: float


def speed(folder: str, logs: int = LOGS, hours: float = HOURS, on: str = "processes:2") -> Speed:
    """Play recorded runs of the patrol with times of real robots on another policy."""
    plan = patrol(ROBOTS)
    paths = [
        record(plan, n, hours * 3600, os.path.join(folder, "%d.jsonl" % n)) for n in range(logs)
    ]
    new = replace(plan, policy=Policy(), strict=False).validate()
    begin = time.monotonic()
    with open_executor(on) as executor:
        rewards = {"*Temperature_*": 1.0}
        found = on_history(new, paths, mapping={}, rewards=rewards, progress=_quiet, on=executor)
    seconds = time.monotonic() - begin
    megabytes = sum(os.path.getsize(path) for path in paths) / 1e6
    firings = sum(sum(one.firings[-1]) for one in (*found.old, *found.new))
    return Speed(found.robot_hours, megabytes, firings, seconds)


# -- gain ------------------------------------------------------------------------------------------


def roads(seed: int) -> Tuple[Plan, Plan, Dict[str, Duration]]:
    """Two plans that differ in how robots choose their way, and the true times of both.

    Robots choose one of three or four roads again and again. On the first is room for one robot.
    """
    rng = random.Random(seed)
    count, robots = rng.choice((3, 4)), rng.choice((2, 3, 4))
    names = ["Road_%d" % n for n in range(1, count + 1)]
    net = NetBuilder("roads").place("Choose", tokens=robots)
    for n, name in enumerate(names):
        net.place(name, capacity=1 if n == 0 else None)
        net.immediate("into_" + name, inputs="Choose", outputs=name)
        net.exponential("along_" + name, inputs=name, outputs="Choose")
    act = FunctionAction("actions.act", "drive")

    def plan(name: str) -> Plan:
        weights = {"into_" + road: rng.uniform(0.05, 1.0) for road in names}
        total = sum(weights.values())
        table = {t: weight / total for t, weight in weights.items()}
        return Plan(
            net=net.build(),
            name=name,
            actions={"Choose": None, **dict.fromkeys(names, act)},
            robots=tuple(RobotSpec("robot_%d" % k, "Choose") for k in range(robots)),
            durations={road: Duration.exponential(WRONG) for road in names},
            on_failure={"*": FailureRule.retry(1_000, 1.0)},
            policy=Policy.from_table((), [((), table)]),
        ).validate()

    means = {road: rng.uniform(5.0, 30.0) for road in names}
    times = {road: Duration.gamma(rng.uniform(2.0, 20.0), mean) for road, mean in means.items()}
    return plan("old"), plan("new"), times


def really(plan: Plan, times: Dict[str, Duration]) -> Plan:
    """The plan with the true times; one attempt in ten on the second road fails."""
    return replace(plan, durations=times, failures={"Road_2": 0.1}).validate()


class Gain(NamedTuple):
    """What a pair gave, per second: in the runs that were learned from (old plan), as promised for
    the new plan with its interval, and in other runs of both."""

    pair: int
    old: float
    promised: float
    interval: Tuple[float, float]
    held_out_old: float
    held_out_new: float

    @property
    def promised_gain(self) -> float:
        """The promised gain, as a share."""
        return self.promised / self.old - 1

    @property
    def held_out_gain(self) -> float:
        """The gain of the other runs."""
        return self.held_out_new / self.held_out_old - 1


def gains(folder: str, pairs: int = PAIRS, hours: float = 8.0) -> Iterator[Gain]:
    """What replays promise, and what other runs show.

    :param hours: how long the runs are that are learned from; the others are four times as long.
    """
    for pair in range(1, pairs + 1):
        old, new, times = roads(pair)
        # the log has the plan with the wrong times: only its attempts tell the truth
        path = os.path.join(folder, "pair_%d.jsonl" % pair)
        run = VirtualRun(really(old, times), seed=pair, agents=True)
        first = header(old, "pair", "", "log %d" % pair, agents=True, virtual=True)
        log = EventLogWriter(path, first, clocks=run.clocks)
        run.record_to(log)
        run.run(time=hours * 3600)
        log.close()
        rewards = {"along_*": 1.0}
        found = on_history(
            new, [path], mapping={}, rewards=rewards, progress=_quiet, on=LocalExecutor()
        )
        aim = found.aim
        assert (
            aim is not None and aim.old and aim.new and aim.low is not None and aim.high is not None
        )
        shown = []
        for seed, plan in enumerate((old, new), 1_000 + 2 * pair):
            other = VirtualRun(really(plan, times), seed=seed, agents=True)
            fired = other.run(time=4 * hours * 3600).firings
            ended = sum(fired[t.name] for t in plan.net.transitions if t.timed)
            shown.append(ended / (4 * hours * 3600))
        yield Gain(pair, aim.old, aim.new, (aim.low, aim.high), *shown)


# -- coverage --------------------------------------------------------------------------------------


def _one_pair(_: Any, piece: Tuple[int, float], __: Watch) -> Dict[str, bool]:
    """Whether what a second run shows is inside what the first one predicts."""
    seed, seconds = piece
    plan = truth()
    blank = replace(plan, durations={}, outcomes={}, failures={"grip": 0.5})
    with tempfile.TemporaryDirectory() as folder:
        first = record(plan, seed, seconds, os.path.join(folder, "first.jsonl"))
        found = gather([first])
        report = fit_plan(blank, found.attempts, found.events, samples=0)
        fitted = report.apply(blank, ["first.jsonl"])
        second = record(plan, seed + 1_000_000, seconds, os.path.join(folder, "second.jsonl"))
        told = compare_logs(fitted, [second], replications=400, seed=seed, progress=_quiet)
    return {m.name: bool(m.inside) for m in told.comparison.measures}


def coverage(pairs: int, seconds: float, on: str) -> Dict[str, int]:
    """How many of ``pairs`` second runs lie inside the interval of each measure."""
    workload = Workload(_nothing, _one_pair, None)
    items = [WorkItem(workload, (seed, seconds)) for seed in range(1, pairs + 1)]
    inside: Dict[str, int] = {}
    with open_executor(on) as executor:
        for found in executor.ordered(items, "pairs", Watch(_quiet)):
            for name, is_inside in found.items():
                inside[name] = inside.get(name, 0) + is_inside
    return inside


def _nothing(_: Any) -> None:
    return None


def main() -> int:
    """Run a part, and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=("speed", "gain", "coverage"))
    parser.add_argument("--pairs", type=numbers.whole(1, 100_000), help="pairs of plans or runs")
    parser.add_argument("--seconds", type=numbers.seconds, default=300.0, help="of ``coverage``")
    parser.add_argument("--on", default="processes:2", help="where to compute")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    args = parser.parse_args()
    head: List[str]
    rows: List[List[Any]]
    with tempfile.TemporaryDirectory() as folder:
        if args.part == "speed":
            head = ["robot-hours", "MB of logs", "firings played", "s"]
            rows = [list(speed(folder, on=args.on))]
        elif args.part == "gain":
            head = ["pair", "promised gain", "gain of other runs", "difference"]
            rows = []
            for gain in gains(folder, args.pairs or PAIRS):
                off = gain.promised / gain.old * gain.held_out_old / gain.held_out_new - 1
                shares = gain.promised_gain, gain.held_out_gain, off
                rows.append([gain.pair, *("%+.2f %%" % (100 * share) for share in shares)])
        else:
            pairs = args.pairs or 200
            head = ["measure", "inside", "of", "share"]
            found = coverage(pairs, args.seconds, args.on)
            rows = [[n, k, pairs, "%.1f %%" % (100 * k / pairs)] for n, k in found.items()]
            every = sum(found.values()) / (pairs * len(found))
            rows.append(["all", sum(found.values()), pairs * len(found), "%.2f %%" % (100 * every)])
    if args.json:
        print(json.dumps([dict(zip(head, row)) for row in rows], indent=2))
    else:
        print(machine_line())
        print()
        print(table(head, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
