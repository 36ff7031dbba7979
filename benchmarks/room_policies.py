"""Two plans of the patrol in the critical room: ``python3 -m
benchmarks.room_policies PLAN OTHER``.

Both are run with the same seeds, in PyBullet, with robots that drive (``room_run``), without
ROS. A referee that sees the true poses counts how many locations the robots enter, and whether
there were ever two robots in one. The visits of each seed are compared in pairs.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.analysis.simulation.estimates import mean
from gspn_framework_package.formats.example_plans import plans_folder

LIBRARIES = ("numpy", "scipy", "pybullet")
CONFIDENCE = 0.95


def run_in_room(plan: str, seed: int, minutes: float, log: Path) -> Dict[str, Any]:
    """One run.

    :param plan: the plan's file or folder.
    :param minutes: its length in the time of the physics.
    :param log: the event log to write.
    :returns: the referee's counts, and what failed.
    """
    from benchmarks.room_run import RoomRun
    from gspn_framework_package.formats.plan_file import read_plan
    from gspn_framework_package.world.room_file import load_room

    room = load_room(os.path.join(plans_folder(), "patrol", "critical_room.yaml"))
    log.unlink(missing_ok=True)
    started = time.perf_counter()
    run = RoomRun(read_plan(plan), room, seed, str(log))
    run.run(minutes * 60)
    report = run.referee.report()
    run.close()
    del report["entry_log"]
    hours = minutes / 60
    return {
        "seed": seed,
        "minutes": minutes,
        "visits_per_hour": report["entries"] / hours,
        "laps_per_hour_and_robot": report["laps"] / hours / len(report["robots"]),
        **report,
        "failures": run.failures,
        "wall_seconds": time.perf_counter() - started,
    }


def runs_of(
    plan: str, name: str, seeds: Sequence[int], minutes: float, folder: Path
) -> List[Dict[str, Any]]:
    """The runs of a plan with each seed; those that the folder already has are used again."""
    results = []
    for seed in seeds:
        kept = folder / ("%s_%d.json" % (name, seed))
        if kept.exists():
            result = json.loads(kept.read_text(encoding="utf-8"))
            if result["minutes"] == minutes:
                results.append(result)
                continue
        result = run_in_room(plan, seed, minutes, kept.with_suffix(".jsonl"))
        kept.write_text(json.dumps(result, indent=2), encoding="utf-8")
        told = "%s, seed %d: %.1f visits/h, %d times two in one location, in %.0f s"
        rule = result["two_in_one_location"]
        values = (name, seed, result["visits_per_hour"], rule, result["wall_seconds"])
        print(told % values, file=sys.stderr, flush=True)
        results.append(result)
    return results


def compared(old: List[Dict[str, Any]], new: List[Dict[str, Any]]) -> Dict[str, Any]:
    """Means with 95 % intervals, and that of the differences between runs of the same seed."""
    key = "visits_per_hour"
    first, second = (np.array([run[key] for run in runs], dtype=float) for runs in (old, new))
    found = {}
    for name, samples in (("old", first), ("new", second), ("difference", second - first)):
        estimate = mean(samples, CONFIDENCE)
        low, high = (estimate.mean + sign * estimate.half_width for sign in (-1, 1))
        found[name] = {"mean": estimate.mean, "low": low, "high": high}
    change = found["difference"]
    return {
        **found,
        "relative": change["mean"] / found["old"]["mean"],
        "significant": not change["low"] <= 0 <= change["high"],
        "rule_broken": {
            name: sum(run["two_in_one_location"] for run in runs)
            for name, runs in (("old", old), ("new", new))
        },
    }


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0, or 1 if two robots were ever in one location."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.room_policies", description="two plans of the patrol in the critical room"
    )
    parser.add_argument("plan", help="a plan of the patrol")
    parser.add_argument("other", help="another, for example with a computed policy")
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=list(range(1, 11)), help="seeds (1 to 10)"
    )
    parser.add_argument("--minutes", type=float, default=15.0, help="length of a run (15)")
    parser.add_argument("--quick", action="store_true", help="two seeds of two minutes")
    parser.add_argument("--folder", help="keep logs and results there; those there are used again")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    if args.quick:
        args.seeds, args.minutes = args.seeds[:2], min(args.minutes, 2.0)
    if len(args.seeds) < 2:
        parser.error("an interval needs two seeds or more")
    folder = Path(args.folder or tempfile.mkdtemp(prefix="gspn_room_policies_"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        old, new = (
            runs_of(plan, name, args.seeds, args.minutes, folder)
            for plan, name in ((args.plan, "old"), (args.other, "new"))
        )
    finally:
        if args.folder is None:
            shutil.rmtree(folder, ignore_errors=True)
    machine, result = describe_machine(LIBRARIES), compared(old, new)
    if args.json:
        shown = {"machine": machine, "old": old, "new": new, "result": result}
        print(json.dumps(shown, indent=2))
    else:
        print(machine_line(machine) + "\n")
        print(_text(old, new, result))
    return int(any(result["rule_broken"].values()))


def _text(old: List[Dict[str, Any]], new: List[Dict[str, Any]], result: Dict[str, Any]) -> str:
    rows = []
    for first, second in zip(old, new):
        a, b = first["visits_per_hour"], second["visits_per_hour"]
        rule = "%d, %d" % (first["two_in_one_location"], second["two_in_one_location"])
        rows.append([first["seed"], "%.1f" % a, "%.1f" % b, "%+.1f" % (b - a), rule])
    head = ["seed", "visits/h", "the other", "difference", "two in one location"]
    change = result["difference"]
    return "%s\n\n%s visits/h, %s visits/h; difference %+.2f (%+.2f to %+.2f), %+.1f %%: %s" % (
        table(head, rows),
        *("%.2f" % result[name]["mean"] for name in ("old", "new")),
        change["mean"],
        change["low"],
        change["high"],
        100 * result["relative"],
        "significant" if result["significant"] else "not significant at 95 %",
    )


if __name__ == "__main__":
    sys.exit(main())
