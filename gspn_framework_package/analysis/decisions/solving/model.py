"""The arrays for the numeric methods: the part of an automaton whose values are unknown.

Everything is maximised here; callers that minimise negate the rewards. With ``E`` the exit rate,
``c`` the constant of a row and ``g`` the gain per second, the unknown values ``V`` satisfy::

    V(s) = (c(s) - g + sum over the arcs of rate * V(target)) / E(s)              s tangible
    V(s) = max over the rows of c(row) + sum of probability * V(target)           s vanishing

Known values (goals, other components) are part of the constants.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, List, NamedTuple, Optional, Tuple

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices, Matrix
from gspn_framework_package.analysis.compiling import numba_is_there
from gspn_framework_package.analysis.decisions.solving.graphs import Arrows
from gspn_framework_package.analysis.graph import components, longest_levels
from gspn_framework_package.model.errors import LimitError

_WORTH_LOADING = 10_000
"""Number of arcs above which compiled loops save more time than loading them takes."""

_SETTLED = 5e-16
"""A cycle of vanishing states has settled when nothing changes by more than this share of the
largest value."""

_TURNS = 100_000
"""Largest number of iterations of such a cycle."""

_NONE: Indices = np.zeros(0, dtype=np.int64)


class _Level(NamedTuple):
    """Vanishing states that depend on each other only if they are ``cyclic``: their numbers, rows,
    the first of the rows of each, and the matrix of the rows."""

    states: Indices
    rows: Indices
    begins: Indices
    matrix: Matrix
    cyclic: bool


@dataclass(eq=False)
class Model:
    """States with unknown values.

    :ivar tangible: boolean array, one value per state.
    :ivar arrows: rows, arcs and targets.
    :ivar values: float array: rate or probability of each arc.
    :ivar constant: float array, one value per row.
    :ivar exits: float array, one value per state: the exit rate, arcs to known states included; 1
      for vanishing states.
    :ivar row_ids: int array: the source of each row.
    :ivar state_ids: int array: the source of each state (one of them, if several).
    :ivar into: boolean array, one value per row: whether it may lead to a goal, which is not a
        state here.
    """

    tangible: Booleans
    arrows: Arrows
    values: Floats
    constant: Floats
    exits: Floats
    row_ids: Indices
    state_ids: Indices
    into: Booleans

    def __len__(self) -> int:
        return len(self.tangible)

    @cached_property
    def compiled(self) -> Any:
        """The compiled loops, or None."""
        if len(self.values) < _WORTH_LOADING or not numba_is_there():
            return None
        from gspn_framework_package.analysis.decisions.solving import numba_sweeps

        return numba_sweeps

    @cached_property
    def matrix(self) -> Matrix:
        """The rows as a sparse matrix (CSR) over the states."""
        return sparse.csr_matrix(
            (self.values, self.arrows.targets, self.arrows.arcs),
            shape=(len(self.constant), len(self)),
        )

    @cached_property
    def first_rows(self) -> Indices:
        """The first row of each state."""
        return self.arrows.rows[:-1]

    @cached_property
    def row_states(self) -> Indices:
        """The state of each row."""
        return self.arrows.row_states

    @cached_property
    def _tangible_rows(self) -> Tuple[Indices, Matrix]:
        states = np.flatnonzero(self.tangible)
        return states, self.matrix[self.arrows.rows[states]]

    # -- vanishing states --------------------------------------------------------------------------

    @cached_property
    def _vanishing_order(self) -> Tuple[Indices, Indices, Booleans]:
        """The vanishing states so that each comes after those it leads to; where each block of them
        begins; whether the block is a cycle."""
        tangible = self.tangible
        states = np.flatnonzero(~tangible)
        if not len(states):
            return states, np.zeros(1, dtype=np.int64), np.zeros(0, dtype=bool)
        sources = np.repeat(self.row_states, np.diff(self.arrows.arcs))
        inner = ~tangible[sources] & ~tangible[self.arrows.targets]
        sources, targets = sources[inner], self.arrows.targets[inner]
        level, acyclic = longest_levels(len(self), sources, targets)
        if acyclic:
            order = states[np.argsort(level[states], kind="stable")]
            begins = np.searchsorted(level[order], np.arange(int(level[order[-1]]) + 2))
            return order, begins, np.zeros(len(begins) - 1, dtype=bool)
        count, of, _ = components(len(self), sources, targets)
        across = of[sources] != of[targets]
        level, _ = longest_levels(count, of[sources[across]], of[targets[across]])
        looping = np.zeros(count, dtype=bool)
        looping[of[sources[~across]]] = True
        # the states of a level that are in no cycle form one block, each cycle another one
        key = np.where(looping[of], of + 1, 0)
        order = states[np.lexsort((key[states], level[of[states]]))]
        names = np.stack([level[of[order]], key[order]], axis=1)
        changes = np.flatnonzero((np.diff(names, axis=0) != 0).any(axis=1)) + 1
        begins = np.concatenate([[0], changes, [len(order)]])
        return order, begins, key[order[begins[:-1]]] > 0

    @cached_property
    def _levels(self) -> List[_Level]:
        order, begins, cyclic = self._vanishing_order
        rows = self.arrows.rows
        found = []
        for first, last, loops in zip(begins[:-1], begins[1:], cyclic):
            states = order[first:last]
            counts = rows[states + 1] - rows[states]
            starts = np.cumsum(counts) - counts
            listed = np.repeat(rows[states] - starts, counts) + np.arange(int(counts.sum()))
            found.append(_Level(states, listed, starts, self.matrix[listed], bool(loops)))
        return found

    def settle(self, values: Floats, chosen: Optional[Indices] = None) -> None:
        """Set the values of the vanishing states from those of the tangible ones, in place.

        :param chosen: the row that each state takes; None: the best.
        :raises LimitError: a cycle of vanishing states with a tiny exit probability did not
            converge.
        """
        order, begins, cyclic = self._vanishing_order
        if not len(order):
            return
        tolerance = _SETTLED * float(np.abs(values).max(initial=0.0))
        if self.compiled is not None:
            settled = self.compiled.settle(
                order,
                begins,
                cyclic,
                self.arrows.rows,
                self.arrows.arcs,
                self.arrows.targets,
                self.values,
                self.constant,
                _NONE if chosen is None else chosen,
                tolerance,
                _TURNS,
                values,
            )
        else:
            settled = self._settle_by_level(values, chosen, tolerance)
        if not settled:
            raise LimitError(
                "a cycle of immediate transitions is left too rarely to compute its value"
            )

    def _settle_by_level(self, values: Floats, chosen: Optional[Indices], tolerance: float) -> bool:
        settled = True
        for level in self._levels:
            for turn in range(_TURNS):
                found = self.constant[level.rows] + level.matrix @ values
                if chosen is None:
                    best = np.maximum.reduceat(found, level.begins)
                else:
                    at = chosen[level.states] - self.arrows.rows[level.states]
                    best = found[level.begins + at]
                if level.cyclic and turn < _TURNS - 1:
                    change = float(np.abs(best - values[level.states]).max())
                    values[level.states] = best
                    if change > tolerance:
                        continue
                elif level.cyclic:
                    settled = False
                values[level.states] = best
                break
        return settled

    # -- steps -------------------------------------------------------------------------------------

    def sweep(self, values: Floats, gain: float, backward: bool = True) -> None:
        """Better values, in place: one sweep over all states."""
        if self.compiled is not None:
            self.compiled.sweep(
                self.tangible,
                self.arrows.rows,
                self.arrows.arcs,
                self.arrows.targets,
                self.values,
                self.constant,
                self._shares,
                gain,
                backward,
                values,
            )
            return
        self.settle(values)
        states, matrix = self._tangible_rows
        total = self.constant[self.arrows.rows[states]] - gain + matrix @ values
        values[states] = total * self._shares[states]

    @cached_property
    def _shares(self) -> Floats:
        with np.errstate(divide="ignore"):
            return np.where(self.exits > 0, 1.0 / self.exits, 0.0)

    def drift(self, values: Floats) -> Floats:
        """For each tangible state ``c + sum of rate * V - E * V``: the imbalance of its equation,
        per second."""
        states, matrix = self._tangible_rows
        return (
            self.constant[self.arrows.rows[states]]
            + matrix @ values
            - self.exits[states] * values[states]
        )

    def row_values(self, values: Floats, gain: float = 0.0) -> Floats:
        """The value of taking each row."""
        if self.compiled is not None:
            found = np.empty(len(self.constant))
            self.compiled.backed_up(
                self.arrows.arcs,
                self.arrows.targets,
                self.values,
                self.constant,
                values,
                found,
            )
        else:
            found = self.constant + self.matrix @ values
        tangible = self.tangible
        rows = self.first_rows[tangible]
        found[rows] = np.where(
            self.exits[tangible] > 0,
            (found[rows] - gain) * self._shares[tangible],
            values[tangible],
        )
        return found

    def best_rows(self, row_values: Floats, slack: float = 0.0) -> Indices:
        """The first row of each state whose value is within ``slack`` of the best."""
        rows = self.arrows.rows
        if len(self.constant) == len(self):
            return np.arange(len(self), dtype=np.int64)
        best = np.maximum.reduceat(row_values, rows[:-1])
        good = np.flatnonzero(row_values >= best[self.row_states] - slack)[::-1]
        found = np.empty(len(self), dtype=np.int64)
        found[self.row_states[good]] = good
        return found

    def part(
        self, number: Indices, size: int, rows: Booleans, known: Optional[Floats] = None
    ) -> Model:
        """A model of some of the states and rows; see :func:`made`."""
        part = made(
            self.tangible,
            self.arrows,
            self.values,
            self.constant,
            self.exits,
            number=number,
            size=size,
            rows=rows,
            known=known,
        )
        part.into |= self.into[part.row_ids]
        return part

    def taking(self, chosen: Indices) -> Model:
        """The model in which each state has only its ``chosen`` row."""
        rows = np.zeros(len(self.constant), dtype=bool)
        rows[chosen] = True
        return self.part(np.arange(len(self)), len(self), rows)

    def earning(self, constant: Floats) -> Model:
        """The same model with other constants."""
        other = copy.copy(self)
        other.constant = constant
        return other


def _taken(
    rows: Indices, arrows: Arrows, values: Floats
) -> Tuple[Indices, Indices, Floats, Indices]:
    """The arcs of some rows: where those of each row begin, their targets and their values, and
    how many each row has."""
    lengths = np.asarray(np.diff(arrows.arcs))
    if len(rows) == len(lengths) and (np.diff(rows) == 1).all():
        return arrows.arcs, arrows.targets, values, lengths
    lengths = lengths[rows]
    starts = np.cumsum(lengths) - lengths
    entries = np.repeat(arrows.arcs[rows] - starts, lengths) + np.arange(int(lengths.sum()))
    arcs = np.concatenate([[0], np.cumsum(lengths)])
    return arcs, arrows.targets[entries], values[entries], lengths


def made(
    tangible: Booleans,
    arrows: Arrows,
    values: Floats,
    constant: Floats,
    exits: Floats,
    *,
    number: Indices,
    size: int,
    rows: Booleans,
    known: Optional[Floats] = None,
    goal: Optional[Booleans] = None,
) -> Model:
    """A model of some of the states and rows of another.

    :param number: int array: the new number of each state; -1: it is left out. Several states may
      become one, which is then vanishing.
    :param size: how many states there will be.
    :param rows: boolean array: the rows to keep; their states must be kept too.
    :param known: float array: the values of states that are left out; None: 0.
    :param goal: boolean array: the states whose entering ``into`` counts; None: all left out.
    """
    owners = number[arrows.row_states]
    kept = np.flatnonzero(rows)
    if (np.diff(owners[kept]) < 0).any():
        kept = kept[np.argsort(owners[kept], kind="stable")]
    arcs, targets, data, lengths = _taken(kept, arrows, values)
    owners = owners[kept]
    new_constant = constant[kept].astype(np.float64)
    inside = number >= 0
    alone = np.bincount(number[inside], minlength=size) == 1
    new_tangible = np.zeros(size, dtype=bool)
    new_tangible[number[inside]] = tangible[inside]
    new_tangible &= alone
    new_exits = np.ones(size)
    new_exits[number[inside]] = exits[inside]
    new_exits[~new_tangible] = 1.0
    state_ids = np.zeros(size, dtype=np.int64)
    listed = np.flatnonzero(inside)[::-1]
    state_ids[number[listed]] = listed
    to = number[targets]
    arc_rows = np.repeat(np.arange(len(kept)), lengths)
    out = to < 0
    into = np.zeros(len(kept), dtype=bool)
    into[arc_rows[out if goal is None else out & goal[targets]]] = True
    loops = to == owners[arc_rows]
    if known is not None and out.any():
        new_constant += np.bincount(
            arc_rows[out], weights=data[out] * known[targets[out]], minlength=len(kept)
        )
    if loops.any():
        share = np.bincount(arc_rows[loops], weights=data[loops], minlength=len(kept))
        held = new_tangible[owners]
        scale = np.ones(len(kept))
        # A vanishing state repeats such a row until it leaves; a tangible one only stays.
        scale[~held] = 1.0 / (1.0 - share[~held])
        rest = new_exits[owners[held]] - share[held]
        # in a state without exits, the remainder is only rounding
        new_exits[owners[held]] = np.where(rest > 1e-15 * share[held], rest, 0.0)
        new_constant *= scale
        data = data * scale[arc_rows]
    stays = ~(out | loops)
    if not stays.all():
        counts = np.concatenate([[0], np.cumsum(stays)])
        arcs, to, data = counts[arcs], to[stays], data[stays]
    offsets = np.searchsorted(owners, np.arange(size + 1))
    arrows = Arrows(offsets, np.asarray(arcs, dtype=np.int64), to.astype(np.int32))
    return Model(new_tangible, arrows, data, new_constant, new_exits, kept, state_ids, into)
