"""Decision problems of the literature as nets with choices: whoever decides chooses among immediate
transitions of weight 0."""

from __future__ import annotations

from typing import Dict, Optional

import numpy as np

from benchmarks.decisions import automaton_of
from benchmarks.literature.answers import WIDTH, Between
from benchmarks.literature.chains import cluster
from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.analysis.decisions.automaton import Rewards
from gspn_framework_package.analysis.decisions.solving.optima import optimum
from gspn_framework_package.analysis.state_space.space import explore
from gspn_framework_package.model.action import Action, CommandAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan, RobotSpec

JOBS = {5: 2, 10: 3}
"""Number of jobs -> number of processors."""

WIDER = (1e-8, 1e-7, 1e-6)
"""Widths that are tried next, where rounding does not allow the narrowest: rare ends take long."""

STAGES = {10: (10, 10.0), 5_010: (5_000, 10.0), 5_100: (5_000, 100.0)}
"""Name of an instance of :func:`erlang` -> stages, and their rate."""


def stream(n: int) -> Net:
    """A client that receives and plays ``n`` packages of a video, of Quatmann, Junges and Katoen
    (2017): when one has come and nothing plays, it starts to play, or tries to go on buffering,
    which fails once in a hundred times."""
    net = NetBuilder("stream_%d" % n).place("idle", tokens=1).place("left", tokens=n)
    for place in ("stored", "played", "playing", "buffering", "chance", "done"):
        net.place(place)
    net.exponential("receive", 4.0, inputs=["buffering", "left"], outputs=["idle", "stored"])
    net.exponential("arrive", 4.0, inputs=["playing", "left"], outputs=["playing", "stored"])
    net.exponential("play", 4.0, inputs=["playing", "stored"], outputs=["playing", "played"])
    net.exponential(
        "underrun", 4.0, inputs=["playing", "left"], outputs=["idle", "left"], inhibitors="stored"
    )
    net.exponential("end", 4.0, inputs="playing", outputs="done", inhibitors=["left", "stored"])
    net.immediate(
        "wait", inputs=["idle", "left"], outputs=["buffering", "left"], inhibitors="stored"
    )
    net.immediate(
        "keep", 0, inputs=["idle", "left", "stored"], outputs=["chance", "left", "stored"]
    )
    net.immediate("kept", 0.99, inputs="chance", outputs="buffering")
    net.immediate("lost", 0.01, inputs=["chance", "stored"], outputs=["playing", "played"])
    net.immediate(
        "start", 0, inputs=["idle", "stored"], outputs=["playing", "played"], inhibitors="played"
    )
    net.immediate(
        "restart", 0, inputs=["idle", "stored", "played"], outputs=["playing", "played", "played"]
    )
    return net.build()


def jobs(n: int) -> Net:
    """The scheduling of ``n`` jobs on equal processors (Bruno, Downey and Frederickson 1981, as
    Quatmann, Junges and Katoen, 2017, model it): the i-th has the rate i mod 3 + 1, and at the end
    of a job all processors are assigned anew."""
    net = NetBuilder("jobs_%d" % n).place("choosing", tokens=1).place("free", tokens=JOBS[n])
    net.place("finished").place("unfinished", tokens=n).place("clearing")
    for kind in range(3):
        waits, runs = "waits%d" % kind, "runs%d" % kind
        count = sum(1 for job in range(1, n + 1) if job % 3 == kind)
        net.place(waits, tokens=count).place(runs)
        net.immediate(
            "assign%d" % kind, 0, inputs=["choosing", "free", waits], outputs=["choosing", runs]
        )
        net.exponential(
            "finish%d" % kind,
            "%d * #%s" % (kind + 1, runs),
            inputs=[runs, "choosing", "unfinished"],
            outputs=["finished", "free", "clearing"],
        )
        net.immediate(
            "clear%d" % kind,
            priority=2,
            inputs=["clearing", runs],
            outputs=["clearing", "free", waits],
        )
    net.immediate("cleared", inputs="clearing", outputs="choosing")
    return net.build()


def repaired_cluster(n: int) -> Net:
    """The workstation cluster of Haverkort, Hermanns and Katoen (2000) with ``n`` workstations on
    each side, whose repairman chooses what is repaired next, without an inspection."""
    return cluster(n, choice=True)


def erlang(instance: int) -> Net:
    """The Erlang stages of Zhang and Neuhäußer (2010): one way takes so many stages to the goal,
    the other leads there once in two times, and otherwise never."""
    stages, rate = STAGES[instance]
    net = NetBuilder("erlang_%d" % instance).place("start", tokens=1).place("left", tokens=stages)
    for place in ("short", "halfway", "long", "chain", "goal", "lost"):
        net.place(place)
    net.immediate("a", 0, inputs="start", outputs="short")
    net.immediate("b", 0, inputs="start", outputs="long")
    net.exponential("first_a", 1.0, inputs="short", outputs="halfway")
    net.exponential("first_b", 1.0, inputs="long", outputs="chain")
    for end in ("goal", "lost"):
        net.exponential("to_" + end, 0.5, inputs="halfway", outputs=end)
    net.exponential("stage", rate, inputs={"chain": 1, "left": 2}, outputs=["chain", "left"])
    net.exponential("last", rate, inputs=["chain", "left"], outputs="goal", inhibitors={"left": 2})
    return net.build()


