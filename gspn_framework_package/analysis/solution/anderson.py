"""Anderson acceleration of a fixed-point iteration ``x = G(x)``.

The next point is not ``G(x)`` but the combination of the last few ``G(x)`` whose changes ``G(x) -
x`` cancel out best (Anderson 1965). For a linear ``G`` this is equivalent to GMRES (Walker and Ni
2011), and does not need the matrix of ``G``.

The vectors are read and written in parts, so that they need not be in memory.
"""

from __future__ import annotations

from typing import Callable, Iterator, Protocol

import numpy as np

from gspn_framework_package.analysis.arrays import Floats

ANDERSON_DEPTH = 5
"""Number of earlier steps to combine."""

_DEPENDENT = 1e-12
"""Changes whose directions are this close to linear dependence count as one, since separating them
would only amplify rounding."""

_PART = 1 << 13
"""Number of entries of a vector read at once: few enough for the processor's cache, and too few for
BLAS to start threads."""


class Vector(Protocol):
    """Numbers that are read and written in parts: a float array, or a file."""

    def __getitem__(self, part: slice) -> Floats: ...

    def __setitem__(self, part: slice, values: Floats) -> None: ...


def parts(size: int) -> Iterator[slice]:
    """The parts in which to read a vector of this size."""
    for begin in range(0, size, _PART):
        yield slice(begin, min(begin + _PART, size))


class Anderson:
    """The memory of one iteration; ``next`` is called with every point and its image under ``G``.

    >>> turn = np.array([[0.0, -0.9], [0.9, 0.0]])  # unaccelerated: 260 steps to 1e-12
    >>> point, accelerated = np.array([1.0, 0.0]), Anderson(2)
    >>> for _ in range(4):
    ...     accelerated.next(point, turn @ point + 1.0)
    >>> bool(np.abs(turn @ point + 1.0 - point).max() < 1e-12)
    True
    """

    def __init__(self, size: int, vector: Callable[[int], Vector] = np.empty) -> None:
        """:param vector: creates a vector of a given size, with arbitrary entries."""
        self._size = size
        self._depth = depth = ANDERSON_DEPTH
        self._changes = [vector(size) for _ in range(depth)]  # of successive G(x) - x
        self._moves = [vector(size) for _ in range(depth)]  # of successive G(x)
        self._products = np.zeros((depth, depth))  # scalar products of the changes
        self._count = 0
        self._last_change, self._last_image = vector(size), vector(size)
        self._begun = False

    def next(self, point: Vector, image: Vector) -> None:
        """Replace ``point`` by the point to continue from.

        :param image: ``G(point)``.
        """
        if not self._begun:
            self._begun = True
            for part in parts(self._size):
                known = image[part]
                self._last_change[part] = known - point[part]
                self._last_image[part] = known
                point[part] = known
            return
        row = self._count % self._depth
        self._count += 1
        used = min(self._count, self._depth)
        sums = np.zeros((2, used))  # the products of the changes with the newest, and with G(x) - x
        for part in parts(self._size):
            known = image[part]
            change = known - point[part]
            newest = change - self._last_change[part]
            self._changes[row][part] = newest
            self._moves[row][part] = known - self._last_image[part]
            self._last_change[part] = change
            self._last_image[part] = known
            for number in range(used):
                other = newest if number == row else self._changes[number][part]
                sums[0, number] += other @ newest
                sums[1, number] += other @ change
        self._products[row, :used] = self._products[:used, row] = sums[0]
        length = np.sqrt(np.maximum(np.diagonal(self._products)[:used], 1e-300))
        gram = self._products[:used, :used] / np.outer(length, length)
        shares = np.linalg.lstsq(gram, sums[1] / length, rcond=_DEPENDENT)[0] / length
        for part in parts(self._size):
            moved = np.array(image[part])
            for number, share in enumerate(shares.tolist()):
                moved -= share * self._moves[number][part]
            point[part] = moved

    def forget(self) -> None:
        """Restart: the next point is unrelated to the earlier ones."""
        self._count, self._begun = 0, False
