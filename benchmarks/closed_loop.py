"""The model against the run: ``python3 -m benchmarks.closed_loop WHAT``.

* ``table``: how many checks a second plans/patrol makes, as observed on threads and as several
  models of it predict.
* ``plans``: for patrol, rendezvous and tokens, a model fitted to one run on threads predicts
  another.
* ``room``: a model fitted to runs with some seeds in the critical room (PyBullet, four robots that
  drive) predicts runs with other seeds.

It uses the verbs ``fit``, ``compare``, ``analyse`` and ``simulate`` as a person would.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.model.errors import ExecutionError

LIBRARIES = ("numpy", "scipy", "numba", "pybullet")

PLANS: Tuple[Tuple[str, int, Tuple[str, ...]], ...] = (
    ("patrol", 4, ("Temperature_High", "Temperature_Low")),
    ("rendezvous", 4, ("Hand_Over",)),
    ("tokens", 6, ("t1", "t2", "t3", "t4")),
)
"""Plan, number of agents, and what the transitions that are counted together contain."""


ROOM_LOCATIONS = ("L1", "L2", "L3", "L4")
"""The locations of the critical room; a lap visits each. There are as many robots."""


def _ask(*words: str, codes: Sequence[int] = (0,)) -> Any:
    """Run a verb, and return the JSON object that it prints."""
    code, out = _gspn(*words, "--json")
    if code not in codes:
        raise ExecutionError("gspn %s ended with exit code %d" % (" ".join(words), code))
    return json.loads(out)


def _gspn(*words: str) -> Tuple[int, str]:
    """Run the command ``gspn``; returns its exit code and what it printed."""
    command = [sys.executable, "-m", "gspn_framework_package", *words]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    return done.returncode, done.stdout


def _run_on_threads(plan: str, agents: int, seconds: float, seed: int, log: Path) -> None:
    print("%s: %g s on threads" % (plan, seconds), file=sys.stderr, flush=True)
    size = ("--agents", str(agents), "--seconds", str(seconds), "--seed", str(seed))
    code, _ = _gspn("run", plan, *size, "--quiet", "--log", str(log))
    if code:
        raise ExecutionError("the run of %s ended with exit code %d" % (plan, code))


def _counted(rates: Dict[str, float], names: Sequence[str]) -> float:
    return sum(rate for t, rate in rates.items() if any(name in t for name in names))


# -- table -----------------------------------------------------------------------------------------


def models(folder: Path, seconds: float) -> List[List[str]]:
    """Observe plans/patrol, and let each model predict its checks per second."""
    plan, agents, names = os.path.join(plans_folder(), "patrol"), 4, PLANS[0][2]
    log = folder / "patrol.jsonl"
    if not log.exists():
        _run_on_threads(plan, agents, seconds, 1, log)
    fitted = {
        family: _fit(plan, [log], folder / (family + ".json"), family)
        for family in ("exponential", "gamma")
    }
    observed = _observed(fitted["gamma"], [log], names)
    rows = [("observed, on threads", observed)]

    def analysed(path: str, timing: str) -> float:
        found = _ask("analyse", path, "--timing", timing, "--no-structure")
        return _counted(found["steady_state"]["throughput"], names)

    def simulated(path: str) -> float:
        found = _ask("simulate", path, "--time", "2000", "--warmup", "100", "--replications", "20")
        return _counted({t: v["mean"] for t, v in found["throughput"].items()}, names)

    rows.append(("the file's rates, classical (--timing net)", analysed(plan, "net")))
    rows.append(("the file's rates, as it runs", analysed(plan, "run")))
    rows.append(("fitted, exponential, as it runs", analysed(fitted["exponential"], "run")))
    rows.append(("the same, simulated", simulated(fitted["exponential"])))
    rows.append(("fitted, gamma, simulated", simulated(fitted["gamma"])))
    return [
        [name, "%.3f" % value, "%+.1f %%" % (100 * (value / observed - 1))] for name, value in rows
    ]


def _fit(plan: str, logs: Sequence[Path], target: Path, family: str = "auto") -> str:
    """Fit the plan to the logs, anew; returns the new plan file."""
    words = ["fit", plan, *map(str, logs), "--durations", family, "-o", str(target), "--force"]
    _ask(*words)
    return str(target)


def _observed(plan: str, logs: Sequence[Path], names: Sequence[str]) -> float:
    found = _ask("compare", plan, *map(str, logs), "--replications", "20", codes=(0, 1))
    rates = {m["of"]: m["observed"] for m in found["measures"] if m["kind"] == "throughput"}
    return _counted(rates, names)


# -- fit on one, predict another -------------------------------------------------------------------


def _predict(plan: str, logs: Sequence[Path], names: Sequence[str]) -> Dict[str, Any]:
    """Compare the logs with the plan's prediction."""
    found = _ask("compare", plan, *map(str, logs), codes=(0, 1))
    by_kind: Dict[str, List[Dict[str, Any]]] = {}
    for measure in found["measures"]:
        by_kind.setdefault(measure["kind"], []).append(measure)
    rates = by_kind["throughput"]
    predicted = _counted({m["of"]: m["predicted"] for m in rates}, names)
    observed = _counted({m["of"]: m["observed"] for m in rates}, names)
    return {
        "predicted_per_s": predicted,
        "observed_per_s": observed,
        "relative_error": predicted / observed - 1 if observed else None,
        "tokens_inside": sum(m["inside"] for m in by_kind["mean tokens"]),
        "tokens": len(by_kind["mean tokens"]),
        "measures_inside": sum(m["inside"] for m in found["measures"]),
        "measures": len(found["measures"]),
        "outside": [m for m in found["measures"] if not m["inside"]],
        "alarms": [s for s in found["streams"] if s["alarm_at"] is not None],
    }


