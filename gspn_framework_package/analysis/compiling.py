"""Compiles with numba and caches the machine code for the next process if a cache directory is
writable. numba is imported when the first function is compiled."""

from __future__ import annotations

import importlib.util
import os
from typing import Any, Callable, Dict

# otherwise, numba's colorama appends an escape sequence to the output at the end of the process if
# the output is a terminal
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

Function = Callable[..., Any]


def numba_is_there() -> bool:
    """Whether numba is installed; does not import it."""
    return importlib.util.find_spec("numba") is not None


def compiled(function: Function, allocates: bool = True) -> Any:
    """``function``, compiled by numba on its first call.

    For a function that creates no arrays, set ``allocates`` to false: it then does not count
    references to its arrays, which would take most of the time of a small function.

    The machine code is cached next to the source file, or in the user's cache directory. If neither
    is writable (a read-only installation, a user without a home), every process compiles it again.

    :raises ImportError: numba is not installed.
    """
    from numba import njit

    options: Dict[str, Any] = {"nogil": True}
    if not allocates:
        options["_nrt"] = False
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no writable cache directory
        return njit(**options)(function)


def compiled_part(function: Function, inserted: bool) -> Any:
    """``function``, compiled as a part of the compiled functions that call it; it creates no
    arrays.

    :param inserted: whether it is inserted where it is called, which pays at one or two places:
        handing over many arrays takes longer than most of these functions.
    :raises ImportError: numba is not installed.
    """
    from numba import njit

    options: Dict[str, Any] = {
        "_nrt": False,
        "no_cpython_wrapper": True,
        "no_cfunc_wrapper": True,
        "forceinline": inserted,
    }
    return njit(**options)(function)
