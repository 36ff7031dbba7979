"""The solar farm of the multi-robot GSPNR toolbox: ``python3 -m
benchmarks.solar_farm``.

The model is that of Azevedo, Matos, Lima and Avendaño, *Petri Net Toolbox for Multi-Robot Planning
under Uncertainty* (Applied Sciences 11, 2021), with the numbers of its authors' files: UAVs with
two levels of battery inspect four panels, and a UGV drives to those that are discharged and charges
them. A round ends when all panels have been inspected. The policy with the highest reward per
second is computed, beside that of a team that chooses at random.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from benchmarks.literature.answers import Between
from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.plans import INSTANT
from gspn_framework_package.analysis.arrays import Floats
from gspn_framework_package.analysis.decisions.aims import Aim, Objective
from gspn_framework_package.analysis.decisions.automaton import WAIT
from gspn_framework_package.analysis.decisions.problem import DecisionProblem, SizedTeam
from gspn_framework_package.analysis.decisions.solving.evaluation import evaluate_policy
from gspn_framework_package.analysis.decisions.solving.optima import optimum
from gspn_framework_package.model.action import Action, FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.plan import Plan, RobotSpec

CENTRE = "centre"
PANELS = ("panel1", "panel2", "panel3", "panel4")
SECONDS = {
    ("panel1", "panel2"): 17.0,
    ("panel2", "panel3"): 11.0,
    ("panel2", CENTRE): 25.0,
    (CENTRE, "panel4"): 29.0,
}
"""Edge -> mean time that it takes, in both directions."""

INSPECTING, CHARGING, NEXT_ROUND, WAITING = 0.0111, 0.005555556, 2.0, 1.0
"""Rates (1/s): of an inspection, of charging, of the next round when all panels are inspected, and
of the UGV's waiting."""

DISCHARGED = 0.2
"""How often a UAV is discharged after an inspection, or after a flight that does not end in the
centre."""

INSPECTION, STRANDED = 200.0, -1.0
"""The reward for an inspection, and that for each second of a discharged UAV."""


HOUR = 3600.0
"""How long the authors simulate a run (s)."""


def solar_farm_plan(uavs: int) -> Plan:
    """The plan, with that many UAVs and a UGV, all in the centre. Charged UAVs are in places that
    end with ``_B1``, discharged ones in those with ``_B0``."""
    net = NetBuilder("solar_farm")
    idle: Dict[str, None] = {}
    busy: List[str] = []

    def rest(name: str, tokens: int = 0) -> str:
        if name not in idle:
            idle[name] = None
            net.place(name, tokens)
        return name

    def act(name: str, rate: float, source: Sequence[str], output: Sequence[str]) -> None:
        net.exponential(name, rate, None, inputs=source, outputs=output)

    def work(name: str) -> str:
        net.place(name)
        busy.append(name)
        return name

    def uncertain(after: str, where: str) -> None:
        """The battery after something: chance."""
        for level, share in (("B1", 1 - DISCHARGED), ("B0", DISCHARGED)):
            name = "%s_%s" % (after, level)
            net.immediate(name, share, inputs=after, outputs=rest("%s_%s" % (where, level)))

    rest(CENTRE + "_B1", uavs)
    rest(CENTRE + "_UGV", 1)
    resources = ["inspections", *("due_" + panel for panel in PANELS)]
    for name in resources:
        net.place(name, int(name != "inspections"))
    chance = []
    for (a, b), seconds in (*SECONDS.items(), *((k[::-1], v) for k, v in SECONDS.items())):
        for kind in ("B1", "UGV"):
            way = "%s_%s_%s" % (a, b, kind)
            start = rest("%s_%s" % (a, kind))
            net.immediate("go_" + way, inputs=start, outputs=work("to_" + way))
            lands = kind == "B1" and b != CENTRE
            end = rest("landed_" + way if lands else "%s_%s" % (b, kind))
            act("arrived_" + way, 1 / seconds, ["to_" + way], [end])
            if lands:
                chance.append(end)
                uncertain(end, b)
    for panel in PANELS:
        charged, ugv = panel + "_B1", panel + "_UGV"
        net.immediate(
            "inspect_" + panel,
            inputs=[charged, "due_" + panel],
            outputs=[work("inspecting_" + panel), "inspections"],
        )
        end = rest("inspected_" + panel)
        act("finished_" + panel, INSPECTING, ["inspecting_" + panel], [end])
        chance.append(end)
        uncertain(end, panel)
        pair = [work("charging_" + panel), work("lending_" + panel)]
        net.immediate("charge_" + panel, inputs=[panel + "_B0", ugv], outputs=pair)
        act("charged_" + panel, CHARGING, pair, [charged, ugv])
        net.immediate("wait_" + panel, inputs=ugv, outputs=work("waiting_" + panel))
        act("waited_" + panel, WAITING, ["waiting_" + panel], [ugv])
    every = ["due_" + panel for panel in PANELS]
    net.exponential("next_round", NEXT_ROUND, inputs={"inspections": len(PANELS)}, outputs=every)
    actions: Dict[str, Action] = {**idle}
    actions.update((name, FunctionAction(INSTANT, name)) for name in busy)
    robots = [RobotSpec("uav_%d" % (k + 1), CENTRE + "_B1") for k in range(uavs)]
    return Plan(
        net=net.build(),
        name="solar_farm",
        actions=actions,
        resource_places=frozenset(resources),
        robots=(*robots, RobotSpec("ugv", CENTRE + "_UGV")),
        simulate_environment=True,
        chance=frozenset(chance),
    ).validate()


