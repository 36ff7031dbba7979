"""The two forms of the kernel: compiled by numba, or plain Python on lists."""

from __future__ import annotations

import importlib.util
import types
from functools import lru_cache
from typing import Any, Callable, Dict, List, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel

WORTH_COMPILING = 20_000
"""After this many firings in plain Python (a second or two), the compiled form takes over, if numba
is installed."""


@lru_cache(maxsize=None)
def compiled_kernel() -> Dict[str, Callable[..., Any]]:
    """All functions of the kernel, compiled on their first call.

    :raises ImportError: numba is not installed.
    """
    from gspn_framework_package.analysis.compiling import compiled

    names = dict(vars(kernel))
    for name, function in vars(kernel).items():
        if isinstance(function, types.FunctionType) and function.__module__ == kernel.__name__:
            # the copy calls the compiled forms of the others
            copy = types.FunctionType(function.__code__, names, name, function.__defaults__)
            copy.__module__ = kernel.__name__
            copy.__qualname__ = name
            names[name] = compiled(copy, allocates=False)
    return names


def may_compile() -> bool:
    """Whether numba is installed; does not import it."""
    return importlib.util.find_spec("numba") is not None


def is_loaded() -> bool:
    """Whether the compiled form is in memory already."""
    return compiled_kernel.cache_info().currsize > 0


def as_lists(arrays: Tuple[Any, ...]) -> Tuple[Any, ...]:
    """A named tuple of arrays, as one of lists."""
    return type(arrays)(*(a.tolist() if isinstance(a, np.ndarray) else a for a in arrays))


def as_arrays(lists: Tuple[Any, ...], like: Tuple[Any, ...]) -> Tuple[Any, ...]:
    """A named tuple of lists, as one of arrays of the types of ``like``."""
    return type(lists)(
        *(np.array(a, dtype=b.dtype) if isinstance(a, list) else a for a, b in zip(lists, like))
    )


def ragged(parts: List[List[Any]], dtype: Any = np.int64) -> Tuple[Any, Any]:
    """Lists of numbers as two arrays: where each begins (and the last one ends), and all of them
    one after another. The second is never empty, for numba needs its type."""
    offsets = np.zeros(len(parts) + 1, dtype=np.int64)
    np.cumsum([len(part) for part in parts], out=offsets[1:])
    flat = [value for part in parts for value in part] or [0]
    return offsets, np.array(flat, dtype=dtype)
