"""The Markov chain of a state space on disk: the rates into each tangible state, in a file.

The tangible states are numbered in the order of their keys. Without vanishing states, the sources
of the firings into consecutive states by one transition are the keys smaller by a fixed number:
they are nearly consecutive too, and found by one merge of two sorted sequences. So the rates come
in the order of their targets without sorting. With vanishing states, the rates out of some states
are found in memory and written to the file by target, to be collected afterwards: a distribution
sort. The vector of the states stays in memory and the matrix is read from disk, as in D. D.
Deavours and W. H. Sanders, *An efficient disk-based tool for solving large Markov models*,
Performance Evaluation 33, 1998.
"""

from __future__ import annotations

from typing import Dict, Iterator, List, NamedTuple, Tuple

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices, Matrix, Words
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.graph import reachable_from
from gspn_framework_package.analysis.on_disk.keys import Keys
from gspn_framework_package.analysis.on_disk.scratch import ScratchFile, ScratchVector
from gspn_framework_package.analysis.on_disk.search import OnDiskSpace
from gspn_framework_package.analysis.on_disk.sorted_keys import SortedKeys
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.numpy_engine import has_concession
from gspn_framework_package.analysis.state_space.rated_graph import firing_rate, rate
from gspn_framework_package.analysis.state_space.window import rows_of_round, window
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError

_VECTOR_SHARE = 2
"""A vector over the states may take the memory divided by this."""

_ROWS_SHARE = 8
"""The part of the matrix that is read or built at once may take the memory divided by this."""

_PER_ENTRY = 40
"""Bytes of memory that an entry of the matrix takes while it is built."""

_PER_ROW = 80
"""Additional bytes of a row, and of its packed marking."""

_PER_COLLECTED = 80
"""Bytes that an arc takes while arcs are collected by target."""

_MOST_ROWS = 1 << 17
"""More rows at once save no time."""

_ARC = np.dtype([("target", np.int64), ("source", np.int64), ("rate", np.float64)])


class _Block(NamedTuple):
    """A block of the matrix in the file: its ``first`` row, its numbers of ``rows`` and
    ``entries``, and its ``position`` (bytes)."""

    first: int
    rows: int
    entries: int
    position: int

    @property
    def part(self) -> slice:
        """The rows."""
        return slice(self.first, self.first + self.rows)


