"""The Markov chain of a net in parts: each rank holds the rates into its own tangible states."""

from __future__ import annotations

import functools
from typing import Iterator, List, Tuple, Type

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices, Matrix, Words
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.distributed.exploration import RankStates
from gspn_framework_package.analysis.distributed.ranks import divided
from gspn_framework_package.analysis.graph import flat_ranges
from gspn_framework_package.analysis.state_space.exploration import Growing
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.rated_graph import rate
from gspn_framework_package.analysis.state_space.window import rows_of_round
from gspn_framework_package.analysis.watch import Watch

_Rates = Tuple[Words, Indices, Indices, Floats]
"""Packed markings; for each rate the number of its source, the position of its target in them, and
its value."""

_BLOCK = 1 << 20
"""Rates that are renumbered at once."""


class _Arcs:
    """Rates as they come in: the target, source and value of each."""

    def __init__(self, source_type: Type[np.generic]) -> None:
        self.sources = Growing(source_type)
        self._targets, self._values = Growing(np.int32), Growing(np.float64)

    def extend(self, targets: Indices, sources: Indices, values: Floats) -> None:
        """Append some."""
        self._targets.extend(targets)
        self.sources.extend(sources)
        self._values.extend(values)

    def matrix(self, rows: int, columns: int) -> Matrix:
        """The matrix (CSR) of the rates from sources (columns) to targets (rows); they are
        released."""
        arrays = [part.finished() for part in (self._targets, self.sources, self._values)]
        self._targets, self.sources, self._values = (Growing(a.dtype.type, 0, 0) for a in arrays)
        targets, sources, values = arrays
        return sparse.csr_matrix((values, (targets, sources)), (rows, columns))


