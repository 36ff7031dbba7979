"""The net of a plan under its policy: the policy fixes the choices, and what remains is a Markov
chain.

The rules are those of the execution (``docs/semantics.md``), with three simplifications that make
it a chain:

* robots take no time in a place with immediate outputs, even where an action runs there;
* if several robots could fire at once, each is equally likely to fire first (in a run, the one that
  finished first does);
* exponential transitions that only take resources (events of the environment) fire at their rates.

A robot draws once per marking and keeps its choice: if its choice is not enabled, it waits until
the marking changes. So a marking can occur as two states: *asking*, in zero time, and *waiting*.
"""

from __future__ import annotations

import math
import time
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.plan.structure import only_written
from gspn_framework_package.analysis.state_space.exploration import (
    Allowance,
    Growing,
    RawGraph,
    label_type,
)
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.packing import Packing
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph
from gspn_framework_package.analysis.state_space.space import StateSpace
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.model.plan import Plan

PLAN_STATE_LIMIT = 200_000
"""Default limit on the states of a plan's exploration."""

_STATE_BYTES, _ARC_BYTES = 400, 100
"""Memory of a state during the exploration, besides its counts, and of an arc."""

WAITING = "(waits)"
"""Entry of a firing sequence at which robots wait, having drawn transitions that are not
enabled."""


class Branch(NamedTuple):
    """One way to leave a vanishing marking: ``transition`` (None: the robots wait in it) with
    ``probability``."""

    transition: Optional[int]
    probability: float


class PlanRules:
    """What happens in a marking of a plan under its policy and weights.

    :ivar net: the plan's net without the counters that nothing reads (``counters``), with one
      server per robot.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.counters = only_written(plan)
        self.net = plan_net(plan, self.counters)
        self._table = plan.policy.bind(plan.net)
        net = self.net
        self._full = [plan.net.place_index[p.name] for p in net.places]
        self._start = list(plan.net.initial_marking)
        self._until = (
            parse_condition(plan.until, [p.name for p in net.places]) if plan.until else None
        )
        acts = [p.name not in plan.resource_places for p in net.places]
        self._immediate = [
            t for t, transition in enumerate(net.transitions) if not transition.timed
        ]
        self._timed = [t for t, transition in enumerate(net.transitions) if transition.timed]
        self._spontaneous = [
            t for t in self._immediate if not any(acts[p] for p, _ in net.inputs[t])
        ]
        self._leaving = {
            p: [t for t in net.consumers[p] if not net.transitions[t].timed]
            for p in range(len(net.places))
            if acts[p]
        }
        self._deciding = [p for p, leaving in self._leaving.items() if leaving]

    def is_over(self, marking: Marking) -> bool:
        """Whether the plan's ``until`` holds, so that the run ends there."""
        return self._until is not None and self._until.holds(marking)

    def timed(self, marking: Marking) -> List[Tuple[int, float]]:
        """The enabled exponential transitions, with their rates (1/s)."""
        net = self.net
        return [
            (t, net.effective_rate(marking, t)) for t in self._timed if net.is_enabled(marking, t)
        ]

    def outcomes(self, marking: Marking) -> List[Branch]:
        """What happens in zero time. The list is empty if nothing does, so that time passes. If the
        robots may wait, that is the last outcome."""
        net = self.net
        enabled = [t for t in self._immediate if net.is_enabled(marking, t)]
        if not enabled:
            return []
        ready = set(enabled)
        spontaneous = [t for t in self._spontaneous if t in ready]
        if spontaneous:
            return self._by_weight(spontaneous)
        draws = []
        for p in self._deciding:
            if marking[p]:
                draw = {
                    t: probability for t, probability in self._draw(marking, p, ready) if t in ready
                }
                if draw:
                    draws.append((marking[p], draw))
        return self._first_of(draws)

    def _by_weight(self, candidates: Sequence[int]) -> List[Branch]:
        transitions = self.net.transitions
        top = max(transitions[t].priority for t in candidates)
        weights = [(t, transitions[t].weight) for t in candidates if transitions[t].priority == top]
        total = sum(weight for _, weight in weights)
        if total == 0:
            return [Branch(weights[0][0], 1.0)]  # file order, as in the token game
        return [Branch(t, weight / total) for t, weight in weights if weight]

    def _draw(self, marking: Marking, p: int, ready: set[int]) -> List[Tuple[int, float]]:
        """The distribution from which a robot in place ``p`` draws: pairs (transition,
        probability)."""
        full = self._start
        for q, count in zip(self._full, marking):
            full[q] = count
        place = self._full[p]
        distribution = self._table.distribution(full, place)
        if distribution is not None:
            choices = list(distribution.choices)
        elif self._table.matches(full) or self.plan.strict:
            return []
        else:
            choices = [(t, self.net.transitions[t].weight) for t in self._leaving[p] if t in ready]
        priorities = [self.net.transitions[t].priority for t, _ in choices if t in ready]
        floor = max(priorities, default=0)
        choices = [(t, v) for t, v in choices if self.net.transitions[t].priority >= floor]
        total = sum(v for _, v in choices)
        return [(t, v / total) for t, v in choices if v] if total else []

    def _first_of(self, draws: Sequence[Tuple[int, Dict[int, float]]]) -> List[Branch]:
        """Which transition fires first when every robot has drawn. Higher priority takes
        precedence; within a priority every order of the robots is equally likely.

        :param draws: for each place, the number of robots there and the enabled transitions that
            each of them may have drawn (transition -> probability).
        """
        priority = {t: self.net.transitions[t].priority for _, draw in draws for t in draw}
        chance: Dict[int, float] = {}
        for level in sorted(set(priority.values()), reverse=True):
            groups = []
            for robots, draw in draws:
                mine = sum(v for t, v in draw.items() if priority[t] == level)
                above = sum(v for t, v in draw.items() if priority[t] > level)
                groups.append((robots, mine, max(1.0 - above - mine, 0.0)))
            for i, (robots, draw) in enumerate(draws):
                first = robots * _goes_first(groups, i)
                for t, v in draw.items():
                    if priority[t] == level:
                        chance[t] = chance.get(t, 0.0) + v * first
        wait = 1.0 - sum(chance.values())
        outcomes = [Branch(t, v) for t, v in sorted(chance.items()) if v > 0]
        if outcomes and wait > 1e-12:
            return outcomes + [Branch(None, wait)]
        total = sum(outcome.probability for outcome in outcomes)
        return [Branch(t, v / total) for t, v in outcomes]


