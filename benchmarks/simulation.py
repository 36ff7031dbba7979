"""Firings per second of the simulation: ``python3 -m
benchmarks.simulation``.

Each row is a plan. *kernel* plays its run, compiled and plain; *table* reads the plan as a net, as
``--timing net`` does, with the table of markings that was the only engine of 0.2; *plain loop* is a
race of the net that looks at every transition each time, compiled as well, which knows neither
policy nor robots. The times are processor time; compiled code is loaded before the clock starts;
engines take turns, and the fastest turn counts.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from benchmarks.machine import (
    LIBRARIES,
    describe_machine,
    machine_line,
    table,
)
from benchmarks.plans import grid_plan, ring_plan
from gspn_framework_package.analysis.arrays import Floats, Indices
from gspn_framework_package.analysis.simulation import machine
from gspn_framework_package.analysis.simulation.plan_run import PlanRun
from gspn_framework_package.analysis.simulation.plan_tables import PlanTables
from gspn_framework_package.analysis.simulation.state_cache import StateCache, TableRuns
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.run_net.compiling import compile_plan

TABLE_RUNS = 100
"""Replications that the table of markings advances in step."""


def subjects() -> List[Tuple[str, Plan]]:
    """The plans, with what they are called."""
    patrol = read_plan(os.path.join(plans_folder(), "patrol"))
    return [
        ("patrol, 4 robots", patrol),
        ("patrol, 30 robots", patrol.for_robots(30)),
        ("patrol, 1,000 robots", patrol.for_robots(1000)),
        ("grid of 512 places, 30 robots", grid_plan(16, 30)),
        ("ring of 100 places, 1,000 robots", ring_plan(100, 1000)),
    ]


def kernel_rate(plan: Plan, seconds: float, compiled: bool) -> float:
    """Firings per second of processor time of the plan's run."""
    run = PlanRun(PlanTables(plan, PlanTiming(plan)))
    if compiled:
        run.compile()
    run.begin([1, 2, 3, 4])
    run.go(math.inf, 1000)
    chunk = 200_000 if compiled else 2_000
    before = run.firings_so_far
    spent = _spend(seconds, lambda: run.go(math.inf, chunk))
    return (run.firings_so_far - before) / spent


def table_rate(plan: Plan, seconds: float) -> float:
    """Firings per second of processor time of the plan read as a net, by the table of markings.
    Its runs are as long as fits the time."""
    source = np.random.Generator(np.random.PCG64(1))
    markings = StateCache(compile_plan(plan, None))
    length = 1.0
    while True:
        runs = TableRuns(markings, TABLE_RUNS, length, 0.0, source)
        spent = _spend(0.0, lambda runs=runs: runs.go(Watch()))  # type: ignore[misc]
        if spent >= seconds / 2:
            return runs.events / spent
        length *= min(max(seconds / max(spent, 1e-3), 1.5), 8.0)


def plain_rate(net: Net, seconds: float) -> float:
    """Firings per second of processor time of the plain loop."""
    from gspn_framework_package.analysis.compiling import compiled

    loop = compiled(_plain_loop)
    arcs = _padded(net)
    loop(*arcs, 1000)
    return 1_000_000 / _spend(0.0, lambda: loop(*arcs, 1_000_000)) if seconds else 0.0


def _spend(seconds: float, work: Callable[[], Any]) -> float:
    """Do the work again and again for this processor time; returns the time taken (s)."""
    begin = time.process_time()
    while True:
        work()
        spent = time.process_time() - begin
        if spent >= seconds:
            return spent


def _padded(net: Net) -> Tuple[Any, ...]:
    """Marking; per transition its input, inhibitor and output places (-1: none) and what it needs;
    rates (or weights), and which are exponential."""

    def rows(arcs: Sequence[Sequence[Tuple[int, int]]], which: int) -> Indices:
        width = max((len(mine) for mine in arcs), default=0) or 1
        found = np.full((len(arcs), width), -1 if which == 0 else 0, dtype=np.int64)
        for t, mine in enumerate(arcs):
            for k, pair in enumerate(mine):
                found[t, k] = pair[which]
        return found

    effects = [net.effect(t) for t in range(len(net.transitions))]
    return (
        np.array(net.initial_marking, dtype=np.int64),
        rows(net.inputs, 0),
        rows(net.inputs, 1),
        rows(net.inhibitors, 0),
        rows(net.inhibitors, 1),
        rows(effects, 0),
        rows(effects, 1),
        np.array([t.rate if t.timed else max(t.weight, 1e-9) for t in net.transitions]),
        np.array([int(t.timed) for t in net.transitions], dtype=np.int64),
    )


