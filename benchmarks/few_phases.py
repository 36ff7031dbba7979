"""Fitted plans, exact and simulated: ``python3 -m benchmarks.few_phases``.

The patrol, the warehouse and generated plans are played in virtual time, and ``gspn fit`` learns
from that. ``gspn analyse`` answers for the fitted plan; ``gspn simulate`` follows the durations
that were learned. Counted are the mean tokens and throughputs whose interval contains the simulated
mean, or reaches into its 99 % interval. ``--log PLAN LOG`` fits a log of one's own besides.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
from typing import Iterator, List, Optional, Sequence, Tuple

from benchmarks.command import run_command
from benchmarks.harness.processes import run_verb
from benchmarks.machine import machine_line, table
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Plan, RobotSpec

KINDS = {
    "constant": lambda rng, mean: Duration.deterministic(mean),
    "tiny": lambda rng, mean: Duration.deterministic(1e-6),
    "gamma": lambda rng, mean: Duration.gamma(rng.uniform(2.0, 60.0), mean),
    "exponential": lambda rng, mean: Duration.exponential(mean),
    "heavy": lambda rng, mean: Duration.lognormal(rng.uniform(0.9, 1.4), mean),
    "uniform": lambda rng, mean: Duration.uniform(0.4 * mean, 1.6 * mean),
}


def generated(seed: int) -> Plan:
    """Three or four robots take one of three roads, of which one is narrow, load one after the
    other, and are repaired after an alarm; how long that takes is of random kinds."""
    rng = random.Random(seed)
    robots = rng.choice((3, 4))
    net = NetBuilder("generated_%d" % seed).place("Choose", tokens=robots).place("Dock", tokens=1)
    net.place("Queue").place("Load").place("Repair")
    for road in ("Road_1", "Road_2", "Road_3"):
        net.place(road, capacity=1 if road == "Road_1" else None)
        net.immediate("into_" + road, weight=rng.uniform(0.2, 1.0), inputs="Choose", outputs=road)
        net.exponential("along_" + road, inputs=road, outputs="Queue")
    net.immediate("dock", inputs=["Queue", "Dock"], outputs="Load")
    net.exponential("loaded", inputs="Load", outputs=["Choose", "Dock"])
    net.exponential("alarm", rate=rng.uniform(0.01, 0.05), inputs="Road_2", outputs="Repair")
    net.exponential("repaired", inputs="Repair", outputs="Choose")
    act = FunctionAction("actions.act", "act")
    timed = ("Choose", "Road_1", "Road_2", "Road_3", "Load", "Repair")
    durations = {
        place: KINDS[rng.choice(list(KINDS))](rng, rng.uniform(0.5, 8.0)) for place in timed
    }
    return Plan(
        net=net.build(),
        name="generated_%d" % seed,
        actions={**dict.fromkeys(timed, act), "Queue": None},
        resource_places=frozenset(["Dock"]),
        robots=tuple(RobotSpec("robot_%d" % k, "Choose") for k in range(robots)),
        durations=durations,
        failures={"Road_3": 0.1},
        events={"alarm": EventSource(function="actions.act")},
        on_failure={"*": FailureRule.retry(1_000)},
    ).validate()


def compared(plan: str, seconds: float = 5_000.0, runs: int = 200) -> List[object]:
    """A row of the table: a plan file, analysed and simulated."""
    done = run_verb("analyse", plan, "--json")
    exact = json.loads(done.output)
    took = [round(done.wall_seconds, 1), round(done.cpu_seconds, 1), round(done.peak_mb)]
    length = ["--time", str(seconds), "--warmup", str(seconds / 10)]
    asked = ["simulate", plan, *length, "--replications", str(runs), "--confidence", "0.99"]
    simulated = json.loads(run_verb(*asked, "--json").output)
    steady = exact["steady_state"]
    if steady is None:
        return [plan, "-", *took, "none", "", ""]
    spans = exact.get("intervals", {})
    widths, inside, overlapping = [], 0, 0
    for key in ("mean_tokens", "throughput"):
        for name, value in steady[key].items():
            low, high = spans.get("steady_state." + key, {}).get(name) or (value, value)
            mean, noise = (simulated[key][name][part] or 0.0 for part in ("mean", "half_width"))
            rounding = 1e-6 + 1e-6 * value
            inside += low - rounding <= mean <= high + rounding
            reaches = low - noise - rounding <= mean <= high + noise + rounding
            overlapping += reaches
            if not reaches:
                print(plan, key, name, (low, value, high), (mean, noise), file=sys.stderr)
            widths.append((high - low) / 2 / value if value else 0.0)
    return [
        exact["name"],
        exact["states"]["total"],
        *took,
        "%d of %d" % (overlapping, len(widths)),
        inside,
        "%.2g %%" % (100 * statistics.median(widths)),
    ]


def fitted(plan: str, log: Optional[str], seed: int, target: str) -> str:
    """Learn a plan from a log, by default of 1,000 s in virtual time, and write it to a folder."""
    verbs: List[Tuple[str, ...]] = [("fit", plan, log or target + ".jsonl", "-o", target)]
    if log is None:
        run = ("--time", "1000", "--seed", str(seed), "--log", target + ".jsonl")
        verbs.insert(0, ("simulate", plan, *run))
    for words in verbs:
        command = [sys.executable, "-m", "gspn_framework_package", *words]
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    return target


def _plans(folder: str, count: int) -> Iterator[str]:
    yield from ("plans/patrol", "plans/warehouse")
    for seed in range(1, count + 1):
        path = os.path.join(folder, "generated_%d.json" % seed)
        with open(path, "w", encoding="utf-8") as file:
            json.dump(plan_to_json(generated(seed)), file)
        yield path


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--plans", type=int, default=4, help="number of generated plans")
    parser.add_argument("--log", nargs=2, action="append", default=[], metavar=("PLAN", "LOG"))
    given = parser.parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        plans: List[Tuple[str, Optional[str]]] = [
            (plan, None) for plan in _plans(folder, given.plans)
        ]
        plans += [(plan, log) for plan, log in given.log]
        for seed, (plan, log) in enumerate(plans, 1):
            target = os.path.join(folder, "fitted_%d.json" % seed)
            rows.append(compared(fitted(plan, log, seed, target)))
            print(rows[-1], file=sys.stderr)
    took = ("s", "s of a processor", "MB")
    print(table(("plan", "states", *took, "contain", "strictly", "half width"), rows))
    print(machine_line())
    return 0


if __name__ == "__main__":
    run_command("few_phases", main)
