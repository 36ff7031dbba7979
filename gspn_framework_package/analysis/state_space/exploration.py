"""What the exploration engines share: their result, room, growing arrays.

An engine is a function ``explore(packed, limit, watch) -> RawGraph``: ``numpy_engine`` (always
there) and ``numba_engine`` (where numba is installed). ``sparse_engine`` takes the net itself.
"""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple, Tuple

import numpy as np


class RawGraph(NamedTuple):
    """What an engine found: ``states`` (uint64, shape ``(n, words)``, the initial one first); the
    arcs of state ``s`` at ``offsets[s]:offsets[s + 1]`` of ``targets`` (state numbers) and
    ``labels`` (transitions in engine order); the successors of the first ``explored`` states are
    known, of all of them when the limit was not met and there was room enough."""

    states: Any
    offsets: Any
    targets: Any
    labels: Any
    explored: int


class Allowance(NamedTuple):
    """What an exploration may use: ``memory`` in bytes, and the time ``until`` when (of the
    monotonic clock)."""

    memory: float = math.inf
    until: float = math.inf

    def left(self, used: float) -> bool:
        """Whether there is any, with ``used`` bytes in use."""
        return used <= self.memory and time.monotonic() < self.until


ENDLESS = Allowance()
"""Room without an end."""


class FieldOverflowError(Exception):
    """A count outgrew its field; ``bits`` are the guard bits that were hit, one int per word."""

    def __init__(self, bits: Tuple[int, ...]) -> None:
        super().__init__("a field of a packed marking is too narrow")
        self.bits = bits


class Growing:
    """An array that grows in place by its first axis; ``array[:used]`` is what counts."""

    def __init__(self, dtype: Any, columns: int = 0, capacity: int = 1024) -> None:
        self._columns = columns
        self.array = np.empty((capacity, columns) if columns else capacity, dtype=dtype)
        self.used = 0

    def reserve(self, count: int) -> None:
        """Have room for ``count`` rows in all."""
        capacity = len(self.array)
        if count > capacity:
            # more room would be filled with zeros, and counts
            self._resize(max(count, capacity + (capacity >> 2)))

    def extend(self, rows: Any) -> None:
        """Append ``rows``."""
        self.reserve(self.used + len(rows))
        self.array[self.used : self.used + len(rows)] = rows
        self.used += len(rows)

    def finished(self) -> Any:
        """The array of the rows in use; the rest is given back."""
        self._resize(self.used)
        return self.array

    def _resize(self, capacity: int) -> None:
        # In place: the allocator moves pages instead of copying, so that there is never a second
        # copy.
        shape = (capacity, self._columns) if self._columns else (capacity,)
        self.array.resize(shape, refcheck=False)


def label_type(transitions: int) -> Any:
    """The smallest integer type for transition numbers."""
    return np.uint8 if transitions <= 2**8 else np.int16 if transitions <= 2**15 else np.int32
