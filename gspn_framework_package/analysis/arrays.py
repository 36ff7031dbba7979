"""Names for array types. The NumPy of Ubuntu 20.04 has no numpy.typing yet, so only type checkers
see the element types."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Union

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.floating[Any]]
    Indices = NDArray[np.integer[Any]]
    Booleans = NDArray[np.bool_]
    Words = NDArray[np.unsignedinteger[Any]]
else:
    Floats = Indices = Booleans = Words = np.ndarray

Selection = Union[Indices, Booleans, slice, None]
"""A selection of rows: numbers, a mask or a slice; None selects all."""

Matrix = Any
"""A SciPy sparse matrix; SciPy has no type annotations."""
