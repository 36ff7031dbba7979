"""Anderson acceleration of a fixed-point iteration ``x = G(x)``.

Instead of going to ``G(x)``, the next point is the combination of the last few ``G(x)`` whose
changes ``G(x) - x`` cancel out best (Anderson 1965). For a linear ``G`` this is equivalent to GMRES
(Walker and Ni 2011), and does not need the matrix of ``G``.
"""

from __future__ import annotations

from typing import Callable, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Floats

DEPTH = 5
"""Number of earlier steps that are combined."""

_DEPENDENT = 1e-12
"""Changes whose directions are this close to linear dependence count as one, since separating them
would only amplify rounding."""


class Anderson:
    """The memory of one iteration; ``next`` is called with every point and its image under ``G``.

    >>> turn = np.array([[0.0, -0.9], [0.9, 0.0]])  # by itself it would take 260 steps to 1e-12
    >>> point, accelerated = np.array([1.0, 0.0]), Anderson(2)
    >>> for _ in range(4):
    ...     point = accelerated.next(point, turn @ point + 1.0)
    >>> bool(np.abs(turn @ point + 1.0 - point).max() < 1e-12)
    True
    """

    def __init__(
        self, size: int, depth: int = DEPTH, total: Optional[Callable[[Floats], Floats]] = None
    ) -> None:
        """:param total: adds up the scalar products (float array) of all processes, if each of them
        has a part of the vectors."""
        self._total = total or (lambda sums: sums)
        self._changes = np.zeros((depth, size))  # differences of successive G(x) - x
        self._moves = np.zeros((depth, size))  # differences of successive G(x)
        self._products = np.zeros((depth, depth))  # of the changes with each other
        self._count = 0
        self._last: Optional[Tuple[Floats, Floats]] = None

    def next(self, point: Floats, image: Floats) -> Floats:
        """The point to continue from.

        :param point: float array.
        :param image: ``G(point)``: a separate array, which is kept and must not be changed.
        """
        change = image - point
        last, self._last = self._last, (change, image)
        if last is None:
            return image.copy()
        row = self._count % len(self._changes)
        np.subtract(change, last[0], out=self._changes[row])
        np.subtract(image, last[1], out=self._moves[row])
        self._count += 1
        used = min(self._count, len(self._changes))
        changes = self._changes[:used]
        self._products[row, :used] = self._products[:used, row] = self._total(
            changes @ changes[row]
        )
        length = np.sqrt(np.maximum(np.diagonal(self._products)[:used], 1e-300))
        gram = self._products[:used, :used] / np.outer(length, length)
        aligned = self._total(changes @ change)
        shares = np.linalg.lstsq(gram, aligned / length, rcond=_DEPENDENT)[0] / length
        result: Floats = image - shares @ self._moves[:used]
        return result

    def forget(self) -> None:
        """Start again: the next point is unrelated to the earlier ones."""
        self._count, self._last = 0, None