WAYS = {
    "12": (15.20, 15.68),
    "13": (9.13, 9.13),
    "14": (17.75, 18.03),
    "23": (14.79, 13.30),
    "25": (20.45, 20.43),
    "26": (25.39, 24.30),
    "34": (15.46, 16.11),
    "35": (23.50, 24.05),
    "36": (19.84, 19.32),
    "37": (24.64, 24.64),
    "46": (24.91, 23.94),
    "47": (20.19, 19.67),
    "56": (16.07, 15.09),
    "58": (18.67, 17.82),
    "67": (17.05, 18.08),
    "68": (7.60, 7.60),
    "78": (18.26, 17.84),
}
"""Two nodes of the museum -> mean time (s) from the first to the second, and back."""

CLOSED = {"2": 0.1, "3": 0.9, "4": 0.5, "5": 0.1, "6": 0.9, "7": 0.5}
"""Node with a door -> how often it is closed."""

LEVEL = ("12", "13", "14", "23", "34", "56", "67")
"""The ways that lead through no door. Any other leads through that of its first node."""

SHORTEST, EVERY = 1, 2
"""Which ways the robot may take in :func:`museum`."""


def museum(ways: int) -> Net:
    """The way through a museum (Street, Grubb and Mansouri, *Planning under Uncertainty from
    Behaviour Trees*, 2025): a robot looks at a door when it is there, and opens one that is closed
    in 30 s. With :data:`SHORTEST` it does as their initial tree does, and takes the shortest way,
    1, 3, 6 and 8, whatever the doors are; with :data:`EVERY` it chooses among all ways."""
    net = NetBuilder("museum_%d" % ways)
    for node in "12345678":
        net.place("v" + node, tokens=int(node == "1"))
    for node, closed in CLOSED.items():
        here, unknown = "v" + node, "unknown" + node
        looking, shut, opening, free = (w + node for w in ("looking", "closed", "opening", "open"))
        net.place(unknown, tokens=1)
        for place in (looking, shut, opening, free):
            net.place(place)
        net.immediate("look" + node, 0, inputs=[here, unknown], outputs=looking)
        net.immediate("finds_closed" + node, closed, inputs=looking, outputs=[here, shut])
        net.immediate("finds_open" + node, 1 - closed, inputs=looking, outputs=[here, free])
        net.immediate("opens" + node, 0, inputs=[here, shut], outputs=opening)
        net.exponential("opened" + node, 1 / 30, inputs=opening, outputs=[here, free])
    for way, (there, back) in WAYS.items():
        for seconds, a, b in ((there, way[0], way[1]), (back, way[1], way[0])):
            if ways == SHORTEST and a + b not in ("13", "36", "68"):
                continue
            door = [] if way in LEVEL else ["open" + way[0]]
            going = "going" + a + b
            net.place(going)
            net.immediate("go" + a + b, 0, inputs=["v" + a, *door], outputs=[going, *door])
            net.exponential("comes" + a + b, 1 / seconds, inputs=going, outputs="v" + b)
    return net.build()


def museum_plan(ways: int) -> Plan:
    """The same as a plan of one robot, for ``gspn optimise``: what is known of the doors are
    resources, and what a robot finds at a door is chance."""
    net = museum(ways)
    doors = frozenset(what + node for what in ("unknown", "closed", "open") for node in CLOSED)
    actions: Dict[str, Action] = {
        place.name: CommandAction(["true"]) if place.name.startswith(("going", "opening")) else None
        for place in net.places
        if place.name not in doors
    }
    return Plan(
        net=net,
        name=net.name,
        actions=actions,
        resource_places=doors,
        robots=(RobotSpec("robot_1", "v1"),),
        chance=frozenset("looking" + node for node in CLOSED),
        until="v8 >= 1",
        simulate_environment=True,
    ).validate()


class Choices:
    """The decision problem of a net.

    :param net: whoever decides chooses among its immediate transitions of weight 0.
    """

    def __init__(self, net: Net) -> None:
        self.net = net
        self.space = explore(net, limit=10**8)
        self.automaton = automaton_of(self.space)

    def best(
        self,
        aim: Aim,
        goal: str,
        *,
        maximise: bool,
        place: Optional[str] = None,
        fires: Optional[str] = None,
        share: float = 1.0,
    ) -> Between:
        """The best probability or mean until a condition holds.

        :param place: what costs: a token in this place for a second; None: time.
        :param fires: what costs instead: a firing of this transition.
        :param share: what a token costs for a second.
        """
        automaton, space = self.automaton, self.space
        rate = np.ones(len(automaton))
        impulse = np.zeros(len(automaton.targets))
        if place is not None:
            rate = share * space.column(self.net.place_index[place])
        if fires is not None:
            rate = np.zeros(len(automaton))
            impulse[automaton.fired == self.net.transition_index[fires]] = 1.0
        for width in (WIDTH, *WIDER):
            try:
                found = optimum(
                    automaton,
                    aim,
                    None if aim is Aim.REACH else Rewards(rate, impulse),
                    goal=space.holds(goal),
                    maximise=maximise,
                    width=width,
                )
                break
            except LimitError:
                if width == WIDER[-1]:
                    raise
        return Between(found.lower, found.upper)
