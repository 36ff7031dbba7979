"""Robots in random tight places: ``python3 -m benchmarks.room_tight``.

The places are doors and corridors that one or two robots fit through, with robots on both sides
that want to get to the other; crossings of narrow lanes; halls full of boxes. Two to six robots
drive from random poses to random goals. The benchmark counts touches, which must not occur; goals
given up, which may occur if a robot that has arrived blocks another; and robots still on their way
after four minutes, which must not occur either.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.model.net import Point
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.grid import Grid
from gspn_framework_package.world.navigation import NavigationStatus
from gspn_framework_package.world.room import Box, Pose, Room

LIMIT = 240.0
"""World time (s) after which no robot may still be on its way."""

LENGTH, WIDTH = 5.0, 3.0
"""Size (m) of the hall that contains the places."""

APART = 0.26
"""Least distance (m) between two starts, and between two goals."""

_FAULTS = ("touches", "touches_of_solids", "still_on_the_way")


def _wall_with_gap(source: random.Random, thickness: float) -> List[Box]:
    gap, y = source.uniform(0.32, 0.6), source.uniform(-0.6, 0.6)
    south, north = WIDTH / 2 + y - gap / 2, WIDTH / 2 - y - gap / 2
    return [
        Box((0.0, -WIDTH / 2 + south / 2), (thickness, south)),
        Box((0.0, WIDTH / 2 - north / 2), (thickness, north)),
    ]


def _crossing(source: random.Random) -> List[Box]:
    lane = source.uniform(0.34, 0.6)
    signs = [(x, y) for x in (-1, 1) for y in (-1, 1)]
    return [Box((x * (lane / 2 + 0.6), y * (lane / 2 + 0.45)), (1.2, 0.9)) for x, y in signs]


def _clutter(source: random.Random) -> List[Box]:
    return [
        Box(
            (source.uniform(-2.3, 2.3), source.uniform(-1.3, 1.3)),
            (source.uniform(0.1, 0.5), source.uniform(0.1, 0.5)),
            source.uniform(-math.pi, math.pi),
        )
        for _ in range(source.randint(8, 18))
    ]


PLACES: Dict[str, Callable[[random.Random], List[Box]]] = {
    "door": lambda source: _wall_with_gap(source, 0.1),
    "corridor": lambda source: _wall_with_gap(source, source.uniform(0.8, 2.2)),
    "crossing": _crossing,
    "clutter": _clutter,
}
"""The obstacles in the hall, by kind of place."""


def make_room(boxes: Sequence[Box]) -> Room:
    """The hall with boxes in it."""
    x, y = LENGTH / 2, WIDTH / 2
    return Room("hall", (((-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)),), obstacles=tuple(boxes))


def _points(
    free: Sequence[Point], sides: Sequence[int], source: random.Random
) -> Optional[List[Point]]:
    """Free points with some distance between them, one for each of ``sides``: west (-1) or east (1)
    of the middle, or anywhere (0)."""
    found: List[Point] = []
    for side in sides:
        fitting = [
            p
            for p in free
            if p[0] * side >= 0.2 * abs(side) and all(math.dist(p, q) > APART for q in found)
        ]
        if not fitting:
            return None
        found.append(source.choice(fitting))
    return found


def measure(kind: str, seed: int) -> Optional[Dict[str, Any]]:
    """One trial; None if the place has no room for this many robots.

    :param kind: a key of :data:`PLACES`.
    """
    source = random.Random("%s %d" % (kind, seed))
    room = make_room(PLACES[kind](source))
    grid, robots = Grid(room), source.choice((2, 3, 4, 4, 6))
    roomy = [(float(x), float(y)) for x, y in zip(grid.xs[grid.free], grid.ys[grid.free])]
    field = grid.field(source.choice(roomy))
    free = [point for point in roomy if math.isfinite(field.cost(point))]
    through = kind in ("door", "corridor")
    sides = [(1 if index % 2 else -1) if through else 0 for index in range(robots)]
    starts, goals = _points(free, sides, source), _points(free, [-side for side in sides], source)
    if starts is None or goals is None:
        return None
    names = ["robot_%d" % (index + 1) for index in range(robots)]
    team = DrivingTeam(
        room, names, [Pose(x, y, source.uniform(-math.pi, math.pi)) for x, y in starts]
    )
    for name, goal in zip(names, goals):
        team.navigators[name].go(Pose(*goal), team.time, turn=False)
    while team.time < LIMIT and any(navigator.active for navigator in team.navigators.values()):
        team.step()
    ends = [navigator.status for navigator in team.navigators.values()]
    reasons = [
        navigator.reason
        for navigator in team.navigators.values()
        if navigator.status is NavigationStatus.FAILED
    ]
    contacts = team.physics.contacts
    team.close()
    return {
        "place": kind,
        "seed": seed,
        "robots": robots,
        "touches": sum(contacts.robots.values()),
        "touches_of_solids": sum(contacts.solids.values()),
        "arrived": ends.count(NavigationStatus.REACHED),
        "given_up": ends.count(NavigationStatus.FAILED),
        "still_on_the_way": robots
        - ends.count(NavigationStatus.REACHED)
        - ends.count(NavigationStatus.FAILED),
        "reasons": reasons,
        "seconds": round(team.time, 1),
    }


def summary(results: Sequence[Dict[str, Any]]) -> str:
    """A table with a line for each kind of place."""
    rows: List[Sequence[Any]] = []
    for kind in PLACES:
        of_kind = [result for result in results if result["place"] == kind]
        keys = ("robots", "arrived", "touches", "touches_of_solids", "given_up", "still_on_the_way")
        sums: Tuple[int, ...] = tuple(sum(result[key] for result in of_kind) for key in keys)
        rows.append([kind, len(of_kind), *sums])
    head = (
        "place",
        "trials",
        "robots",
        "arrived",
        "touches",
        "with walls",
        "given up",
        "still on the way",
    )
    return table(head, rows)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0: no robot touched anything or failed to arrive, 1: otherwise."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.room_tight", description=__doc__.split(":")[0]
    )
    parser.add_argument("--trials", type=int, default=30, help="of each kind of place (30)")
    parser.add_argument("--place", choices=list(PLACES), help="one kind of place only")
    parser.add_argument("--seed", type=int, default=0, help="of the first trial (0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    results: List[Dict[str, Any]] = []
    for kind in [args.place] if args.place else PLACES:
        for seed in range(args.seed, args.seed + args.trials):
            result = measure(kind, seed)
            if result is None:
                continue
            results.append(result)
            if any(result[fault] for fault in _FAULTS):
                print("%s, seed %d: %s" % (kind, seed, result), file=sys.stderr, flush=True)
            told = "%s, seed %d: %d robots, %g s" % (
                kind,
                seed,
                result["robots"],
                result["seconds"],
            )
            print("; given up: ".join([told, *result["reasons"]]), file=sys.stderr, flush=True)
    machine = describe_machine(("numpy", "scipy", "pybullet"))
    if args.json:
        print(json.dumps({"machine": machine, "results": results}, indent=2))
    else:
        print(machine_line(machine) + "\n")
        print(summary(results))
    return int(any(result[fault] for result in results for fault in _FAULTS))


if __name__ == "__main__":
    sys.exit(main())
