"""Worker processes of this machine.

They are spawned, because a process with threads cannot safely be forked. Each holds one end of a
pipe; when this process closes the other end, because the work was cancelled or the process ended
for any reason, the workers end at once.
"""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import os
import signal
import threading
from multiprocessing.connection import Connection
from typing import Any, Optional, Sequence

from gspn_framework_package.analysis.executors.remote import Packed, RemoteExecutor, work_on

_SPAWN = multiprocessing.get_context("spawn")


class ProcessExecutor(RemoteExecutor):
    """A pool of processes, started with the first task.

    :param count: number of processes; None: one for each processor that this process may use.
    """

    def __init__(self, count: Optional[int] = None) -> None:
        self._count = len(os.sched_getaffinity(0)) if count is None else count
        self.name = "processes:%d" % self._count
        self._pool: Optional[concurrent.futures.ProcessPoolExecutor] = None
        self._lifeline: Optional[Connection] = None

    @property
    def workers(self) -> int:
        """The number of processes."""
        return self._count

    def _submit(self, packed: Packed, piece: Any) -> Any:
        # The workers inherit that interrupts are blocked, since a terminal sends interrupts to
        # every process.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            if self._pool is None:
                theirs, self._lifeline = _SPAWN.Pipe(duplex=False)
                self._pool = concurrent.futures.ProcessPoolExecutor(
                    self._count, _SPAWN, initializer=_begin, initargs=(theirs,)
                )
            return self._pool.submit(work_on, packed, piece)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def _restart(self) -> None:
        self.close()

    def _stop(self, running: Sequence[Any], ticket: str) -> None:
        self.close()

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None and self._lifeline is not None:
            self._lifeline.close()
            self._pool.shutdown()
        self._pool = self._lifeline = None


def _begin(lifeline: Connection) -> None:
    def watch() -> None:
        try:
            lifeline.poll(None)
        finally:
            os._exit(1)

    threading.Thread(target=watch, name="lifeline", daemon=True).start()