def on_threads(folder: Path, seconds: float) -> List[Dict[str, Any]]:
    """Fit each plan on one run, and predict another."""
    results = []
    for name, agents, counted in PLANS:
        plan = os.path.join(plans_folder(), name)
        logs = [folder / ("%s_%d.jsonl" % (name, number)) for number in (1, 2)]
        for number, log in enumerate(logs, 1):
            if not log.exists():
                _run_on_threads(plan, agents, seconds, number, log)
        fitted = _fit(plan, logs[:1], folder / (name + "_fitted.json"))
        results.append({"plan": name, "seconds": seconds, **_predict(fitted, logs[1:], counted)})
    return results


def in_room(
    folder: Path, minutes: float, learn: Sequence[int], predict: Sequence[int]
) -> Dict[str, Any]:
    """Fit the patrol of the critical room on runs with the seeds ``learn``, and predict those with
    ``predict``. Logs that the folder already has are used again."""
    from benchmarks.room_run import RoomRun
    from gspn_framework_package.formats.plan_file import read_plan
    from gspn_framework_package.world.room_file import load_room

    home = os.path.join(plans_folder(), "patrol")
    plan = os.path.join(home, "room.json")
    logs = {seed: folder / ("seed_%d.jsonl" % seed) for seed in (*learn, *predict)}
    for seed, log in logs.items():
        if log.exists():
            continue
        started = time.perf_counter()
        unfinished = log.with_suffix(".unfinished")
        unfinished.unlink(missing_ok=True)
        run = RoomRun(
            read_plan(plan),
            load_room(os.path.join(home, "critical_room.yaml")),
            seed,
            str(unfinished),
        )
        run.run(minutes * 60)
        run.close()
        unfinished.rename(log)
        told = "seed %d: %g minutes in %.0f s" % (seed, minutes, time.perf_counter() - started)
        print(told, file=sys.stderr, flush=True)
    fitted = _fit(plan, [logs[seed] for seed in learn], folder / "room_fitted.json")
    found = _predict(fitted, [logs[seed] for seed in predict], PLANS[0][2])
    checks = []
    for seed in predict:
        alone = _ask("compare", fitted, str(logs[seed]), codes=(0, 1))
        checks += [
            {"seed": seed, **measure}
            for measure in alone["measures"]
            if measure["kind"] == "visits" and "Check_Temperature" in measure["of"]
        ]
    return {
        "learned_from": list(learn),
        "predicted": list(predict),
        "minutes": minutes,
        "laps_per_hour_of_a_robot": {
            key: 3600 * found[key + "_per_s"] / len(ROOM_LOCATIONS) / len(ROOM_LOCATIONS)
            for key in ("predicted", "observed")
        },
        "checks_of_a_location": checks,
        **found,
    }


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.closed_loop", description="how well models of a plan predict its runs"
    )
    parser.add_argument("what", choices=("table", "plans", "room"))
    parser.add_argument("--seconds", type=float, default=240.0, help="length of a run (240)")
    parser.add_argument("--minutes", type=float, default=15.0, help="of a run in the room (15)")
    parser.add_argument(
        "--learn", type=int, nargs="+", default=[1, 2, 3, 4, 5], help="seeds (1 2 3 4 5)"
    )
    parser.add_argument(
        "--predict", type=int, nargs="+", default=[6, 7, 8, 9, 10], help="seeds (6 7 8 9 10)"
    )
    parser.add_argument(
        "--folder", help="keep the logs and the fitted plans there; logs that it has are used again"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    folder = Path(args.folder or tempfile.mkdtemp(prefix="gspn_closed_loop_"))
    folder.mkdir(parents=True, exist_ok=True)
    result: Any
    try:
        if args.what == "table":
            result = models(folder, args.seconds)
            shown = table(["model", "checks/s", "error"], result)
        elif args.what == "plans":
            result = on_threads(folder, args.seconds)
            shown = _table(result)
        else:
            result = in_room(folder, args.minutes, args.learn, args.predict)
            shown = _table([{"plan": "patrol in the room", **result}]) + "\n" + _checks(result)
    finally:
        if args.folder is None:
            shutil.rmtree(folder, ignore_errors=True)
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": machine, "result": result}, indent=2))
    else:
        print(machine_line(machine) + "\n")
        print(shown)
    return 0


def _checks(result: Dict[str, Any]) -> str:
    """What a patrol is for: laps, and checks of each location in each predicted run."""
    laps, checks = result["laps_per_hour_of_a_robot"], result["checks_of_a_location"]
    inside = sum(measure["inside"] for measure in checks)
    rows = [
        [m["of"], m["seed"], m["observed"], m["predicted"], "%.4g to %.4g" % tuple(m["interval"])]
        for m in checks
    ]
    return "laps per hour and robot: %.2f predicted, %.2f observed\n" % (
        laps["predicted"],
        laps["observed"],
    ) + "checks of a location in a run: %d of %d inside the 95 %% interval\n\n%s" % (
        inside,
        len(checks),
        table(["place", "seed", "observed", "predicted", "interval"], rows),
    )


def _table(results: Sequence[Dict[str, Any]]) -> str:
    head = ["plan", "predicted/s", "observed/s", "error", "places inside", "measures inside"]
    rows = [
        [
            r["plan"],
            "%.4f" % r["predicted_per_s"],
            "%.4f" % r["observed_per_s"],
            "%+.1f %%" % (100 * (r["relative_error"] or 0.0)),
            "%d of %d" % (r["tokens_inside"], r["tokens"]),
            "%d of %d" % (r["measures_inside"], r["measures"]),
        ]
        for r in results
    ]
    lines = [table(head, rows)]
    for r in results:
        for measure in r["outside"]:
            lines.append(
                "%s: %s: observed %s, interval %s"
                % (r["plan"], measure["name"], measure["observed"], measure["interval"])
            )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
