"""Threads made on demand, for actions that run for as long as they like."""

from __future__ import annotations

import queue
import threading
from typing import Callable, Optional

Task = Callable[[], None]


class WorkerPool:
    """Runs tasks, each at once: on an idle thread, or on a new one (thesis 7.2.1).

    Its threads are daemons, since a function that never returns must not keep the process from
    ending (those of ``concurrent.futures`` do). An idle thread ends after ``idle_seconds``.
    A task must not raise.
    """

    def __init__(self, name: str = "worker", idle_seconds: float = 10.0) -> None:
        self._name = name
        self._idle_seconds = idle_seconds
        self._lock = threading.Lock()
        self._idle = 0
        self._tasks: queue.SimpleQueue[Optional[Task]] = queue.SimpleQueue()
        self._made = 0

    def submit(self, task: Task) -> None:
        """Run ``task`` now, on a thread of its own."""
        with self._lock:
            if self._idle > 0:
                self._idle -= 1
                self._tasks.put(task)
                return
            self._made += 1
            name = "%s-%d" % (self._name, self._made)
        threading.Thread(target=self._work, args=(task,), name=name, daemon=True).start()

    def _work(self, task: Optional[Task]) -> None:
        while task is not None:
            task()
            with self._lock:
                self._idle += 1
            task = self._next()

    def _next(self) -> Optional[Task]:
        try:
            return self._tasks.get(timeout=self._idle_seconds)
        except queue.Empty:
            pass
        with self._lock:
            if self._idle > 0:
                self._idle -= 1
                return None
        # every idle thread is spoken for, this one too: its task is on the way
        return self._tasks.get()