class SolarFarm:
    """The decision problem of a plan of :func:`solar_farm_plan`, solved."""

    def __init__(self, plan: Plan) -> None:
        self.decisions = DecisionProblem(plan, team_sizes=[len(plan.robots)])
        self.team = self.decisions.teams[0]
        rewards = {"inspect_" + panel: INSPECTION for panel in PANELS}
        rewards.update({panel + "_B0": STRANDED for panel in PANELS})
        self.earned = self.decisions.rewards(self.team, Objective.long_run(rewards))
        allowed = self.decisions.allowed(self.team)
        self.best = optimum(self.team.automaton, Aim.LONG_RUN, self.earned, allowed=allowed)

    def in_first(self, seconds: float) -> Between:
        """What the best policy of the long run earns per second (estimated) in the first so many
        seconds, which have to be enough to forget the start: all UAVs are charged then, which is
        worth as much as that state's bias is above the mean one."""
        automaton, row_of = self.team.automaton, self.best.row_of
        weights = np.zeros(len(automaton.choices))
        weights[row_of[row_of >= 0]] = 1.0
        found = evaluate_policy(automaton, Aim.LONG_RUN, self.earned, weights)
        bias = np.where(found.sojourn > 0, found.values, 0.0)
        start = sum(chance * found.values[state] for state, chance in automaton.initial)
        head_start = (start - found.sojourn @ bias) / seconds
        return Between(found.lower + head_start, found.upper + head_start, certified=False)


def solve(uavs: int) -> Dict[str, Any]:
    """The best policy's reward per second, in the long run and in the first hour, and that of
    random choices."""
    plan = solar_farm_plan(uavs)
    started = time.perf_counter()
    farm = SolarFarm(plan)
    seconds = time.perf_counter() - started
    automaton, choices = farm.team.automaton, _at_random(farm.decisions, farm.team)
    at_random = evaluate_policy(automaton, Aim.LONG_RUN, farm.earned, choices)
    return {
        "uavs": uavs,
        "places": len(plan.net.places),
        "transitions": len(plan.net.transitions),
        "states": len(automaton),
        "lower": farm.best.lower,
        "upper": farm.best.upper,
        "first_hour": farm.in_first(HOUR).lower,
        "random": at_random.value,
        "seconds": seconds,
    }


def _at_random(decisions: DecisionProblem, team: SizedTeam) -> Floats:
    """The weights of the rows if each is as likely as the others of its state."""
    automaton = team.automaton
    allowed = decisions.allowed(team) & (automaton.choices != WAIT)
    rows = np.bincount(automaton.row_states, weights=allowed, minlength=len(automaton))
    weights: Floats = allowed / np.maximum(rows, 1)[automaton.row_states]
    return weights


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark; returns 0."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.solar_farm", description="the solar farm of the GSPNR toolbox"
    )
    parser.add_argument("--uavs", type=int, nargs="+", default=[1, 2], help="how many (1 2)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    machine, results = describe_machine(("numpy", "scipy", "numba")), [solve(n) for n in args.uavs]
    if args.json:
        print(json.dumps({"machine": machine, "results": results}, indent=2))
        return 0
    head = ["UAVs", "states", "reward/s, best, certified", "in the first hour", "at random", "s"]
    rows = [
        [
            r["uavs"],
            r["states"],
            "%.9g to %.9g" % (r["lower"], r["upper"]),
            "%.6g" % r["first_hour"],
            "%.6g" % r["random"],
            "%.2f" % r["seconds"],
        ]
        for r in results
    ]
    print(machine_line(machine) + "\n\n" + table(head, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