def _plain_loop(
    initial: Indices,
    inputs: Indices,
    needs: Indices,
    inhibitors: Indices,
    bounds: Indices,
    places: Indices,
    changes: Indices,
    rates: Floats,
    timed: Indices,
    count: int,
) -> float:
    """Fire ``count`` transitions of a net; returns the time (s)."""
    marking = initial.copy()
    strength = np.zeros(len(rates))
    now = 0.0
    for _ in range(count):
        total = 0.0
        immediate = 0.0
        for t in range(len(rates)):
            degree = 1 << 30
            for k in range(inputs.shape[1]):
                if inputs[t, k] >= 0:
                    degree = min(degree, marking[inputs[t, k]] // needs[t, k])
            for k in range(inhibitors.shape[1]):
                if inhibitors[t, k] >= 0 and marking[inhibitors[t, k]] >= bounds[t, k]:
                    degree = 0
            strength[t] = rates[t] * degree if timed[t] else rates[t] * min(degree, 1)
            if timed[t]:
                total += strength[t]
            else:
                immediate += strength[t]
        kind = 0 if immediate > 0.0 else 1
        left = np.random.random() * (total if kind else immediate)
        if kind:
            now += np.random.exponential() / total
        fired = -1
        for t in range(len(rates)):
            if timed[t] == kind and strength[t] > 0.0:
                fired = t
                left -= strength[t]
                if left < 0.0:
                    break
        for k in range(places.shape[1]):
            if places[fired, k] >= 0:
                marking[places[fired, k]] += changes[fired, k]
    return now


def measure(plan: Plan, seconds: float, turns: int) -> Dict[str, float]:
    """The rates of all engines, each the best of ``turns``."""
    engines: Dict[str, Callable[[], float]] = {
        "plain": lambda: kernel_rate(plan, seconds, False),
        "table": lambda: table_rate(plan, seconds),
    }
    if machine.numba_is_there():
        engines["kernel"] = lambda: kernel_rate(plan, seconds, True)
        engines["loop"] = lambda: plain_rate(plan.net, seconds)
    best = dict.fromkeys(engines, 0.0)
    for _ in range(turns):
        for name, engine in engines.items():
            best[name] = max(best[name], engine())
    return best


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.simulation", description=__doc__.split(":")[0]
    )
    parser.add_argument("--quick", action="store_true", help="one turn of a fifth of a second each")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    seconds, turns = (0.2, 1) if args.quick else (2.0, 3)
    results = []
    for name, plan in subjects():
        if sys.stderr.isatty():
            print("%s ..." % name, file=sys.stderr)
        results.append({"plan": name, **measure(plan, seconds, turns)})
    described = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": described, "results": results}, indent=2))
        return 0
    print(machine_line(described) + "\n")
    print(table(("plan", *_COLUMNS.values()), [_row(result) for result in results]))
    return 0


_COLUMNS = {
    "kernel": "kernel, compiled [1/s]",
    "plain": "kernel, plain [1/s]",
    "table": "table [1/s]",
    "loop": "plain loop [1/s]",
    "to_table": "kernel / table",
    "to_loop": "kernel / plain loop",
}


def _row(result: Dict[str, Any]) -> List[Any]:
    kernel = result.get("kernel")
    ratios: Dict[str, Optional[float]] = {"to_table": None, "to_loop": None}
    if kernel is not None:
        ratios = {"to_table": kernel / result["table"], "to_loop": kernel / result["loop"]}
    return [result["plan"], *({**result, **ratios}.get(key) for key in _COLUMNS)]


if __name__ == "__main__":
    sys.exit(main())