class OnDiskChain:
    """The continuous-time Markov chain of the tangible states of a space on disk.

    :param memory: bytes of memory to use.
    :ivar tangible: the keys of the states; their positions are the numbers of the states.
    :ivar exit_rates: the rate (1/s) out of each state.
    :ivar entries: the number of rates.
    :raises RefusedError: there is a timeless trap, or a choice has no weights.
    :raises LimitError: there is too little memory for a vector over the states, the disk has too
        little space, or the time is over.
    """

    def __init__(self, space: OnDiskSpace, memory: float, watch: Watch) -> None:
        self.space, self._watch = space, watch
        counts = space.counts
        size = counts.states - counts.vanishing
        if 8 * size * _VECTOR_SHARE > memory:
            raise LimitError(
                "a chain of %s states needs %.3g GB of memory"
                % (format(size, ","), 8e-9 * size * _VECTOR_SHARE),
                hint="raise --memory",
            )
        self._column_type = np.dtype(np.int32 if size < 2**31 else np.int64)
        self._report_disk(size, counts.arcs, bool(counts.vanishing))
        if space.has_vanishing_start:  # it has no tangible successors
            Chain(rate(window(space.packed, space.packed.initial[None, :])))
        self.tangible: SortedKeys = space.tangible(watch)
        each = _PER_ROW + 16 * space.packed.words + _PER_ENTRY * (counts.arcs / max(size, 1))
        self._rows = int(min(max(memory / _ROWS_SHARE / each, 1), _MOST_ROWS))
        self._memory = memory
        self._blocks: List[_Block] = []
        self._columns: Indices = np.empty(0, dtype=self._column_type)
        self._rates: Floats = np.empty(0)
        self._file = space.scratch.file()
        self.exit_rates = ScratchVector(space.scratch, size)
        self.entries = 0
        if counts.vanishing:
            self._from_windows()
        else:
            self._from_sources()

    def __len__(self) -> int:
        return len(self.tangible)

    def _report_disk(self, size: int, arcs: int, vanishing: bool) -> None:
        """Build the matrix. :raises LimitError: the disk has too little space."""
        each = 8 + self._column_type.itemsize + (_ARC.itemsize if vanishing else 0)
        needed = each * arcs + (16 + self.space.code.dtype.itemsize) * size
        self.space.scratch.require(needed)
        self._what = "states of the chain (up to %.3g GB on disk)" % (needed / 1e9)

    @property
    def initial(self) -> Booleans:
        """Boolean array: the initial state, if it is tangible."""
        found = np.zeros(len(self), dtype=bool)
        if not self.space.has_vanishing_start:
            key = self.space.code.encode(self.space.packed.initial[None, :])
            found[self.tangible.search(key)[0]] = True
        return found

    # -- building ---------------------------------------------------------------------------------

    def _from_sources(self) -> None:
        """Find the rates into each state, where no state is vanishing."""
        exits = np.zeros(len(self))
        packed = self.space.packed
        moving = np.flatnonzero((packed.change != 0).any(axis=1)).tolist()
        for part, keys in self.parts(self._rows):
            self._watch.step(self._what, part.start)
            states = self.space.code.decode(keys)
            found = [self._into(states, row) for row in moving]
            counts = np.zeros(len(keys), dtype=np.int64)
            for rows, _, _ in found:
                counts[rows] += 1
            ends = np.cumsum(counts)
            at = ends - counts
            columns: Indices = np.empty(int(counts.sum()), dtype=self._column_type)
            rates = np.empty(len(columns))
            for rows, sources, values in found:
                here = at[rows]
                columns[here], rates[here] = sources, values
                at[rows] += 1
                exits[sources] += values  # each occurs once
            self._put(
                part.start, np.concatenate([np.zeros(1, dtype=np.int64), ends]), columns, rates
            )
        for part, _ in self.parts(self._rows):
            self.exit_rates[part] = exits[part]

    def _into(self, states: Words, row: int) -> Tuple[Indices, Indices, Floats]:
        """The firings of a transition (in engine order) into some states: which of them, the
        numbers of the sources, and the rates."""
        packed = self.space.packed
        before = states - packed.change[row]
        rows = np.flatnonzero(((before & packed.guard) == 0).all(axis=1))
        before = before[rows]
        able = has_concession(packed, row, before)
        rows, before = rows[able], before[able]
        sources, there = self.tangible.search(self.space.code.encode(before))
        rows, sources = rows[there], sources[there]
        values = firing_rate(
            packed.net, int(packed.order[row]), PackedStore(packed, before), np.flatnonzero(there)
        )
        return rows, sources, np.broadcast_to(np.asarray(values, dtype=np.float64), len(rows))

    def _from_windows(self) -> None:
        """Find the rates out of each state, with vanishing states eliminated, and sort them."""
        size, space = len(self), self.space
        file = space.scratch.file()
        kept: Dict[int, List[Tuple[int, int]]] = {}  # for each block the parts of the file
        for part, chain in self.windows():
            self._watch.step(self._what, part.start)
            length = part.stop - part.start
            self.exit_rates[part] = chain.exit_rates[:length]
            leaving = chain.rates[:length].tocoo()
            store = chain.graph.store
            assert isinstance(store, PackedStore)  # windows are packed
            arcs = np.empty(leaving.nnz, dtype=_ARC)
            arcs["target"] = self._numbers(store.packed(chain.states))[leaving.col]
            arcs["source"], arcs["rate"] = leaving.row + part.start, leaving.data
            arcs = arcs[np.argsort(arcs["target"], kind="stable")]
            space.scratch.require(arcs.nbytes)
            blocks = arcs["target"] // self._rows
            cuts = np.flatnonzero(np.diff(blocks)) + 1
            for block in np.split(arcs, cuts) if len(arcs) else ():
                number = int(block["target"][0]) // self._rows
                kept.setdefault(number, []).append((file.append(block), len(block)))
        for number in range(-(-size // self._rows)):
            first = number * self._rows
            self._watch.step("sorted " + self._what, first)
            self._collect(file, kept.get(number, []), first, min(first + self._rows, size))
        file.close()

    def _collect(
        self, file: ScratchFile, places: List[Tuple[int, int]], first: int, last: int
    ) -> None:
        """Write the rows ``first`` to ``last`` from the arcs written to some ``places`` (position
        in bytes, number) of a file; use fewer rows at once if they are longer than most."""
        entries = sum(number for _, number in places)
        room = max(self._memory / _ROWS_SHARE / _PER_COLLECTED, 1)
        rows = max(int((last - first) * min(room / max(entries, 1), 1.0)), 1)
        for begin in range(first, last, rows):
            end = min(begin + rows, last)
            found = [np.empty(0, dtype=_ARC)]
            for position, number in places:
                arcs = file.read(position, np.empty(number, dtype=_ARC))
                found.append(arcs[(arcs["target"] >= begin) & (arcs["target"] < end)])
            arcs = np.concatenate(found)
            matrix = sparse.csr_matrix(
                (arcs["rate"], (arcs["target"] - begin, arcs["source"])),
                shape=(end - begin, len(self)),
            )
            self._put(begin, matrix.indptr, matrix.indices, matrix.data)

    def _put(self, first: int, offsets: Indices, columns: Indices, rates: Floats) -> None:
        self.space.scratch.require(rates.nbytes + columns.nbytes + offsets.nbytes)
        position = self._file.append(offsets.astype(self._column_type))
        self._file.append(columns.astype(self._column_type, copy=False))
        self._file.append(rates)
        self._blocks.append(_Block(first, len(offsets) - 1, len(rates), position))
        self.entries += len(rates)

    def _numbers(self, words: Words) -> Indices:
        """The numbers of packed markings of tangible states."""
        keys = self.space.code.encode(words)
        order = np.argsort(keys, kind="stable")
        numbers = np.empty(len(keys), dtype=np.int64)
        numbers[order] = self.tangible.search(keys[order])[0]
        return numbers

    # -- reading --------------------------------------------------------------------------------

    def parts(self, rows: int = 0) -> Iterator[Tuple[slice, Keys]]:
        """The states in blocks: their numbers and keys.

        :param rows: number per block; 0: as many as the memory allows.
        """
        rows = rows or self._rows
        for begin in range(0, len(self), rows):
            part = slice(begin, min(begin + rows, len(self)))
            yield part, self.tangible.read(part.start, part.stop)

    def windows(self) -> Iterator[Tuple[slice, Chain]]:
        """Yield the states in parts: the slice of their numbers, and a chain that begins with these
        states and has the rates out of them."""
        packed = self.space.packed
        for part, keys in self.parts(min(rows_of_round(len(packed.order)), self._rows)):
            yield part, Chain(rate(window(packed, self.space.code.decode(keys))))

    def blocks(self) -> Iterator[Tuple[slice, Matrix]]:
        """The states in blocks: their numbers and the rates into them (CSR, one column per state).
        Each block overwrites the previous one."""
        for block in self._blocks:
            yield block.part, self._read(block)

    def _read(self, block: _Block) -> Matrix:
        most = max(each.entries for each in self._blocks)
        if len(self._columns) < most:  # the same memory for all blocks
            self._columns, self._rates = np.empty(most, dtype=self._column_type), np.empty(most)
        offsets = np.empty(block.rows + 1, dtype=self._column_type)
        columns, rates = self._columns[: block.entries], self._rates[: block.entries]
        position = block.position
        for array in (offsets, columns, rates):
            self._file.read(position, array)
            position += array.nbytes
        return sparse.csr_matrix((rates, columns, offsets), shape=(block.rows, len(self)))

    # -- reachability --------------------------------------------------------------------------

    def reaching(self, state: int) -> Booleans:
        """The states from which a state can be reached."""
        seen = np.zeros(len(self), dtype=bool)
        seen[state] = True
        done = np.zeros(len(self), dtype=bool)  # the states whose sources have been seen
        order = self._blocks
        while not seen.all() and (seen > done).any():
            order = order[::-1]  # a pass propagates far along or against the order
            for block in order:
                part = block.part
                if not (seen[part] > done[part]).any():
                    continue
                self._watch.step("states that lead on", np.count_nonzero(done))
                inner = _Arcs(self._read(block), part)
                if not seen[part].all():
                    seen[part] = reachable_from(block.rows, inner.rows, inner.near, seen[part])
                seen[inner.sources[(seen[part] > done[part])[inner.targets]]] = True
                done[part] = seen[part]
        return seen

    def reached(self, state: int) -> Booleans:
        """The states that can be reached from a state."""
        seen = np.zeros(len(self), dtype=bool)
        seen[state] = True
        order, known = self._blocks, 0
        while known < np.count_nonzero(seen) < len(self):
            known = int(np.count_nonzero(seen))
            order = order[::-1]
            for block in order:
                part = block.part
                if seen[part].all():
                    continue
                self._watch.step("states that are led to", known)
                inner = _Arcs(self._read(block), part)
                begins = seen[part].copy()
                begins[inner.targets[seen[inner.sources]]] = True
                seen[part] = reachable_from(block.rows, inner.near, inner.rows, begins)
        return seen


class _Arcs:
    """The arcs into the states of a block.

    :ivar targets: int array: the number of each target in the block.
    :ivar sources: int array: the number of each source.
    :ivar rows: the targets of the arcs between two states of the block.
    :ivar near: the sources of these, numbered in the block.
    """

    def __init__(self, rates: Matrix, part: slice) -> None:
        self.targets: Indices = np.repeat(
            np.arange(rates.shape[0], dtype=np.int32), np.diff(rates.indptr)
        )
        self.sources: Indices = rates.indices
        inside = (self.sources >= part.start) & (self.sources < part.stop)
        self.rows = self.targets[inside]
        self.near = self.sources[inside] - part.start
