"""Graph algorithms on Markov automata: possible rows, end components, reachability.

An end component is a set of states, with rows that never leave it and lead from each of its states
to every other: a policy can stay in it forever. See L. de Alfaro, *Formal Verification of
Probabilistic Systems* (Stanford University, 1997).
"""

from __future__ import annotations

from typing import NamedTuple, Optional, Tuple

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.arrays import Booleans, Indices, Matrix
from gspn_framework_package.analysis.graph import components_of, search_from


class Arrows(NamedTuple):
    """The arcs of an automaton without their values.

    :ivar rows: int64 array of states + 1: the rows of each state.
    :ivar arcs: int64 array of rows + 1: the arcs of each row.
    :ivar targets: int array: the state that each arc leads to.
    """

    rows: Indices
    arcs: Indices
    targets: Indices

    @property
    def states(self) -> int:
        """The number of states."""
        return len(self.rows) - 1

    @property
    def row_states(self) -> Indices:
        """The state of each row."""
        return np.repeat(np.arange(self.states, dtype=np.int32), np.diff(self.rows))

    @property
    def arc_rows(self) -> Indices:
        """The row of each arc."""
        return np.repeat(np.arange(len(self.arcs) - 1, dtype=np.int32), np.diff(self.arcs))

    def matrix(self, rows: Optional[Booleans] = None) -> Matrix:
        """The sparse matrix (CSR) with an entry for every arc, or for those of ``rows``."""
        offsets, targets = self.arcs[self.rows], self.targets
        if rows is not None and not rows.all():
            kept = np.repeat(rows, np.diff(self.arcs))
            counts = np.concatenate([[0], np.cumsum(kept)])
            offsets, targets = counts[offsets], targets[kept]
        ones = np.ones(len(targets), dtype=bool)
        shape = (self.states, self.states)
        matrix = sparse.csr_matrix((ones, targets, offsets), shape=shape, copy=True)
        matrix.sum_duplicates()  # SciPy's search never ends with parallel arcs
        return matrix


def any_of_row(arrows: Arrows, marked: Booleans) -> Booleans:
    """Boolean array over the rows: one of the arcs is marked (boolean array over the arcs)."""
    counts = np.concatenate([[0], np.cumsum(marked)])
    return counts[arrows.arcs[1:]] > counts[arrows.arcs[:-1]]


def any_of_state(arrows: Arrows, marked: Booleans) -> Booleans:
    """Boolean array over the states: one of the rows is marked (boolean array over the rows)."""
    counts = np.concatenate([[0], np.cumsum(marked)])
    return counts[arrows.rows[1:]] > counts[arrows.rows[:-1]]


def staying(
    arrows: Arrows, states: Booleans, rows: Booleans, goal: Optional[Booleans] = None
) -> Tuple[Booleans, Booleans]:
    """The largest set of ``states``, with those of their ``rows``, that a policy need never leave.

    :param goal: boolean array: states that belong to the set regardless of their rows.
    :return: boolean arrays over the states and over the rows.
    """
    owners, rows = arrows.row_states, rows & states[arrows.row_states]
    while True:
        kept = states & any_of_state(arrows, rows)
        if goal is not None:
            kept |= goal
        if (kept == states).all() and not (~kept).any():
            return states, rows
        states = kept
        leaving = rows & (any_of_row(arrows, ~states[arrows.targets]) | ~states[owners])
        if goal is not None:
            leaving &= ~goal[owners]
        if not leaving.any():
            return states, rows
        rows = rows & ~leaving


def reaching(
    arrows: Arrows, goal: Booleans, rows: Optional[Booleans] = None
) -> Tuple[Booleans, Indices]:
    """The states that can reach ``goal`` by ``rows``.

    :return: boolean array over the states, including ``goal``; int array: the state after each of
        them on a shortest path to ``goal`` (-1: none, or in ``goal``).
    """
    reached, after = search_from(arrows.matrix(rows).T.tocsr(), np.flatnonzero(goal))
    return reached, np.where(reached & ~goal, after, -1)


def rows_toward(arrows: Arrows, after: Indices, rows: Optional[Booleans] = None) -> Indices:
    """For each state the first of ``rows`` that may lead to the state ``after`` it; -1: none."""
    arc_rows = arrows.arc_rows
    owners = arrows.row_states[arc_rows]
    leading = arrows.targets == after[owners]
    if rows is not None:
        leading &= rows[arc_rows]
    arcs = np.flatnonzero(leading)[::-1]
    found = np.full(arrows.states, -1, dtype=np.int64)
    found[owners[arcs]] = arc_rows[arcs]
    return found


def forward(arrows: Arrows, start: Indices, rows: Optional[Booleans] = None) -> Booleans:
    """Boolean array: the states that ``rows`` may lead to from ``start`` (numbers), including
    ``start``."""
    return search_from(arrows.matrix(rows), start)[0]


class EndComponents(NamedTuple):
    """The maximal end components.

    :ivar number: their number.
    :ivar of: int array: the component of each state; -1: none.
    :ivar rows: boolean array over the rows: those that stay in the component of their state.
    """

    number: int
    of: Indices
    rows: Booleans


def end_components(arrows: Arrows, states: Booleans, rows: Booleans) -> EndComponents:
    """The maximal end components among ``states`` and ``rows``. A row without arcs stays in its
    state."""
    states, rows = staying(arrows, states, rows)
    if not rows.any():
        return EndComponents(0, np.full(arrows.states, -1, dtype=np.int64), rows)
    owners, arc_rows = arrows.row_states, arrows.arc_rows
    sources = owners[arc_rows]
    while True:
        of = components_of(arrows.matrix(rows)).of
        leaving = rows & any_of_row(arrows, of[sources] != of[arrows.targets])
        if not leaving.any():
            break
        rows = rows & ~leaving
    held = any_of_state(arrows, rows)
    names, numbers = np.unique(of[held], return_inverse=True)
    component = np.full(arrows.states, -1, dtype=np.int64)
    component[held] = numbers.reshape(-1)
    return EndComponents(len(names), component, rows)


def surely(arrows: Arrows, into: Booleans, rows: Booleans) -> Tuple[Booleans, Booleans]:
    """The states where some policy reaches the goal with probability 1.

    :param into: boolean array over the rows: those that may lead to the goal, which is not a state.
    :return: boolean array over the states; boolean array over the rows after which this still
        holds.
    """
    inside = np.ones(arrows.states, dtype=bool)
    possible = rows.copy()
    while True:
        reached, _ = reaching(arrows, any_of_state(arrows, possible & into), possible)
        if (reached == inside).all():
            return inside, possible
        inside = reached
        possible &= inside[arrows.row_states]
        possible &= ~any_of_row(arrows, ~inside[arrows.targets])


def avoiding(arrows: Arrows, into: Booleans, rows: Booleans) -> Tuple[Booleans, Booleans]:
    """The states where some policy never reaches the goal, and the rows that stay there, as boolean
    arrays."""
    return staying(arrows, np.ones(arrows.states, dtype=bool), rows & ~into)


def rows_into(arrows: Arrows, into: Booleans, rows: Booleans) -> Indices:
    """For each state, one of ``rows`` that leads closer to the goal; -1: none."""
    _, after = reaching(arrows, any_of_state(arrows, rows & into), rows)
    found = rows_toward(arrows, after, rows)
    last = np.flatnonzero(rows & into)[::-1]
    found[arrows.row_states[last]] = last
    return found
