"""Elimination of vanishing states: the states that the net reaches from them in zero time.

Cycles of immediate firings are resolved first (each by one small linear system); the rest is
acyclic, and eliminated level by level.
"""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Tuple

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices, Matrix
from gspn_framework_package.analysis.graph import components, flat_ranges, longest_levels
from gspn_framework_package.analysis.state_space.exploration import Growing
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph
from gspn_framework_package.model.errors import RefusedError


class _Cycle(NamedTuple):
    """A strongly connected set of vanishing states; ``visits[i, j]`` is the mean number of visits
    to ``j`` before leaving the set, after entering at ``i``."""

    states: Indices
    visits: Floats


class Elimination:
    """The states to which the vanishing states of a graph lead.

    :param kept: boolean array: the states to keep, at least all tangible ones.
    :raises RefusedError: there is a timeless trap: immediate transitions fire forever.
    """

    def __init__(self, graph: RatedGraph, kept: Booleans) -> None:
        self._graph = graph
        self._kept = kept
        self._number = np.cumsum(kept) - 1  # of each kept state
        self._cycles: List[_Cycle] = []
        arcs = np.flatnonzero(~kept[graph.sources])
        self._sources, self._targets = graph.sources[arcs], graph.targets[arcs]
        self._values = graph.values[arcs]
        self._take_cycles_apart()
        inner = ~kept[self._targets]
        self._level, acyclic = longest_levels(len(kept), self._sources[inner], self._targets[inner])
        assert acyclic
        self.ends = self._solve()
        """Sparse matrix: the probability of going in zero time from any state (row) to a kept state
        (column: its number among those kept). A kept state leads to itself."""

    def _take_cycles_apart(self) -> None:
        inner = ~self._kept[self._targets]
        if not inner.any():
            return
        found = components(len(self._kept), self._sources[inner], self._targets[inner])
        size = np.bincount(found.of, minlength=found.number)
        looping = self._sources[inner & (self._sources == self._targets)]
        nontrivial = size > 1
        nontrivial[found.of[looping]] = True
        for number in np.flatnonzero(nontrivial).tolist():
            self._take_apart(np.flatnonzero(found.of == number))

    def _take_apart(self, states: Indices) -> None:
        """Replace the arcs that leave ``states`` by those with which the net leaves the set."""
        position = np.full(len(self._kept), -1, dtype=np.int64)
        position[states] = np.arange(len(states))
        mine = position[self._sources] >= 0
        inside = mine & (position[self._targets] >= 0)
        out = mine & ~inside
        if not out.any():
            raise RefusedError(
                "a timeless trap: immediate transitions fire forever from %s"
                % self._graph.text(int(states[0])),
                hint="a cycle of immediate transitions must have an exit",
            )
        shape = (len(states), len(states))
        stay = sparse.csr_matrix(
            (
                self._values[inside],
                (position[self._sources[inside]], position[self._targets[inside]]),
            ),
            shape=shape,
        )
        visits = np.linalg.inv(np.eye(len(states)) - stay.toarray())
        leave = sparse.csr_matrix(
            (self._values[out], (position[self._sources[out]], self._targets[out])),
            shape=(len(states), len(self._kept)),
        )
        leaving = (sparse.csr_matrix(visits) @ leave).tocoo()
        self._sources = np.concatenate([self._sources[~mine], states[leaving.row]])
        self._targets = np.concatenate(
            [self._targets[~mine], leaving.col.astype(self._targets.dtype)]
        )
        self._values = np.concatenate([self._values[~mine], leaving.data])
        self._cycles.append(_Cycle(states, visits))

    def _solve(self) -> Matrix:
        kept = self._kept
        # where the row of each state begins in ``columns`` and ``values``
        begin = np.zeros(len(kept), dtype=np.int64)
        length = np.zeros(len(kept), dtype=np.int64)
        columns, values = Growing(np.int64), Growing(np.float64)
        own = np.flatnonzero(kept)
        begin[own], length[own] = np.arange(len(own)), 1
        columns.extend(np.arange(len(own)))
        values.extend(np.ones(len(own)))
        order = np.argsort(self._level[self._sources], kind="stable")
        sources, targets, weights = self._sources[order], self._targets[order], self._values[order]
        ends = np.searchsorted(
            self._level[sources], np.arange(int(self._level.max(initial=0)) + 1), side="right"
        )
        first = 0
        for last in ends.tolist():
            arcs = slice(first, last)
            first = last
            if arcs.start == arcs.stop:
                continue
            to = targets[arcs]
            entries = flat_ranges(begin[to], begin[to] + length[to])
            rows = np.repeat(sources[arcs], length[to])
            data = np.repeat(weights[arcs], length[to]) * values.array[entries]
            states, row = np.unique(rows, return_inverse=True)
            block = sparse.csr_matrix(
                (data, (row.reshape(-1), columns.array[entries])), shape=(len(states), len(own))
            )
            begin[states] = columns.used + block.indptr[:-1]
            length[states] = np.diff(block.indptr)
            columns.extend(block.indices)
            values.extend(block.data)
        entries = flat_ranges(begin, begin + length)
        offsets = np.concatenate([[0], np.cumsum(length)])
        return sparse.csr_matrix(
            (values.array[entries], columns.array[entries], offsets), shape=(len(kept), len(own))
        )

    def visits(self, inflow: Floats) -> Floats:
        """How often each vanishing state is visited per unit of time.

        :param inflow: float array over all states: how often each is entered per unit of time from
            kept states (entries for kept states are ignored).
        """
        visits = np.where(self._kept, 0.0, inflow)
        inner = ~self._kept[self._targets]
        sources, targets, values = self._sources[inner], self._targets[inner], self._values[inner]
        order = np.argsort(-self._level[sources], kind="stable")
        sources, targets, values = sources[order], targets[order], values[order]
        levels = -self._level[sources]
        first = 0
        while first < len(sources):
            last = int(np.searchsorted(levels, levels[first], side="right"))
            part = slice(first, last)
            np.add.at(visits, targets[part], visits[sources[part]] * values[part])
            first = last
        for cycle in self._cycles:
            visits[cycle.states] = visits[cycle.states] @ cycle.visits
        return visits


def eliminate(graph: RatedGraph, kept: Optional[Booleans] = None) -> Tuple[Booleans, Elimination]:
    """The states to keep (a boolean array: the tangible ones, and those of ``kept``) and the
    elimination of the others."""
    stay = ~graph.vanishing if kept is None else ~graph.vanishing | kept
    return stay, Elimination(graph, stay)
