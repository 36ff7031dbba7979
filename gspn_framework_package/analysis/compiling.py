"""Compiling with numba so that the machine code is kept for the next process, where there is a
place to keep it; the import fails where numba is not installed."""

from __future__ import annotations

from typing import Any, Callable

from numba import njit

Function = Callable[..., Any]


def compiled(function: Function) -> Any:
    """``function``, compiled by numba at its first call.

    Its machine code is kept beside its file, or in the user's cache. Where neither can be written
    (an installation that is read-only, a user without a home) every process compiles for itself.
    """
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba found no place to keep it
        return njit(nogil=True)(function)
