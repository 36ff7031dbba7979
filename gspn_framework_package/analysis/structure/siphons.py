"""Siphons, sets of places that stay empty once empty, and traps, which stay marked once marked.

A *siphon* is a set of places such that every transition that puts a token into it also takes one
out of it; a *trap* is the same with the directions exchanged. The minimal ones are listed by
branching on the places of one already found: each branch excludes one of its places. A minimal set
is strongly connected (every place of it is fed, through others of it, by every other), so each
strongly connected part of the net is searched separately. There can be exponentially many minimal
sets; the search stops at a limit and reports it. Inhibitor arcs are ignored.

Two questions are decided without a list: the largest siphon or trap inside a set of places, and
whether every siphon holds a marked trap (:func:`unguarded_siphon`). The latter examines only the
siphons that avoid the marked traps found so far.

A net may have 100,000 nodes, and most of the work is repeated with one place fewer. Therefore sets
are byte arrays, which are copied in microseconds, and each part of the net is searched with its own
numbering.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices
from gspn_framework_package.analysis.graph import components
from gspn_framework_package.analysis.limits import STRUCTURE_LIMIT, Effort
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.net import Net


class PlaceSet(NamedTuple):
    """A siphon or a trap: its ``places``, and whether one of them is ``marked`` initially."""

    places: Tuple[str, ...]
    marked: bool


def minimal_sets(
    net: Net,
    limit: int = STRUCTURE_LIMIT,
    watch: Optional[Watch] = None,
    *,
    kind: str,
    arcs: Optional[Directions] = None,
) -> List[PlaceSet]:
    """The minimal siphons or traps, by size.

    :param kind: ``siphons`` or ``traps``.
    :param arcs: the arcs of the net, if known.
    :raises LimitError: the search took more than ``limit`` steps.
    """
    rules = getattr(arcs or Directions(net), kind)
    return _named(net, _minimal_sets(rules, Effort(limit, watch)))


def largest_set(
    net: Net, within: Iterable[str], *, kind: str, arcs: Optional[Directions] = None
) -> Tuple[str, ...]:
    """The largest siphon or trap inside a set of places (names), in the order of the net; it may be
    empty. Parameters as for :func:`minimal_sets`."""
    chosen = np.zeros(len(net.places), dtype=bool)
    chosen[[net.place_number(name) for name in within]] = True
    inside = _Inside.largest(getattr(arcs or Directions(net), kind), Effort(1 << 62), chosen)
    return tuple(net.places[p].name for p in inside.numbers())


def unguarded_siphon(
    net: Net,
    limit: int = STRUCTURE_LIMIT,
    watch: Optional[Watch] = None,
    *,
    minimal: Optional[Sequence[PlaceSet]] = None,
    arcs: Optional[Directions] = None,
) -> Optional[PlaceSet]:
    """A siphon that holds no marked trap; None if every siphon holds one (Commoner's condition,
    under which an ordinary net without priorities, inhibitor arcs and capacities has no deadlock).

    :param minimal: the minimal siphons, if known: then no search is needed.
    :param arcs: the arcs of the net, if known.
    :raises LimitError: the search took more than ``limit`` steps.
    """
    effort = Effort(limit, watch)
    arcs = arcs or Directions(net)
    siphons, traps = arcs.siphons, arcs.traps
    marked = np.array([count > 0 for count in net.initial_marking], dtype=bool)
    for siphon in minimal or ():
        places = [net.place_index[name] for name in siphon.places]
        inside = _Inside.largest(traps.of_part(places, effort), effort)
        if not marked[places][inside.mask].any():
            return siphon
    if minimal is not None:
        return None
    waiting: List[Tuple[Optional[_Inside], int, FrozenSet[int]]] = [(None, -1, frozenset())]
    while waiting:
        before, without, required = waiting.pop()
        if before is None:
            inside = _Inside.largest(siphons, effort)
        else:
            inside = before.copy()
            inside.remove(without)
        if not inside.size or not inside.has_all(required):
            continue
        trap = _Inside.largest(traps, effort, inside.mask)
        if not (trap.mask & marked).any():
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


def _marked_part(trap: _Inside, marked: Booleans) -> Set[int]:
    """A smaller marked trap inside a marked trap."""
    for p in np.flatnonzero(trap.mask & marked).tolist():  # it must contain this place
        needed, possible, closed = trap.demand({p})
        if possible and closed:
            return needed
    for p in trap.numbers():
        if trap.has(p):
            smaller = trap.copy()
            smaller.remove(p)
            if (smaller.mask & marked).any():
                trap = smaller
    return set(trap.numbers())


@dataclass(eq=False)
class _Rules:
    """The arcs as seen by siphons; for traps, the directions are exchanged. Places and transitions
    are numbered from 0.

    :ivar feeding: for each place the transitions that put tokens into it: each of them must take
        from every siphon that contains the place.
    :ivar taking: for each transition, the places that it takes from.
    :ivar fed: for each transition the places that it puts tokens into.
    :ivar asking: for each place the transitions that take from it.
    :ivar numbers: for each place its number in the net.
    :ivar connected: whether the places are known to be strongly connected.
    """

    feeding: Sequence[Sequence[int]]
    taking: Sequence[Sequence[int]]
    fed: Sequence[Sequence[int]]
    asking: Sequence[Sequence[int]]
    numbers: Sequence[int]
    connected: bool = False

    def of_part(self, places: Sequence[int], effort: Effort, connected: bool = False) -> _Rules:
        """The rules restricted to these places, which are numbered by their order here."""
        place = {p: i for i, p in enumerate(places)}
        transition: Dict[int, int] = {}
        for p in places:
            for t in chain(self.feeding[p], self.asking[p]):
                transition.setdefault(t, len(transition))
        taking = [tuple([place[q] for q in self.taking[t] if q in place]) for t in transition]
        fed = [tuple([place[q] for q in self.fed[t] if q in place]) for t in transition]
        effort.spend(
            1 + len(places) + sum(len(self.taking[t]) + len(self.fed[t]) for t in transition) // 4,
            _PLACES,
        )
        return _Rules(
            [tuple([transition[t] for t in self.feeding[p]]) for p in places],
            taking,
            fed,
            [tuple([transition[t] for t in self.asking[p]]) for p in places],
            [self.numbers[p] for p in places],
            connected,
        )

    def in_net(self, places: Iterable[int]) -> FrozenSet[int]:
        """The numbers that these places have in the net."""
        return frozenset([self.numbers[p] for p in places])

    @cached_property
    def here(self) -> Dict[int, int]:
        """The numbers of the places here, by those in the net."""
        return {number: p for p, number in enumerate(self.numbers)}

    @cached_property
    def feeding_arcs(self) -> Tuple[Indices, Indices]:
        """The pairs of ``feeding``, as two arrays: places, transitions."""
        return _pairs(self.feeding)

    @cached_property
    def taking_arcs(self) -> Tuple[Indices, Indices]:
        """The pairs of ``asking``, as two arrays: places, transitions."""
        return _pairs(self.asking)


def _pairs(rows: Sequence[Sequence[int]]) -> Tuple[Indices, Indices]:
    lengths = np.fromiter(map(len, rows), dtype=np.int64, count=len(rows))
    return (
        np.repeat(np.arange(len(rows)), lengths),
        np.fromiter(chain.from_iterable(rows), dtype=np.int64, count=int(lengths.sum())),
    )


class Directions:
    """The arcs of a net as seen by siphons and by traps, built once for all questions on both."""

    def __init__(self, net: Net) -> None:
        taken, fed = _sets(net.inputs), _sets(net.outputs)
        numbers = range(len(net.places))
        self.siphons = _Rules(net.producers, taken, fed, net.consumers, numbers)
        self.traps = _Rules(net.consumers, fed, taken, net.producers, numbers)


def _sets(arcs: Sequence[Sequence[Tuple[int, int]]]) -> List[Tuple[int, ...]]:
    return [tuple([p for p, _ in row]) for row in arcs]


class _Inside:
    """The largest siphon (trap) inside a set of places, updated when a place is removed from the
    set.

    :ivar size: the number of its places.
    """

    def __init__(
        self, rules: _Rules, places: bytearray, left: array[int], size: int, effort: Effort
    ) -> None:
        self.rules = rules
        self.size = size
        self._places = places  # for each place, whether it belongs to it
        # for each transition, how many of the places that it takes from belong to it
        self._left = left
        self._effort = effort

    @classmethod
    def largest(cls, rules: _Rules, effort: Effort, within: Optional[Booleans] = None) -> _Inside:
        """The largest one, among all places or ``within`` a set (boolean array)."""
        if within is None:
            within = np.ones(len(rules.feeding), dtype=bool)
        places, transitions = rules.taking_arcs
        left = np.bincount(transitions[within[places]], minlength=len(rules.taking))
        places, transitions = rules.feeding_arcs
        leaving = np.unique(places[left[transitions] == 0])
        effort.spend(1 + (len(left) + len(within)) // _VECTORISED, _PLACES)
        found = cls(
            rules,
            bytearray(within.tobytes()),
            array("i", left.astype(np.int32).tobytes()),
            int(within.sum()),
            effort,
        )
        found._settle(leaving.tolist())
        return found

    @property
    def mask(self) -> Booleans:
        """Boolean array: which places belong to it."""
        return np.frombuffer(bytes(self._places), dtype=bool)

    def numbers(self) -> List[int]:
        """The numbers of its places, sorted."""
        found: List[int] = np.flatnonzero(self.mask).tolist()
        return found

    def has(self, place: int) -> bool:
        """Whether ``place`` belongs to it."""
        return bool(self._places[place])

    def has_all(self, places: Iterable[int]) -> bool:
        """Whether all of ``places`` belong to it."""
        return all(map(self._places.__getitem__, places))

    def copy(self) -> _Inside:
        """An independent copy."""
        self._effort.spend(1 + (len(self._places) + len(self._left)) // _VECTORISED, _PLACES)
        return _Inside(self.rules, self._places[:], self._left[:], self.size, self._effort)

    def remove(self, place: int) -> None:
        """Remove ``place``, and the places that can then no longer belong to it."""
        self._settle([place])

    def _settle(self, leaving: List[int]) -> None:
        places, left, rules = self._places, self._left, self.rules
        steps = 0
        while leaving:
            p = leaving.pop()
            if not places[p]:
                continue
            places[p] = 0
            self.size -= 1
            steps += 1
            for t in rules.asking[p]:
                steps += 1
                left[t] = rest = left[t] - 1
                if not rest:
                    leaving += [q for q in rules.fed[t] if places[q]]
        self._effort.spend(steps, _PLACES)

    def demand(self, required: Iterable[int]) -> Tuple[Set[int], bool, bool]:
        """The places that a siphon (trap) inside this one must contain if it contains ``required``.

        :returns: the places it must contain; whether such a set is possible; whether these places
            already form one.
        """
        needed = set(required)
        fresh = list(needed)
        open_transitions: Set[int] = set()
        while fresh or open_transitions:
            while fresh:
                p = fresh.pop()
                if not self._places[p]:
                    return needed, False, False
                self._effort.spend(1 + len(self.rules.feeding[p]), _PLACES)
                open_transitions.update(self.rules.feeding[p])
            remaining: Set[int] = set()
            for t in open_transitions:
                taking = self.rules.taking[t]
                self._effort.spend(len(taking), _PLACES)
                if not needed.isdisjoint(taking):
                    continue
                if self._left[t] == 1:
                    only = next(q for q in taking if self._places[q])
                    needed.add(only)
                    fresh.append(only)
                else:
                    remaining.add(t)
            if not fresh:
                return needed, True, not remaining
            open_transitions = remaining
        return needed, True, True

    def parts(self) -> List[List[int]]:
        """Its strongly connected parts: every minimal set lies in one of them."""
        rules, inside = self.rules, self.mask
        chosen = np.flatnonzero(inside)
        if self.size <= 1 or (rules.connected and self.size == len(inside)):
            return [chosen.tolist()]
        # with a node for each transition, there are no more arcs than in the net
        from_places, into = rules.taking_arcs
        fed, out_of = rules.feeding_arcs
        taken, given = inside[from_places], inside[fed]
        count, nodes = len(inside), len(inside) + len(rules.taking)
        sources = np.concatenate([from_places[taken], count + out_of[given]])
        targets = np.concatenate([count + into[taken], fed[given]])
        self._effort.spend(1 + (nodes + len(sources)) // _VECTORISED, _PLACES)
        of = components(nodes, sources, targets).of
        found: Dict[int, List[int]] = {}
        for p, component in zip(chosen.tolist(), of[chosen].tolist()):
            found.setdefault(component, []).append(p)
        return list(found.values())


_VECTORISED = 32
"""Number of elements that compiled code processes in the time of one step of Python."""

_PLACES = "steps of siphons and traps"


class _Found:
    """The minimal sets found so far.

    :ivar sets: these sets, as numbers of places of the net.
    """

    def __init__(self) -> None:
        self.sets: Set[FrozenSet[int]] = set()
        self._first: Set[int] = set()  # the lowest place of each

    def add(self, places: FrozenSet[int]) -> None:
        """Add a minimal set."""
        self.sets.add(places)
        self._first.add(min(places))

    def within(self, inside: _Inside, effort: Effort) -> List[Set[int]]:
        """The sets found ``inside`` another, in its numbers: usually none in a net of thousands of
        parts."""
        if not self.sets:
            return []
        effort.spend(1 + inside.size // 16, _PLACES)
        places = inside.rules.in_net(inside.numbers())
        if self._first.isdisjoint(places):
            return []
        effort.spend(len(self.sets) // 4, _PLACES)
        here = inside.rules.here
        return [{here[number] for number in s} for s in self.sets if s <= places]


def _minimal_sets(rules: _Rules, effort: Effort) -> Set[FrozenSet[int]]:
    """All minimal sets."""
    found = _Found()
    waiting: List[Tuple[_Inside, int, FrozenSet[int]]] = [
        (_Inside.largest(rules, effort), -1, frozenset())
    ]
    while waiting:
        inside, without, required = waiting.pop()
        effort.spend(1, _PLACES, "%d found" % len(found.sets))
        if without >= 0:
            inside = inside.copy()
            inside.remove(without)
        if not inside.size or not inside.has_all(required):
            continue
        rules, parts = inside.rules, inside.parts()
        if len(parts) == 1 and inside.size * 2 > len(rules.feeding):
            _branch(inside, required, effort, found, waiting)
            continue
        for part in parts:
            if required and not required.issubset(part):
                continue
            if len(part) * 2 > len(rules.feeding):
                mask = np.zeros(len(rules.feeding), dtype=bool)
                mask[part] = True
                waiting.append((_Inside.largest(rules, effort, mask), -1, required))
            elif len(part) > 1:
                of_part = rules.of_part(part, effort, connected=True)
                numbers = {p: i for i, p in enumerate(part)} if required else {}
                waiting.append(
                    (
                        _Inside.largest(of_part, effort),
                        -1,
                        frozenset(numbers[p] for p in required),
                    )
                )
            elif _is_one(rules, part[0], effort):
                found.add(rules.in_net(part))
    return found.sets


def _is_one(rules: _Rules, place: int, effort: Effort) -> bool:
    """Whether a single place is a siphon (trap)."""
    effort.spend(1, _PLACES)
    return all(place in rules.taking[t] for t in rules.feeding[place])


def _branch(
    inside: _Inside,
    required: FrozenSet[int],
    effort: Effort,
    found: _Found,
    waiting: List[Tuple[_Inside, int, FrozenSet[int]]],
) -> None:
    """Search a strongly connected set for the minimal sets that contain all of ``required``: add
    one to ``found``, and the branches that may contain others to ``waiting``."""
    rules = inside.rules
    needed, possible, closed = inside.demand(required)
    if not possible:
        return
    if not (closed and needed):
        known = found.within(inside, effort)
        if known:
            pivot = min(known, key=lambda s: len(s - needed))
        else:
            pivot = _shrunk(inside)
            found.add(rules.in_net(pivot))
        for p in sorted(pivot - needed):
            if p in needed:  # by now, the other places require it
                continue
            waiting.append((inside, p, frozenset(needed)))
            needed, possible, closed = inside.demand(needed | {p})
            if not possible:
                return
            if closed:
                break
    # every set that contains all of them is that set, or larger
    if closed and needed and rules.in_net(needed) not in found.sets:
        smaller = rules.of_part(sorted(needed), effort)
        found.add(smaller.in_net(_shrunk(_Inside.largest(smaller, effort))))


def _shrunk(inside: _Inside) -> Set[int]:
    """A minimal set inside ``inside``, which must not be empty."""
    needed: Set[int] = set()  # the places that every set inside contains
    for p in inside.numbers():
        if p in needed or not inside.has(p):
            continue
        smaller = inside.copy()
        smaller.remove(p)
        if smaller.size:
            inside = smaller
        else:
            needed.add(p)
        needed, _, closed = inside.demand(needed)
        if closed and needed:
            return needed
    return set(inside.numbers())


def _named(net: Net, found: Iterable[Iterable[int]]) -> List[PlaceSet]:
    sets = sorted((sorted(places) for places in found), key=lambda numbers: (len(numbers), numbers))
    return [
        PlaceSet(
            tuple(net.places[p].name for p in numbers), any(net.initial_marking[p] for p in numbers)
        )
        for numbers in sets
    ]
