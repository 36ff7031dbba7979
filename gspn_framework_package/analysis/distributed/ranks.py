"""What the ranks say to each other: two operations, and what follows from them."""

from __future__ import annotations

import functools
from typing import Any, Callable, List, Optional, Sequence, TypeVar

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.state_space.exploration import FieldOverflowError
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import GspnError, LimitError

Value = TypeVar("Value")


class Ranks:
    """The processes that compute together, as one of them sees them. Every operation is called by
    all of them, in the same order.

    :ivar rank: the number of this process, from 0.
    :ivar size: how many there are.
    """

    rank: int
    size: int

    def gather(self, value: Value) -> List[Value]:
        """The values of all ranks, in their order, on every rank."""
        raise NotImplementedError

    def exchange(self, parts: Sequence[np.ndarray]) -> List[np.ndarray]:
        """Send an array to every rank, and return the one from each. They may have any length, and
        agree in type and in the length of a row."""
        raise NotImplementedError

    def swap(
        self, sent: np.ndarray, outgoing: Sequence[int], incoming: Sequence[int]
    ) -> np.ndarray:
        """Exchange rows where all lengths are known.

        :param sent: the rows for each rank, one after the other.
        :param outgoing: how many go to each.
        :param incoming: how many come from each.
        :returns: the rows from each rank, one after the other.
        """
        parts = self.exchange(np.split(sent, np.cumsum(outgoing)[:-1]))
        assert [len(part) for part in parts] == list(incoming)
        return np.concatenate(parts)

    def total(self, value: Any) -> Any:
        """The sum of the values (numbers or arrays) of all ranks, the same on every rank."""
        return sum(self.gather(value))

    def agreed(self, work: Callable[[], Value]) -> List[Value]:
        """Do ``work`` on every rank, and return all results.

        :raises GspnError: it failed on some rank; then every rank raises the error of the first of
          them, so that none waits for one that gave up.
        """
        result: Optional[Value] = None
        error: Optional[Exception] = None
        try:
            result = work()
        except (GspnError, FieldOverflowError) as problem:
            error = problem
        except MemoryError:
            error = self.too_little_memory()
        found: List[Any] = self.gather((result, error))
        for _, failure in found:
            if failure is not None:
                raise failure
        return [value for value, _ in found]

    def too_little_memory(self) -> LimitError:
        """The error of this rank, if it has too little memory."""
        return LimitError(
            "rank %d of %d has too little memory" % (self.rank, self.size),
            hint="raise --limit-memory, or take more ranks",
        )


class Alone(Ranks):
    """One process that computes everything itself."""

    rank, size = 0, 1

    def gather(self, value: Value) -> List[Value]:
        """See :meth:`Ranks.gather`."""
        return [value]

    def exchange(self, parts: Sequence[np.ndarray]) -> List[np.ndarray]:
        """See :meth:`Ranks.exchange`."""
        return list(parts)


class AgreedWatch(Watch):
    """A watch that ends the work of all ranks if it ends that of one. All call it together.

    :param ranks: the ranks.
    :param watch: the watch of this rank.
    """

    def __init__(self, ranks: Ranks, watch: Watch) -> None:
        super().__init__()
        self._ranks, self._watch = ranks, watch

    def step(self, what: str, count: int) -> None:
        """See :meth:`Watch.step`."""
        self._ranks.agreed(functools.partial(self._watch.step, what, count))


def divided(owners: Indices, size: int, *columns: np.ndarray) -> List[List[np.ndarray]]:
    """Arrays of equal length, each divided among ``size`` ranks by the ``owners`` of its rows."""
    order = np.argsort(owners, kind="stable")
    cuts = np.cumsum(np.bincount(owners, minlength=size))[:-1]
    return [np.split(column[order], cuts) for column in columns]
