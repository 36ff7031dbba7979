"""The two forms of the kernel: compiled by numba, or plain Python on lists."""

from __future__ import annotations

import ast
import glob
import inspect
import os
from collections import Counter
from functools import lru_cache
from typing import Any, Callable, Dict, Iterator, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.compiling import numba_is_there as numba_is_there
from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.model.errors import how_to_install

WORTH_COMPILING = 20_000
"""After this many firings in plain Python (a second or two), the compiled form takes over, if numba
is installed."""

MANY_FIRINGS = 200_000
"""More firings than this in plain Python (ten seconds or more) are worth a note."""

SLOW = "numba would simulate about twenty times as fast (%s)" % how_to_install("numba")
"""The note."""

_LOOPS = ("play", "race")


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
        if isinstance(index, ast.Constant) or isinstance(index, ast.Name) and index.id.isupper():
            return node  # numba sees that a constant is not negative
        call: Any = ast.Call(ast.Name("_unsigned", ast.Load()), [index], [])
        if old:
            wrapped.value = call
        else:
            node.slice = call
        return node


@lru_cache(maxsize=None)
def compiled_kernel() -> Dict[str, Callable[..., Any]]:
    """The loops of the kernel, compiled on their first call, with the functions that they call.

    :raises ImportError: numba is not installed.
    """
    from gspn_framework_package.analysis.compiling import compiled, compiled_part

    tree = ast.parse(inspect.getsource(kernel))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    used = Counter(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
    for node in functions:
        node.body = [_Unsigned().visit(statement) for statement in node.body]
    names: Dict[str, Any] = {"__name__": kernel.__name__, "_unsigned": np.uint64}
    exec(compile(ast.fix_missing_locations(tree), kernel.__file__, "exec"), names)
    for node in functions:
        function = names[node.name]
        names[node.name] = (
            compiled(function, allocates=False)
            if node.name in _LOOPS
            else compiled_part(function, inserted=used[node.name] <= 2)
        )
    return {name: names[name] for name in _LOOPS}


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


def as_lists(arrays: Any) -> Any:
    """Convert a named tuple of arrays, and of such tuples, to one of lists."""
    if isinstance(arrays, tuple):
        return type(arrays)(*map(as_lists, arrays))
    return arrays.tolist()


def as_arrays(lists: Any, like: Any) -> Any:
    """Convert a named tuple of lists, and of such tuples, to one of arrays of the types of
    ``like``."""
    if isinstance(lists, tuple):
        return type(lists)(*map(as_arrays, lists, like))
    return np.array(lists, dtype=like.dtype)


def plain_tuple(arrays: Any) -> Any:
    """A named tuple, and those in it, as plain tuples."""
    return tuple(map(plain_tuple, arrays)) if isinstance(arrays, tuple) else arrays


def all_in(arrays: Any) -> Iterator[Any]:
    """The arrays or lists in a named tuple, and in those in it."""
    if isinstance(arrays, tuple):
        for part in arrays:
            yield from all_in(part)
    else:
        yield arrays


def ragged(parts: Sequence[Sequence[Any]], dtype: Any = np.int64) -> Tuple[Any, Any]:
    """Lists of numbers as two arrays: the start of each (and the end of the last), and their
    concatenation. The second is never empty, since numba needs its type."""
    offsets = np.zeros(len(parts) + 1, dtype=np.int64)
    np.cumsum([len(part) for part in parts], out=offsets[1:])
    flat = [value for part in parts for value in part] or [0]
    return offsets, np.array(flat, dtype=dtype)


def integers(values: Sequence[int]) -> Any:
    """Whole numbers as an array; never empty, since numba needs its type."""
    return np.array(values if len(values) else [0], dtype=np.int64)


def floats(values: Sequence[float]) -> Any:
    """The same for floats."""
    return np.array(values if len(values) else [0.0], dtype=np.float64)
