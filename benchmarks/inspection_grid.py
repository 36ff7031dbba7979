"""A net of decisions: robots with batteries inspect the nodes of a grid, from a dock in a corner.

A robot at a node chooses a neighbour to go to, or to inspect the node, or at the dock to charge.
Going to a neighbour takes one level of its battery; without any it creeps to the dock, which takes
long. When all nodes are inspected, the site becomes due again after a while. ``WAIT`` rows are not
part of it. Choices are immediate transitions of weight 0.
"""

from __future__ import annotations

from typing import List, Tuple

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Net

GO, INSPECT, CHARGE, RENEW, CREEP = 0.2, 0.1, 0.02, 0.1, 0.005
"""Rates (1/s)."""


def inspection_grid(side: int = 3, robots: int = 1, levels: int = 4) -> Net:
    """The net of a square grid.

    :param side: nodes on each side; the first is the dock, all others are inspected.
    :param levels: levels of a battery, at least 1; an empty one is one more.
    """
    nodes = [(x, y) for x in range(side) for y in range(side)]
    builder = NetBuilder()
    names = {node: "%d%d" % node for node in nodes}
    for node in nodes[1:]:
        builder.place("due_" + names[node], tokens=1)
        builder.place("done_" + names[node])
    for node in nodes:
        for level in range(levels + 1):
            start = robots if node == nodes[0] and level == levels else 0
            builder.place("at_%s_%d" % (names[node], level), tokens=start)
    for node in nodes:
        name = names[node]
        for level in range(levels + 1):
            here = "at_%s_%d" % (name, level)
            if level < levels and node == nodes[0]:
                charging = "charging_%d" % level
                builder.place(charging)
                builder.immediate("charge_%d" % level, weight=0, inputs=here, outputs=charging)
                builder.exponential(
                    "charged_%d" % level,
                    rate=CHARGE,
                    servers=None,
                    inputs=charging,
                    outputs="at_%s_%d" % (name, levels),
                )
            if node != nodes[0]:
                busy = "inspecting_%s_%d" % (name, level)
                builder.place(busy)
                builder.immediate(
                    "inspect_%s_%d" % (name, level),
                    weight=0,
                    inputs=[here, "due_" + name],
                    outputs=busy,
                )
                builder.exponential(
                    "inspected_%s_%d" % (name, level),
                    rate=INSPECT,
                    servers=None,
                    inputs=busy,
                    outputs=[here, "done_" + name],
                )
            if node != nodes[0] and not level:
                creeping = "creeping_%s" % name
                builder.place(creeping)
                builder.immediate("creep_%s" % name, weight=0, inputs=here, outputs=creeping)
                builder.exponential(
                    "crept_%s" % name,
                    rate=CREEP,
                    servers=None,
                    inputs=creeping,
                    outputs="at_%s_0" % names[nodes[0]],
                )
            for other in _neighbours(node, side) if level else []:
                going = "going_%s_%s_%d" % (name, names[other], level)
                builder.place(going)
                builder.immediate(
                    "go_%s_%s_%d" % (name, names[other], level),
                    weight=0,
                    inputs=here,
                    outputs=going,
                )
                builder.exponential(
                    "arrive_%s_%s_%d" % (name, names[other], level),
                    rate=GO,
                    servers=None,
                    inputs=going,
                    outputs="at_%s_%d" % (names[other], level - 1),
                )
    builder.exponential(
        "renew",
        rate=RENEW,
        inputs=["done_" + names[node] for node in nodes[1:]],
        outputs=["due_" + names[node] for node in nodes[1:]],
    )
    return builder.build()


def inspections(net: Net) -> List[str]:
    """The transitions that end an inspection."""
    return [t.name for t in net.transitions if t.name.startswith("inspected_")]


def all_done(net: Net) -> str:
    """The condition that every node is inspected."""
    return " and ".join("%s >= 1" % p.name for p in net.places if p.name.startswith("done_"))


def _neighbours(node: Tuple[int, int], side: int) -> List[Tuple[int, int]]:
    x, y = node
    found = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]
    return [(a, b) for a, b in found if 0 <= a < side and 0 <= b < side]
