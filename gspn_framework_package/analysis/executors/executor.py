"""What executors have in common, and the one that computes in this process.

>>> def squared(prepared, piece, watch):
...     return prepared * piece**2
>>> workload = Workload(prepare=float, work=squared, shared="2")
>>> with LocalExecutor() as executor:
...     executor.ordered([WorkItem(workload, n) for n in (1, 2, 3)], "squares", Watch())
[2.0, 8.0, 18.0]
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Callable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import GspnError


@dataclass
class Workload:
    """What the tasks of one computation share.

    :ivar prepare: a function of a module, called once by each worker: makes of ``shared`` what the
        tasks need.
    :ivar work: a function of a module, called for each task with what is prepared, the ``piece`` of
        the task, and a watch, of which it asks now and then whether the work was cancelled.
    :ivar shared: plain data: it travels to the workers, files do not.
    :ivar ready: what ``prepare`` would return, if this process has it already.
    """

    prepare: Callable[[Any], Any]
    work: Callable[[Any, Any, Watch], Any]
    shared: Any
    ready: Optional[Any] = None


class WorkItem(NamedTuple):
    """A part of a computation.

    :ivar piece: plain data that says which part.
    :ivar size: how much of what is counted for the progress this is.
    :ivar name: what an error that it raises is about; empty if that needs no word.
    """

    workload: Workload
    piece: Any
    size: int = 1
    name: str = ""


class Executor:
    """Computes tasks, in any order. To be closed, or used as a context manager.

    :ivar name: as it is chosen on the command line.
    """

    name = ""

    @property
    def workers(self) -> int:
        """How many tasks are computed at once."""
        return 1

    def map(self, tasks: Sequence[WorkItem], what: str, watch: Watch) -> Iterator[Tuple[int, Any]]:
        """Yield the number of each task with its result, as they end.

        :param what: what the sizes of the tasks count, for the progress: ``runs``.
        :param watch: receives the progress, and is asked whether to stop.
        :raises CancelledError: the watch cancelled the work; no worker goes on with it.
        :raises WorkersError: the workers cannot be had, or died again and again.
        :raises GspnError: what a task raised.
        """
        raise NotImplementedError

    def ordered(self, tasks: Sequence[WorkItem], what: str, watch: Watch) -> List[Any]:
        """The results in the order of the tasks; see :meth:`map`."""
        found = dict(self.map(tasks, what, watch))
        return [found[number] for number in range(len(tasks))]

    def close(self) -> None:
        """End the workers that were started for this executor."""

    def __enter__(self) -> Executor:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


class LocalExecutor(Executor):
    """Computes one task after the other in this process."""

    name = "local"

    def map(self, tasks: Sequence[WorkItem], what: str, watch: Watch) -> Iterator[Tuple[int, Any]]:
        """See :meth:`Executor.map`. A task that reports progress itself is heard instead."""
        heard = _Heard(watch)
        workload, ready = None, None
        done = 0
        for number, task in enumerate(tasks):
            with naming(task):
                if task.workload is not workload:
                    workload = task.workload
                    ready = workload.ready
                    if ready is None:
                        ready = workload.prepare(workload.shared)
                result = task.workload.work(ready, task.piece, heard)
            yield number, result
            done += task.size
            if not heard.reports:
                watch.step(what, done)


@contextmanager
def naming(item: WorkItem) -> Iterator[None]:
    """Say in an error which item it is about."""
    try:
        yield
    except GspnError as error:
        if item.name:
            error.located(element=item.name)
        raise


class _Heard(Watch):
    """Passes on what a task reports."""

    def __init__(self, watch: Watch) -> None:
        super().__init__()
        self.reports = False
        self._watch = watch

    def cancelled(self) -> bool:
        return self._watch.cancelled()

    def step(self, what: str, count: int) -> None:
        self.reports = True
        self._watch.step(what, count)
