"""Writes net.xml, policy.json, plan.json and, if Graphviz is there, net.svg: python3 make_plan.py

It reads site.tmap2, a map of topological_navigation, and tasks.yaml, what the robots do there.
"""

import json
import math
import os
import shutil
from collections import deque

from gspn_framework_package.formats.dot import net_graph, render
from gspn_framework_package.formats.registry import write_net
from gspn_framework_package.formats.yaml_file import read_yaml
from gspn_framework_package.making.site_map import read_map
from gspn_framework_package.model.builder import NetBuilder

HERE = os.path.dirname(os.path.abspath(__file__))
DESCRIPTION = (
    "Robots inspect four nodes of a site, which become due again and again, and charge at its dock."
)


class Site:
    """The nodes and edges of a map of topological_navigation, and the tasks there."""

    def __init__(self, folder=HERE, levels=None):
        site = read_map(os.path.join(folder, "site.tmap2"))
        self.tasks = read_yaml(os.path.join(folder, "tasks.yaml")).data
        self.at = {name: (node.x, node.y) for name, node in site.nodes.items()}
        self.edges = [(edge.source, edge.target) for edge in site.edges]
        self.narrow = {}
        """Narrow edge, in both directions -> the resource place with a token while it is free."""
        for edge in self.tasks["narrow"]:
            a, b = edge.split("_")
            self.narrow[a, b] = self.narrow[b, a] = "Free_" + edge
        self.dock = self.tasks["dock"]
        self.free = [*dict.fromkeys(self.narrow.values()), "Free_dock"]
        self.inspected = list(self.tasks["due_again_after"])
        self.levels = list(self.tasks["battery"])[:levels]
        """Of the battery, from full to low."""
        charge = self.tasks["charge"].items()
        self.charge = {level: time for level, time in charge if level in self.levels}

    def below(self, level):
        """The level below this one; None: there is none."""
        return dict(zip(self.levels, self.levels[1:])).get(level)

    def seconds(self, a, b):
        """The mean time that an edge takes."""
        (ax, ay), (bx, by) = self.at[a], self.at[b]
        return math.hypot(ax - bx, ay - by) / self.tasks["drive"]["speed"]

    def ways_to(self, target):
        """Node -> (number of edges to the target, next node on the way there)."""
        found = {target: (0, target)}
        front = deque([target])
        while front:
            node = front.popleft()
            for a, b in self.edges:
                if b == node and a not in found:
                    found[a] = (found[node][0] + 1, node)
                    front.append(a)
        return found


def durations(site):
    """Action place -> (mean, shape) of the time that its action takes; None: a robot decides
    there."""
    tasks = site.tasks
    found = {}
    for level in site.levels:
        for node in site.at:
            found["At_%s_%s" % (node, level)] = None
        for a, b in site.edges:
            time = (site.seconds(a, b), tasks["drive"]["shape"])
            found["Drive_%s_%s_%s" % (a, b, level)] = time
        for node in site.inspected:
            time = (tasks["inspect"]["mean"], tasks["inspect"]["shape"])
            found["Inspect_%s_%s" % (node, level)] = time
    for level, time in site.charge.items():
        found["Charge_" + level] = (time["mean"], time["shape"])
    found["Stranded"] = (tasks["stranded"]["mean"], tasks["stranded"]["shape"])
    return found


