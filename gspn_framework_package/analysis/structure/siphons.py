"""Siphons, sets of places that stay empty once empty, and traps, which stay marked once marked.

A *siphon* is a set of places such that every transition that puts a token into it also takes one
out of it; a *trap* is the same with the directions exchanged. The minimal ones are listed by
branching on the places of one already found: each branch excludes one of its places. A minimal set
is strongly connected (every place of it is fed, through others of it, by every other), so each
strongly connected part of the net is searched on its own. There can be exponentially many minimal
sets; the search stops at a limit and reports it. Inhibitor arcs are ignored.

Two questions are decided without a list: the largest siphon or trap inside a set of places, and
whether every siphon holds a marked trap (:func:`unguarded_siphon`). The latter examines only the
siphons that avoid the marked traps found so far.
"""

from __future__ import annotations

from collections import Counter
from itertools import chain
from typing import Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from gspn_framework_package.analysis.limits import STRUCTURE_LIMIT, Effort
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.net import Net


class PlaceSet(NamedTuple):
    """A siphon or a trap: its ``places``, and whether one of them is ``marked`` initially."""

    places: Tuple[str, ...]
    marked: bool


def minimal_siphons(
    net: Net, limit: int = STRUCTURE_LIMIT, watch: Optional[Watch] = None
) -> List[PlaceSet]:
    """The minimal siphons, by size.

    :raises LimitError: the search took more than ``limit`` steps.
    """
    return _listed(net, _siphon_rules(net), Effort(limit, watch))


def minimal_traps(
    net: Net, limit: int = STRUCTURE_LIMIT, watch: Optional[Watch] = None
) -> List[PlaceSet]:
    """The minimal traps, by size.

    :raises LimitError: the search took more than ``limit`` steps.
    """
    return _listed(net, _trap_rules(net), Effort(limit, watch))


def largest_siphon(net: Net, within: Iterable[str]) -> Tuple[str, ...]:
    """The largest siphon inside a set of places (names), in the order of the net; it may be
    empty."""
    return _largest(net, _siphon_rules(net), within)


def unguarded_siphon(
    net: Net,
    limit: int = STRUCTURE_LIMIT,
    watch: Optional[Watch] = None,
    *,
    minimal: Optional[Sequence[PlaceSet]] = None,
) -> Optional[PlaceSet]:
    """A siphon that holds no marked trap; None if every siphon holds one (Commoner's condition,
    under which an ordinary net without priorities, inhibitor arcs and capacities has no deadlock).

    :param minimal: the minimal siphons, if known: then no search is needed.
    :raises LimitError: the search took more than ``limit`` steps.
    """
    effort = Effort(limit, watch)
    siphons, traps = _siphon_rules(net), _trap_rules(net)
    for siphon in minimal or ():
        inside = _Inside.of(traps, [net.place_index[name] for name in siphon.places], effort)
        if not any(net.initial_marking[p] for p in inside.places):
            return siphon
    if minimal is not None:
        return None
    everywhere = range(len(net.places))
    marked = {p for p, count in enumerate(net.initial_marking) if count}
    waiting: List[Tuple[Optional[_Inside], int, FrozenSet[int]]] = [(None, -1, frozenset())]
    while waiting:
        before, without, required = waiting.pop()
        if before is None:
            inside = _Inside.of(siphons, everywhere, effort)
        else:
            inside = before.copy()
            inside.remove(without)
        if not inside.places or not required <= inside.places:
            continue
        trap = _Inside.of(traps, inside.places, effort)
        if not trap.places & marked:
            return _named(net, [_shrunk(inside)])[0]
        guard = _marked_part(trap, marked)
        needed = set(required)
        for p in sorted(guard - required):  # a siphon not holding that trap lacks one of its places
            if p in needed:
                continue
            waiting.append((inside, p, frozenset(needed)))
            needed, possible, _ = inside.demand(needed | {p})
            if not possible:
                break
    return None


def _marked_part(trap: _Inside, marked: Set[int]) -> Set[int]:
    """A smaller marked trap inside a marked trap."""
    for p in sorted(trap.places & marked):  # the set that this mark demands
        needed, possible, closed = trap.demand({p})
        if possible and closed:
            return needed
    for p in sorted(trap.places):
        if p in trap.places:
            smaller = trap.copy()
            smaller.remove(p)
            if smaller.places & marked:
                trap = smaller
    return trap.places