def _goes_first(groups: Sequence[Tuple[int, float, float]], mine: int) -> float:
    """The probability that one robot of group ``mine``, whose draw is enabled, fires before all
    others whose draw is enabled: the mean of 1 / (1 + number of those), and 0 if one drew a higher
    priority.

    :param groups: (robots, probability of an enabled draw of this priority, probability of no
        enabled draw of this or a higher one).
    """
    polynomial = np.ones(1)  # coefficients by the number of robots with an enabled draw
    for i, (robots, enabled, idle) in enumerate(groups):
        for _ in range(robots - (i == mine)):
            polynomial = np.convolve(polynomial, [idle, enabled])
    return float((polynomial / np.arange(1, len(polynomial) + 1)).sum())


def plan_net(plan: Plan, left_out: Sequence[str] = ()) -> Net:
    """The net of a plan for analysis: without the places ``left_out``. The exponential transitions
    that leave action places get as many servers as there are robots."""
    net = plan.net.without_places(left_out)
    acts = {p for p, place in enumerate(net.places) if place.name not in plan.resource_places}
    transitions = [
        t._replace(servers=None) if t.timed and any(p in acts for p, _ in net.inputs[i]) else t
        for i, t in enumerate(net.transitions)
    ]
    return Net(net.places, transitions, net.arcs, net.name)


