"""The scaling experiments of thesis 6.1, extended tenfold, and the throughput with instant actions.

Each experiment is a list of points (robots, places); each point is one run with its own
``roslaunch`` on a master that the experiments share.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from benchmarks.harness.processes import MachineLoad, quiet_machine
from benchmarks.harness.team import LaunchedTeam
from benchmarks.plans import INSTANT, ring_plan, tokens_plan
from benchmarks.token_game import standalone_rate
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Plan, Synchronisation

Tell = Callable[[str], None]
Point = Tuple[int, int]


class Experiment(NamedTuple):
    """``points`` and ``quick`` hold (robots, places); ``plan`` makes the plan of a point."""

    title: str
    source: str
    points: Tuple[Point, ...]
    quick: Tuple[Point, ...]
    plan: Callable[[int, int], Plan]
    timeout: float = 90.0
    """Seconds after which a point is given up if not all robots have fired."""

    def chosen(self, quick: bool, sizes: Sequence[int]) -> Tuple[Point, ...]:
        """The points to run: all, the quick ones, or those whose growing number is among ``sizes``,
        which may exceed the listed points."""
        if not sizes:
            return self.quick if quick else self.points
        robots, places = self.points[0]
        if any(point[1] != places for point in self.points):
            return tuple((robots, n) for n in sizes)
        return tuple((n, places) for n in sizes)


def _tokens(robots: int, places: int) -> Plan:
    return tokens_plan().for_robots(robots)


def _instant(robots: int, places: int) -> Plan:
    return tokens_plan(INSTANT).for_robots(robots)


def _ring(robots: int, places: int) -> Plan:
    return ring_plan(places, robots)


def _of_tokens(robots: Iterable[int]) -> Tuple[Point, ...]:
    return tuple((n, 7) for n in robots)


EXPERIMENTS: Dict[str, Experiment] = {
    "tokens": Experiment(
        "More robots, seven places",
        "thesis 6.1.1, Figure 6.2",
        _of_tokens([*range(1, 16), 20, 30, 40, 50]),
        _of_tokens([1, 3, 5, 13]),
        _tokens,
    ),
    "places": Experiment(
        "More places, five robots",
        "thesis 6.1.2, Figure 6.4",
        tuple((5, n) for n in [*range(2, 17), 20, 30, 50, 75, 100]),
        ((5, 2), (5, 7), (5, 16)),
        _ring,
    ),
    "one": Experiment(
        "More places, one robot",
        "thesis 6.1.3, Figure 6.6",
        tuple((1, n) for n in [*range(2, 36), *range(40, 101, 5), 200, 300, 500, 750, 1000]),
        ((1, 2), (1, 35), (1, 100)),
        _ring,
    ),
    "large": Experiment(
        "A large team: 50 robots, 20 places each",
        "1,000 action servers",
        ((50, 20),),
        ((20, 20),),
        _ring,
        timeout=240.0,
    ),
    "throughput": Experiment(
        "Actions that return at once",
        "plans/tokens",
        _of_tokens([1, 2, 3, 5, 8, 13]),
        _of_tokens([1, 3]),
        _instant,
    ),
}
"""The experiments by their names on the command line."""


THESIS_START = 1200.0
"""Seconds that the thesis waited for the execution to start with more than 13 tokens ("around 20
minutes", 6.1.1)."""


def thesis_start(robots: int) -> Optional[float]:
    """The start-up time (s) that the thesis reports in 6.1.1; None if it reports none."""
    return THESIS_START if robots > 13 else None


def run_point(
    name: str, robots: int, places: int, mode: str, window: float, partial: bool = False
) -> Dict[str, Any]:
    """Run one point of an experiment; returns its figures by name. A point that fails has a note.

    :param window: length (s) of the measurement.
    :param partial: whether to use partial synchronisation.
    """
    experiment = EXPERIMENTS[name]
    plan = experiment.plan(robots, places)
    if partial:
        plan = replace(plan, synchronisation=Synchronisation.PARTIAL)
    servers = robots * sum(1 for action in plan.actions.values() if action is not None)
    row: Dict[str, Any] = {"servers": servers, "note": ""}
    faults: List[str] = []
    team = LaunchedTeam(plan, mode)
    try:
        with team:
            try:
                team.await_steady(experiment.timeout)
                row.update(_figures(team, window))
            finally:
                faults = team.programs.errors("launch")
            team.end()
            violation = team.verdict().violation
    except ExecutionError as error:
        row["note"] = error.message
    else:
        if violation is not None:
            faults.append("the logs contradict each other: rule %d: %s" % violation)
    if faults:
        row["note"] += "; first fault: " * bool(row["note"]) + faults[0][:300]
    return {**row, "faults": len(faults)}


def _figures(team: LaunchedTeam, window: float) -> Dict[str, Any]:
    """What a team does and needs; times are in seconds from the start of ``roslaunch``."""
    found = team.measure(window)
    logs = team.logs.values()
    goals = [[r["mono"] for r in log.of("goal") if r["attempt"] == 1] for log in logs]
    return {
        "started_s": round(max(log.records[0]["mono"] for log in logs) - team.began, 2),
        "first_goals_s": round(max(times[0] for times in goals) - team.began, 2),
        "all_fired_s": round(max(times[1] for times in goals) - team.began, 2),
        "firings_per_s": round(found.firings_per_s, 2),
        "cpu_percent_of_core": round(100 * found.cpu["robots"], 1),
        "cpu_seconds": round(found.cost.cpu_seconds, 2),
        "processes": found.cost.processes,
        "pss_mb": round(found.cost.pss_mb, 1),
        "threads": found.cost.threads,
        "descriptors": found.cost.descriptors,
        "machine_cpu_percent": round(found.machine.cpu_percent, 1),
        "machine_memory_percent": round(found.machine.memory_percent, 1),
    }


def standalone_results(quick: bool, seconds: float, tell: Tell) -> List[Dict[str, Any]]:
    """Firings per second without ROS, for the teams of the throughput experiment."""
    experiment = EXPERIMENTS["throughput"]
    rows = []
    for robots, _ in experiment.quick if quick else experiment.points:
        tell("throughput: %d agents, standalone" % robots)
        began = time.process_time()
        rate = standalone_rate(_instant(robots, 7), seconds, record=True)
        spent = (time.process_time() - began) / seconds
        rows.append(
            {
                "experiment": "throughput",
                "mode": "standalone",
                "robots": robots,
                "places": 7,
                "firings_per_s": round(rate, 1),
                "cpu_percent_of_core": round(100 * spent, 1),
            }
        )
    return rows


def baseline() -> MachineLoad:
    """The load of the machine before anything runs (in the thesis: 0.8 % of the processors, 25.9 %
    of the memory)."""
    return quiet_machine()
