"""``python3 -m benchmarks``: the scaling experiments of the thesis, and throughput, locally."""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import sys
from typing import Any, Dict, List, Optional, Sequence

from benchmarks import scaling
from benchmarks.figures import draw_figures
from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.team import LAUNCH_FILES
from benchmarks.machine import machine_line, table
from benchmarks.results import Results
from gspn_framework_package.cli import numbers
from gspn_framework_package.model.errors import GspnError, UsageError

COLUMNS = (
    ("robots", "robots"),
    ("places", "places"),
    ("servers", "servers"),
    ("mode", "mode"),
    ("all_fired_s", "all fired [s]"),
    ("thesis", "thesis [s]"),
    ("firings_per_s", "firings/s"),
    ("cpu_percent_of_core", "CPU [% of a core]"),
    ("pss_mb", "PSS [MB]"),
    ("processes", "processes"),
    ("threads", "threads"),
    ("descriptors", "descriptors"),
    ("machine_cpu", "machine CPU [%]"),
    ("machine_memory", "machine memory [%]"),
)


def main(words: Optional[Sequence[str]] = None) -> int:
    """Run the experiments, print their figures and return the exit code."""
    parser = argparse.ArgumentParser(prog="python3 -m benchmarks")
    parser.add_argument(
        "experiments",
        nargs="*",
        metavar="EXPERIMENT",
        help="which: %s, standalone (default: all)"
        % ", ".join("%s (%s)" % (name, e.source) for name, e in scaling.EXPERIMENTS.items()),
    )
    parser.add_argument("--quick", action="store_true", help="a few points of each")
    parser.add_argument(
        "--sizes",
        type=_sizes,
        default=(),
        metavar="N,N,...",
        help="measure these points instead: numbers of robots, or of places where those grow",
    )
    parser.add_argument(
        "--mode",
        choices=[*LAUNCH_FILES, "both"],
        default="process",
        help="a process for each robot, or all hosted in one (default: %(default)s)",
    )
    parser.add_argument("--partial", action="store_true", help="with partial synchronisation")
    parser.add_argument(
        "--window",
        type=numbers.duration,
        default=5.0,
        metavar="S",
        help="seconds to measure each point (default: %(default)s)",
    )
    parser.add_argument(
        "--output",
        metavar="FOLDER",
        help="write results.csv, results.json and the figures there; go on where a run into that "
        "folder was interrupted",
    )
    parser.add_argument(
        "--again",
        action="store_true",
        help="also measure the points that the folder already holds",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.epilog = (
        "CPU and memory of the machine are psutil's cpu_percent and virtual_memory, five samples "
        "averaged, with the "
        "baseline subtracted, as in the thesis; everything else is of the robots' own processes. "
        "Close what else runs."
    )
    try:
        return run(parser.parse_args(words))
    except GspnError as error:
        print("error: %s" % error, file=sys.stderr)
        return error.exit_code


def run(args: argparse.Namespace) -> int:
    """Run the experiments and print their figures."""
    known = [*scaling.EXPERIMENTS, "standalone"]
    wanted = args.experiments or known
    for name in wanted:
        if name not in known:
            raise UsageError(
                "there is no experiment '%s'" % name, hint="there are: " + ", ".join(known)
            )
    results = Results(args.output or "")
    before = scaling.baseline()
    baseline = {
        "baseline_cpu_percent": round(before.cpu_percent, 1),
        "baseline_memory_percent": round(before.memory_percent, 1),
    }
    told: List[Dict[str, Any]] = []
    for name in wanted:
        if name == "standalone":
            for row in scaling.standalone_results(args.quick, args.window, _tell):
                results.add({**row, "synchronisation": "", "window_s": args.window})
            continue
        if name == wanted[0] or not told:
            need_ros()
        told += _run_experiment(name, args, results, baseline)
        if not args.json:
            _print(name, results)
    if args.json:
        print(json.dumps(results.report(), indent=2))
    else:
        if "standalone" in wanted:
            _print_standalone(results.rows)
        print(
            "\n%s\nbaseline: CPU %.1f %%, memory %.1f %%"
            % (machine_line(results.machine), before.cpu_percent, before.memory_percent)
        )
    if args.output:
        for path in draw_figures(results.rows, args.output):
            _tell("drew " + path)
    failed = [row for row in told if row.get("note") or row.get("faults")]
    for row in failed:
        print(
            "%(experiment)s, %(robots)d robots, %(places)d places, %(mode)s: %(faults)d faults "
            "%(note)s" % row,
            file=sys.stderr,
        )
    return 1 if failed else 0


def _run_experiment(
    name: str, args: argparse.Namespace, results: Results, baseline: Dict[str, float]
) -> List[Dict[str, Any]]:
    """Measure the points without results yet (with ``--again``, all), on a separate master."""
    synchronisation = "partial" if args.partial else "full"
    modes = list(LAUNCH_FILES) if args.mode == "both" else [args.mode]
    points = [
        {
            "experiment": name,
            "mode": mode,
            "robots": robots,
            "places": places,
            "synchronisation": synchronisation,
        }
        for mode in modes
        for robots, places in scaling.EXPERIMENTS[name].chosen(args.quick, args.sizes)
    ]
    points = [point for point in points if args.again or not results.has(point)]
    rows = []
    signal.signal(signal.SIGTERM, _terminated)  # to shut running robots down properly
    with Master() if points else contextlib.nullcontext():
        for point in points:
            _tell("%(experiment)s: %(robots)d robots, %(places)d places, %(mode)s" % point)
            row = scaling.run_point(
                name,
                int(point["robots"]),
                int(point["places"]),
                str(point["mode"]),
                args.window,
                args.partial,
            )
            rows.append({**point, **row, **baseline, "window_s": args.window})
            results.add(rows[-1])
    return rows


def _sizes(text: str) -> List[int]:
    """Parse comma-separated numbers, for argparse."""
    return [numbers.robots(part) for part in text.split(",")]


def _terminated(*_: Any) -> None:
    raise KeyboardInterrupt


def _tell(text: str) -> None:
    print("bench: %s ..." % text, file=sys.stderr, flush=True)


def _print(name: str, results: Results) -> None:
    experiment = scaling.EXPERIMENTS[name]
    print("\n%s (%s)\n" % (experiment.title, experiment.source))
    print(
        table([head for _, head in COLUMNS], [_cells(row) for row in results.of(name)]), flush=True
    )


def _cells(row: Dict[str, Any]) -> List[Any]:
    told = dict(row)
    if "machine_cpu_percent" in row:
        told["machine_cpu"] = row["machine_cpu_percent"] - row["baseline_cpu_percent"]
        told["machine_memory"] = row["machine_memory_percent"] - row["baseline_memory_percent"]
    if row["experiment"] == "tokens":
        told["thesis"] = scaling.thesis_start(row["robots"])
    return [told.get(key) for key, _ in COLUMNS]


def _print_standalone(rows: Sequence[Dict[str, Any]]) -> None:
    print("\nWithout ROS, actions that return at once, recorded\n")
    found = [r for r in rows if r["mode"] == "standalone"]
    print(
        table(
            ["agents", "firings/s", "CPU [% of a core]"],
            [[r["robots"], r["firings_per_s"], r["cpu_percent_of_core"]] for r in found],
        )
    )


if __name__ == "__main__":
    sys.exit(main())
