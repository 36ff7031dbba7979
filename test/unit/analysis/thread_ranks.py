"""Ranks that are threads of one process, for tests that need no mpiexec."""

import threading

import numpy as np

from gspn_framework_package.analysis.distributed import Ranks
from gspn_framework_package.model.errors import GspnError


class ThreadRanks(Ranks):
    def __init__(self, rank, shared):
        self.rank, self.size = rank, len(shared.slots)
        self._shared = shared

    def gather(self, value):
        shared = self._shared
        shared.slots[self.rank] = value
        shared.barrier.wait()
        found = list(shared.slots)
        shared.barrier.wait()
        return found

    def exchange(self, parts):
        assert len(parts) == self.size
        return [np.array(sent[self.rank]) for sent in self.gather(parts)]


class _Shared:
    def __init__(self, size):
        self.slots = [None] * size
        self.barrier = threading.Barrier(size, timeout=15)


def on_ranks(size, work):
    """The results of ``work(ranks)`` on every rank; raises the first error of one."""
    shared = _Shared(size)
    results, errors = [None] * size, []

    def run(rank):
        try:
            results[rank] = work(ThreadRanks(rank, shared))
        except BaseException as error:
            errors.append(error)
            if not isinstance(error, GspnError):
                shared.barrier.abort()  # the others would wait for it

    threads = [threading.Thread(target=run, args=(rank,), daemon=True) for rank in range(size)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        # an error that all ranks agreed on, rather than the broken barrier that it left
        raise min(errors, key=lambda error: isinstance(error, threading.BrokenBarrierError))
    return results
