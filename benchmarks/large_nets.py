"""Nets of any size, not from the literature, for measuring the limits of the analysis."""

from __future__ import annotations

import random
from typing import Callable, List, Mapping

from gspn_framework_package.model.net import Arc, Net, Place, Transition


def ring(n: int, tokens: int = 1) -> Net:
    """A cycle of ``n`` places, with all tokens in the first."""
    places = [Place("p%d" % i, tokens if i == 0 else 0) for i in range(n)]
    transitions = [Transition("t%d" % i, timed=True) for i in range(n)]
    arcs = []
    for i in range(n):
        arcs += [Arc("p%d" % i, "t%d" % i), Arc("t%d" % i, "p%d" % ((i + 1) % n))]
    return Net(places, transitions, arcs, "ring_%d" % n)


def chain(n: int) -> Net:
    """A sequence of ``n`` places, with a token that ends in the last."""
    whole, last = ring(n), "t%d" % (n - 1)
    arcs = [arc for arc in whole.arcs if last not in arc[:2]]
    return Net(whole.places, whole.transitions[:-1], arcs, whole.name)


def grid(n: int) -> Net:
    """A token that walks over a grid of ``n`` by ``n`` places, from each to its four neighbours."""
    places, transitions, arcs = [], [], []
    for y in range(n):
        for x in range(n):
            here = "p%d_%d" % (x, y)
            places.append(Place(here, int(x == y == 0)))
            for name, i, j in (
                ("right", x + 1, y),
                ("down", x, y + 1),
                ("left", x - 1, y),
                ("up", x, y - 1),
            ):
                if 0 <= i < n and 0 <= j < n:
                    name = "%s%d_%d" % (name, x, y)
                    transitions.append(Transition(name, timed=True))
                    arcs += [Arc(here, name), Arc(name, "p%d_%d" % (i, j))]
    return Net(places, transitions, arcs, "grid_%d" % n)


def star(n: int, tokens: int = 1) -> Net:
    """``n`` users who take from one pool and return to it: a place with ``n`` arcs each way."""
    places, transitions, arcs = [Place("pool", tokens)], [], []
    for i in range(n):
        places.append(Place("busy%d" % i))
        transitions += [Transition("take%d" % i, timed=True), Transition("give%d" % i, timed=True)]
        arcs += [Arc("pool", "take%d" % i), Arc("take%d" % i, "busy%d" % i)]
        arcs += [Arc("busy%d" % i, "give%d" % i), Arc("give%d" % i, "pool")]
    return Net(places, transitions, arcs, "star_%d" % n)


def scattered(places: int, transitions: int, tokens: int = 20, seed: int = 1) -> Net:
    """Transitions that take from two places and put into two, all drawn at random."""
    draw = random.Random(seed)
    arcs: List[Arc] = []
    for t in range(transitions):
        arcs += [Arc("p%d" % p, "t%d" % t) for p in draw.sample(range(places), 2)]
        arcs += [Arc("t%d" % t, "p%d" % p) for p in draw.sample(range(places), 2)]
    counts = [0] * places
    for _ in range(tokens):
        counts[draw.randrange(places)] += 1
    return Net(
        [Place("p%d" % i, counts[i]) for i in range(places)],
        [Transition("t%d" % i, timed=True) for i in range(transitions)],
        arcs,
        "scattered_%d_%d" % (places, transitions),
    )


def cells(n: int) -> Net:
    """``n`` machines with three places each, which hand a part to the next machine when it is free.
    Every third place is marked, so that the initial marking alone has about ``n`` successors."""
    places, transitions, arcs = [], [], []
    for i in range(n):
        places += [
            Place("free%d" % i, i % 3 != 0),
            Place("busy%d" % i, int(i % 3 == 0)),
            Place("full%d" % i),
        ]
        transitions += [Transition("work%d" % i, timed=True), Transition("hand%d" % i, timed=True)]
        following = (i + 1) % n
        arcs += [
            Arc("busy%d" % i, "work%d" % i),
            Arc("work%d" % i, "full%d" % i),
            Arc("full%d" % i, "hand%d" % i),
            Arc("free%d" % following, "hand%d" % i),
            Arc("hand%d" % i, "free%d" % i),
            Arc("hand%d" % i, "busy%d" % following),
        ]
    places = [p._replace(tokens=int(p.tokens)) for p in places]
    return Net(places, transitions, arcs, "cells_%d" % n)


def workflow(size: int, seed: int = 1) -> Net:
    """A workflow of about ``size`` places, from ``start`` to ``end`` and back: nested sequences,
    choices, and forks of up to three branches; choices and forks join again."""
    return _Workflow(random.Random(seed)).build(size)


