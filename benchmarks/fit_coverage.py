"""Coverage of the intervals that ``gspn fit`` gives: simulate, log, fit, compare with the truth.

A plan with known durations, outcomes, failures and a known environment runs in virtual time and
writes real event logs. Each log is read back and fitted; the share of 95 % intervals that contain
the truth should be between 92 and 98 % in 200 runs.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

from benchmarks.machine import machine_line, table
from gspn_framework_package.analysis.fitting import FitReport, fit_plan
from gspn_framework_package.execution.logged_attempts import gather
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Plan, RobotSpec

Interval = Tuple[float, float]


class Covered(NamedTuple):
    """A value, how many ``runs`` gave an interval for it, and how many of these ``hit`` the truth;
    ``below`` and ``above``: the truth was on that side of the interval."""

    value: str
    truth: float
    runs: int
    hit: int
    below: int
    above: int

    @property
    def share(self) -> float:
        """The share of intervals that contain the truth."""
        return self.hit / self.runs if self.runs else 0.0


def truth() -> Plan:
    """Three robots in a ring of five places, each with another kind of duration; a timeout cuts off
    some actions, and the environment makes parts."""
    net = NetBuilder("coverage").place("drive", tokens=3).place("look").place("think")
    net.place("grip").place("wait").place("parts")
    net.exponential("arrived", inputs="drive", outputs="look")
    net.exponential("found", inputs="look", outputs="think")
    net.exponential("nothing", inputs="look", outputs="drive")
    net.exponential("decided", inputs="think", outputs="grip")
    net.exponential("gripped", inputs="grip", outputs="wait")
    net.exponential("again", inputs="wait", outputs="drive")
    net.exponential("made", rate=0.5, outputs="parts", inhibitors={"parts": 3})
    net.immediate("used", inputs={"parts": 3})
    places = ("drive", "look", "think", "grip", "wait")
    return Plan(
        net=net.build(),
        name="coverage",
        actions={place: FunctionAction("actions.act", place) for place in places},
        resource_places=frozenset(["parts"]),
        robots=tuple(RobotSpec("robot_%d" % k, "drive") for k in (1, 2, 3)),
        durations={
            "drive": Duration.gamma(30.0, 2.0),
            "look": Duration.exponential(1.5),
            "think": Duration.lognormal(0.6, 1.0),
            "grip": Duration.gamma(2.5, 1.0),
            "wait": Duration.exponential(1.0),
        },
        outcomes={"look": {"found": 0.6, "nothing": 0.4}},
        failures={"grip": 0.15},
        timeouts={"wait": 1.2},
        on_failure={"*": FailureRule.retry(1_000, 0.1)},
        simulate_environment=True,
    ).validate()


def one_run(plan: Plan, seed: int, seconds: float, folder: str) -> FitReport:
    """Simulate the plan, write the log, read it back and fit it."""
    path = os.path.join(folder, "%d.jsonl" % seed)
    run = VirtualRun(plan, seed=seed)
    log = run.record_in(path, "coverage", "log%d" % seed)
    run.run(seconds)
    log.close()
    found = gather([path])
    os.unlink(path)
    # the fit does not know the truth; the tests of fit change nothing with so little data
    blank = replace(plan, durations={}, outcomes={}, failures={"grip": 0.5})
    return fit_plan(blank, found.attempts, found.events, samples=0)


def intervals(report: FitReport) -> Dict[str, Interval]:
    """What was learned, by name, with its interval."""
    found: Dict[str, Interval] = {}
    for place, fit in report.places.items():
        if fit.fit is not None:
            found["mean of " + place] = fit.fit.interval
        for name, outcome in fit.outcomes.items():
            found["outcome " + name] = outcome.interval
        if fit.failure is not None:
            found["failure of " + place] = fit.failure.interval
    for name, event in report.rates.items():
        found["rate of " + name] = event.interval
    return found


def true_values(plan: Plan) -> Dict[str, float]:
    """The truth, by the same names."""
    values = {"mean of " + p: duration.mean for p, duration in plan.durations.items()}
    for chances in plan.outcomes.values():
        values.update({"outcome " + name: chance for name, chance in chances.items()})
    values.update({"failure of " + p: chance for p, chance in plan.failures.items()})
    values["rate of made"] = plan.net.transition("made").number
    return values


def measure(runs: int, seconds: float, seed: int, show: bool = False) -> List[Covered]:
    """Count over ``runs`` virtual runs of ``seconds`` each.

    :param show: whether to report progress on standard error.
    """
    plan = truth()
    values = true_values(plan)
    counts: Dict[str, Counter[str]] = {name: Counter() for name in values}
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for number in range(runs):
            for name, (low, high) in intervals(
                one_run(plan, seed + number, seconds, folder)
            ).items():
                value = values[name]
                where = "below" if value < low else "above" if value > high else "hit"
                counts[name][where] += 1
            if show and (number + 1) % 10 == 0:
                print(
                    "%d of %d runs, %.0f s" % (number + 1, runs, time.monotonic() - begin),
                    file=sys.stderr,
                    flush=True,
                )
    return [
        Covered(name, values[name], sum(c.values()), c["hit"], c["below"], c["above"])
        for name, c in counts.items()
    ]


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure the coverage and print it; exit code 1 if a value is outside of 92 to 98 %."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=200, help="virtual runs (default 200)")
    parser.add_argument(
        "--seconds", type=float, default=120.0, help="length of each, in virtual seconds"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the first run")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    found = measure(args.runs, args.seconds, args.seed, show=True)
    if args.json:
        print(json.dumps([dict(row._asdict(), share=row.share) for row in found], indent=2))
    else:
        print(machine_line())
        print("%d runs of %g s, from seed %d\n" % (args.runs, args.seconds, args.seed))
        head = ("value", "truth", "runs", "covered", "truth below", "truth above")
        rows = [
            (r.value, r.truth, r.runs, "%.1f %%" % (100 * r.share), r.below, r.above) for r in found
        ]
        print(table(head, rows))
    return 0 if all(0.92 <= row.share <= 0.98 for row in found) else 1


if __name__ == "__main__":
    sys.exit(main())