def make_net(site):
    """The net. The level of the battery is part of a robot's place, so that robots stay
    exchangeable."""
    tasks, draw = site.tasks, Drawing(site)
    net = NetBuilder("inspection")
    starts = ["At_%s_%s" % (node, site.levels[0]) for node in tasks["robots"].values()]
    for place in durations(site):
        net.place(place, starts.count(place), position=draw.place(place))
    for number, node in enumerate(site.inspected):
        net.place("Due_" + node, 1, position=draw.top(number, 0))
        net.place("Fresh_" + node, position=draw.top(number, 2))
        rate = 1 / tasks["due_again_after"][node]
        net.exponential(
            "Falls_due_" + node,
            rate,
            inputs="Fresh_" + node,
            outputs="Due_" + node,
            position=draw.top(number, 1),
        )
    for place in site.free:
        net.place(place, 1, position=draw.free(place))
    for level in site.levels:
        for a, b in site.edges:
            _drive(net, site, draw, a, b, level)
        for node in site.inspected:
            here, at = "%s_%s" % (node, level), "At_%s_%s" % (node, level)
            net.immediate(
                "Start_" + here,
                inputs=[at, "Due_" + node],
                outputs="Inspect_" + here,
                position=draw.beside(node, level, 0.5, -1),
            )
            net.exponential(
                "Inspected_" + here,
                1 / tasks["inspect"]["mean"],
                None,
                inputs="Inspect_" + here,
                outputs=[at, "Fresh_" + node],
                position=draw.beside(node, level, 0.5, 1),
            )
    full = "At_%s_%s" % (site.dock, site.levels[0])
    for level, time in site.charge.items():
        net.immediate(
            "Dock_" + level,
            inputs=["At_%s_%s" % (site.dock, level), "Free_dock"],
            outputs="Charge_" + level,
            position=draw.beside(site.dock, level, 0.5, -1),
        )
        net.exponential(
            "Charged_" + level,
            1 / time["mean"],
            None,
            inputs="Charge_" + level,
            outputs=[full, "Free_dock"],
            position=draw.beside(site.dock, level, 0.5, 1),
        )
    net.exponential(
        "Recovered",
        1 / tasks["stranded"]["mean"],
        None,
        inputs="Stranded",
        outputs=full,
        position=draw.top(len(site.inspected), 1),
    )
    return net.build()


def _drive(net, site, draw, a, b, level):
    edge, drained = "%s_%s_%s" % (a, b, level), site.tasks["battery"][level]
    free = [site.narrow[a, b]] if (a, b) in site.narrow else []
    net.immediate(
        "Go_" + edge,
        inputs=["At_%s_%s" % (a, level), *free],
        outputs="Drive_" + edge,
        position=draw.along(a, b, level, 0.25),
    )
    lower = site.below(level)
    for name, share, target in (
        ("Arrive_", 1 - drained, "At_%s_%s" % (b, level)),
        ("Drain_", drained, "At_%s_%s" % (b, lower) if lower else "Stranded"),
    ):
        net.exponential(
            name + edge,
            share / site.seconds(a, b),
            None,
            inputs="Drive_" + edge,
            outputs=[target, *free],
            position=draw.along(a, b, level, 0.7, 2.2 if name == "Drain_" else 1.0),
        )


