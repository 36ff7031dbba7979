"""How soon the alarm notices a robot that becomes slower, and how often it is wrong: ``python3 -m
benchmarks.alarms``.

All runs are in virtual time, of ``plans/patrol`` with four robots, with exponential and with nearly
regular durations (gamma, shape 59, as measured in a run). In the first part, one robot needs 30 %
longer for everything from the middle of the run on. With exponential durations, the delay can be
compared with what theory says about the sums. In the second part, nothing changes for 24 hours, and
the alarms are counted, with the default threshold and with one that allows one false alarm per
hour.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.analysis.monitoring.cusum import RateChart
from gspn_framework_package.analysis.monitoring.monitor import ALARM_EVERY, Monitor
from gspn_framework_package.analysis.monitoring.playing import play_to_monitor
from gspn_framework_package.analysis.monitoring.streams import RATIOS
from gspn_framework_package.execution.attempts import AttemptFollower
from gspn_framework_package.execution.observation import RunObserver
from gspn_framework_package.execution.virtual_time import Slowness, VirtualRun
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.attempt import Attempt
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming

PATROL = Path(plans_folder(), "patrol")
SHAPE = 59.0
HOUR = 3600.0


class _Kept:
    """Takes the place of the log of a virtual run, and reads what is written to it at once."""

    def __init__(self, run: VirtualRun) -> None:
        self._run = run
        self._follower = AttemptFollower(run.plan, agents=True)
        self.observer = RunObserver(run.plan, run.plan)
        self.attempts: List[Attempt] = []

    def append(self, *records: Dict[str, Any], durable: bool = True) -> None:
        """Take in some records."""
        for record in records:
            wall, mono = self._run.clocks()
            self.attempts += self._follower.take({**record, "wall": wall, "mono": mono})
            if self._follower.step is not None:
                self.observer.take(self._follower.step, self._follower.now)


def regular(plan: Plan, shape: Optional[float]) -> Plan:
    """The plan with gamma durations of that shape (None: exponential) and the means of its net."""
    timing = PlanTiming(plan)
    durations = {}
    for p, place in timing.places.items():
        mean = place.duration.mean
        if mean > 0:
            durations[plan.net.places[p].name] = (
                Duration.exponential(mean) if shape is None else Duration.gamma(shape, mean)
            )
    return replace(plan, durations=durations)


def paces_of(plan: Plan, seconds: float = 2000.0) -> Dict[str, float]:
    """Place -> visits per second, from a run in virtual time."""
    result = VirtualRun(plan, seed=99).run(time=seconds)
    paces = dict.fromkeys(plan.action_places, 0.0)
    for t, outputs in enumerate(plan.net.outputs):
        fired = result.firings[plan.net.transitions[t].name]
        for p, weight in outputs:
            if plan.net.places[p].name in paces:
                paces[plan.net.places[p].name] += fired * weight / seconds
    return paces


def watched(
    plan: Plan,
    seconds: float,
    paces: Dict[str, float],
    alarm_every: Sequence[float],
    seed: int,
    slowness: Optional[Slowness] = None,
) -> List[Monitor]:
    """Run a plan in virtual time, watched by a monitor for each time between false alarms."""
    run = VirtualRun(plan, seed=seed, slowness=slowness)
    kept = _Kept(run)
    log: Any = kept
    run.record_to(log)
    run.run(time=seconds)
    monitors = [Monitor(plan, kept.observer.robots, paces, every) for every in alarm_every]
    for monitor in monitors:
        play_to_monitor(monitor, kept.attempts, kept.observer.choices)
    return monitors


def slower(plan: Plan, paces: Dict[str, float], seeds: int, longer: float) -> Dict[str, Any]:
    """The delays of the alarm in runs in which ``robot_2`` needs ``longer`` times its time."""
    middle = 600.0
    pace = sum(paces[name] for name in plan.durations) / len(plan.robots) / longer
    names = [robot.name for robot in plan.robots]
    stream = next(s for s in Monitor(plan, names, paces).streams if s.robot == "robot_2")
    by_theory = min(
        RateChart(ratio).run_length(s.threshold, 1 / longer) / pace
        for ratio, s in zip(RATIOS, stream.sums)
        if ratio < 1
    )
    delays, named, false = [], 0, 0
    for seed in range(1, seeds + 1):
        monitor = watched(
            plan,
            middle + 3 * by_theory,
            paces,
            [ALARM_EVERY],
            seed,
            lambda robot, place, now: longer if robot == "robot_2" and now > middle else 1.0,
        )[0]
        false += sum(alarm.at <= middle for alarm in monitor.alarms)
        after = [alarm for alarm in monitor.alarms if alarm.at > middle]
        if after:
            delays.append(after[0].at - middle)
            named += after[0].robot == "robot_2" and after[0].direction == "slower"
    return {
        "runs": seeds,
        "noticed": len(delays),
        "named": named,
        "alarms before the change": false,
        "mean delay (s)": float(np.mean(delays)) if delays else math.nan,
        "longest delay (s)": max(delays, default=math.nan),
        "exponential theory (s)": by_theory,
    }


def unchanged(plan: Plan, paces: Dict[str, float], seconds: float, seed: int) -> Dict[str, Any]:
    """The alarms of a long run in which nothing changes."""
    rare, hourly = watched(plan, seconds, paces, [ALARM_EVERY, HOUR], seed)
    return {
        "hours": seconds / HOUR,
        "streams": len(rare.streams),
        "alarms, one in 30 days stated": len(rare.alarms),
        "alarms, one per hour stated": len(hourly.alarms),
    }


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--runs", type=int, default=10, help="runs with a slower robot")
    parser.add_argument("--hours", type=float, default=24.0, help="hours without a change")
    parser.add_argument("--longer", type=float, default=1.3, help="factor of the slower robot")
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    args = parser.parse_args(arguments)
    plan = read_plan(str(PATROL))
    found: List[Dict[str, Any]] = []
    for name, shape in (("exponential", None), ("gamma, shape 59", SHAPE)):
        timed = regular(plan, shape)
        paces = paces_of(timed)
        found.append(
            {
                "durations": name,
                **slower(timed, paces, args.runs, args.longer),
                **unchanged(timed, paces, args.hours * HOUR, seed=7),
            }
        )
    if args.json:
        print(json.dumps({"machine": describe_machine(), "results": found}, indent=2))
        return 0
    print(machine_line())
    for row in found:
        print()
        print(table(["durations: %s" % row["durations"], ""], [[k, row[k]] for k in list(row)[1:]]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
