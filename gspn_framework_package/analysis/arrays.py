"""Names for the types of arrays. numpy.typing came after the NumPy of Ubuntu 20.04, so only type
checkers see the types of the elements."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.floating[Any]]
    Indices = NDArray[np.integer[Any]]
    Booleans = NDArray[np.bool_]
else:
    Floats = Indices = Booleans = np.ndarray

Matrix = Any
"""A sparse matrix of SciPy, which has no types."""
