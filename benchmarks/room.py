"""The critical room with 1 to 8 robots that really drive (thesis 6.2): ``python3 -m
benchmarks.room``.

The thesis's simulation works with one to three robots and fails with four: they get stuck or
entangled, or one overtakes another against the plan. Here a referee that sees the true poses judges
each run: laps, touches between robots and with walls, minutes stuck, goals given up, distance, two
robots in one location, overtakings against the plan. The cost is reported as well: real-time
factor, processor, memory.

By default the patrol is decided centrally and stepped as fast as possible (``world.traffic``), so
that this measures the world itself. With ``--ros`` the whole system runs: ``patrol.launch``, one
execution node for each robot, which agree on every firing (needs ROS and the built package).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from typing import Any, Dict, List, Optional, Sequence, Tuple

from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.machine import describe_machine, machine_line
from benchmarks.room_report import FAULTS, figures, show, show_beside_thesis
from benchmarks.room_ros import measure_ros
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.model.errors import ExecutionError

TEAMS: Tuple[Tuple[int, int], ...] = ((1, 2), (2, 2), (3, 2), (4, 10), (6, 2), (8, 2))
"""Number of robots, and number of seeds for teams of that size."""

MINUTES = 15.0
LIBRARIES = ("numpy", "scipy", "pybullet", "rospy", "actionlib")


SCANS = 5
"""Scans of a robot in a second of world time, with ``--scans``."""


def measure(
    room: str, robots: int, seed: int, minutes: float, scans: bool = False
) -> Dict[str, Any]:
    """One run without ROS, in this process.

    :param room: the room file.
    :param robots: size of the team.
    :param seed: seed of all random draws.
    :param minutes: world time (min).
    :param scans: every robot scans, as with ROS while somebody listens.
    """
    import psutil

    from gspn_framework_package.world.room_file import load_room
    from gspn_framework_package.world.traffic import Patrol

    run = Patrol(load_room(room), ["robot_%d" % (i + 1) for i in range(robots)], seed)
    begin, begin_cpu = time.perf_counter(), time.process_time()
    if scans:
        for _ in range(round(minutes * 60 * SCANS)):
            run.run(1 / SCANS)
            for name in run.team.robots:
                run.team.physics.scan(name)
    else:
        run.run(minutes * 60)
    wall, cpu = time.perf_counter() - begin, time.process_time() - begin_cpu
    return {
        "robots": robots,
        "seed": seed,
        **figures(run.referee.report()),
        "failed_actions": len(run.failures),
        "real_time_factor": minutes * 60 / wall,
        "cpu_seconds_per_minute": cpu / minutes,
        "memory_mb": psutil.Process().memory_info().rss / 1e6,
    }


def measure_apart(args: argparse.Namespace, robots: int, seed: int) -> Dict[str, Any]:
    """Call :func:`measure` in a separate process, so that memory and time are its own."""
    words = [sys.executable, "-m", __spec__.name, "--json", "--room", args.room]
    words += ["--robots", str(robots), "--seed", str(seed), "--minutes", str(args.minutes)]
    words += ["--ros", "--factor", str(args.factor)] if args.ros else []
    words += ["--lose"] if args.lose else []
    words += ["--scans"] if args.scans else []
    # 1 means that there were faults, which the results report
    ended = subprocess.run(words, stdout=subprocess.PIPE)
    if ended.returncode not in (0, 1):
        raise ExecutionError("the run with %d robots and seed %d failed" % (robots, seed))
    return dict(json.loads(ended.stdout)["results"][0])


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0: no fault in any run, 1: otherwise."""
    parser = argparse.ArgumentParser(prog="benchmarks.room", description=__doc__.split(":")[0])
    parser.add_argument("--robots", type=int, help="one team of so many robots only")
    parser.add_argument("--seed", type=int, help="one seed only (needs --robots)")
    parser.add_argument("--minutes", type=float, default=MINUTES, help="world time of a run (15)")
    parser.add_argument(
        "--quick", action="store_true", help="one seed and two minutes for each team"
    )
    parser.add_argument("--room", help="the room file (plans/patrol/critical_room.yaml)")
    parser.add_argument("--ros", action="store_true", help="the whole system, with execution nodes")
    parser.add_argument(
        "--factor", type=float, default=5.0, help="with --ros: real-time factor (5)"
    )
    parser.add_argument(
        "--lose", action="store_true", help="with --ros: kill a robot in mid-patrol; it returns"
    )
    parser.add_argument(
        "--scans", action="store_true", help="without --ros: each robot scans five times a second"
    )
    parser.add_argument(
        "--thesis",
        action="store_true",
        help="one run with each number of robots from 1 to 8, beside what thesis 6.3 says of it",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    end_cleanly_on_signal()
    args.room = args.room or os.path.join(plans_folder(), "patrol", "critical_room.yaml")
    if args.quick:
        args.minutes = min(args.minutes, 2.0)
    results: List[Dict[str, Any]] = []
    if args.robots and args.seed is not None:
        if args.ros:
            results.append(
                measure_ros(args.room, args.robots, args.seed, args.minutes, args.factor, args.lose)
            )
        else:
            results.append(measure(args.room, args.robots, args.seed, args.minutes, args.scans))
    else:
        teams: Sequence[Tuple[int, int]] = TEAMS
        if args.thesis:
            teams = [(robots, 1) for robots in range(1, 9)]
        elif args.robots:
            teams = [(args.robots, dict(TEAMS).get(args.robots, 2))]
        runs = [(n, seed) for n, seeds in teams for seed in range(1 if args.quick else seeds)]
        for count, (robots, seed) in enumerate(runs):
            told = "%d of %d: %d robots, seed %d" % (count + 1, len(runs), robots, seed)
            print(told, file=sys.stderr, flush=True)
            results.append(measure_apart(args, robots, seed))
            faults = {name: results[-1].get(name) for name in FAULTS if results[-1].get(name)}
            found = "%d locations, faults: %s" % (results[-1]["entries"], faults or "none")
            print(found, file=sys.stderr, flush=True)
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(
            json.dumps({"machine": machine, "minutes": args.minutes, "results": results}, indent=2)
        )
    else:
        print(machine_line(machine) + "\n")
        print("%g minutes of world time each\n" % args.minutes)
        print(show_beside_thesis(results) if args.thesis else show(results))
    return int(any(result.get(fault) for result in results for fault in FAULTS))


if __name__ == "__main__":
    sys.exit(main())
