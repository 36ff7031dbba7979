"""The two forms of the kernel: compiled by numba, or plain Python on lists."""

from __future__ import annotations

from functools import lru_cache
from types import FunctionType
from typing import Any, Callable, Dict, List, NamedTuple, Tuple

import numpy as np

from gspn_framework_package.analysis.compiling import numba_is_there
from gspn_framework_package.analysis.symbolic import kernel
from gspn_framework_package.analysis.symbolic.kernel import (
    DONE,
    FORGOTTEN,
    HEIGHT,
    MORE_CHILDREN,
    MORE_FRAMES,
    MORE_NODES,
    MORE_VALUES,
    NODES,
    REGISTERS,
    RESULT,
    WORK,
    NodeStore,
    Numbers,
    StepArrays,
    push_fire,
    push_saturate,
)

_ROOM = 1 << 12
"""Number of nodes for which there is room at first, a power of two; everything grows."""

_MOST_CACHED = 1 << 22
"""Largest number of results that a table keeps; more make hardly any net faster."""


class KernelForm(NamedTuple):
    """A form of the kernel: its loop, and its function ``enter_nodes``."""

    run: Callable[..., int]
    enter_nodes: Callable[..., None]
    compiled: bool


PLAIN = KernelForm(kernel.run, kernel.enter_nodes, False)


@lru_cache(maxsize=None)
def compiled_form() -> KernelForm:
    """The compiled form. :raises ImportError: numba is not installed."""
    from gspn_framework_package.analysis.compiling import compiled, compiled_part

    names: Dict[str, Any] = dict(vars(kernel))
    for name, value in vars(kernel).items():
        if isinstance(value, FunctionType) and value.__module__ == kernel.__name__:
            function = FunctionType(value.__code__, names, name)
            names[name] = (
                compiled(function, allocates=False)
                if name in ("run", "enter_nodes")
                else compiled_part(function, inserted=False)
            )
    return KernelForm(names["run"], names["enter_nodes"], True)


def best_form() -> KernelForm:
    """The compiled form if numba is installed, otherwise the plain one."""
    return compiled_form() if numba_is_there() else PLAIN


class Machine:
    """Decision diagrams, and the operation on them in progress.

    :param form: the form of the kernel.
    :param steps: the steps, of Python lists.
    """

    def __init__(self, form: KernelForm, steps: StepArrays) -> None:
        self._form = form
        self._compiled = form.compiled
        self.store = NodeStore(
            start=self._zeros(_ROOM, np.int64),
            low=self._zeros(_ROOM, np.int64),
            pool=self._zeros(4 * _ROOM, np.int32),
            table=self._zeros(2 * _ROOM, np.int32),
            fired=self._zeros(2 * _ROOM, np.int64),
            fired_to=self._zeros(2 * _ROOM, np.int32),
            joined=self._zeros(2 * _ROOM, np.int64),
            joined_to=self._zeros(2 * _ROOM, np.int32),
        )
        self._st = self._zeros(REGISTERS, np.int64)
        self._st[NODES] = 2
        self._stack = self._zeros(4 * _ROOM, np.int64)
        self._vec = self._zeros(_ROOM, np.int32)
        self._dirty = self._zeros(_ROOM, np.int8)
        self.use(steps)

    def use(self, steps: StepArrays) -> None:
        """Use these steps from now on; those that were there before keep their numbers."""
        if self._compiled:
            steps = StepArrays(*(np.array(part, dtype=np.int64) for part in steps))
        self._steps = steps

    @property
    def nodes(self) -> int:
        """The number of nodes made so far."""
        return int(self._st[NODES])

    @property
    def work(self) -> int:
        """The number of elementary operations so far."""
        return int(self._st[WORK])

    @property
    def result(self) -> int:
        """The set that the last work found."""
        return int(self._st[RESULT])

    @property
    def memory(self) -> int:
        """The size (bytes) of the arrays."""
        parts = (*self.store, self._stack, self._vec, self._dirty)
        return sum(part.nbytes if self._compiled else 8 * len(part) for part in parts)

    def begin_close(self, level: int, tokens: int, child: int) -> None:
        """Begin to close the markings with this number of tokens in the place of a level, and those
        of ``child`` below, under the transitions of the level."""
        self._vec[0], self._dirty[0] = child, 1
        self._st[HEIGHT] = 1
        push_saturate(self._st, self._stack, level, 0, tokens, -1, -1)

    def begin_step(self, level: int, step: int, node: int) -> None:
        """Begin to take a nontrivial step from the nontrivial set ``node`` of this level."""
        push_fire(self._st, self._stack, self.store, self._steps, level, step, node)

    def go_on(self, turns: int) -> bool:
        """Continue the work, for at most ``turns`` operations or until there is no room; returns
        whether it is done."""
        outcome = self._form.run(
            self.store, self._steps, self._st, self._stack, self._vec, self._dirty, turns
        )
        if outcome == DONE:
            return True
        if outcome == MORE_NODES:
            self._more_nodes()
        elif outcome == MORE_CHILDREN:
            self.store = self.store._replace(pool=self._longer(self.store.pool))
        elif outcome == MORE_FRAMES:
            self._stack = self._longer(self._stack)
        elif outcome == MORE_VALUES:
            self._vec, self._dirty = self._longer(self._vec), self._longer(self._dirty)
        elif self._st[FORGOTTEN] > len(self.store.fired):
            self.store = self._with_more_results(self.store)
        return False

    def children(self, node: int) -> Tuple[int, List[int]]:
        """The lowest number of tokens of a node, and its children from there on."""
        start = self.store.start
        children = self.store.pool[start[node] : start[node + 1]]
        return int(self.store.low[node]), children.tolist() if self._compiled else children

    def _more_nodes(self) -> None:
        old = self.store
        store = old._replace(
            start=self._longer(old.start),
            low=self._longer(old.low),
            table=self._zeros(2 * len(old.table), np.int32),
        )
        if len(old.fired) < len(store.start):
            store = self._with_more_results(store)
        self._form.enter_nodes(store, self._st[NODES])
        self.store = store

    def _with_more_results(self, store: NodeStore) -> NodeStore:
        """Make room for at least twice as many results, which are found again: that takes less than
        moving them."""
        size = 2 * len(store.fired)
        while size < self._st[FORGOTTEN]:
            size *= 2
        self._st[FORGOTTEN] = 0
        size = min(size, _MOST_CACHED)
        if size == len(store.fired):
            return store
        return store._replace(
            fired=self._zeros(size, np.int64),
            fired_to=self._zeros(size, np.int32),
            joined=self._zeros(size, np.int64),
            joined_to=self._zeros(size, np.int32),
        )

    def _zeros(self, size: int, dtype: Any) -> Numbers:
        return np.zeros(size, dtype=dtype) if self._compiled else [0] * size

    def _longer(self, numbers: Numbers) -> Numbers:
        if not self._compiled:
            return numbers + [0] * len(numbers)
        longer = np.zeros(2 * len(numbers), dtype=numbers.dtype)
        longer[: len(numbers)] = numbers
        return longer
