"""Compiles with numba and caches the machine code for the next process if a cache directory is
writable. The import fails if numba is not installed."""

from __future__ import annotations

import os
from typing import Any, Callable, Dict

# otherwise, numba's colorama appends an escape sequence to the output at the end of the process if
# the output is a terminal
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

from numba import config, njit

__all__ = ["Function", "compiled", "config"]

Function = Callable[..., Any]


def compiled(function: Function, allocates: bool = True) -> Any:
    """``function``, compiled by numba on its first call.

    For a function that creates no arrays, set ``allocates`` to false: it then does not count
    references to its arrays, which would take most of the time of a small function.

    The machine code is cached next to the source file, or in the user's cache directory. If neither
    is writable (a read-only installation, a user without a home), every process compiles it again.
    """
    options: Dict[str, Any] = {"nogil": True}
    if not allocates:
        options["_nrt"] = False
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no writable cache directory
        return njit(**options)(function)
