"""The common part of executors with workers outside this process, and the worker's side.

A worker keeps its prepared data for the next task of the same workload. Its versions of Python and
of the libraries must be those of the client, since others may round differently.
"""

from __future__ import annotations

import concurrent.futures
import hashlib
import pickle
import platform
import threading
import uuid
from collections import deque
from functools import lru_cache
from pathlib import Path
from typing import Any, Deque, Dict, Iterator, List, NamedTuple, Sequence, Set, Tuple

import numpy as np

import gspn_framework_package
from gspn_framework_package.analysis.executors.executor import (
    Executor,
    WorkItem,
    Workload,
    naming,
)
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import WorkersError
from gspn_framework_package.model.kept import Kept

_LOOK = 0.1
"""Seconds between two checks for cancellation."""

_AHEAD = 3
"""Number of tasks handed out at a time, per worker."""

_MOST_DEATHS = 3
"""A task is abandoned after this many workers died on it."""

_PREPARED = 8
"""Number of workloads whose prepared data a worker keeps."""


class Packed(NamedTuple):
    """A workload as sent to a worker: its ``content`` with a ``digest``, the ``ticket`` for
    cancelling its work, and the sender's versions."""

    content: bytes
    digest: str
    ticket: str
    versions: Tuple[Tuple[str, str], ...]


@lru_cache(maxsize=None)
def versions() -> Tuple[Tuple[str, str], ...]:
    """The components that must be the same in the client and its workers, with their versions."""
    return (
        ("Python", ".".join(platform.python_version_tuple()[:2])),
        ("gspn_framework_package", "%s (%s)" % (gspn_framework_package.__version__, _sources())),
        ("numpy", np.__version__),
    )


def _sources() -> str:
    """A short digest of the computing code, which also changes between two releases."""
    folder = Path(gspn_framework_package.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(
        path for part in ("analysis", "model") for path in (folder / part).rglob("*.py")
    ):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


def version_difference(theirs: Sequence[Tuple[str, str]], ours: Sequence[Tuple[str, str]]) -> str:
    """The differences between the versions of a worker and the client, in words; empty if there are
    none."""
    mine = dict(ours)
    return ", ".join(
        "%s %s instead of %s" % (name, version, mine.get(name))
        for name, version in theirs
        if mine.get(name) != version
    )


class RemoteExecutor(Executor):
    """Hands tasks to a pool with the interface of ``concurrent.futures``."""

    def map(self, tasks: Sequence[WorkItem], what: str, watch: Watch) -> Iterator[Tuple[int, Any]]:
        """See :meth:`Executor.map`."""
        packed = _Packing()
        waiting: Deque[int] = deque(range(len(tasks)))
        running: Dict[Any, int] = {}
        deaths: Dict[int, int] = {}
        done = 0
        try:
            while waiting or running:
                died = False
                while waiting and len(running) < _AHEAD * self.workers:
                    task = tasks[waiting[0]]
                    try:
                        future = self._submit(packed.of(task.workload), task.piece)
                    except concurrent.futures.BrokenExecutor:
                        died = True
                        break
                    running[future] = waiting.popleft()
                ended, _ = concurrent.futures.wait(
                    running, 0 if died else _LOOK, concurrent.futures.FIRST_COMPLETED
                )
                lost: List[int] = []
                for future in ended:
                    number = running.pop(future)
                    try:
                        with naming(tasks[number]):
                            result = self._result(future)
                    except concurrent.futures.BrokenExecutor:
                        lost.append(number)
                        continue
                    done += tasks[number].size
                    yield number, result
                if lost or died:
                    lost += running.values()
                    running.clear()
                    self._replace(lost, deaths)
                    waiting.extendleft(sorted(lost, reverse=True))
                self._look()
                watch.step(what, done)
        finally:
            if waiting or running:
                self._stop(list(running), packed.ticket)

    def _replace(self, lost: Sequence[int], deaths: Dict[int, int]) -> None:
        """Start the workers again after one died on one of the tasks ``lost``."""
        for number in lost:
            deaths[number] = deaths.get(number, 0) + 1
        if max(deaths.values(), default=0) > _MOST_DEATHS:
            raise WorkersError(
                "workers died %d times on the same task" % (_MOST_DEATHS + 1),
                hint="is there enough memory? Take fewer workers",
            )
        self._restart()

    def _submit(self, packed: Packed, piece: Any) -> Any:
        """Call :func:`work_on` in a worker; returns a future."""
        raise NotImplementedError

    def _result(self, future: Any) -> Any:
        """The result of a finished future; raises what its task raised."""
        return future.result()

    def _restart(self) -> None:
        """Start the workers again after the pool broke."""

    def _look(self) -> None:
        """Raise an error if the workers can no longer be reached."""

    def _stop(self, running: Sequence[Any], ticket: str) -> None:
        """Stop the work on the futures ``running``, even if a worker has started it."""
        raise NotImplementedError


class _Packing:
    """Packs each workload of one computation once."""

    def __init__(self) -> None:
        self.ticket = uuid.uuid4().hex
        self._packed: Dict[int, Tuple[Workload, Packed]] = {}

    def of(self, workload: Workload) -> Packed:
        found = self._packed.get(id(workload))
        if found is None:
            content = pickle.dumps((workload.prepare, workload.work, workload.shared), 4)
            digest = hashlib.sha256(content).hexdigest()
            found = workload, Packed(content, digest, self.ticket, versions())
            self._packed[id(workload)] = found
        return found[1]


# -- in the worker ---------------------------------------------------------------------------------

_kept = threading.local()  # a worker of Dask may have several threads, but prepared data has state
_cancelled: Set[str] = set()


def cancel_work(ticket: str) -> None:
    """Stop this worker's tasks with a ticket."""
    _cancelled.add(ticket)


def work_on(packed: Packed, piece: Any) -> Any:
    """Compute a task in this worker.

    :raises WorkersError: this worker has another version than the client.
    """
    wrong = version_difference(versions(), packed.versions)
    if wrong:
        raise different_versions("a worker", wrong)
    if not hasattr(_kept, "workloads"):
        _kept.workloads = Kept(_PREPARED)

    def unpacked() -> Tuple[Any, Any]:
        prepare, work, shared = pickle.loads(packed.content)
        return work, prepare(shared)

    work, prepared = _kept.workloads.get(packed.digest, unpacked)
    return work(prepared, piece, Watch(cancel=lambda: packed.ticket in _cancelled))


def different_versions(who: str, wrong: str) -> WorkersError:
    """The error for a worker with another version."""
    return WorkersError(
        "%s has %s" % (who, wrong), hint="install the same versions there: results depend on them"
    )
