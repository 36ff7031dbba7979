"""Runs by the kernel, in either of its forms: what runs of a plan and of a net have in common."""

from __future__ import annotations

from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel, machine
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Net

FIRST_ROW = 8
"""Initial number of counts of a place for which time is recorded; more are added when they
occur."""

LONGEST_ROW = 4096
"""Largest counts for which time is booked separately."""


class KernelRun:
    """Runs of one subject, one after the other.

    :param arrays: named tuples of arrays that do not change.
    :param state: a named tuple of arrays that do, as they are at the start.
    :ivar compiled: whether the kernel is the compiled one.
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

    def compile(self) -> None:
        """Switch to the compiled kernel, continuing the run."""
        self.functions = machine.compiled_kernel()
        self.compiled = True
        self.arrays = self._arrays
        self.state = machine.as_arrays(self.state, self._like)
        self._fresh = machine.as_arrays(self._fresh, self._like)

    def begin(self, words: List[int]) -> None:
        """Put everything back to the start; ``words`` are the four words of the random numbers."""
        for now, before in zip(self.state, self._fresh):
            now[:] = before
        self.state.random[:] = words

    def go(self, stop: float, budget: int) -> int:
        """Continue until the clock reaches ``stop`` (s), the run ends, or ``budget`` events have
        happened; returns a status of the kernel.

        :raises RefusedError: there is a timeless cycle, or the model cannot be played.
        """
        end = self.state.numbers[kernel.EVENTS] + budget
        while True:
            left = int(end - self.state.numbers[kernel.EVENTS])
            if left <= 0:
                return kernel.MORE
            status = self.step(float(stop), left)  # a whole number would be compiled for again
            if status == kernel.GROW:
                self._grow()
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
        for array in (state.area, state.spent, state.firings):
            array[:] = [0] * len(array) if isinstance(array, list) else 0

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
        old_from = np.array(state.spent_from)
        old = np.array(state.spent)
        counts = np.array(state.level[: len(self.net.places)])
        rows = np.diff(old_from)
        grown = np.where(
            counts >= rows, np.minimum(np.maximum(2 * rows, counts + 1), LONGEST_ROW), rows
        )
        spent_from = np.cumsum([0, *grown.tolist()]).astype(np.int64)
        spent = np.zeros(int(spent_from[-1]))
        within = np.arange(len(old)) - np.repeat(old_from[:-1], rows)
        spent[np.repeat(spent_from[:-1], rows) + within] = old
        fresh = np.zeros(len(spent))
        if self.compiled:
            self.state = state._replace(spent=spent, spent_from=spent_from)
            self._fresh = self._fresh._replace(spent=fresh, spent_from=spent_from.copy())
        else:
            self.state = state._replace(spent=spent.tolist(), spent_from=spent_from.tolist())
            self._fresh = self._fresh._replace(spent=fresh.tolist(), spent_from=spent_from.tolist())
        self.state.numbers[kernel.GROWN] = 0


def first_rows(marking: Sequence[int]) -> Any:
    """The initial start of each place's row of recorded times."""
    rows = [min(max(FIRST_ROW, n + 2), LONGEST_ROW) for n in marking]
    return np.cumsum([0, *rows]).astype(np.int64)


def whole_numbers(size: int, fill: int = 0) -> Any:
    """An array of whole numbers."""
    return np.full(size, fill, dtype=np.int64)


def real(size: int) -> Any:
    """An array of zeros."""
    return np.zeros(size)