class _Rules(NamedTuple):
    """The arcs in terms of siphons; for traps, the directions are exchanged.

    :ivar feeding: for each place the transitions (numbers) that put tokens into it: each of them
        must take from every set that has the place.
    :ivar taking: for each transition the places (numbers) that it takes from.
    :ivar fed: for each transition the places that it puts tokens into.
    :ivar asking: for each place the transitions that take from it.
    """

    feeding: Sequence[Sequence[int]]
    taking: Sequence[Sequence[int]]
    fed: Sequence[Sequence[int]]
    asking: Sequence[Sequence[int]]


def _siphon_rules(net: Net) -> _Rules:
    return _Rules(net.producers, _sets(net.inputs), _sets(net.outputs), net.consumers)


def _trap_rules(net: Net) -> _Rules:
    return _Rules(net.consumers, _sets(net.outputs), _sets(net.inputs), net.producers)


def _sets(arcs: Sequence[Sequence[Tuple[int, int]]]) -> List[Tuple[int, ...]]:
    return [tuple([p for p, _ in row]) for row in arcs]


class _Inside:
    """The largest siphon (trap) inside a set of places, updated when a place leaves that set.

    :ivar places: the numbers of its places.
    """

    def __init__(
        self, rules: _Rules, places: Set[int], left: Dict[int, int], effort: Effort
    ) -> None:
        self.rules = rules
        self.places = places
        # transition -> how many of the places that it takes from are in ``places``
        self._left = left
        self._effort = effort

    @classmethod
    def of(cls, rules: _Rules, places: Iterable[int], effort: Effort) -> _Inside:
        """The largest one inside ``places``."""
        chosen = set(places)
        asking, feeding = rules.asking, rules.feeding
        left = Counter(chain.from_iterable([asking[p] for p in chosen]))
        effort.spend(len(chosen) + len(left), _PLACES)
        found = cls(rules, chosen, left, effort)
        # map, not a comprehension, for speed: this runs for every place of every part of the net
        found._settle([p for p in chosen if not all(map(left.__contains__, feeding[p]))])
        return found

    def copy(self) -> _Inside:
        """An independent copy."""
        self._effort.spend(1 + (len(self.places) + len(self._left)) // 16, _PLACES)
        return _Inside(self.rules, set(self.places), dict(self._left), self._effort)

    def remove(self, place: int) -> None:
        """Remove ``place``, and the places that can then no longer belong to it."""
        if place in self.places:
            self._settle([place])

    def _settle(self, leaving: List[int]) -> None:
        places, left, rules = self.places, self._left, self.rules
        while leaving:
            p = leaving.pop()
            if p not in places:
                continue
            places.discard(p)
            self._effort.spend(1 + len(rules.asking[p]), _PLACES)
            for t in rules.asking[p]:
                left[t] -= 1
                if not left[t]:
                    leaving.extend(q for q in rules.fed[t] if q in places)

    def demand(self, required: Iterable[int]) -> Tuple[Set[int], bool, bool]:
        """What a siphon (trap) inside this one must contain if it contains ``required``.

        :returns: the places it must contain; whether such a set is possible; whether these places
            already form one.
        """
        needed = set(required)
        fresh = list(needed)
        open_transitions: Set[int] = set()
        while fresh or open_transitions:
            while fresh:
                p = fresh.pop()
                if p not in self.places:
                    return needed, False, False
                self._effort.spend(1 + len(self.rules.feeding[p]), _PLACES)
                open_transitions.update(self.rules.feeding[p])
            remaining: Set[int] = set()
            for t in open_transitions:
                taking = self.rules.taking[t]
                self._effort.spend(len(taking), _PLACES)
                if any(q in needed for q in taking):
                    continue
                if self._left.get(t) == 1:
                    only = next(q for q in taking if q in self.places)
                    needed.add(only)
                    fresh.append(only)
                else:
                    remaining.add(t)
            if not fresh:
                return needed, True, not remaining
            open_transitions = remaining
        return needed, True, True

    def parts(self) -> List[Set[int]]:
        """Its strongly connected parts: every minimal set lies in one of them."""
        if len(self.places) <= 1:
            return [set(self.places)]
        chosen = sorted(self.places)
        number = {p: i for i, p in enumerate(chosen)}
        sources: List[int] = []
        targets: List[int] = []
        transitions = sorted({t for p in chosen for t in self.rules.feeding[p]})
        count = len(chosen)
        # with a node for each transition, there are no more arcs than in the net
        for row, t in enumerate(transitions):
            for q in self.rules.taking[t]:
                if q in number:
                    sources.append(number[q])
                    targets.append(count + row)
            for p in self.rules.fed[t]:
                if p in number:
                    sources.append(count + row)
                    targets.append(number[p])
        self._effort.spend(len(sources), _PLACES)
        nodes = count + len(transitions)
        graph = sparse.csr_matrix(
            (np.ones(len(sources), np.int8), (sources, targets)), shape=(nodes, nodes)
        )
        _, of = csgraph.connected_components(graph, connection="strong")
        found: Dict[int, Set[int]] = {}
        for i, component in enumerate(of[:count].tolist()):
            found.setdefault(component, set()).add(chosen[i])
        return list(found.values())


_PLACES = "steps of siphons and traps"


class _Found:
    """The minimal sets found so far.

    :ivar sets: these sets, as place numbers.
    """

    def __init__(self) -> None:
        self.sets: Set[FrozenSet[int]] = set()
        self._first: Set[int] = set()  # the lowest place of each

    def add(self, places: FrozenSet[int]) -> None:
        """Add a minimal set."""
        self.sets.add(places)
        self._first.add(min(places))

    def within(self, places: Set[int]) -> List[FrozenSet[int]]:
        """The sets found inside a set of places: usually none in a net of thousands of parts."""
        if self._first.isdisjoint(places):
            return []
        return [s for s in self.sets if s <= places]


def _minimal_sets(rules: _Rules, count: int, effort: Effort) -> Set[FrozenSet[int]]:
    """All minimal sets."""
    found = _Found()
    waiting: List[Tuple[_Inside, int, FrozenSet[int]]] = [
        (_Inside.of(rules, range(count), effort), -1, frozenset())
    ]
    while waiting:
        inside, without, required = waiting.pop()
        effort.spend(1, _PLACES, "%d found" % len(found.sets))
        if without >= 0:
            inside = inside.copy()
            inside.remove(without)
        if not inside.places or not required <= inside.places:
            continue
        parts = inside.parts()
        if len(parts) > 1:
            for part in parts:
                if required <= part and (len(part) > 1 or _is_one(rules, part, effort)):
                    waiting.append((_Inside.of(rules, part, effort), -1, required))
            continue
        _branch(inside, required, effort, found, waiting)
    return found.sets


def _is_one(rules: _Rules, part: Set[int], effort: Effort) -> bool:
    """Whether a single place is a siphon (trap)."""
    (p,) = part
    effort.spend(1, _PLACES)
    return all(p in rules.taking[t] for t in rules.feeding[p])


def _branch(
    inside: _Inside,
    required: FrozenSet[int],
    effort: Effort,
    found: _Found,
    waiting: List[Tuple[_Inside, int, FrozenSet[int]]],
) -> None:
    """Search a strongly connected set for the minimal sets that contain all of ``required``: add
    one to ``found``, and the branches that may contain others to ``waiting``."""
    needed, possible, closed = inside.demand(required)
    if not possible:
        return
    if not (closed and needed):
        effort.spend(len(found.sets) // 4, _PLACES)
        known = found.within(inside.places)
        if known:
            pivot = min(known, key=lambda s: len(s - needed))
        else:
            pivot = _shrunk(inside)
            found.add(pivot)
        for p in sorted(pivot - needed):
            if p in needed:  # by now the other places demand it
                continue
            waiting.append((inside, p, frozenset(needed)))
            needed, possible, closed = inside.demand(needed | {p})
            if not possible:
                return
            if closed:
                break
    # every set that contains all of them is that set, or larger
    if closed and needed and frozenset(needed) not in found.sets:
        found.add(_shrunk(_Inside.of(inside.rules, needed, effort)))


def _shrunk(inside: _Inside) -> FrozenSet[int]:
    """A minimal set inside ``inside``, which must not be empty."""
    needed: Set[int] = set()  # what every set inside contains
    for p in sorted(inside.places):
        if p in needed or p not in inside.places:
            continue
        smaller = inside.copy()
        smaller.remove(p)
        if smaller.places:
            inside = smaller
        else:
            needed.add(p)
        needed, _, closed = inside.demand(needed)
        if closed and needed:
            return frozenset(needed)
    return frozenset(inside.places)


def _listed(net: Net, rules: _Rules, effort: Effort) -> List[PlaceSet]:
    return _named(net, _minimal_sets(rules, len(net.places), effort))


def _largest(net: Net, rules: _Rules, within: Iterable[str]) -> Tuple[str, ...]:
    inside = _Inside.of(rules, [net.place_number(name) for name in within], Effort(1 << 62))
    return tuple(net.places[p].name for p in sorted(inside.places))


def _named(net: Net, found: Iterable[Iterable[int]]) -> List[PlaceSet]:
    sets = sorted((sorted(places) for places in found), key=lambda numbers: (len(numbers), numbers))
    return [
        PlaceSet(
            tuple(net.places[p].name for p in numbers), any(net.initial_marking[p] for p in numbers)
        )
        for numbers in sets
    ]
