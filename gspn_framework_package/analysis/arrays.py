"""Names for array types. The NumPy of Ubuntu 20.04 has no numpy.typing yet, so only type checkers
see the element types."""

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
"""A SciPy sparse matrix; SciPy has no type annotations."""
