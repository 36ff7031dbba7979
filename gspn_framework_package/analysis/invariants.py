"""P-invariants and T-invariants: the minimal non-negative ones (semiflows), and what follows from them.

The algorithm is that of Farkas with the support test of Colom and Silva (1991). There can be exponentially many
minimal invariants; the work stops at a limit and says so.
"""

from __future__ import annotations

from math import gcd
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Marking, Net

INVARIANT_LIMIT = 20_000
"""Candidate rows that the search may hold at once."""


class Invariant(NamedTuple):
    """A weighted sum over places (or transitions) that firing (or a cycle) leaves as it is.

    :ivar weights: name -> positive whole number; the names that are left out have weight 0.
    :ivar value: of a P-invariant, the sum in the initial marking, which all reachable markings share; None of a
        T-invariant.
    """

    weights: Dict[str, int]
    value: Optional[int] = None

    def __str__(self) -> str:
        terms = ["%s%s" % ("" if w == 1 else "%d*" % w, name) for name, w in self.weights.items()]
        return " + ".join(terms) + ("" if self.value is None else " = %d" % self.value)


def place_invariants(net: Net, limit: int = INVARIANT_LIMIT) -> List[Invariant]:
    """The minimal-support P-invariants.

    :raises LimitError: the search held more than ``limit`` candidates.
    """
    names = [p.name for p in net.places]
    return [
        Invariant({names[p]: w for p, w in row}, sum(w * net.initial_marking[p] for p, w in row))
        for row in _place_semiflows(net, limit)
    ]


def transition_invariants(net: Net, limit: int = INVARIANT_LIMIT) -> List[Invariant]:
    """The minimal-support T-invariants: how often each transition fires on a way back to the same marking.

    :raises LimitError: the search held more than ``limit`` candidates.
    """
    names = [t.name for t in net.transitions]
    columns: List[Dict[int, int]] = [dict(net.effect(t)) for t in range(len(names))]
    return [Invariant({names[t]: w for t, w in row}) for row in _semiflows(columns, limit)]


def transition_surpluses(net: Net, limit: int = INVARIANT_LIMIT) -> List[Dict[str, int]]:
    """The minimal firing counts (transition -> times) that lose no token, and may win some.

    :raises LimitError: the search held more than ``limit`` candidates.
    """
    names = [t.name for t in net.transitions]
    columns: List[Dict[int, int]] = [dict(net.effect(t)) for t in range(len(names))]
    columns += [{p: -1} for p in range(len(net.places))]  # what a place wins is thrown away
    rows = _semiflows(columns, limit)
    return [{names[t]: w for t, w in row if t < len(names)} for row in rows]


def invariant_bounds(net: Net, limit: int = INVARIANT_LIMIT) -> Tuple[Optional[int], ...]:
    """For each place the bound that the P-invariants and its capacity give, or None. When there are too many
    invariants the capacities alone speak."""
    try:
        rows = _place_semiflows(net, limit)
    except LimitError:
        rows = []
    return bounds_of(net, rows, net.initial_marking)


def bounds_of(net: Net, rows: Sequence[Sequence[Tuple[int, int]]], marking: Marking) -> Tuple[Optional[int], ...]:
    """The bounds that these invariants (pairs of place number and weight) give from ``marking``."""
    bounds: List[Optional[int]] = [place.capacity for place in net.places]
    for row in rows:
        value = sum(w * marking[p] for p, w in row)
        for p, w in row:
            known = bounds[p]
            bounds[p] = value // w if known is None else min(known, value // w)
    return tuple(bounds)


def _place_semiflows(net: Net, limit: int) -> List[Tuple[Tuple[int, int], ...]]:
    residuals: List[Dict[int, int]] = [{} for _ in net.places]
    for t in range(len(net.transitions)):
        for p, change in net.effect(t):
            residuals[p][t] = change
    return _semiflows(residuals, limit)


class _Row(NamedTuple):
    support: int  # bit set of the items
    weights: Dict[int, int]
    residual: Dict[int, int]  # what is not yet cancelled


def _semiflows(columns: Sequence[Dict[int, int]], limit: int) -> List[Tuple[Tuple[int, int], ...]]:
    """The minimal-support non-negative integer combinations of ``columns`` that give zero."""
    rows = [_Row(1 << i, {i: 1}, dict(column)) for i, column in enumerate(columns)]
    while True:
        index = _cheapest(rows)
        if index is None:
            break
        positive = [r for r in rows if r.residual.get(index, 0) > 0]
        negative = [r for r in rows if r.residual.get(index, 0) < 0]
        rows = [r for r in rows if index not in r.residual]
        fresh: List[_Row] = []
        if len(positive) * len(negative) > limit:
            raise LimitError("there are too many invariants: more than %d candidates" % limit)
        for a in positive:
            for b in negative:
                fresh.append(_combine(a, b, index))
        rows = _minimal(rows, fresh)
        if len(rows) > limit:
            raise LimitError("there are too many invariants: more than %d candidates" % limit)
    found = [tuple(sorted(r.weights.items())) for r in rows]
    return sorted(found, key=lambda row: [i for i, _ in row])


def _cheapest(rows: Sequence[_Row]) -> Optional[int]:
    """The column whose cancelling makes the fewest new rows; None when all are cancelled."""
    signs: Dict[int, List[int]] = {}
    for row in rows:
        for index, value in row.residual.items():
            signs.setdefault(index, [0, 0])[value > 0] += 1
    if not signs:
        return None
    return min(signs, key=lambda i: (signs[i][0] * signs[i][1] - signs[i][0] - signs[i][1], i))


def _combine(a: _Row, b: _Row, index: int) -> _Row:
    x, y = -b.residual[index], a.residual[index]
    common = gcd(x, y)
    x, y = x // common, y // common
    weights = {i: x * w for i, w in a.weights.items()}
    for i, w in b.weights.items():
        weights[i] = weights.get(i, 0) + y * w
    residual = {i: x * v for i, v in a.residual.items()}
    for i, v in b.residual.items():
        total = residual.get(i, 0) + y * v
        if total:
            residual[i] = total
        else:
            residual.pop(i, None)
    divisor = _gcd_all(weights, residual)
    if divisor > 1:
        weights = {i: w // divisor for i, w in weights.items()}
        residual = {i: v // divisor for i, v in residual.items()}
    return _Row(a.support | b.support, weights, residual)


def _gcd_all(weights: Dict[int, int], residual: Dict[int, int]) -> int:
    divisor = 0
    for value in weights.values():
        divisor = gcd(divisor, value)
        if divisor == 1:
            return 1
    for value in residual.values():
        divisor = gcd(divisor, value)
    return divisor


def _minimal(rows: Sequence[_Row], fresh: Sequence[_Row]) -> List[_Row]:
    """``rows`` and ``fresh`` without those whose support holds that of another."""
    kept: List[_Row] = []
    everyone = sorted(list(rows) + list(fresh), key=lambda r: bin(r.support).count("1"))
    by_lowest: Dict[int, List[int]] = {}  # lowest item of a kept support -> those supports
    for row in everyone:
        if any(other & ~row.support == 0 for i in _bits(row.support) for other in by_lowest.get(i, ())):
            continue
        kept.append(row)
        by_lowest.setdefault(row.support & -row.support, []).append(row.support)
    return kept


def _bits(number: int) -> List[int]:
    """The powers of two that add up to ``number``."""
    found = []
    while number:
        lowest = number & -number
        found.append(lowest)
        number ^= lowest
    return found
