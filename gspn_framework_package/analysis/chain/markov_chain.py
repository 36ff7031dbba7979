"""The continuous-time Markov chain of a net: its tangible states, the rates between them, and its
initial distribution."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Tuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices, Matrix
from gspn_framework_package.analysis.chain.vanishing import Elimination, eliminate
from gspn_framework_package.analysis.graph import components_of
from gspn_framework_package.analysis.plan.space import PlanSpace
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph, rate
from gspn_framework_package.analysis.state_space.space import StateSpace


class Chain:
    """A continuous-time Markov chain.

    :ivar graph: the graph that it was built from.
    :ivar states: int array: for each state of the chain, the state of the graph.
    :ivar rates: sparse matrix (CSR): rates (1/s) from row to column, none from a state to itself.
    :ivar exit_rates: float array: the sum of each row.
    :ivar initial: float array: the distribution at time 0.
    """

    def __init__(self, graph: RatedGraph, absorbing: Optional[Booleans] = None) -> None:
        """:param absorbing: boolean array over the states of the graph: states to make absorbing;
        they may be vanishing.

        :raises RefusedError: there is a timeless trap.
        """
        self.graph = graph
        self.elimination: Optional[Elimination] = None
        if graph.vanishing.any():
            kept, self.elimination = eliminate(graph, absorbing)
            rates, initial = self._without_vanishing(kept, self.elimination, absorbing)
        else:
            kept = np.ones(len(graph), dtype=bool)
            rates, initial = self._as_it_is(absorbing)
        self.states = np.flatnonzero(kept)
        self.rates = _without_loops(rates)
        self.exit_rates = np.asarray(self.rates.sum(axis=1)).reshape(-1)
        self.initial = initial
        self._inflow: Optional[Matrix] = None

    def _as_it_is(self, absorbing: Optional[Booleans]) -> Tuple[Matrix, Floats]:
        """Rates and initial distribution of a graph without vanishing states."""
        graph = self.graph
        values = (
            graph.values
            if absorbing is None
            else np.where(absorbing[graph.sources], 0.0, graph.values)
        )
        offsets = np.searchsorted(graph.sources, np.arange(len(graph) + 1))
        rates = sparse.csr_matrix(
            (values, graph.targets, offsets), shape=(len(graph), len(graph)), copy=True
        )
        initial = np.zeros(len(graph))
        initial[0] = 1.0
        return rates, initial

    def _without_vanishing(
        self, kept: Booleans, elimination: Elimination, absorbing: Optional[Booleans]
    ) -> Tuple[Matrix, Floats]:
        graph = self.graph
        leaving = kept[graph.sources]
        if absorbing is not None:
            leaving &= ~absorbing[graph.sources]
        arcs = np.flatnonzero(leaving)
        number = np.cumsum(kept) - 1
        step = sparse.csr_matrix(
            (graph.values[arcs], (number[graph.sources[arcs]], graph.targets[arcs])),
            shape=(int(kept.sum()), len(graph)),
        )
        initial = np.asarray(elimination.ends[0].todense()).reshape(-1)
        return (step @ elimination.ends).tocsr(), initial

    @classmethod
    def of(cls, space: StateSpace) -> Chain:
        """The chain of the state space of a net or a plan.

        :raises GspnError: see :func:`~.rated_graph.rate`.
        """
        return cls(space.rated() if isinstance(space, PlanSpace) else rate(space))

    def __len__(self) -> int:
        return len(self.states)

    @property
    def inflow(self) -> Matrix:
        """The transposed rate matrix (CSR): row j contains the rates into state j."""
        if self._inflow is None:
            self._inflow = self.rates.T.tocsr()
        return self._inflow

    def column(self, place: int) -> Indices:
        """Token counts of place number ``place`` in the states of the chain."""
        return self.graph.column(place, self.states)

    def bottom_components(self) -> List[Indices]:
        """The recurrent classes, each an int array of states, ordered by their first state."""
        start = int(self.initial.argmax())
        if all(  # two searches take a third of the time of finding components
            len(csgraph.breadth_first_order(arcs, start, return_predecessors=False)) == len(self)
            for arcs in (self.rates, self.inflow)
        ):
            return [np.arange(len(self))]
        found = components_of(self.rates)
        order = np.argsort(found.of, kind="stable")
        ends = np.cumsum(np.bincount(found.of, minlength=found.number))
        classes = [order[ends[c - 1] if c else 0 : ends[c]] for c in np.flatnonzero(found.bottom)]
        return sorted(classes, key=lambda states: int(states[0]))

    def __repr__(self) -> str:
        return "<Chain of %s: %d states, %d rates>" % (
            self.graph.net.name or "a net",
            len(self),
            self.rates.nnz,
        )


def _without_loops(rates: Matrix) -> Matrix:
    """The matrix with parallel arcs summed, and without its diagonal and explicit zeros."""
    rates.sum_duplicates()
    rows = np.repeat(np.arange(rates.shape[0], dtype=rates.indices.dtype), np.diff(rates.indptr))
    rates.data[rows == rates.indices] = 0.0
    if not rates.data.all():
        rates.eliminate_zeros()
    return rates


class Component(NamedTuple):
    """A recurrent class of a chain: its ``states`` (int array), the probability of ending up in it,
    and the stationary distribution over ``states``."""

    states: Indices
    probability: float
    distribution: Floats
