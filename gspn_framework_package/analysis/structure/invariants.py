"""Minimal non-negative P-invariants and T-invariants (semiflows), and the bounds that they imply.

The algorithm is that of Farkas with the support test of Colom and Silva (1991). A first elimination
handles the columns that concern a single row or two rows that cancel each other: these need no test
and create no additional rows, and in most large nets they are nearly all columns. There can be
exponentially many minimal invariants; the search stops at a limit and reports it.

A net may have 100,000 nodes, so the columns are a sparse matrix, and NumPy drops those that cannot
cancel; Python objects are created only for the rest.
"""

from __future__ import annotations

import heapq
from collections import deque
from math import gcd
from typing import Deque, Dict, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices
from gspn_framework_package.analysis.limits import STRUCTURE_LIMIT, Effort
from gspn_framework_package.analysis.structure import incidence
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Marking, Net

Semiflow = Tuple[Tuple[int, int], ...]
"""Pairs (number of a place or transition, weight), sorted by number."""


_ROWS = "steps of invariants"

_ALL = 1 << 62

_VECTORISED = 32
"""Number of entries that NumPy processes in the time of one step of Python."""


class Invariant(NamedTuple):
    """A P-invariant (a weighted sum over places that no firing changes) or a T-invariant (firing
    counts that lead back to the same marking).

    :ivar weights: name -> positive integer; all other names have weight 0.
    :ivar value: for a P-invariant, its sum in the initial marking, and so in all reachable ones;
        None for a T-invariant.
    """

    weights: Dict[str, int]
    value: Optional[int] = None

    def __str__(self) -> str:
        terms = ["%s%s" % ("" if w == 1 else "%d*" % w, name) for name, w in self.weights.items()]
        return " + ".join(terms) + ("" if self.value is None else " = %d" % self.value)


def place_invariants(
    net: Net,
    limit: int = STRUCTURE_LIMIT,
    watch: Optional[Watch] = None,
    largest: Optional[int] = None,
) -> List[Invariant]:
    """The minimal-support P-invariants.

    :param largest: those with more places may be missing.
    :raises LimitError: the search took more than ``limit`` steps.
    """
    names = [p.name for p in net.places]
    return [
        Invariant({names[p]: w for p, w in row}, sum(w * net.initial_marking[p] for p, w in row))
        for row in _place_semiflows(net, Effort(limit, watch), largest)
    ]


def transition_invariants(
    net: Net, limit: int = STRUCTURE_LIMIT, watch: Optional[Watch] = None
) -> List[Invariant]:
    """The minimal-support T-invariants: how often each transition fires on a path back to the same
    marking.

    :raises LimitError: the search took more than ``limit`` steps.
    """
    names = [t.name for t in net.transitions]
    return [
        Invariant({names[t]: w for t, w in row})
        for row in _semiflows(_transition_columns(net), Effort(limit, watch))
    ]


def transition_surpluses(
    net: Net, limit: int = STRUCTURE_LIMIT, watch: Optional[Watch] = None
) -> List[Dict[str, int]]:
    """The minimal firing counts (transition -> times) that lose no token, and may gain some.

    :raises LimitError: the search took more than ``limit`` steps.
    """
    names = [t.name for t in net.transitions]
    columns = _transition_columns(net)
    places = np.arange(len(net.places))
    columns = _Columns(  # tokens that a place gains may be discarded
        columns.number + len(places),
        np.concatenate([columns.items, columns.number + places]),
        np.concatenate([columns.indices, places]),
        columns.values + [-1] * len(places),
        np.concatenate([columns.up, np.zeros(len(places), dtype=bool)]),
    )
    rows = _semiflows(columns, Effort(limit, watch))
    return [{names[t]: w for t, w in row if t < len(names)} for row in rows]


def invariant_bounds(
    net: Net, limit: int = STRUCTURE_LIMIT, watch: Optional[Watch] = None
) -> Tuple[Optional[int], ...]:
    """For each place the bound from the P-invariants and its capacity, or None. If there are too
    many invariants, only the capacities are used."""
    try:
        rows = _place_semiflows(net, Effort(limit, watch))
    except LimitError:
        rows = []
    return bounds_of(net, rows, net.initial_marking)


