"""Compiles with numba and caches the machine code for the next process if a cache directory is
writable. The import fails if numba is not installed."""

from __future__ import annotations

from typing import Any, Callable

from numba import njit

Function = Callable[..., Any]


def compiled(function: Function) -> Any:
    """``function``, compiled by numba on its first call.

    The machine code is cached next to the source file, or in the user's cache directory. If neither
    is writable (a read-only installation, a user without a home), every process compiles it again.
    """
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba found no writable cache directory
        return njit(nogil=True)(function)
