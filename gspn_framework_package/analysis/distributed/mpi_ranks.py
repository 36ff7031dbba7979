"""The ranks of a program that ``mpiexec`` started."""

from __future__ import annotations

from typing import Any, List, NoReturn, Sequence

import numpy as np

from gspn_framework_package.analysis.distributed.ranks import Ranks, Value
from gspn_framework_package.model.errors import WorkersError


class MpiRanks(Ranks):
    """All processes of this program.

    :raises WorkersError: mpi4py is not installed.
    """

    def __init__(self) -> None:
        try:
            from mpi4py import MPI
        except ImportError as error:
            raise WorkersError(
                "--on mpi needs mpi4py (%s)" % error,
                hint="apt install python3-mpi4py openmpi-bin, on every machine",
            ) from None
        self._world: Any = MPI.COMM_WORLD
        self.rank, self.size = self._world.Get_rank(), self._world.Get_size()

    def gather(self, value: Value) -> List[Value]:
        """See :meth:`Ranks.gather`."""
        found: List[Value] = self._world.allgather(value)
        return found

    def exchange(self, parts: Sequence[np.ndarray]) -> List[np.ndarray]:
        """See :meth:`Ranks.exchange`."""
        outgoing = [len(part) for part in parts]
        incoming: List[int] = self._world.alltoall(outgoing)
        received = self.swap(np.concatenate(parts), outgoing, incoming)
        return np.split(received, np.cumsum(incoming)[:-1])

    def swap(
        self, sent: np.ndarray, outgoing: Sequence[int], incoming: Sequence[int]
    ) -> np.ndarray:
        """See :meth:`Ranks.swap`."""
        received = np.empty((sum(incoming), *sent.shape[1:]), dtype=sent.dtype)
        width = sent.shape[1] if sent.ndim > 1 else 1
        self._world.Alltoallv(
            [np.ascontiguousarray(sent), [count * width for count in outgoing]],
            [received, [count * width for count in incoming]],
        )
        return received

    def abort(self, code: int) -> NoReturn:
        """End all ranks at once, because this one cannot go on."""
        self._world.Abort(code)
        raise SystemExit(code)
