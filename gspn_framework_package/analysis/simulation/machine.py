"""The two forms of the kernel: compiled by numba, or plain Python on lists."""

from __future__ import annotations

import ast
import glob
import importlib.util
import inspect
import os
from functools import lru_cache
from typing import Any, Callable, Dict, List, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel

WORTH_COMPILING = 20_000
"""After this many firings in plain Python (a second or two), the compiled form takes over, if numba
is installed."""


class _Unsigned(ast.NodeTransformer):
    """Makes every index in a function an unsigned number.

    numba lets negative indices count from the end; the test for that takes more than half of the
    time of an event, and the kernel has no negative indices.
    """

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        self.generic_visit(node)
        wrapped: Any = node.slice
        old = type(wrapped).__name__ == "Index"  # Python 3.8
        index = wrapped.value if old else wrapped
        call: Any = ast.Call(ast.Name("_unsigned", ast.Load()), [index], [])
        if old:
            wrapped.value = call
        else:
            node.slice = call
        return node


@lru_cache(maxsize=None)
def compiled_kernel() -> Dict[str, Callable[..., Any]]:
    """All functions of the kernel, compiled on their first call.

    :raises ImportError: numba is not installed.
    """
    from gspn_framework_package.analysis.compiling import compiled

    tree = ast.parse(inspect.getsource(kernel))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            node.body = [_Unsigned().visit(statement) for statement in node.body]
    names: Dict[str, Any] = {"__name__": kernel.__name__, "_unsigned": np.uint64}
    exec(compile(ast.fix_missing_locations(tree), kernel.__file__, "exec"), names)
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            names[node.name] = compiled(names[node.name], allocates=False)
    return names


def may_compile() -> bool:
    """Whether numba is installed; does not import it."""
    return importlib.util.find_spec("numba") is not None


def is_loaded() -> bool:
    """Whether the compiled form is in memory already."""
    return compiled_kernel.cache_info().currsize > 0


def is_cached() -> bool:
    """Whether the machine code of the kernel seems to be on the disk, so that the compiled form
    loads within seconds. Imports numba."""
    play: Any = compiled_kernel()["play"]
    folder = play.stats.cache_path
    source = os.path.getmtime(kernel.__file__)
    indices = glob.glob(os.path.join(glob.escape(folder or "."), "kernel.play-*.nbi"))
    found = any(os.path.getmtime(path) >= source for path in indices)
    if not found:
        compiled_kernel.cache_clear()  # it is not in memory: see is_loaded
    return found


def as_lists(arrays: Tuple[Any, ...]) -> Tuple[Any, ...]:
    """Convert a named tuple of arrays to one of lists."""
    return type(arrays)(*(a.tolist() if isinstance(a, np.ndarray) else a for a in arrays))


def as_arrays(lists: Tuple[Any, ...], like: Tuple[Any, ...]) -> Tuple[Any, ...]:
    """Convert a named tuple of lists to one of arrays of the types of ``like``."""
    return type(lists)(
        *(np.array(a, dtype=b.dtype) if isinstance(a, list) else a for a, b in zip(lists, like))
    )


def ragged(parts: List[List[Any]], dtype: Any = np.int64) -> Tuple[Any, Any]:
    """Lists of numbers as two arrays: the start of each (and the end of the last), and their
    concatenation. The second is never empty, since numba needs its type."""
    offsets = np.zeros(len(parts) + 1, dtype=np.int64)
    np.cumsum([len(part) for part in parts], out=offsets[1:])
    flat = [value for part in parts for value in part] or [0]
    return offsets, np.array(flat, dtype=dtype)
