"""The classical reading of a plan (``--timing net``): its net under its policy. The policy fixes
the choices, and what remains is a Markov chain.

The rules are those of the execution (``docs/semantics.md``), with simplifications that make it a
chain of the net's own markings:

* the clock of an exponential transition runs only while the transition is enabled;
* each robot in a place has its own clock for an event that interrupts it there;
* robots take no time in a place with immediate outputs, even where an action runs there;
* if several robots could fire at once, each is equally likely to fire first (in a run, the one that
  finished first does);
* exponential transitions that only take resources (events of the environment) fire at their rates.

A robot draws once per marking and keeps its choice: if its choice is not enabled, it waits until
the marking changes. So a marking can occur as two states: *asking*, in zero time, and *waiting*.

:mod:`~gspn_framework_package.analysis.plan.run_rules` follows the run itself.
"""

from __future__ import annotations

from typing import AbstractSet, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.plan.structure import only_written
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.model.plan import Plan


class Branch(NamedTuple):
    """One way to leave a vanishing marking: ``transition`` (None: the robots wait in it) with
    ``probability``."""

    transition: Optional[int]
    probability: float


class PlanRules:
    """What happens in a marking of a plan under its policy and weights.

    :ivar net: the plan's net without the counters that nothing reads (``counters``), with one
      server per robot.
    :ivar acts: for each place whether its tokens are robots.
    :ivar urgency: for each transition its priority; -1 if it is exponential.
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
        self.acts = acts = [p.name not in plan.resource_places for p in net.places]
        self.urgency = [-1 if t.timed else t.priority for t in net.transitions]
        self._immediate = [
            t for t, transition in enumerate(net.transitions) if not transition.timed
        ]
        self._timed = [t for t, transition in enumerate(net.transitions) if transition.timed]
        self.interrupts: Dict[int, int] = {
            t: p
            for t in self._timed
            if net.transitions[t].name in plan.events
            for p, _ in net.inputs[t]
            if acts[p]
        }
        """Transitions by which events interrupt a robot -> the place of the robot."""
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
            (t, self.event_rate(marking, t) or net.effective_rate(marking, t))
            for t in self._timed
            if net.is_enabled(marking, t)
        ]

    def event_rate(self, marking: Marking, t: int) -> float:
        """The rate (1/s) at which the event of ``t``, which is enabled, comes: to any of the robots
        in its place. 0 if it interrupts nobody."""
        return (
            self.net.transitions[t].rate * marking[self.interrupts[t]]
            if t in self.interrupts
            else 0.0
        )

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
            return self.by_weight(spontaneous)
        draws = []
        for p in self._deciding:
            if marking[p]:
                draw = {
                    t: probability for t, probability in self.draw(marking, p, ready) if t in ready
                }
                if draw:
                    draws.append(Requests(marking[p], draw))
        return self._first_of(draws)

    def by_weight(self, candidates: Sequence[int]) -> List[Branch]:
        """Which of these transitions, which take resources only, fires."""
        transitions = self.net.transitions
        top = max(transitions[t].priority for t in candidates)
        weights = [(t, transitions[t].weight) for t in candidates if transitions[t].priority == top]
        total = sum(weight for _, weight in weights)
        if total == 0:
            return [Branch(weights[0][0], 1.0)]  # file order, as in the token game
        return [Branch(t, weight / total) for t, weight in weights if weight]

    def draw(self, marking: Marking, p: int, ready: AbstractSet[int]) -> List[Tuple[int, float]]:
        """The distribution from which a robot in place ``p`` draws: pairs (transition,
        probability).

        :param ready: the immediate transitions that can fire.
        """
        full = self._start
        for q, count in zip(self._full, marking):
            full[q] = count
        place = self._full[p]
        distribution = self._table.distribution(full, place)
        if distribution is not None:
            choices = list(distribution.choices)
        elif self._table.matches(full, place) or self.plan.strict:
            return []
        else:
            choices = [(t, self.net.transitions[t].weight) for t in self._leaving[p] if t in ready]
        priorities = [self.net.transitions[t].priority for t, _ in choices if t in ready]
        floor = max(priorities, default=0)
        choices = [(t, v) for t, v in choices if self.net.transitions[t].priority >= floor]
        total = sum(v for _, v in choices)
        return [(t, v / total) for t, v in choices if v] if total else []

    def _first_of(self, draws: Sequence[Requests]) -> List[Branch]:
        """What fires first when every robot has drawn, or that they wait."""
        chance: Dict[int, float] = {}
        for found in first_to_fire(draws, self.urgency):
            for t, value in found.items():
                chance[t] = chance.get(t, 0.0) + value
        wait = 1.0 - sum(chance.values())
        outcomes = [Branch(t, v) for t, v in sorted(chance.items()) if v > 0]
        if outcomes and wait > 1e-12:
            return [*outcomes, Branch(None, wait)]
        total = sum(outcome.probability for outcome in outcomes)
        return [Branch(t, v / total) for t, v in outcomes]


class Requests(NamedTuple):
    """Robots in one place that ask alike.

    :ivar robots: how many they are.
    :ivar draw: the transitions that each of them may ask for and that can fire: transition ->
        probability. With the remaining probability it asks for nothing that can fire.
    :ivar last: whether all others were done before (one robot only).
    """

    robots: int
    draw: Dict[int, float]
    last: bool = False


def first_to_fire(groups: Sequence[Requests], urgency: Sequence[int]) -> List[Dict[int, float]]:
    """Which request fires first. Higher urgency takes precedence; within one, every order of the
    robots is equally likely, except for one that is known to be the last.

    :param urgency: the urgency of each transition.
    :returns: for each group, transition -> the probability that a robot of this group goes first
        and fires it. The rest is the probability that no request can fire.
    """
    if len(groups) == 1 and groups[0].robots == 1:
        return [dict(groups[0].draw)]
    first: List[Dict[int, float]] = [{} for _ in groups]
    for level in sorted({urgency[t] for group in groups for t in group.draw}, reverse=True):
        rows = []
        for robots, draw, last in groups:
            mine = sum(v for t, v in draw.items() if urgency[t] == level)
            above = sum(v for t, v in draw.items() if urgency[t] > level)
            rows.append((robots, mine, max(1.0 - above - mine, 0.0), last))
        for i, (robots, draw, _) in enumerate(groups):
            share = robots * _goes_first(rows, i)
            for t, v in draw.items():
                if urgency[t] == level:
                    first[i][t] = v * share
    return first


def _goes_first(groups: Sequence[Tuple[int, float, float, bool]], mine: int) -> float:
    """The probability that one robot of group ``mine``, asking for a transition of this urgency,
    fires before all others that do: the mean of 1 / (1 + number of those), and 0 if one asks for
    something more urgent.

    :param groups: (robots, probability of asking for something of this urgency, probability of
        asking for nothing of this or a higher one, whether the others were done before).
    """
    polynomial = np.ones(1)  # coefficients by the number of robots that ask for this urgency
    for i, (robots, enabled, idle, last) in enumerate(groups):
        factor = [idle, enabled]
        if groups[mine][3]:
            factor = [idle]
        elif last:
            factor = [idle + enabled]
        for _ in range(robots - (i == mine)):
            polynomial = np.convolve(polynomial, factor)
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