class Drawing:
    """Where things are drawn: the map once for each level of the battery, side by side."""

    CELL, LANE, ASIDE = 640, 60, 200

    def __init__(self, site):
        self.site = site
        xs, ys = (sorted({at[axis] for at in site.at.values()}) for axis in (0, 1))
        self.cells = {
            node: (xs.index(x), len(ys) - 1 - ys.index(y)) for node, (x, y) in site.at.items()
        }
        self.width = (len(xs) + 0.6) * self.CELL

    def node(self, node, level):
        """Where the robots in a node with a level of the battery are."""
        column, row = self.cells[node]
        left = 300 + self.site.levels.index(level) * self.width
        return (left + column * self.CELL, 700 + row * self.CELL)

    def along(self, a, b, level, share, lanes=1.0):
        """A point of the lane from a to b."""
        (ax, ay), (bx, by) = self.node(a, level), self.node(b, level)
        length = math.hypot(bx - ax, by - ay)
        ex, ey = (bx - ax) / length, (by - ay) / length
        off = lanes * self.LANE
        return (round(ax + share * (bx - ax) - ey * off), round(ay + share * (by - ay) + ex * off))

    def beside(self, node, level, share, side=0):
        """A point on the side of the node on which there is no edge."""
        x, y = self.node(node, level)
        taken = {
            tuple(p - q for p, q in zip(self.cells[b], self.cells[a]))
            for a, b in self.site.edges
            if a == node
        }
        dx, dy = next(way for way in ((1, 0), (-1, 0), (0, 1), (0, -1)) if way not in taken)
        out, across = share * self.ASIDE, 55 * side
        return (round(x + dx * out + dy * across), round(y + dy * out + dx * across))

    def place(self, place):
        """Where an action place is."""
        what, *names = place.split("_")
        if what == "At":
            return self.node(*names)
        if what == "Drive":
            return self.along(*names, 0.48)
        if what == "Inspect":
            return self.beside(*names, 1.0)
        if what == "Charge":
            return self.beside(self.site.dock, *names, 1.0)
        return self.top(len(self.site.inspected), 0)

    def free(self, place):
        """Where the resource place of a narrow edge or of the dock is."""
        middle = self.site.levels[len(self.site.levels) // 2]
        if place == "Free_dock":
            return self.beside(self.site.dock, middle, 1.0, -2)
        (ax, ay), (bx, by) = (self.node(node, middle) for node in place.split("_")[1:])
        return (round((ax + bx) / 2), round((ay + by) / 2))

    def top(self, column, row):
        """A point above the maps."""
        return (300 + column * 400, 100 + 120 * row)


def make_policy(site):
    """By hand: to the nearest node that is due, the first of the list if two are as near; to the
    dock if the battery is low, or if nothing is due."""
    ways = {node: site.ways_to(node) for node in site.at}
    due = ["Due_" + node for node in site.inspected]
    rows = []

    def step(node, target, level):
        return "Go_%s_%s_%s" % (node, ways[target][node][1], level)

    def home(node, level):
        if node != site.dock:
            return step(node, site.dock, level)
        return "Dock_" + level if level in site.charge else None

    def row(cells, choice):
        rows.append({"marking": cells, "choose": {choice: 1}})

    for level in site.levels:
        for node in site.at:
            if level == site.levels[-1]:
                row(["-"] * len(due), home(node, level))
                continue
            nearest = sorted(site.inspected, key=lambda target: ways[target][node][0])
            for number, target in enumerate(nearest):
                cells = [0 if other in nearest[:number] else "-" for other in site.inspected]
                cells[site.inspected.index(target)] = 1
                here = node == target
                row(cells, "Start_%s_%s" % (node, level) if here else step(node, target, level))
            if home(node, level):
                row([0] * len(due), home(node, level))
    return {"description": " ".join(make_policy.__doc__.split()), "places": due, "rows": rows}


def make_plan(site):
    """The plan file."""
    first = site.levels[0]
    times = durations(site)
    return {
        "plan": "inspection",
        "description": DESCRIPTION,
        "net": "net.xml",
        "policy": "policy.json",
        "actions": {place: _action(site, place, time) for place, time in times.items()},
        "resource_places": [
            *(what + node for node in site.inspected for what in ("Due_", "Fresh_")),
            *site.free,
        ],
        "environment": "simulate",
        "robots": {
            robot: "At_%s_%s" % (node, first) for robot, node in site.tasks["robots"].items()
        },
        "spawn": ["At_%s_%s" % (node, first) for node in site.tasks["spawn"]],
        "on_evict": _given_back(site),
        "durations": {
            place: {"mean": time[0], "distribution": "gamma", "shape": time[1]}
            for place, time in times.items()
            if time
        },
    }


def _given_back(site):
    """Action place -> what a robot has there that others need."""
    found = {"Charge_" + level: {"Free_dock": 1} for level in site.charge}
    for level in site.levels:
        for (a, b), free in site.narrow.items():
            found["Drive_%s_%s_%s" % (a, b, level)] = {free: 1}
        for node in site.inspected:
            found["Inspect_%s_%s" % (node, level)] = {"Due_" + node: 1}
    return found


def _action(site, place, time):
    if time is None:
        return None
    settings = {"mean": time[0], "shape": time[1]}
    if place.startswith("Drive_"):
        settings["drained"] = site.tasks["battery"][place.split("_")[-1]]
        return {"function": "actions.Drive", "settings": settings}
    return {"function": "actions.TakeTime", "settings": settings}


def main():
    """Write the files beside this one."""
    write(HERE)
    if shutil.which("dot"):
        one_level = net_graph(make_net(Site(levels=1)))
        with open(os.path.join(HERE, "net.svg"), "wb") as file:
            file.write(render(one_level.text()))


def write(folder):
    """Write the net, the policy and the plan into a folder."""
    site = Site()
    write_net(make_net(site), os.path.join(folder, "net.xml"), "pipe")
    for name, content in (("policy.json", make_policy(site)), ("plan.json", make_plan(site))):
        with open(os.path.join(folder, name), "w", encoding="utf-8") as file:
            file.write(json.dumps(content, indent=2) + "\n")


if __name__ == "__main__":
    main()