class PlanSpace(StateSpace):
    """The markings that a plan reaches under its policy, and the firings between them; made by
    :func:`explore_plan`.

    :ivar counters: the omitted places, which are only written.
    """

    def __init__(
        self,
        rules: PlanRules,
        graph: RawGraph,
        markings: Indices,
        vanishing: Booleans,
        values: Floats,
        shortage: Tuple[str, str] = ("", ""),
    ) -> None:
        widths = [max(int(n).bit_length(), 1) for n in markings.max(axis=0)]
        packing = Packing(rules.net, widths)
        order = np.arange(len(rules.net.transitions) + 1)  # the last one: the robots wait
        store = PackedStore(packing, packing.pack_all(markings))
        super().__init__(
            rules.net, store, graph, order, untimed=False, engine="plan", shortage=shortage
        )
        self.counters = rules.counters
        self._vanishing = vanishing
        self._values = values

    @property
    def is_vanishing(self) -> Booleans:
        """Boolean array: the robots move on in zero time."""
        return self._vanishing

    def transition_name(self, transition: int) -> str:
        """The name of a transition, or WAITING."""
        return (
            WAITING
            if transition == len(self.net.transitions)
            else super().transition_name(transition)
        )

    def rated(self) -> RatedGraph:
        """The graph with rates and probabilities.

        :raises LimitError: it is not complete.
        """
        self.require_complete("its Markov chain")
        return RatedGraph(
            self.net,
            self._vanishing,
            self.sources,
            self.targets,
            self.transitions,
            self._values,
            self.store,
        )


def explore_plan(
    plan: Plan,
    *,
    limit: int = PLAN_STATE_LIMIT,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    memory: float = math.inf,
    seconds: float = math.inf,
) -> PlanSpace:
    """Find the markings that a plan reaches under its policy.

    :param plan: a validated plan.
    :param limit: stop soon after this many states are known; the result is then not ``complete``.
    :param progress: receives the number of states at intervals.
    :param cancel: called at intervals; returns whether to stop.
    :param memory: stop when the exploration takes more than this many bytes.
    :param seconds: stop after this time (s).
    :raises CancelledError: ``cancel`` returned true.
    """
    room = Allowance(memory, time.monotonic() + seconds)
    shortage = ("--limit", "")
    rules = PlanRules(plan)
    net = rules.net
    watch = Watch(progress, cancel)
    wait = len(net.transitions)
    index: Dict[Tuple[Marking, bool], int] = {(net.initial_marking, False): 0}
    order: List[Tuple[Marking, bool]] = [(net.initial_marking, False)]
    vanishing: List[bool] = []
    offsets = Growing(np.int64)
    offsets.extend(np.zeros(1, dtype=np.int64))
    targets: List[int] = []
    labels: List[int] = []
    values: List[float] = []

    def add(marking: Marking, waiting: bool, label: int, value: float) -> None:
        key = marking, waiting
        number = index.get(key)
        if number is None:
            number = index[key] = len(order)
            order.append(key)
        targets.append(number)
        labels.append(label)
        values.append(value)

    explored = 0
    while explored < len(order) <= limit:
        marking, waiting = order[explored]
        over = rules.is_over(marking)
        outcomes = [] if waiting or over else rules.outcomes(marking)
        vanishing.append(bool(outcomes))
        for transition, probability in outcomes:
            if transition is None:
                add(marking, True, wait, probability)
            else:
                add(net.fire(marking, transition), False, transition, probability)
        if not outcomes and not over:
            for t, rate in rules.timed(marking):
                add(net.fire(marking, t), False, t, rate)
        explored += 1
        offsets.extend(np.array([len(targets)]))
        if explored % 256 == 0:
            watch.step("states", len(order))
            if not room.left(
                len(order) * (16 * len(net.places) + _STATE_BYTES) + len(targets) * _ARC_BYTES
            ):
                shortage = ("--limit-memory", "%.3g GB" % (memory / 1e9))
                if not room.left(0):
                    shortage = ("--limit-time", "%g s" % seconds)
                break
    vanishing += [False] * (len(order) - explored)
    offsets.extend(np.full(len(order) - explored, len(targets), dtype=np.int64))
    graph = RawGraph(
        None,
        offsets.finished(),
        np.array(targets, dtype=np.int32),
        np.array(labels, dtype=label_type(wait + 1)),
        explored,
    )
    markings = np.array([marking for marking, _ in order], dtype=np.int64).reshape(len(order), -1)
    return PlanSpace(
        rules,
        graph,
        markings,
        np.array(vanishing, dtype=bool),
        np.array(values, dtype=np.float64),
        shortage,
    )
