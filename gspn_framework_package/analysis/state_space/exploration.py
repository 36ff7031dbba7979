"""Common parts of the exploration engines: their result, their allowance, growing arrays.

An engine is a function ``explore(packed, limit, watch) -> RawGraph``: ``numpy_engine`` (always
available) and ``numba_engine`` (if numba is installed). ``sparse_engine`` takes the net itself.
"""

from __future__ import annotations

import math
import time
from typing import Callable, NamedTuple, Optional, Sequence, Tuple, Type, TypeVar

import numpy as np

from gspn_framework_package.analysis.arrays import Indices, Words
from gspn_framework_package.analysis.state_space.packing import PackedNet, starting_widths
from gspn_framework_package.model.net import Net

_Result = TypeVar("_Result")


class RawGraph(NamedTuple):
    """The graph that an engine found.

    :ivar states: uint64 array of shape ``(n, words)``, the initial state first; None if the
        markings are stored elsewhere.
    :ivar offsets: the arcs of state ``s`` are ``offsets[s]:offsets[s + 1]``.
    :ivar targets: for each arc, the number of the state it leads to.
    :ivar labels: for each arc, its transition in engine order.
    :ivar explored: the number of states, from the first on, whose successors are known: all of
        them, unless the limit or the allowance was exhausted.
    """

    states: Optional[Words]
    offsets: Indices
    targets: Indices
    labels: Indices
    explored: int


class Allowance(NamedTuple):
    """The resources of an exploration: ``memory`` (bytes), and the time ``until`` which it may run
    (s, monotonic clock)."""

    memory: float = math.inf
    until: float = math.inf

    def left(self, used: float) -> bool:
        """Whether resources are left when ``used`` bytes are in use."""
        return used <= self.memory and time.monotonic() < self.until

    def shortage(self, states: int, limit: int, seconds: float) -> Tuple[str, str]:
        """The exhausted resource of an exploration that began with ``seconds`` and ended early: the
        option to raise, and its value (empty: the limit on states)."""
        if states > limit:
            return "--limit", ""
        if time.monotonic() >= self.until:
            return "--limit-time", "%g s" % seconds
        return "--limit-memory", "%.3g GB" % (self.memory / 1e9)


ENDLESS = Allowance()
"""An allowance without limits."""


class FieldOverflowError(Exception):
    """A count outgrew its field; ``bits`` are the guard bits that were set, one int per word."""

    def __init__(self, bits: Tuple[int, ...]) -> None:
        super().__init__("a field of a packed marking is too narrow")
        self.bits = bits


def in_wide_fields(
    net: Net,
    bounds: Sequence[Optional[int]],
    work: Callable[[PackedNet], _Result],
    *,
    by_priority: bool = True,
    alike: Optional[Indices] = None,
) -> _Result:
    """Do ``work`` on a packed net, repeating it with wider fields whenever a count outgrows its
    field.

    :param bounds: for each place, the largest number of tokens that it can hold (None: unknown).
    :param work: raises FieldOverflowError if a field is too narrow.
    :param by_priority: see :class:`~.packing.PackedNet`.
    :param alike: int array: a number for each place; places with the same number get fields of the
        same width. None: each has its own width.
    :raises LimitError: a field already has the maximum width.
    """
    widths = starting_widths(net, bounds)
    while True:
        if alike is not None:
            widest = np.zeros(len(widths), dtype=np.int64)
            np.maximum.at(widest, alike, np.array(widths, dtype=np.int64))
            widths = tuple(widest[alike].tolist())
        packed = PackedNet(net, widths, by_priority=by_priority)
        try:
            return work(packed)
        except FieldOverflowError as overflow:
            widths = packed.wider(overflow.bits)


class Growing:
    """An array that grows in place along its first axis; only ``array[:used]`` is valid."""

    def __init__(self, dtype: Type[np.generic], columns: int = 0) -> None:
        self._columns = columns
        self.array: np.ndarray = np.empty((1024, columns) if columns else 1024, dtype=dtype)
        self.used = 0

    def reserve(self, count: int) -> None:
        """Reserve space for ``count`` rows in total."""
        capacity = len(self.array)
        if count > capacity:
            # zeroing a larger reserve would make it occupy memory
            self._resize(max(count, capacity + (capacity >> 2)))

    def extend(self, rows: np.ndarray) -> None:
        """Append ``rows``."""
        self.reserve(self.used + len(rows))
        self.array[self.used : self.used + len(rows)] = rows
        self.used += len(rows)

    def finished(self) -> np.ndarray:
        """The array of the rows in use; the rest is released."""
        self._resize(self.used)
        return self.array

    def _resize(self, capacity: int) -> None:
        # In place, the allocator moves pages instead of copying, so there is never a second copy.
        shape = (capacity, self._columns) if self._columns else (capacity,)
        self.array.resize(shape, refcheck=False)


def label_type(transitions: int) -> Type[np.generic]:
    """The smallest integer type for transition numbers."""
    return np.uint8 if transitions <= 2**8 else np.int16 if transitions <= 2**15 else np.int32
