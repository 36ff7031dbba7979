"""What drives an action caller or a job runner in a test, as the worker of an execution node does."""

import queue
import threading
import time

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.patience import Patience

PATIENT = Patience(server=20, acknowledgement=20, status=20, result=20)


def plan_in(folder, actions, **more):
    """A plan with a place for each action, and its functions in ``folder``."""
    net = NetBuilder()
    for place in actions:
        net.place(place)
    return Plan(net.build(), actions=actions, folder=folder, **more)


class Worker:
    """A thread that polls ``driven`` and carries out the tasks that are put: a function, and its
    arguments."""

    def __init__(self):
        self.driven = None
        self._tasks = queue.SimpleQueue()

    def put(self, *task):
        self._tasks.put(task)

    def drive(self, driven):
        """Begin. ``driven`` has ``poll`` and ``close``."""
        self.driven = driven
        threading.Thread(target=self._work, daemon=True).start()

    def close(self):
        self.put(self.driven.close)
        self.put(None)

    def _work(self):
        while True:
            due = self.driven.poll(time.monotonic())
            wait = None if due is None else max(0.0, due - time.monotonic())
            try:
                function, *arguments = self._tasks.get(timeout=wait)
            except queue.Empty:
                continue
            if function is None:
                return
            function(*arguments)
