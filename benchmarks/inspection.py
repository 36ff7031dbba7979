"""The inspection of a site, greedy against computed: ``python3 -m
benchmarks.inspection``.

``gspn optimise`` computes the policy of ``plans/inspection`` that keeps the number of nodes that
are due as low as possible. The gain over the plan's own policy is then measured three times: in the
model (exactly, with exponential times), in virtual time (with the plan's durations), and on ROS
nodes, where the actions really take their time (needs ROS and the built package).
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.team import LaunchedTeam
from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.analysis.simulation.estimates import mean
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.observation import RunObserver
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Plan

LIBRARIES = ("numpy", "scipy", "numba", "rospy", "actionlib")
CONFIDENCE = 0.95
DUE, INSPECTED = "Due_", "Inspected_"
AIM = ("--reward", DUE + "*=-1", "--may-wait", "At_*")
"""What ``gspn optimise`` is asked: as few nodes due as possible; robots may wait in any node."""

WARM_UP = 15.0
"""Seconds of a run on ROS that do not count: all nodes are due in the beginning."""


class SiteRun(NamedTuple):
    """What a run shows: the mean number of nodes that are due, and inspections per second."""

    due: float
    inspections: float


def write_team(robots: int, folder: Path) -> str:
    """Write the plan for a team of that size into a folder; returns the plan's file."""
    home = Path(plans_folder(), "inspection")
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(str(home / "actions.py"), str(folder / "actions.py"))
    plan = read_plan(str(home)).for_robots(robots)
    file = folder / "plan.json"
    file.write_text(json.dumps(plan_to_json(plan)), encoding="utf-8")
    return str(file)


def compute(plan: str, target: Path) -> Dict[str, Any]:
    """Compute the policy of a plan file into another; returns the report of ``gspn optimise``."""
    return dict(_ask("optimise", plan, *AIM, "--simulate", "0", "-o", str(target), "--force"))


def _ask(*words: str) -> Any:
    """Run a verb, and return the JSON object that it prints."""
    command = [sys.executable, "-m", "gspn_framework_package", *words, "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise ExecutionError("gspn %s ended with exit code %d" % (words[0], done.returncode))
    return json.loads(done.stdout)


def seen_in(log: str, plan: Plan, warm_up: float) -> SiteRun:
    """What an event log shows after the first ``warm_up`` seconds of the run.

    :raises ExecutionError: the run is not longer than that.
    """
    recorded = read_log(log)
    observer = RunObserver(plan, recorded.plan)
    before: Optional[Tuple[float, Dict[str, float], Dict[str, int]]] = None
    for step in replay(recorded):
        observer.take(step, float(step.record["mono"]))
        if before is None and observer.seconds >= warm_up:
            before = observer.seconds, observer.tokens, dict(observer.firings)
    if before is None or observer.seconds <= before[0]:
        raise ExecutionError("the run ended within %g s" % warm_up, file=log)
    seconds, tokens, firings = before
    length = observer.seconds - seconds
    return SiteRun(
        _sum(observer.tokens, tokens, DUE) / length,
        _sum(observer.firings, firings, INSPECTED) / length,
    )


def in_virtual_time(plan: Plan, seed: int, seconds: float) -> SiteRun:
    """One run of the plan in virtual time."""
    result = VirtualRun(plan, seed=seed).run(time=WARM_UP + seconds, warmup=WARM_UP)
    return SiteRun(
        math.fsum(v for name, v in result.mean_tokens.items() if name.startswith(DUE)),
        math.fsum(result.throughput(t) for t in result.firings if t.startswith(INSPECTED)),
    )


def _sum(after: Mapping[str, float], before: Mapping[str, float], start: str) -> float:
    return math.fsum(after[name] - before[name] for name in after if name.startswith(start))


def run_on_ros(plan: Plan, seconds: float) -> SiteRun:
    """One run of the plan with one node for each of its robots."""
    with LaunchedTeam(plan) as team:
        team.await_steady()
        team.pass_time(seconds + WARM_UP)
        team.end()
        faults, violation = team.programs.errors("launch"), team.verdict().violation
        if violation is not None:
            faults.append("rule %d: %s" % violation)
        if faults:
            raise ExecutionError("; ".join(faults), file=team.folder)
        return seen_in(team.log_file(team.robots[0]), plan, WARM_UP)


def compared(pairs: Sequence[Tuple[SiteRun, SiteRun]]) -> Dict[str, Any]:
    """What pairs of runs (greedy, computed) show: means, and 95 % intervals of the means of both
    and of their difference."""
    found: Dict[str, Any] = {"runs": len(pairs)}
    for number, key in enumerate(SiteRun._fields):
        old, new = (np.array([pair[who][number] for pair in pairs]) for who in (0, 1))
        found[key] = {}
        for name, samples in (("greedy", old), ("computed", new), ("difference", new - old)):
            estimate = mean(samples, CONFIDENCE)
            low, high = (estimate.mean + sign * estimate.half_width for sign in (-1, 1))
            found[key][name] = {"mean": estimate.mean, "low": low, "high": high}
        found[key]["gain"] = found[key]["difference"]["mean"] / found[key]["greedy"]["mean"]
    return found


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.inspection",
        description="the inspection of a site, greedy against computed",
    )
    parser.add_argument("--robots", type=int, default=2, help="size of the team (2)")
    parser.add_argument("--seconds", type=float, default=120.0, help="of a run on ROS (120)")
    parser.add_argument("--pairs", type=int, default=5, help="pairs of runs on ROS (5)")
    parser.add_argument("--virtual", type=float, default=2000.0, help="s in virtual time (2000)")
    parser.add_argument("--virtual-pairs", type=int, default=20, help="pairs of those runs (20)")
    parser.add_argument("--no-ros", action="store_true", help="leave out the runs on ROS nodes")
    parser.add_argument("--quick", action="store_true", help="short runs, two pairs each")
    parser.add_argument("--computed", metavar="PLAN", help="a plan that has been computed before")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    end_cleanly_on_signal()
    if args.quick:
        args.pairs = args.virtual_pairs = 2
        args.seconds, args.virtual = min(args.seconds, 20.0), min(args.virtual, 200.0)
    if min(args.pairs, args.virtual_pairs) < 2:
        parser.error("an interval needs two pairs or more")
    if not args.no_ros:
        need_ros()
    folder = Path(tempfile.mkdtemp(prefix="gspn_inspection_"))
    try:
        result = measure(args, folder)
    finally:
        shutil.rmtree(str(folder), ignore_errors=True)
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": machine, "robots": args.robots, **result}, indent=2))
    else:
        print(machine_line(machine) + "\n\n%d robots\n" % args.robots)
        print(_text(result))
    return 0