def bounds_of(
    net: Net, rows: Sequence[Sequence[Tuple[int, int]]], marking: Marking
) -> Tuple[Optional[int], ...]:
    """The bounds that these invariants (pairs of place number and weight) give from ``marking``."""
    bounds: List[Optional[int]] = [place.capacity for place in net.places]
    for row in rows:
        value = sum(w * marking[p] for p, w in row)
        for p, w in row:
            known = bounds[p]
            bounds[p] = value // w if known is None else min(known, value // w)
    return tuple(bounds)


def uncovered_place(net: Net) -> Optional[str]:
    """A place that is in no P-invariant, if that is evident without a search. None: there may be
    such a place or not."""
    lost = _Elimination(_place_columns(net), Effort(_ALL)).lost
    return net.places[min(lost)].name if lost else None


def uncovered_transition(net: Net) -> Optional[str]:
    """A transition that is in no T-invariant, if that is evident without a search; None leaves it
    open."""
    lost = _Elimination(_transition_columns(net), Effort(_ALL)).lost
    return net.transitions[min(lost)].name if lost else None


class _Columns(NamedTuple):
    """The columns to combine, as a sparse matrix without zeros: column ``items[k]`` has the value
    ``values[k]`` at the index ``indices[k]``.

    :ivar number: the number of columns.
    :ivar up: whether the values are positive.
    """

    number: int
    items: Indices
    indices: Indices
    values: List[int]  # not an array: a value may be larger than 2**63
    up: Booleans


def _transition_columns(net: Net) -> _Columns:
    transitions, places, values, up = incidence.effects(net)
    return _Columns(len(net.transitions), transitions, places, values, up)


def _place_columns(net: Net) -> _Columns:
    transitions, places, values, up = incidence.effects(net)
    return _Columns(len(net.places), places, transitions, values, up)


def _place_semiflows(net: Net, effort: Effort, largest: Optional[int] = None) -> List[Semiflow]:
    return _semiflows(_place_columns(net), effort, largest)


def _semiflows(columns: _Columns, effort: Effort, largest: Optional[int] = None) -> List[Semiflow]:
    """The minimal-support non-negative integer combinations of ``columns`` that give zero.

    :param largest: those of more columns may be missing.
    """
    simple = _Elimination(columns, effort)
    found = [_primitive(row.weights) for row in simple.rows if not row.residual]
    atoms = [row for row in simple.rows if row.residual]
    for combination in _combined([row.residual for row in atoms], effort, largest):
        weights: Dict[int, int] = {}
        for atom, times in combination.items():
            effort.spend(len(atoms[atom].weights), _ROWS)
            weights.update((i, times * w) for i, w in atoms[atom].weights.items())
        found.append(_primitive(weights))
    return sorted(found, key=lambda row: [i for i, _ in row])


