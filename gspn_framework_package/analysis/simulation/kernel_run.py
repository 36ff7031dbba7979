"""Runs by the kernel, in either of its forms: what runs of a plan and of a net have in common."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel, machine
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Marking, Net

FIRST_ROW = 8
"""Initial number of counts of a place for which time is recorded; more are added when they
occur."""


class KernelRun:
    """Runs of one subject, one after the other.

    :param arrays: named tuples of arrays that do not change.
    :param state: a named tuple of arrays that do, as they are at the start.
    :ivar compiled: whether the kernel is the compiled one.
    :ivar arguments: the arrays and the state, as the kernel takes them.
    :ivar state: the state, as arrays if compiled, else as lists.
    """

    def __init__(self, net: Net, arrays: Sequence[Any], state: Any) -> None:
        self.net = net
        self.compiled = False
        self.functions: Dict[str, Any] = vars(kernel)
        self._like = state
        self._arrays = tuple(arrays)
        self.arrays: Tuple[Any, ...] = tuple(machine.as_lists(part) for part in arrays)
        self.state: Any = machine.as_lists(state)
        self._fresh: Any = machine.as_lists(state)
        self._hand_over()

    def _hand_over(self) -> None:
        """Prepare what every run needs: the arguments of the kernel, and all arrays in one row.

        The arguments are plain tuples: numba's cache on disk cannot be read after a class among its
        types has been renamed.
        """
        self.arguments: Tuple[Any, ...] = machine.plain_tuple((*self.arrays, self.state))
        self._to_reset = list(zip(machine.all_in(self.state), machine.all_in(self._fresh)))
        self._compute_values()

    def _compute_values(self) -> None:
        """Compute the rates and weights that depend on the marking, in this one."""
        functions, net, rates = self._values()
        for k in range(len(functions.transition)):
            kernel.compute(k, functions, net, rates, self.state.counts.level)

    def _values(self) -> Tuple[kernel.MarkingFunctions, kernel.NetArrays, kernel.Rates]:
        """Where the kernel has them."""
        raise NotImplementedError

    def compile(self) -> None:
        """Switch to the compiled kernel, continuing the run."""
        self.functions = machine.compiled_kernel()
        self.compiled = True
        self.arrays = self._arrays
        self.state = machine.as_arrays(self.state, self._like)
        self._fresh = machine.as_arrays(self._fresh, self._like)
        self._hand_over()

    def begin(self, words: List[int]) -> None:
        """Reset everything; ``words`` are the four words of the random numbers."""
        for now, before in self._to_reset:
            now[:] = before
        self.state.random[:] = words
        self._compute_values()

    def continue_from(self, state: Any) -> None:
        """Continue from another state."""
        self.state = state
        self._hand_over()

    def go(self, stop: float, budget: int) -> int:
        """Continue until the clock reaches ``stop`` (s), the run ends, or ``budget`` events have
        happened; returns a status of the kernel.

        :raises RefusedError: there is a timeless cycle, or the model cannot be played.
        :raises NetError: a rate or weight that depends on the marking is not above 0.
        """
        end = self.state.numbers[kernel.EVENTS] + budget
        while True:
            left = int(end - self.state.numbers[kernel.EVENTS])
            if left <= 0:
                return kernel.MORE
            status = self.step(float(stop), left)  # a whole number would be compiled for again
            if status == kernel.GROW:
                self._grow()
            elif status == kernel.NO_VALUE:
                t = int(self.state.numbers[kernel.WITHOUT_VALUE]) - 1
                self.net.value(self.marking, t)
                raise AssertionError("the kernel has no value for transition %d" % t)
            elif status == kernel.TIMELESS:
                raise RefusedError(
                    "more than %d firings without time between them" % kernel.FIRINGS_PER_ENTRY,
                    hint="a cycle of immediate transitions must have an exit, and its actions "
                    "must take time",
                )
            else:
                status = self.after(status)
                if status != kernel.MORE:
                    return status

    def step(self, stop: float, budget: int) -> int:
        """Call the loop of the kernel."""
        raise NotImplementedError

    def after(self, status: int) -> int:
        """Handle a status specific to the subject; returns MORE to continue."""
        return status

    def forget(self) -> None:
        """Reset the counts; the run continues."""
        state = self.state
        for array in (state.counts.area, state.counts.spent, state.firings):
            array[:] = [0] * len(array) if isinstance(array, list) else 0

    @property
    def marking(self) -> Marking:
        """The marking now."""
        return tuple(int(n) for n in self.state.counts.level[: len(self.net.places)])

    @property
    def now(self) -> float:
        """The time of the run (s)."""
        return float(self.state.clocks[kernel.NOW])

    @property
    def firings_so_far(self) -> int:
        """The number of firings since the run began."""
        return int(self.state.numbers[kernel.FIRINGS])

    def _grow(self) -> None:
        """Make room for the counts that have outgrown their rows of booked times."""
        state = self.state
        old_from = np.array(state.counts.spent_from)
        old = np.array(state.counts.spent)
        counts = np.array(state.counts.level[: len(self.net.places)])
        rows = np.diff(old_from)
        grown = np.where(
            counts >= rows, np.minimum(np.maximum(2 * rows, counts + 1), kernel.LONGEST_ROW), rows
        )
        spent_from = np.cumsum([0, *grown.tolist()]).astype(np.int64)
        spent = np.zeros(int(spent_from[-1]))
        within = np.arange(len(old)) - np.repeat(old_from[:-1], rows)
        spent[np.repeat(spent_from[:-1], rows) + within] = old
        self._fresh = self._with_rows(self._fresh, np.zeros(len(spent)), spent_from.copy())
        self.continue_from(self._with_rows(state, spent, spent_from))
        self.state.numbers[kernel.GROWN] = 0

    def _with_rows(self, state: Any, spent: Any, spent_from: Any) -> Any:
        rows = (spent, spent_from) if self.compiled else (spent.tolist(), spent_from.tolist())
        return state._replace(counts=state.counts._replace(spent=rows[0], spent_from=rows[1]))


def first_counts(marking: Sequence[int], more: int) -> kernel.CountArrays:
    """The counts at the start of a run: those of its marking, then that many of 0."""
    rows = [min(max(FIRST_ROW, n + 2), kernel.LONGEST_ROW) for n in marking]
    return kernel.CountArrays(
        level=np.array([*marking, *[0] * more], dtype=np.int64),
        since=real(len(marking)),
        area=real(len(marking)),
        spent=real(sum(rows)),
        spent_from=np.cumsum([0, *rows]).astype(np.int64),
    )


def first_clocks() -> Any:
    """The clocks at the start of a run, in which nothing is due."""
    clocks = real(kernel.CLOCKS)
    clocks[kernel.ENVIRONMENT_AT] = clocks[kernel.LOSS_AT] = math.inf
    return clocks


def sum_tree(values: Sequence[float]) -> Any:
    """The tree of sums of some values."""
    leaves = 1
    while leaves < len(values):
        leaves *= 2
    tree = real(2 * leaves)
    tree[leaves : leaves + len(values)] = values
    for i in range(leaves - 1, 0, -1):
        tree[i] = tree[2 * i] + tree[2 * i + 1]
    return tree


def whole_numbers(size: int, fill: int = 0) -> Any:
    """An array of whole numbers."""
    return np.full(size, fill, dtype=np.int64)


def real(size: int) -> Any:
    """An array of zeros."""
    return np.zeros(size)