class _Workflow:
    def __init__(self, draw: random.Random) -> None:
        self._draw = draw
        self._places = [Place("start", 1), Place("end")]
        self._transitions = [Transition("again", timed=True)]
        self._arcs = [Arc("end", "again"), Arc("again", "start")]

    def build(self, size: int) -> Net:
        self._between("start", "end", size - 2, 0)
        return Net(self._places, self._transitions, self._arcs, "workflow_%d" % size)

    def _between(self, first: str, last: str, size: int, depth: int) -> None:
        """Add paths from place ``first`` to place ``last`` with about ``size`` places between."""
        if size < 2:
            self._step([first], [last])
            return
        kind = self._draw.random()
        if kind < 0.6 or size < 8 or depth > 6:  # a sequence
            middle = self._place()
            share = self._draw.randrange(size)
            self._between(first, middle, share, depth)
            self._between(middle, last, size - 1 - share, depth)
        elif kind < 0.85:  # a choice
            self._between(first, last, size // 2, depth + 1)
            self._between(first, last, size // 2, depth + 1)
        else:  # a fork
            count = self._draw.choice((2, 2, 3))
            ends = [(self._place(), self._place()) for _ in range(count)]
            self._step([first], [begin for begin, _ in ends])
            for begin, end in ends:
                self._between(begin, end, min(size // count - 2, 6), depth + 1)
            rest = size - count * min(size // count, 8)
            if rest > 1:
                middle = self._place()
                self._step([end for _, end in ends], [middle])
                self._between(middle, last, rest - 1, depth)
            else:
                self._step([end for _, end in ends], [last])

    def _place(self) -> str:
        self._places.append(Place("p%d" % len(self._places)))
        return self._places[-1].name

    def _step(self, before: List[str], after: List[str]) -> None:
        name = "t%d" % len(self._transitions)
        self._transitions.append(Transition(name, timed=True))
        self._arcs += [Arc(p, name) for p in before] + [Arc(name, p) for p in after]


def endings(n: int, length: int) -> Net:
    """A walk of ``length`` steps that may stop for good at each of them, in one of ``n`` ways:
    ``n * length`` deadlocks."""
    places = [Place("here%d" % i, int(i == 0)) for i in range(length)] + [
        Place("way%d" % i) for i in range(n)
    ]
    places += [Place("at%d" % i) for i in range(length)]
    transitions, arcs = [], []
    for i in range(length):
        if i + 1 < length:
            transitions.append(Transition("on%d" % i, rate=float(n), timed=True))
            arcs += [Arc("here%d" % i, "on%d" % i), Arc("on%d" % i, "here%d" % (i + 1))]
        for k in range(n):
            name = "stop%d_%d" % (i, k)
            transitions.append(Transition(name, rate=0.1 + 0.01 * k, timed=True))
            arcs += [Arc("here%d" % i, name), Arc(name, "way%d" % k), Arc(name, "at%d" % i)]
    return Net(places, transitions, arcs, "endings_%d_%d" % (n, length))


def switches(n: int, tokens: int) -> Net:
    """``n`` switches, each of which is set once to one of two positions, and a ring of six places
    with ``tokens``: ``2 ** n`` recurrent classes among ``3 ** n`` settings."""
    net = ring(6, tokens)
    places, transitions, arcs = list(net.places), list(net.transitions), list(net.arcs)
    for i in range(n):
        places += [Place("open%d" % i, 1), Place("left%d" % i), Place("right%d" % i)]
        for side, rate in (("left", 1.0 + 0.1 * i), ("right", 2.0)):
            name = "%s_%d" % (side, i)
            transitions.append(Transition(name, rate=rate, timed=True))
            arcs += [Arc("open%d" % i, name), Arc(name, "%s%d" % (side, i))]
    return Net(places, transitions, arcs, "switches_%d_%d" % (n, tokens))


LARGE: Mapping[str, Callable[[], Net]] = {
    "ring 500": lambda: ring(500),
    "ring 2000": lambda: ring(2_000),
    "ring 50000": lambda: ring(50_000),
    "ring 100000": lambda: ring(100_000),
    "chain 50000": lambda: chain(50_000),
    "grid 141": lambda: grid(141),
    "star 33333": lambda: star(33_333),
    "scattered 50000": lambda: scattered(50_000, 50_000, tokens=50_000),
    "cells 30000": lambda: cells(30_000),
    "workflow 250": lambda: workflow(250),
    "workflow 1000": lambda: workflow(1_000),
    "endings 6000": lambda: endings(30, 200),
    "switches 9": lambda: switches(9, 1),
    "switches 10": lambda: switches(10, 1),
}
"""Name -> a function that builds the net."""
