"""The base of all executors, and the one that computes in this process.

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
    """The data and functions shared by the tasks of one computation.

    :ivar prepare: a module-level function, called once by each worker, that turns ``shared`` into
        what the tasks need.
    :ivar work: a module-level function, called for each task with the prepared data, the ``piece``
        of the task, and a watch that it checks at intervals for cancellation.
    :ivar shared: plain data: it is sent to the workers, files are not.
    :ivar ready: the result of ``prepare``, if this process has it already.
    """

    prepare: Callable[[Any], Any]
    work: Callable[[Any, Any, Watch], Any]
    shared: Any
    ready: Optional[Any] = None


class WorkItem(NamedTuple):
    """A part of a computation.

    :ivar piece: plain data that identifies the part.
    :ivar size: the contribution to the progress count.
    :ivar name: the subject of its error messages; empty if obvious.
    """

    workload: Workload
    piece: Any
    size: int = 1
    name: str = ""


class Executor:
    """Computes tasks, in any order. Close it after use, or use it as a context manager.

    :ivar name: its name on the command line.
    """

    name = ""

    @property
    def workers(self) -> int:
        """Number of tasks computed at once."""
        return 1

    def map(self, tasks: Sequence[WorkItem], what: str, watch: Watch) -> Iterator[Tuple[int, Any]]:
        """Yield the number of each task with its result, as they end.

        :param what: the unit of the tasks' sizes for the progress, such as ``runs``.
        :param watch: receives the progress, and may stop the work.
        :raises CancelledError: the watch cancelled the work; no worker continues it.
        :raises WorkersError: the workers are not available or died repeatedly.
        :raises GspnError: a task raised it.
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
        """See :meth:`Executor.map`. If a task reports progress itself, that is passed on
        instead."""
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
    """Add to an error the item that it is about."""
    try:
        yield
    except GspnError as error:
        if item.name:
            error.located(element=item.name)
        raise


class _Heard(Watch):
    """Passes on the reports of a task."""

    def __init__(self, watch: Watch) -> None:
        super().__init__()
        self.reports = False
        self._watch = watch

    def cancelled(self) -> bool:
        return self._watch.cancelled()

    def step(self, what: str, count: int) -> None:
        self.reports = True
        self._watch.step(what, count)
