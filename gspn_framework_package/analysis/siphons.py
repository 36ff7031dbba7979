"""Siphons and traps: sets of places that stay empty once they are, or marked once they are.

A *siphon* is a set of places such that every transition that puts a token into it also takes one out of it; a
*trap* is the same with the directions exchanged. The minimal ones are listed by branching on the places of one
already found, each branch without one of its places. There can be exponentially many; the work stops at a limit
and says so. Inhibitor arcs play no part.
"""

from __future__ import annotations

from typing import List, NamedTuple, Sequence, Set, Tuple

from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

SIPHON_LIMIT = 20_000
"""Branches that the search may look at."""


class PlaceSet(NamedTuple):
    """A siphon or a trap: its ``places``, and whether one of them is ``marked`` initially."""

    places: Tuple[str, ...]
    marked: bool


def minimal_siphons(net: Net, limit: int = SIPHON_LIMIT) -> List[PlaceSet]:
    """The minimal siphons, by size. :raises LimitError: the search looked at more than ``limit`` branches."""
    return _named(net, _minimal_sets(len(net.places), net.producers, _sets(net.inputs), limit))


def minimal_traps(net: Net, limit: int = SIPHON_LIMIT) -> List[PlaceSet]:
    """The minimal traps, by size. :raises LimitError: the search looked at more than ``limit`` branches."""
    return _named(net, _minimal_sets(len(net.places), net.consumers, _sets(net.outputs), limit))


def largest_siphon(net: Net, within: int) -> int:
    """The largest siphon inside the set of places ``within`` (bit sets of place numbers)."""
    return _reduce(within, net.producers, _sets(net.inputs))


def largest_trap(net: Net, within: int) -> int:
    """The largest trap inside the set of places ``within`` (bit sets of place numbers)."""
    return _reduce(within, net.consumers, _sets(net.outputs))


def _sets(arcs: Sequence[Sequence[Tuple[int, int]]]) -> List[int]:
    return [sum(1 << p for p in {p for p, _ in row}) for row in arcs]


def _reduce(within: int, feeding: Sequence[Sequence[int]], support: Sequence[int]) -> int:
    """``within`` less the places that some transition feeds without taking from what is left."""
    changed = True
    while changed:
        changed = False
        for p in _numbers(within):
            if any(not support[t] & within for t in feeding[p]):
                within &= ~(1 << p)
                changed = True
    return within


def _minimal_sets(count: int, feeding: Sequence[Sequence[int]], support: Sequence[int], limit: int) -> Set[int]:
    found: Set[int] = set()
    waiting: List[Tuple[int, int]] = [((1 << count) - 1, 0)]  # (places allowed, places required)
    looked_at = 0
    while waiting:
        looked_at += 1
        if looked_at > limit:
            raise LimitError("there are too many: %d found, not all looked for" % len(found))
        allowed, required = waiting.pop()
        allowed = _reduce(allowed, feeding, support)
        required, closed = _demand(required, allowed, feeding, support)
        if not allowed or required & ~allowed:
            continue
        if closed and required:
            found.add(_shrink(required, feeding, support))
            continue
        inside = [known for known in found if not known & ~allowed]
        if inside:
            pivot = min(inside, key=lambda known: bin(known & ~required).count("1"))
        else:
            pivot = _shrink(allowed, feeding, support)
            found.add(pivot)
        before = required
        for p in _numbers(pivot & ~required):
            waiting.append((allowed & ~(1 << p), before))
            before |= 1 << p
    return found


def _demand(required: int, allowed: int, feeding: Sequence[Sequence[int]], support: Sequence[int]) -> Tuple[int, bool]:
    """``required`` with the places that it cannot do without (where a transition that feeds it has one input place
    left), and whether it is a siphon by itself now. A demand that cannot be met shows as a place that is not
    ``allowed``."""
    while True:
        closed = True
        for p in _numbers(required):
            for t in feeding[p]:
                if support[t] & required:
                    continue
                closed = False
                options = support[t] & allowed
                if not options:
                    return required | ~allowed, False
                if not options & (options - 1):
                    required |= options
                    break
            else:
                continue
            break
        else:
            return required, closed


def _shrink(siphon: int, feeding: Sequence[Sequence[int]], support: Sequence[int]) -> int:
    """A minimal set inside ``siphon``."""
    for p in _numbers(siphon):
        if siphon >> p & 1:
            smaller = _reduce(siphon & ~(1 << p), feeding, support)
            if smaller:
                siphon = smaller
    return siphon


def _numbers(bits: int) -> List[int]:
    found = []
    while bits:
        lowest = bits & -bits
        found.append(lowest.bit_length() - 1)
        bits ^= lowest
    return found


def _named(net: Net, found: Set[int]) -> List[PlaceSet]:
    sets = sorted((_numbers(bits) for bits in found), key=lambda numbers: (len(numbers), numbers))
    return [
        PlaceSet(tuple(net.places[p].name for p in numbers), any(net.initial_marking[p] for p in numbers))
        for numbers in sets
    ]
