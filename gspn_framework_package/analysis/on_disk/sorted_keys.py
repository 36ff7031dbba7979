"""Sets of keys as sorted sequences, in memory if small, otherwise in a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices
from gspn_framework_package.analysis.on_disk.keys import Keys, distinct
from gspn_framework_package.analysis.on_disk.scratch import Scratch, ScratchFile
from gspn_framework_package.analysis.watch import Watch

_WINDOW = 64
"""Largest number of blocks of a file read at once to look up keys."""


class Budget(NamedTuple):
    """The memory that the parts of a search may take.

    :ivar block: number of keys between two that stay in memory as an index.
    :ivar resident: largest size (bytes) of a sequence that stays in memory.
    :ivar together: number of keys merged in memory.
    :ivar expanded: bytes for the successors of some markings.
    """

    block: int
    resident: int
    together: int
    expanded: int

    @classmethod
    def of(cls, memory: float, key_size: int) -> Budget:
        """The shares of ``memory`` (bytes), with keys of ``key_size`` bytes."""
        return cls(
            block=int(min(max(memory / (4096 * key_size), 4), 16384)),
            resident=int(memory / 32),
            # merging needs five times this: the keys twice, sorted, and the distinct ones
            together=max(int(memory / 16 / key_size), 16),
            expanded=int(memory / 4),
        )


@dataclass(eq=False)
class SortedKeys:
    """Distinct keys in ascending order; made by :class:`Writer`.

    :ivar fences: every ``block``-th key, from the first on.
    """

    _count: int
    fences: Keys
    _block: int
    _array: Optional[Keys]
    _file: Optional[ScratchFile]
    _position: int
    _owner: bool

    def __len__(self) -> int:
        return self._count

    def read(self, begin: int, end: int) -> Keys:
        """The keys number ``begin`` to ``end``."""
        if self._array is not None:
            return self._array[begin:end]
        assert self._file is not None
        keys = np.empty(min(end, self._count) - begin, dtype=self.fences.dtype)
        return self._file.read(self._position + begin * keys.itemsize, keys)

    def parts(self, size: int) -> Iterator[Keys]:
        """All keys in order, at most ``size`` at a time."""
        for begin in range(0, self._count, size):
            yield self.read(begin, begin + size)

    def search(self, keys: Keys) -> Tuple[Indices, Booleans]:
        """The positions where ascending ``keys`` are or would be, and which of them are present.
        Only the blocks that may contain them are read."""
        positions = np.zeros(len(keys), dtype=np.int64)
        present = np.zeros(len(keys), dtype=bool)
        if not len(keys) or not self._count:
            return positions, present
        if self._array is not None:
            return _search(self._array, keys)
        blocks = np.searchsorted(self.fences, keys, side="right") - 1
        at = int(np.searchsorted(blocks, 0))  # keys before are smaller than all here
        gaps = np.append(np.flatnonzero(np.diff(blocks) > 1) + 1, len(blocks))
        while at < len(keys):
            first = int(blocks[at])
            end = int(gaps[np.searchsorted(gaps, at, side="right")])
            if blocks[end - 1] >= first + _WINDOW:
                end = int(np.searchsorted(blocks, first + _WINDOW))
            begin = first * self._block
            window = self.read(begin, (int(blocks[end - 1]) + 1) * self._block)
            found, there = _search(window, keys[at:end])
            positions[at:end] = found + begin
            present[at:end] = there
            at = end
        return positions, present

    def discard(self) -> None:
        """Free its space. A part of a larger file can still be read from there."""
        self._array = None
        if self._file is not None and self._owner:
            self._file.close()
            self._file = None


def _search(ordered: Keys, keys: Keys) -> Tuple[Indices, Booleans]:
    positions = np.searchsorted(ordered, keys)
    inside = np.minimum(positions, len(ordered) - 1)
    return positions, ordered[inside] == keys


class Writer:
    """Makes a :class:`SortedKeys` of ascending parts.

    :param dtype: the type of a key.
    :param file: the file to append it to; None: a new file, if it does not fit into memory.
    """

    def __init__(
        self, scratch: Scratch, budget: Budget, dtype: np.dtype, file: Optional[ScratchFile] = None
    ) -> None:
        self._scratch = scratch
        self._budget = budget
        self._dtype = dtype
        self._owner = file is None
        self._file = file
        self._position = 0 if file is None else file.size
        self._held: Optional[List[Keys]] = []
        self._fences: List[Keys] = []
        self._count = 0

    def append(self, keys: Keys) -> None:
        """Append keys that are larger than those before."""
        if not len(keys):
            return
        block = self._budget.block
        self._fences.append(keys[-self._count % block :: block].copy())
        self._count += len(keys)
        if not self._owner and self._file is not None:
            self._file.append(keys)
        if self._held is not None:
            self._held.append(keys)
            if self._count * keys.itemsize > self._budget.resident:
                self._spill()
        elif self._owner and self._file is not None:
            self._file.append(keys)

    def _spill(self) -> None:
        if self._owner:
            self._file = self._scratch.file()
            for keys in self._held or ():
                self._file.append(keys)
        self._held = None

    def finished(self) -> SortedKeys:
        """The sequence that was written."""
        array = None if self._held is None else _joined(self._held, self._dtype)
        return SortedKeys(
            self._count,
            _joined(self._fences, self._dtype),
            self._budget.block,
            array,
            self._file,
            self._position,
            self._owner,
        )


def _joined(arrays: Sequence[Keys], dtype: np.dtype) -> Keys:
    return np.concatenate([np.empty(0, dtype=dtype), *arrays]).astype(dtype, copy=False)


def by_ranges(runs: Sequence[SortedKeys], most: int) -> Iterator[List[Keys]]:
    """The keys of several sequences by consecutive ranges of keys: for each range, the keys of each
    sequence, about ``most`` in total."""
    if sum(len(run) for run in runs) <= most:
        yield [run.read(0, len(run)) for run in runs]
        return
    block = max(run._block for run in runs)
    fences = np.sort(np.concatenate([run.fences for run in runs]), kind="stable")
    cuts = distinct(fences[max(most // block, 1) :: max(most // block, 1)])
    ends = [np.append(run.search(cuts)[0], len(run)) for run in runs]
    begins = [0] * len(runs)
    for number in range(len(cuts) + 1):
        stops = [int(end[number]) for end in ends]
        yield [run.read(begin, stop) for run, begin, stop in zip(runs, begins, stops)]
        begins = stops


def merge_sorted(
    runs: Sequence[SortedKeys],
    scratch: Scratch,
    budget: Budget,
    watch: Watch,
    what: str,
    count: int,
) -> SortedKeys:
    """Merge several sequences into one; they are discarded.

    :param what: what is being counted, for the progress line, and its ``count``.
    :raises LimitError: the disk is full.
    """
    dtype = runs[0].fences.dtype
    scratch.require(sum(len(run) for run in runs) * dtype.itemsize)
    writer = Writer(scratch, budget, dtype)
    for parts in by_ranges(runs, budget.together):
        writer.append(distinct(np.concatenate(parts)))
        watch.step(what, count)
    for run in runs:
        run.discard()
    return writer.finished()


class Pile:
    """Collects keys in any order, possibly with repetitions."""

    def __init__(self, scratch: Scratch, budget: Budget, dtype: np.dtype) -> None:
        self._scratch = scratch
        self._budget = budget
        self._dtype = dtype
        self._held: List[Keys] = []
        self._holding = 0
        self._runs: List[SortedKeys] = []

    def add(self, keys: Keys) -> None:
        """Add ascending keys."""
        self._held.append(keys)
        self._holding += len(keys)
        if self._holding > self._budget.together:
            self._put_down()

    def _put_down(self) -> None:
        writer = Writer(self._scratch, self._budget, self._dtype)
        keys = distinct(_joined(self._held, self._dtype))
        self._held, self._holding = [], 0
        self._scratch.require(keys.nbytes)
        writer.append(keys)
        self._runs.append(writer.finished())

    def taken(self) -> Iterable[Keys]:
        """The distinct keys in ascending order, in parts; the pile is empty afterwards."""
        if self._holding or not self._runs:
            self._put_down()
        for parts in by_ranges(self._runs, self._budget.together):
            yield distinct(np.concatenate(parts))
        for run in self._runs:
            run.discard()
        self._runs = []
