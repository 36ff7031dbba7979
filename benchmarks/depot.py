"""The depot with and without its groups of mutual exclusion: ``python3 -m benchmarks.depot``.

``plans/depot`` is what ``gspn build --deadlock-free`` makes of its map: a robot enters an aisle
when no other one is in it. Without that, the same map and the same tasks give a plan in which
robots jam: one wants to get out of an aisle, and one wants to get in. Each of the two plans runs in
virtual time, and again with eight robots that drive in the simulated room. A robot has jammed if it
has stood in a node of an aisle for five minutes at the end.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from typing import Any, Dict, List, Optional, Sequence

from benchmarks.driven_run import DrivenRun, Visits
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.machine import describe_machine, machine_line
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.site_map import read_map
from gspn_framework_package.making.site_plan import build_site_plan
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.world import patrol
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.room_file import load_room
from gspn_framework_package.world.traffic import SimulatedRobot

LIBRARIES = ("numpy", "scipy", "pybullet")
ROBOTS = 8
JAMMED = 300.0
"""Seconds for which a robot stands in a node of an aisle that has jammed."""


def depot(name: str) -> str:
    """The path of a file of the plan."""
    return os.path.join(plans_folder(), "depot", name)


def without_measures() -> Plan:
    """The plan of the same map without groups."""
    return build_site_plan(depot("map.yaml"), depot("tasks.yaml"), ROBOTS).as_read()


def jammed(run: Visits) -> List[str]:
    """The robots that have jammed, by name."""
    return [
        robot
        for robot, (place, seconds) in run.stays().items()
        if place.startswith("At_") and "yard" not in place and seconds >= JAMMED
    ]


class Depot:
    """The room of the depot, and what its robots do there.

    :param robots: their names.
    """

    def __init__(self, robots: Sequence[str]) -> None:
        self.nodes = read_map(depot("map.yaml")).nodes
        self.team = DrivingTeam(load_room(depot("depot.yaml")), robots)
        self.team.close_doors(["gate"])

    def drives(self, command: StartAction, robot: SimulatedRobot) -> Optional[patrol.ActionSteps]:
        """What a robot does in a place of the plan."""
        what, *words = command.place.split("_")
        if what == "Drive":
            return self._to(words[1], robot)
        if what in ("Open", "Close"):
            return self._door(what == "Open", robot)
        if what == "Stranded":
            return self._carried(robot)
        return None

    def _to(self, node: str, robot: SimulatedRobot) -> patrol.ActionSteps:
        slots = [Pose(*slot) for slot in self.nodes[node].slots]
        if slots:
            first = patrol.preferred_slot(robot.name) - 1
            yield from patrol.park(robot, slots, first, self.team.room.robot.radius)
        else:
            position, turned = (self.nodes[node].pose[key] for key in ("position", "orientation"))
            yaw = 2 * math.atan2(turned["z"], turned["w"])
            yield from patrol.drive(robot, Pose(position["x"], position["y"], yaw))
        return None

    def _door(self, opens: bool, robot: SimulatedRobot) -> patrol.ActionSteps:
        begin = robot.now()
        while robot.now() - begin < (4.0 if opens else 3.0):
            yield "at the gate"
        self.team.close_doors([] if opens else ["gate"])
        return None

    def _carried(self, robot: SimulatedRobot) -> patrol.ActionSteps:
        """Somebody carries the robot to the yard."""
        slots = [Pose(*slot) for slot in self.nodes["yard"].slots]
        taken = list(robot.others().values())
        free = [s for s in slots if all(s.distance(pose) > 0.4 for pose in taken)]
        self.team.carry(robot.name, free[0])
        yield "carried"
        return None


def in_virtual_time(plan: Plan, minutes: float, seed: int) -> Dict[str, Any]:
    """A run in virtual time; see :func:`figures`."""
    run = Visits(plan, seed)
    begin = time.perf_counter()
    run.run(minutes * 60)
    return {
        **figures(run, minutes),
        "times_real_time": minutes * 60 / (time.perf_counter() - begin),
    }


def in_the_room(plan: Plan, minutes: float, seed: int) -> Dict[str, Any]:
    """A run with robots that drive; see :func:`figures`."""
    room = Depot([robot.name for robot in plan.robots])
    run = DrivenRun(plan, room.team, room.drives, seed)
    begin = time.perf_counter()
    run.begin()
    run.drive(minutes * 60)
    wall = time.perf_counter() - begin
    report = run.referee.report()
    room.team.close()
    return {
        **figures(run, minutes),
        "metres": report["distance"],
        "contacts": report["contacts_between_robots"] + report["contacts_with_solids"],
        "goals_given_up": report["goals_aborted"],
        "failed_actions": len(run.failures),
        "times_real_time": minutes * 60 / wall,
    }


def figures(run: Visits, minutes: float) -> Dict[str, Any]:
    """What a run did: how many tasks, how many robots jammed, and where."""
    stays, stuck = run.stays(), jammed(run)
    return {
        "tasks": run.count("Finished_"),
        "tasks_per_hour": run.count("Finished_") / minutes * 60,
        "jammed": len(stuck),
        "where": sorted(stays[robot][0] for robot in stuck),
    }


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0: without measures robots jam, with them they do not, and nobody
    touches anything; 1: otherwise."""
    parser = argparse.ArgumentParser(prog="benchmarks.depot", description=__doc__.split(":")[0])
    parser.add_argument("--minutes", type=float, default=30.0, help="time of a run (30)")
    parser.add_argument("--seed", type=int, default=0, help="of all random draws (0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    end_cleanly_on_signal()
    plans = {"as shipped": read_plan(depot("plan.json")), "without measures": without_measures()}
    results = {
        "%s, %s" % (name, where): measure(plan, args.minutes, args.seed)
        for name, plan in plans.items()
        for where, measure in (("in virtual time", in_virtual_time), ("in the room", in_the_room))
    }
    machine = describe_machine(LIBRARIES)
    if args.json:
        print(json.dumps({"machine": machine, "results": results}, indent=2))
    else:
        print(machine_line(machine) + "\n")
        for title, result in results.items():
            print("%s:" % title)
            for name, value in result.items():
                text = "%.4g" % value if isinstance(value, float) else value
                print("  %-16s %s" % (name.replace("_", " "), text))
    wrong = [
        result
        for title, result in results.items()
        if bool(result["jammed"]) == title.startswith("as shipped") or result.get("contacts")
    ]
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