class RankChain:
    """The part of a chain that belongs to one rank: its tangible states, numbered in their order,
    and the rates into them. All ranks make it together.

    :ivar states: the states of this rank.
    :ivar tangible: int array: for each state of the chain, the state of this rank.
    :ivar first: int array: in the numbering of all ranks, the first state of each, and their number
        at the end.
    :ivar exit_rates: float array: the rate (1/s) out of each.
    :ivar near: sparse matrix (CSR): the rates into each state (row) from others of this rank.
    :ivar far: sparse matrix (CSR): the rates into each state from those states of other ranks that
        lead here at all (columns).
    :raises RefusedError: there is a timeless trap, or no weight decides a choice.
    """

    def __init__(self, states: RankStates, watch: Watch) -> None:
        self.states, self.ranks = states, states.ranks
        self._watch = watch
        self.tangible: Indices = np.flatnonzero(~states.vanishing)
        counts = self.ranks.gather(len(self.tangible))
        self.first: Indices = np.concatenate([[0], np.cumsum(counts)])
        self.exit_rates: Floats = np.zeros(len(self.tangible))
        self.ranks.agreed(self._leave_the_initial_state)
        self._into_matrices(*self._receive_rates())

    def __len__(self) -> int:
        return len(self.tangible)

    @property
    def total(self) -> int:
        """The number of states of the chain, on all ranks."""
        return int(self.first[-1])

    @property
    def memory(self) -> int:
        """Bytes that the rates take."""
        matrices = (self.near, self.far)
        return int(sum(m.data.nbytes + m.indices.nbytes + m.indptr.nbytes for m in matrices))

    def windows(self) -> Iterator[Tuple[slice, Chain]]:
        """This rank's states, some at a time: which they are, and a chain of its own in which they
        are the first states, with the rates out of them."""
        rows = rows_of_round(len(self.states.packed.order))
        for begin in range(0, len(self), rows):
            part = slice(begin, min(begin + rows, len(self)))
            yield part, Chain(rate(self.states.window(self.tangible[part])))

    # -- making it ---------------------------------------------------------------------------------

    def _leave_the_initial_state(self) -> None:
        """Follow the immediate firings at the beginning, which follow no tangible state.

        :raises RefusedError: they never end, or no weight decides.
        """
        if self.states.has_initial and self.states.vanishing[0]:
            Chain(rate(self.states.window(np.zeros(1, dtype=np.int64))))

    def _receive_rates(self) -> Tuple[_Arcs, _Arcs]:
        """The rates into the states of this rank: those from its own states (numbered here), and
        those from others (in the numbering of all ranks)."""
        ranks, states = self.ranks, self.states
        number = np.cumsum(~states.vanishing, dtype=np.int32) - np.int32(1)
        begin, end = self.first[ranks.rank], self.first[ranks.rank + 1]
        near = _Arcs(np.int32)
        far = _Arcs(np.int32 if self.total < 2**31 else np.int64)
        windows = self.windows()
        left = True
        while left:
            found: List[_Rates] = []
            left = any(ranks.agreed(functools.partial(self._next_rates, windows, found)))
            words, rows, columns, values = found.pop()
            owners, there = states.numbers_anywhere(words)
            parts = divided(
                owners[columns], ranks.size, there[columns], rows + self.first[ranks.rank], values
            )
            targets, sources, rates = (np.concatenate(ranks.exchange(part)) for part in parts)
            targets = number[targets]
            own = (sources >= begin) & (sources < end)
            near.extend(targets[own], sources[own] - begin, rates[own])
            own = ~own
            far.extend(targets[own], sources[own], rates[own])
        return near, far

    def _next_rates(self, windows: Iterator[Tuple[slice, Chain]], found: List[_Rates]) -> bool:
        """The rates out of some more states; returns whether there were any left."""
        following = next(windows, None)
        if following is None:
            none = np.zeros(0, dtype=np.int64)
            words = np.zeros((0, self.states.packed.words), dtype=np.uint64)
            found.append((words, none, none, np.zeros(0)))
            return False
        part, chain = following
        length = part.stop - part.start
        self.exit_rates[part] = chain.exit_rates[:length]
        leaving = chain.rates[:length].tocoo()
        store = chain.graph.store
        assert isinstance(store, PackedStore)  # windows are packed
        words = store.packed(chain.states)
        found.append((words, leaving.row + part.start, leaving.col, leaving.data))
        self._watch.step("states of the chain on each rank", part.stop)
        return True

    def _into_matrices(self, near: _Arcs, far: _Arcs) -> None:
        """Make the matrices, one after the other, so that the arcs of one are released before those
        of the other are sorted."""
        ranks, size = self.ranks, len(self)
        self.near: Matrix = near.matrix(size, size)
        leads_here = np.zeros(self.total, dtype=bool)
        leads_here[far.sources.finished()] = True
        outside = np.flatnonzero(leads_here).astype(far.sources.array.dtype)
        del leads_here
        for begin in range(0, far.sources.used, _BLOCK):  # in place, since there may be very many
            part = far.sources.array[begin : begin + _BLOCK]
            part[:] = np.searchsorted(outside, part)
        self.far: Matrix = far.matrix(size, len(outside))
        cuts = np.searchsorted(outside, self.first[1:-1])
        asked = [
            (part - at).astype(np.int32) for part, at in zip(np.split(outside, cuts), self.first)
        ]
        wanted = ranks.exchange(asked)
        self._cuts = cuts
        self._sent: Indices = np.concatenate(wanted)
        self._outgoing = [len(part) for part in wanted]
        self._incoming = [len(part) for part in asked]

    # -- values of the states of all ranks ---------------------------------------------------------

    def fetch(self, values: np.ndarray) -> np.ndarray:
        """The values of the states of other ranks that lead here, in the order of the columns of
        ``far``, from the ``values`` of the states of each rank."""
        return self.ranks.swap(values[self._sent], self._outgoing, self._incoming)

    def reaching(self, state: int) -> Booleans:
        """The states of this rank from which a state can be reached.

        :param state: its number here; -1 if it belongs to another rank.
        """
        seen = np.zeros(len(self), dtype=bool)
        told = np.zeros(self.far.shape[1], dtype=bool)
        frontier: Indices = np.array([state] if state >= 0 else [], dtype=np.int64)
        seen[frontier] = True
        while True:
            news = np.zeros(len(told), dtype=bool)
            while len(frontier):  # as far as it goes on this rank
                news[_columns(self.far, frontier)] = True
                before = _columns(self.near, frontier)
                frontier = np.unique(before[~seen[before]])
                seen[frontier] = True
            news &= ~told
            told |= news
            received = self.ranks.exchange(np.split(news, self._cuts))
            if not any(self.ranks.gather(bool(news.any()))):
                return seen
            entered = self._sent[np.concatenate(received)]
            frontier = np.unique(entered[~seen[entered]])
            seen[frontier] = True

    def reached(self, state: int) -> Booleans:
        """The states of this rank that can be reached from a state (see :meth:`reaching`)."""
        seen = np.zeros(len(self), dtype=bool)
        if state >= 0:
            seen[state] = True
        while True:
            inflow = self.near @ seen.astype(np.float64)
            inflow += self.far @ self.fetch(seen).astype(np.float64)
            news = (inflow > 0) & ~seen
            seen |= news
            if not any(self.ranks.gather(bool(news.any()))):
                return seen


def _columns(matrix: Matrix, rows: Indices) -> Indices:
    """The columns of the entries in some rows of a sparse matrix (CSR)."""
    return matrix.indices[flat_ranges(matrix.indptr[rows], matrix.indptr[rows + 1])]
