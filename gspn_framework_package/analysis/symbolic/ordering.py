"""Orders of the places, on which the size of a decision diagram depends.

Places that one transition joins, or one invariant, should be close together. Which of the orders is
good shows only when the diagram grows, so there are several, the most promising first.
"""

from __future__ import annotations

import heapq
from typing import Dict, List, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.model.net import Net

PlaceOrder = Tuple[int, ...]
"""Place numbers, that of the highest level first."""

_ROUNDS = 60
"""Rounds of each improvement; most orders settle in fewer."""

_SLIGHT = 0.001
"""The weight of the places of a transition beside that of an invariant."""


def promising_orders(net: Net, together: Sequence[Sequence[int]]) -> List[PlaceOrder]:
    """Some orders of the places, the most promising first.

    :param together: numbers of places that belong together, besides those of a transition.
    """
    groups = [sorted(group) for group in _touched(net)]
    tied = groups + [list(places) for places in together if len(places) > 1]
    natural, walked = tuple(range(len(net.places))), _walk(net, tied)
    found = [
        _few_open(natural, groups, [1.0] * len(groups)),
        _few_open(natural, tied, [_SLIGHT if i < len(groups) else 1.0 for i in range(len(tied))]),
        _drawn_together(walked, groups),
        _drawn_together(walked, tied),
        _drawn_together(natural, groups),
    ]
    better: Dict[PlaceOrder, int] = {}
    worse: Dict[PlaceOrder, int] = {}
    for order in found:
        costs = sorted((_cost(way, groups), way) for way in (order, order[::-1]))
        for (cost, way), into in zip(costs, (better, worse)):
            into[way] = cost
    return list(
        dict.fromkeys(
            [
                *sorted(better, key=lambda way: better[way]),
                *sorted(worse, key=lambda way: worse[way]),
            ]
        )
    )


def _touched(net: Net) -> List[Set[int]]:
    """For each transition, the places that it reads or changes."""
    touched = []
    for t in range(len(net.transitions)):
        places = {p for p, _ in (*net.inputs[t], *net.inhibitors[t], *net.effect(t))}
        if len(places) > 1:
            touched.append(places)
    return touched


def _cost(order: PlaceOrder, groups: Sequence[Sequence[int]]) -> int:
    """The levels that the transitions span, and how high they begin."""
    level = np.empty(len(order), dtype=np.int64)
    level[list(order)] = np.arange(len(order), 0, -1)
    total = 0
    for group in groups:
        levels = level[group]
        total += 2 * int(levels.max() - levels.min()) + int(levels.max())
    return total


def _walk(net: Net, groups: Sequence[Sequence[int]]) -> PlaceOrder:
    """Breadth first, from a place that is far from others."""
    at: List[List[int]] = [[] for _ in net.places]
    for g, group in enumerate(groups):
        for p in group:
            at[p].append(g)

    def walk(first: int, seen: Set[int]) -> List[int]:
        found, taken = [first], set()
        known = {first} | seen
        for p in found:
            for g in sorted(at[p], key=lambda g: len(groups[g])):
                if g in taken:
                    continue
                taken.add(g)
                new = [q for q in groups[g] if q not in known]
                known.update(new)
                found += new
        return found

    order: List[int] = []
    seen: Set[int] = set()
    for p in range(len(net.places)):
        if p not in seen:
            part = walk(walk(p, seen)[-1], seen)
            order += part
            seen.update(part)
    return tuple(order)


def _few_open(
    start: PlaceOrder, groups: Sequence[Sequence[int]], weights: Sequence[float]
) -> PlaceOrder:
    """The order in which each next place is the one that leaves the least weight of open groups:
    those of which some places, but not all, are before the cut. A diagram has to remember at a
    level what the open groups have above it.
    """
    at: List[List[int]] = [[] for _ in start]
    for g, group in enumerate(groups):
        for p in group:
            at[p].append(g)
    left = [len(group) for group in groups]
    opens = [sum(weights[g] for g in at[p] if left[g] > 1) for p in range(len(start))]
    joins = [0.0] * len(start)  # the weight of the open groups that a place is in
    order: List[int] = []
    placed = [False] * len(start)
    queue = [(opens[p], 0.0, rank, p) for rank, p in enumerate(start)]
    rank_of = {p: rank for rank, p in enumerate(start)}
    heapq.heapify(queue)
    while queue:
        weight, joined, _, p = heapq.heappop(queue)
        if placed[p] or (weight, joined) != (opens[p], -joins[p]):
            continue
        placed[p] = True
        order.append(p)
        changed: Set[int] = set()
        for g in at[p]:
            others = [q for q in groups[g] if not placed[q]]
            if left[g] == len(groups[g]):
                for q in others:
                    opens[q] -= weights[g]
                    joins[q] += weights[g]
                changed.update(others)
            left[g] -= 1
            if left[g] == 1:
                opens[others[0]] -= weights[g]
                changed.add(others[0])
        for q in changed:
            heapq.heappush(queue, (opens[q], -joins[q], rank_of[q], q))
    return tuple(order)


def _drawn_together(start: PlaceOrder, groups: Sequence[Sequence[int]]) -> PlaceOrder:
    """The order after each place has repeatedly moved to the middle of its groups (FORCE; Aloul,
    Markov, Sakallah 2003), where a group pulls the less, the larger it is."""
    if not groups:
        return start
    member = np.array([p for group in groups for p in group])
    sizes = np.array([len(group) for group in groups])
    group_of = np.repeat(np.arange(len(groups)), sizes)
    weight = 1.0 / (sizes - 1)
    pull = weight[group_of]
    pulls = np.bincount(member, weights=pull, minlength=len(start))
    lonely = pulls == 0
    pulls[lonely] = 1.0
    begins = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    position = np.empty(len(start))
    position[list(start)] = np.arange(len(start))
    best, least = position, np.inf
    for round_ in range(_ROUNDS):
        where = position[member]
        spans = np.maximum.reduceat(where, begins) - np.minimum.reduceat(where, begins)
        span = float((weight * spans).sum())
        if span >= least and round_ > 5:
            break
        if span < least:
            best, least = position, span
        middle = np.bincount(group_of, weights=where) / sizes
        pulled = np.bincount(member, weights=pull * middle[group_of], minlength=len(start)) / pulls
        pulled[lonely] = position[lonely]
        position = np.empty(len(start))
        position[np.argsort(pulled, kind="stable")] = np.arange(len(start))
    return tuple(int(p) for p in np.argsort(best))