def _primitive(weights: Dict[int, int]) -> Semiflow:
    divisor = _gcd_all(weights.values())
    return tuple(sorted((i, w // divisor) for i, w in weights.items()))


def _gcd_all(values: Iterable[int]) -> int:
    divisor = 0
    for value in values:
        divisor = gcd(divisor, value)
        if divisor == 1:
            break
    return divisor


class _Atom:
    """A positive combination of columns that no other atom uses: the ``weights`` of the columns,
    and the ``residual`` that is not yet cancelled."""

    __slots__ = ("weights", "residual")

    def __init__(self, item: int, column: Dict[int, int]) -> None:
        self.weights = {item: 1}
        self.residual = column

    @property
    def size(self) -> int:
        return len(self.weights) + len(self.residual)

    def scale(self, times: int) -> None:
        if times != 1:
            self.weights = {i: times * w for i, w in self.weights.items()}
            self.residual = {i: times * v for i, v in self.residual.items()}


def _is_simple(lowering: Set[int], raising: Set[int]) -> bool:
    """Whether the atoms that change an index can be dropped, or there are just two, which can be
    merged."""
    return not lowering or not raising or len(lowering) == len(raising) == 1


class _Elimination:
    """Cancels indices for which there is no choice.

    If all columns change an index in the same direction, they are dropped; if a single column
    raises it and a single one lowers it, the two are merged. The smaller column is merged into the
    larger one, so a ring costs no more than its arcs.

    :ivar rows: the remaining rows.
    :ivar lost: the numbers of the columns that are in no combination that gives zero.
    """

    def __init__(self, columns: _Columns, effort: Effort) -> None:
        self._effort = effort
        kept = self._kept_of(columns)
        numbers = np.flatnonzero(kept).tolist()
        self.lost: Set[int] = set(np.flatnonzero(~kept).tolist())
        self._atoms: Dict[int, _Atom] = {i: _Atom(i, {}) for i in numbers}
        items, indices = columns.items.tolist(), columns.indices.tolist()
        for k in np.flatnonzero(kept[columns.items]).tolist():
            self._atoms[items[k]].residual[indices[k]] = columns.values[k]
        # index -> (atoms that lower it, atoms that raise it)
        self._at: Dict[int, Tuple[Set[int], Set[int]]] = {}
        for number, atom in self._atoms.items():
            for index, value in atom.residual.items():
                if index not in self._at:
                    self._at[index] = set(), set()
                self._at[index][value > 0].add(number)
        self._waiting: Deque[int] = deque(
            index
            for index, (lowering, raising) in self._at.items()
            if _is_simple(lowering, raising)
        )
        while self._waiting:
            self._look_at(self._waiting.popleft())
        self.rows = [self._atoms[number] for number in sorted(self._atoms)]

    def _kept_of(self, columns: _Columns) -> Booleans:
        """Boolean array: the columns that remain after dropping, again and again, all columns that
        change an index if they all change it in the same direction. This ends when few are dropped
        at a time.

        :raises LimitError: so many remain, with nothing to merge, that combining them exceeds the
            limit.
        """
        kept = np.ones(columns.number, dtype=bool)
        items, indices, up = columns.items, columns.indices, columns.up
        size = int(indices.max()) + 1 if len(indices) else 0
        while True:
            self._effort.spend(len(items) // _VECTORISED, _ROWS)
            raised = np.bincount(indices[up], minlength=size)
            lowered = np.bincount(indices[~up], minlength=size)
            gone = np.unique(items[((raised > 0) != (lowered > 0))[indices]])
            if not len(gone) and not ((raised == 1) & (lowered == 1)).any():
                _afford_rows(len(np.unique(items)), self._effort)
            if len(gone) * _VECTORISED <= len(items):
                return kept
            kept[gone] = False
            left = kept[items]
            items, indices, up = items[left], indices[left], up[left]

    def _look_at(self, index: int) -> None:
        self._effort.spend(1, _ROWS)
        lowering, raising = self._at[index]
        if not lowering or not raising:
            # iterating over a set that was once large takes just as long when it is empty
            if lowering or raising:
                for number in list(lowering or raising):
                    self._drop(number)
        elif len(lowering) == len(raising) == 1:
            a, b = next(iter(lowering)), next(iter(raising))
            large, small = (a, b) if self._atoms[a].size >= self._atoms[b].size else (b, a)
            self._merge(large, small, index)

    def _drop(self, number: int) -> None:
        atom = self._atoms.pop(number)
        self._effort.spend(atom.size, _ROWS)
        self.lost.update(atom.weights)
        for index, value in atom.residual.items():
            self._at[index][value > 0].discard(number)
            self._waiting.append(index)

    def _merge(self, large: int, small: int, index: int) -> None:
        """Add ``small`` to ``large`` so that ``index`` cancels."""
        into, other = self._atoms[large], self._atoms.pop(small)
        self._effort.spend(other.size, _ROWS)
        x, y = abs(other.residual[index]), abs(into.residual[index])
        common = gcd(x, y)
        x, y = x // common, y // common
        if x != 1:
            self._effort.spend(into.size, _ROWS)
        into.scale(x)
        into.weights.update((i, y * w) for i, w in other.weights.items())
        for i, v in other.residual.items():
            before = into.residual.get(i, 0)
            after = before + y * v
            self._at[i][v > 0].discard(small)
            if before:
                self._at[i][before > 0].discard(large)
            if after:
                into.residual[i] = after
                self._at[i][after > 0].add(large)
            else:
                into.residual.pop(i, None)
            self._waiting.append(i)


class _Row(NamedTuple):
    support: int  # bit set of the atoms
    weights: Dict[int, int]
    residual: Dict[int, int]  # the part not yet cancelled


def _afford_rows(rows: int, effort: Effort) -> int:
    """Number of steps to build the bit sets of the supports of this many rows.

    :raises LimitError: they exceed the limit.
    """
    steps = rows**2 >> 10
    effort.afford(steps)
    return steps


def _combined(
    residuals: Sequence[Dict[int, int]], effort: Effort, largest: Optional[int]
) -> List[Dict[int, int]]:
    """The minimal-support non-negative integer combinations of ``residuals`` that give zero.

    :param largest: those of more residuals are left out. Supports only grow, so no other is lost.
    """
    effort.spend(_afford_rows(len(residuals), effort), _ROWS)
    rows: Dict[int, _Row] = {
        i: _Row(1 << i, {i: 1}, dict(column)) for i, column in enumerate(residuals)
    }
    at: Dict[int, Tuple[Set[int], Set[int]]] = {}
    by_lowest: Dict[int, Dict[int, int]] = {}  # lowest bit of a support -> row -> support
    for number, row in rows.items():
        by_lowest[row.support] = {number: row.support}
        for index, value in row.residual.items():
            at.setdefault(index, (set(), set()))[value > 0].add(number)
    heap = [(_cost(at[index]), index) for index in at]
    heapq.heapify(heap)
    fresh_number = len(rows)
    while heap:
        cost, index = heapq.heappop(heap)
        if index not in at or cost != _cost(at[index]):
            continue  # stale: its cost has changed, and it is in the heap again
        negative, positive = at.pop(index)
        effort.spend(len(positive) * len(negative) + 1, _ROWS, "%d candidates" % len(rows))
        fresh: List[_Row] = []
        for a in sorted(positive):
            for b in sorted(negative):
                row = _combine(rows[a], rows[b], index)
                if largest is None or len(row.weights) <= largest:
                    fresh.append(row)
                effort.spend(
                    8 + len(rows[a].residual) + len(rows[a].weights),
                    _ROWS,
                    "%d candidates" % len(rows),
                )
        changed: Set[int] = set()
        for number in positive | negative:
            row = rows.pop(number)
            del by_lowest[row.support & -row.support][number]
            for i, value in row.residual.items():
                if i != index:
                    at[i][value > 0].discard(number)
                    changed.add(i)
        # The remaining rows were already minimal, and the new ones are sums of rows: only the new
        # ones can be non-minimal.
        for row in sorted(fresh, key=lambda r: bin(r.support).count("1")):
            if _holds_another(row.support, by_lowest, effort):
                continue
            number, fresh_number = fresh_number, fresh_number + 1
            rows[number] = row
            by_lowest.setdefault(row.support & -row.support, {})[number] = row.support
            for i, value in row.residual.items():
                at[i][value > 0].add(number)
                changed.add(i)
        for i in changed:
            heapq.heappush(heap, (_cost(at[i]), i))
    return [row.weights for row in rows.values()]


def _cost(signs: Tuple[Set[int], Set[int]]) -> int:
    """Number of additional rows after cancelling an index."""
    lowering, raising = len(signs[0]), len(signs[1])
    return lowering * raising - lowering - raising


def _holds_another(support: int, by_lowest: Dict[int, Dict[int, int]], effort: Effort) -> bool:
    """Whether ``support`` contains the support of an existing row."""
    rest = support
    while rest:
        lowest = rest & -rest
        rest ^= lowest
        others = by_lowest.get(lowest)
        if others:
            effort.spend(len(others), _ROWS)
            if any(not other & ~support for other in others.values()):
                return True
    return False


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
    divisor = gcd(_gcd_all(weights.values()), _gcd_all(residual.values()))
    if divisor > 1:
        weights = {i: w // divisor for i, w in weights.items()}
        residual = {i: v // divisor for i, v in residual.items()}
    return _Row(a.support | b.support, weights, residual)
