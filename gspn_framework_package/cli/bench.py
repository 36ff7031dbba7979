"""``gspn bench``: the scaling experiments of the thesis and the throughput, on this machine."""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
import sys
import time
from typing import Any, Dict, List, Sequence

from gspn_framework_package.benchmark import scaling
from gspn_framework_package.benchmark.figures import draw_figures
from gspn_framework_package.benchmark.machine import describe_machine, machine_line, table
from gspn_framework_package.benchmark.team_run import LAUNCH_FILES, Master, need_ros

NAME = "bench"
HELP = "measure how teams scale: start, cost and throughput, as in thesis 6.1 (needs ROS)"

COLUMNS = (
    ("robots", "robots"), ("places", "places"), ("servers", "servers"), ("mode", "mode"),
    ("all_fired_s", "all fired [s]"), ("firings_per_s", "firings/s"), ("cpu_percent_of_core", "CPU [% of a core]"),
    ("pss_mb", "PSS [MB]"), ("processes", "processes"), ("threads", "threads"), ("descriptors", "descriptors"),
    ("machine_cpu", "machine CPU [%]"), ("machine_memory", "machine memory [%]"),
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    parser.add_argument(
        "experiments",
        nargs="*",
        metavar="EXPERIMENT",
        help="which: %s, standalone (default: all)"
        % ", ".join("%s (%s)" % (name, e.source) for name, e in scaling.EXPERIMENTS.items()),
    )
    parser.add_argument("--quick", action="store_true", help="a few points of each")
    parser.add_argument("--sizes", type=_sizes, default=(), metavar="N,N,...",
                        help="these points instead: robots, or places where places grow")  # fmt: skip
    parser.add_argument("--mode", choices=[*LAUNCH_FILES, "both"], default="process",
                        help="a process for each robot, or all hosted in one (default: %(default)s)")  # fmt: skip
    parser.add_argument("--partial", action="store_true", help="with partial synchronisation")
    parser.add_argument("--window", type=float, default=5.0, metavar="S",
                        help="seconds that each point is measured for (default: %(default)s)")  # fmt: skip
    parser.add_argument("--output", metavar="FOLDER", help="write results.csv, results.json and the figures there")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.epilog = (
        "CPU and memory of the machine are psutil's cpu_percent and virtual_memory, five samples averaged, with the "
        "baseline subtracted, as in the thesis; everything else is of the robots' own processes. Close what else runs."
    )


def run(args: argparse.Namespace) -> int:
    """Run the experiments and tell their figures."""
    known = [*scaling.EXPERIMENTS, "standalone"]
    wanted = args.experiments or known
    for name in wanted:
        if name not in known:
            from gspn_framework_package.model.errors import UsageError

            raise UsageError("there is no experiment '%s'" % name, hint="there are: " + ", ".join(known))
    rows: List[Dict[str, Any]] = []
    before = scaling.baseline()
    baseline = {"cpu_percent": round(before.cpu_percent, 1), "memory_percent": round(before.memory_percent, 1)}
    on_ros = [name for name in wanted if name != "standalone"]
    if on_ros:
        need_ros()
        signal.signal(signal.SIGTERM, _terminated)  # so that the robots under way are ended in order
        modes = list(LAUNCH_FILES) if args.mode == "both" else [args.mode]
        with Master() as master:
            for name in on_ros:
                points = scaling.EXPERIMENTS[name].chosen(args.quick, args.sizes)
                results = scaling.run_experiment(name, master, modes, points, args.window, args.partial, _tell)
                rows += [result.row() for result in results]
                if not args.json:
                    _print(name, rows, baseline)
    if "standalone" in wanted:
        rows += scaling.standalone_results(args.quick, args.window, _tell)
    report = {
        "machine": describe_machine(), "baseline": baseline, "window_s": args.window,
        "synchronisation": "partial" if args.partial else "full",
        "date": time.strftime("%Y-%m-%d"), "results": rows,
    }  # fmt: skip
    if args.output:
        _write(args.output, report)
    if args.json:
        print(json.dumps(report, indent=2))
    else:
        if "standalone" in wanted:
            _print_standalone(rows)
        print("\n%s\nbaseline: CPU %.1f %%, memory %.1f %%" % (
            machine_line(report["machine"]), before.cpu_percent, before.memory_percent))  # fmt: skip
    failed = [row for row in rows if row.get("note") or row.get("faults")]
    for row in failed:
        print("%(experiment)s, %(robots)d robots, %(places)d places, %(mode)s: %(faults)d faults %(note)s" % row,
              file=sys.stderr)  # fmt: skip
    return 1 if failed else 0


def _sizes(text: str) -> List[int]:
    """Numbers with commas. :raises ValueError: not that; argparse tells it."""
    numbers = [int(part) for part in text.split(",")]
    if min(numbers) < 1:
        raise ValueError(text)
    return numbers


def _terminated(*_: Any) -> None:
    raise KeyboardInterrupt


def _tell(text: str) -> None:
    print("bench: %s ..." % text, file=sys.stderr, flush=True)


def _print(name: str, rows: Sequence[Dict[str, Any]], baseline: Dict[str, float]) -> None:
    experiment = scaling.EXPERIMENTS[name]
    print("\n%s (%s)\n" % (experiment.title, experiment.source))
    print(table([head for _, head in COLUMNS], [_cells(r, baseline) for r in rows if r["experiment"] == name]),
          flush=True)  # fmt: skip


def _cells(row: Dict[str, Any], baseline: Dict[str, float]) -> List[Any]:
    told = dict(row)
    if "machine_cpu_percent" in row:
        told["machine_cpu"] = row["machine_cpu_percent"] - baseline["cpu_percent"]
        told["machine_memory"] = row["machine_memory_percent"] - baseline["memory_percent"]
    return [told.get(key) for key, _ in COLUMNS]


def _print_standalone(rows: Sequence[Dict[str, Any]]) -> None:
    print("\nWithout ROS, actions that return at once, recorded\n")
    found = [r for r in rows if r["mode"] == "standalone"]
    print(table(["agents", "firings/s", "CPU [% of a core]"],
                [[r["robots"], r["firings_per_s"], r["cpu_percent_of_core"]] for r in found]))  # fmt: skip


def _write(folder: str, report: Dict[str, Any]) -> None:
    os.makedirs(folder, exist_ok=True)
    rows = report["results"]
    names: Dict[str, None] = {}
    for row in rows:
        names.update(dict.fromkeys(row))
    with open(os.path.join(folder, "results.csv"), "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(names))
        writer.writeheader()
        writer.writerows(rows)
    with open(os.path.join(folder, "results.json"), "w", encoding="utf-8") as file:
        json.dump(report, file, indent=2)
    for path in draw_figures(rows, report["baseline"], folder):
        _tell("drew " + path)
