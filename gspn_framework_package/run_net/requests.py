"""The requests of robots that are done: the distribution from which each draws under the policy,
and which of several requests fires first."""

from __future__ import annotations

from typing import AbstractSet, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.model.plan import Plan


class PolicyDraws:
    """The draws of robots under the policy of a plan.

    :param plan: a validated plan.
    :param net: its net, possibly without some resource places.
    """

    def __init__(self, plan: Plan, net: Net) -> None:
        self._plan, self._net = plan, net
        self._table = plan.policy.bind(plan.net)
        self._full = [plan.net.place_index[p.name] for p in net.places]
        self._start = list(plan.net.initial_marking)

    def of(self, marking: Marking, p: int, ready: AbstractSet[int]) -> List[Tuple[int, float]]:
        """The distribution from which a robot in place ``p`` draws: pairs (transition,
        probability).

        :param ready: the immediate transitions that can fire.
        """
        full = self._start
        for q, count in zip(self._full, marking):
            full[q] = count
        choices: Optional[Sequence[Tuple[int, float]]] = self._table.choices(full, self._full[p])
        if choices is None:
            if self._plan.strict:
                return []
            leaving = self._net.immediate_from[p]
            choices = [(t, self._net.value(marking, t)) for t in leaving if t in ready]
        found = candidates(self._net, choices, ready)
        total = sum(v for _, v in found)
        return [(t, v / total) for t, v in found if v] if total else []


def candidates(
    net: Net, choices: Iterable[Tuple[int, float]], ready: AbstractSet[int]
) -> List[Tuple[int, float]]:
    """Those of the ``choices`` (pairs of a transition and its probability, or weight) from which a
    robot draws: none of a lower priority than one that can fire.

    :param ready: the immediate transitions that can fire.
    """
    transitions = net.transitions
    choices = list(choices)
    floor = max([transitions[t].priority for t, _ in choices if t in ready], default=0)
    return [(t, v) for t, v in choices if transitions[t].priority >= floor]


def by_weight(net: Net, marking: Marking, candidates: Sequence[int]) -> List[Tuple[int, float]]:
    """Which of these transitions, which take resources only and are enabled in ``marking``, fires:
    pairs (transition, probability)."""
    transitions = net.transitions
    top = max(transitions[t].priority for t in candidates)
    weights = [(t, net.value(marking, t)) for t in candidates if transitions[t].priority == top]
    total = sum(weight for _, weight in weights)
    if total == 0:
        return [(weights[0][0], 1.0)]  # file order, as in the token game
    return [(t, weight / total) for t, weight in weights if weight]


class Requests(NamedTuple):
    """Robots in one place whose requests are identical.

    :ivar robots: their number.
    :ivar draw: the transitions that each of them may ask for and that can fire: transition ->
        probability. With the remaining probability it asks for nothing that can fire.
    """

    robots: int
    draw: Dict[int, float]


def first_to_fire(groups: Sequence[Requests], urgency: Sequence[int]) -> List[Dict[int, float]]:
    """Which request fires first. Higher urgency takes precedence; within one, every order of the
    robots is equally likely.

    :param urgency: the urgency of each transition.
    :returns: for each group, transition -> the probability that a robot of this group goes first
        and fires it. The rest is the probability that no request can fire.
    """
    if len(groups) == 1 and groups[0].robots == 1:
        return [dict(groups[0].draw)]
    first: List[Dict[int, float]] = [{} for _ in groups]
    for level in sorted({urgency[t] for group in groups for t in group.draw}, reverse=True):
        rows = []
        for robots, draw in groups:
            mine = sum(v for t, v in draw.items() if urgency[t] == level)
            above = sum(v for t, v in draw.items() if urgency[t] > level)
            rows.append((robots, mine, max(1.0 - above - mine, 0.0)))
        for i, (robots, draw) in enumerate(groups):
            share = robots * _goes_first(rows, i)
            for t, v in draw.items():
                if urgency[t] == level:
                    first[i][t] = v * share
    return first


def _goes_first(groups: Sequence[Tuple[int, float, float]], mine: int) -> float:
    """The probability that one robot of group ``mine``, asking for a transition of this urgency,
    fires before all others that do: the mean of 1 / (1 + number of those), and 0 if one asks for
    something more urgent.

    :param groups: (robots, probability of asking for something of this urgency, probability of
        asking for nothing of this or a higher one).
    """
    polynomial = np.ones(1)  # coefficients by the number of robots that ask for this urgency
    for i, (robots, enabled, idle) in enumerate(groups):
        for _ in range(robots - (i == mine)):
            polynomial = np.convolve(polynomial, [idle, enabled])
    return float((polynomial / np.arange(1, len(polynomial) + 1)).sum())