def measure(args: argparse.Namespace, folder: Path) -> Dict[str, Any]:
    """Compute the policy, and compare it with the plan's own."""
    file = write_team(args.robots, folder)
    result: Dict[str, Any] = {}
    if args.computed is None:
        report = compute(file, folder / "computed.json")
        result["model"] = {
            key: report[key] for key in ("value", "lower", "upper", "present_policy", "rows")
        }
        result["model"]["states"] = report["teams"][0]["states"]
        args.computed = str(folder / "computed.json")
    greedy = read_plan(file)
    plans = (greedy, greedy.with_policy(read_plan(args.computed).policy))
    result["virtual"] = compared(
        [
            (
                in_virtual_time(plans[0], seed, args.virtual),
                in_virtual_time(plans[1], seed, args.virtual),
            )
            for seed in range(1, args.virtual_pairs + 1)
        ]
    )
    if args.no_ros:
        return result
    pairs = []
    with Master():
        for number in range(args.pairs):
            # the seed is also that of the environment: with one seed, all runs have the same luck
            seeded = [plan.with_seed(number + 1) for plan in plans]
            pairs.append(tuple(run_on_ros(plan, args.seconds) for plan in seeded))
            told = "pair %d of %d on ROS: %s" % (number + 1, args.pairs, pairs[-1])
            print(told, file=sys.stderr, flush=True)
    result["ros"] = compared(pairs)  # type: ignore[arg-type]
    return result


def _text(result: Dict[str, Any]) -> str:
    rows: List[List[str]] = []
    if "model" in result:
        model = result["model"]
        present = model["present_policy"]["value"]
        shown = "%.5f to %.5f" % (-model["upper"], -model["lower"])
        gain = "%+.1f %%" % (100 * (model["value"] / present - 1))
        rows.append(["nodes due", "model", "%.5f" % -present, shown, gain, ""])
    for key, title in (("due", "nodes due"), ("inspections", "inspections/s")):
        for where, name in (("virtual", "virtual time"), ("ros", "ROS nodes")):
            if where not in result:
                continue
            seen = result[where][key]
            change = seen["difference"]
            rows.append(
                [
                    title,
                    name,
                    *(
                        "%.4f +- %.4f" % (seen[who]["mean"], seen[who]["high"] - seen[who]["mean"])
                        for who in ("greedy", "computed")
                    ),
                    "%+.1f %%" % (100 * seen["gain"]),
                    "%+.4f (%+.4f to %+.4f)" % (change["mean"], change["low"], change["high"]),
                ]
            )
    head = ["", "where", "greedy", "computed", "gain", "difference, 95 % interval"]
    return table(head, rows)


if __name__ == "__main__":
    sys.exit(main())
