"""Orders of the places, on which the size of a decision diagram depends.

Places that one transition joins, or one invariant, should be close together. Which of the orders is
good shows only when the diagram grows, so there are several, the most promising first.
"""

from __future__ import annotations

from typing import Dict, List, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.model.net import Net

PlaceOrder = Tuple[int, ...]
"""Place numbers, that of the highest level first."""

_ROUNDS = 60
"""Rounds of each improvement; most orders settle in fewer."""


def promising_orders(net: Net, together: Sequence[Sequence[int]]) -> List[PlaceOrder]:
    """Some orders of the places, the most promising first.

    :param together: numbers of places that belong together, besides those of a transition.
    """
    groups = [sorted(group) for group in _touched(net)]
    tied = groups + [list(places) for places in together]
    starts = [tuple(range(len(net.places))), _walk(net, tied)]
    found: Dict[PlaceOrder, int] = {}
    for start in starts:
        for edges in (groups, tied):
            for order in (start, _drawn_together(start, edges)):
                for way in (order, order[::-1]):
                    found.setdefault(way, _cost(way, groups))
    return sorted(found, key=lambda order: found[order])


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


def _drawn_together(start: PlaceOrder, groups: Sequence[Sequence[int]]) -> PlaceOrder:
    """The order after each place has repeatedly moved to the middle of its groups (FORCE; Aloul,
    Markov, Sakallah 2003)."""
    if not groups:
        return start
    member = np.array([p for group in groups for p in group])
    sizes = np.array([len(group) for group in groups])
    group_of = np.repeat(np.arange(len(groups)), sizes)
    often = np.maximum(np.bincount(member, minlength=len(start)), 1)
    lonely = np.bincount(member, minlength=len(start)) == 0
    begins = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    position = np.empty(len(start))
    position[list(start)] = np.arange(len(start))
    best, least = position, np.inf
    for round_ in range(_ROUNDS):
        where = position[member]
        span = float(
            (np.maximum.reduceat(where, begins) - np.minimum.reduceat(where, begins)).sum()
        )
        if span >= least and round_ > 5:
            break
        if span < least:
            best, least = position, span
        middle = np.bincount(group_of, weights=where) / sizes
        pulled = np.bincount(member, weights=middle[group_of], minlength=len(start)) / often
        pulled[lonely] = position[lonely]
        position = np.empty(len(start))
        position[np.argsort(pulled, kind="stable")] = np.arange(len(start))
    return tuple(int(p) for p in np.argsort(best))
