"""The plans that the benchmarks run: the net of thesis Figure 6.1, and rings of any size (Figure
6.3)."""

from __future__ import annotations

import os
from dataclasses import replace

from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.plan import Plan, RobotSpec

MODULE = "benchmarks.load"
"""Has the functions below; a process that runs them has to allow it."""

LOOP = "benchmarks.load.loop"
BRIEF = "benchmarks.load.brief"
SHORT = "benchmarks.load.short"
INSTANT = "benchmarks.load.instant"


def tokens_plan(function: str = LOOP) -> Plan:
    """The plan of ``plans/tokens`` (thesis 6.1.1): seven places, six of them with an action. Here
    the action is one of :mod:`~benchmarks.load`, so that the plan runs from
    any folder."""
    plan = read_plan(os.path.join(plans_folder(), "tokens"))
    return replace(plan, actions={place: FunctionAction(function, place) for place in plan.actions})


def ring_plan(places: int, robots: int, function: str = LOOP) -> Plan:
    """A ring of ``places`` action places (thesis 6.1.2 and 6.1.3) with ``robots`` robots,
    distributed round-robin over the places."""
    names = ["p%d" % k for k in range(1, places + 1)]
    net = NetBuilder("ring_%d" % places)
    for k, name in enumerate(names):
        net.place(name, tokens=len(range(k, robots, places)))
    for k, name in enumerate(names):
        following = names[(k + 1) % places]
        net.exponential("t%d" % (k + 1), rate=1.25, servers=None, inputs=name, outputs=following)
    return Plan(
        net=net.build(),
        name="ring_%d" % places,
        actions={name: FunctionAction(function, name) for name in names},
        robots=tuple(RobotSpec("robot_%d" % (k + 1), names[k % places]) for k in range(robots)),
        spawn=tuple(names),
    ).validate()


def grid_plan(side: int, robots: int) -> Plan:
    """Robots that wander over a grid of ``side`` by ``side`` cells: in each cell an action of 2 s,
    then a decision in which neighbour to go, by weights. It has two places per cell."""
    net = NetBuilder("grid_%d" % side)
    cells = [(row, column) for row in range(side) for column in range(side)]
    for number, (row, column) in enumerate(cells):
        tokens = len(range(number, robots, len(cells)))
        net.place("work_%d_%d" % (row, column), tokens=tokens)
        net.place("leave_%d_%d" % (row, column))
    for row, column in cells:
        here = "%d_%d" % (row, column)
        net.exponential(
            "done_" + here, rate=0.5, servers=None, inputs="work_" + here, outputs="leave_" + here
        )
        for name, next_row, next_column in (
            ("north", row - 1, column),
            ("south", row + 1, column),
            ("west", row, column - 1),
            ("east", row, column + 1),
        ):
            if 0 <= next_row < side and 0 <= next_column < side:
                target = "work_%d_%d" % (next_row, next_column)
                net.immediate(name + "_" + here, inputs="leave_" + here, outputs=target)
    works = ["work_%d_%d" % cell for cell in cells]
    actions = {name: FunctionAction(LOOP, name) for name in works}
    return Plan(
        net=net.build(),
        name="grid_%d" % side,
        actions={**actions, **{name.replace("work", "leave"): None for name in works}},
        robots=tuple(RobotSpec("robot_%d" % (k + 1), works[k % len(works)]) for k in range(robots)),
        spawn=tuple(works),
    ).validate()
