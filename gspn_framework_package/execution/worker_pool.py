"""A pool of threads created on demand, for actions that may run indefinitely."""

from __future__ import annotations

import queue
import threading
from typing import Callable, Optional

Work = Callable[[], None]


class WorkerPool:
    """Runs each task immediately, on an idle thread or a new one (thesis 7.2.1).

    Its threads are daemons, so, unlike with ``concurrent.futures``, a function that never returns
    does not keep the process from exiting. An idle thread ends after ``idle_seconds``. A task must
    not raise.
    """

    def __init__(self, name: str = "worker", idle_seconds: float = 10.0) -> None:
        self._name = name
        self._idle_seconds = idle_seconds
        self._lock = threading.Lock()
        self._idle = 0
        self._tasks: queue.SimpleQueue[Optional[Work]] = queue.SimpleQueue()
        self._made = 0

    def submit(self, task: Work) -> None:
        """Run ``task`` now, on its own thread."""
        with self._lock:
            if self._idle > 0:
                self._idle -= 1
                self._tasks.put(task)
                return
            self._made += 1
            name = "%s-%d" % (self._name, self._made)
        threading.Thread(target=self._work, args=(task,), name=name, daemon=True).start()

    def _work(self, task: Optional[Work]) -> None:
        while task is not None:
            task()
            with self._lock:
                self._idle += 1
            task = self._next()

    def _next(self) -> Optional[Work]:
        try:
            return self._tasks.get(timeout=self._idle_seconds)
        except queue.Empty:
            pass
        with self._lock:
            if self._idle > 0:
                self._idle -= 1
                return None
        # every idle thread is reserved, including this one: its task is about to arrive
        return self._tasks.get()
