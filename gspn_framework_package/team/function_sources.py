"""Runs the Python functions that produce a plan's events and tasks, for one robot of a team."""

from __future__ import annotations

import time
from typing import Any, Mapping, Optional

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.interface import EventObserved, TaskCame
from gspn_framework_package.execution.event_functions import EventFunctions, EventHost
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.sides import EventListener

COMPLAIN_EVERY = 60.0
"""Seconds between two reports that the output of a source cannot be used."""


class Complaints:
    """Reports unusable output of a source, at most once in :data:`COMPLAIN_EVERY`."""

    def __init__(self, listener: EventListener, source: str) -> None:
        self._listener, self._source = listener, source
        self._next = 0.0

    def report(self, text: str) -> None:
        """Report a problem, unless one was reported recently."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + COMPLAIN_EVERY
            self._listener.complain("%s: %s" % (self._source, text))


class FunctionSources:
    """Runs the functions for a robot's events and for tasks.

    A function that submits tasks runs in the process of every robot, so it must give them ids.

    :param witness: whether the member is a witness, for which nothing is watched.
    :param listener: the robot's host.
    :param topics: whether topics can be subscribed to; an event with a topic then needs no
        function.
    :raises PlanError: a function is missing or broken.
    """

    def __init__(
        self, plan: Plan, robot: str, witness: bool, listener: EventListener, *, topics: bool
    ) -> None:
        self._robot, self._witness, self._listener = robot, witness, listener
        self._without_id = Complaints(listener, "tasks from a function")
        self._functions = EventFunctions(
            plan,
            EventHost(self._observed, self._submitted, self._function_failed, listener.data_of),
            topics=topics,
        )

    def subscribe(self) -> None:
        """See :class:`EventSide`: functions do not run before :meth:`start`."""

    def start(self) -> None:
        """See :class:`EventSide`."""
        if not self._witness:
            self._functions.watch(self._robot)
            self._functions.watch_tasks()

    def visit_began(self) -> None:
        """See :class:`EventSide`."""
        self._functions.ask_again(self._robot)

    def close(self) -> None:
        """See :class:`EventSide`."""
        self._functions.close()

    # -- calls from the functions, on their threads ------------------------------------------------

    def _observed(
        self, robot: str, transition: str, holds: Optional[bool], cause: Mapping[str, Any]
    ) -> None:
        if holds is not None or self._listener.watches(transition):
            asked = self._functions.round(robot, transition)
            self._listener.enqueue(
                self._hand_over, asked, robot, EventObserved(transition, holds, cause)
            )

    def _hand_over(self, asked: int, robot: str, given: EventObserved) -> None:
        """Pass a function's report to the replica, unless the function was restarted since."""
        if asked == self._functions.round(robot, given.transition):
            self._listener.give(given)

    def _submitted(self, task: log_entries.Submit) -> None:
        if task.id:
            self._listener.enqueue(self._listener.give, TaskCame(task))
        else:
            self._without_id.report(
                "a task has no id; the function runs in the node of every robot and must return an "
                "id with each task"
            )

    def _function_failed(self, robot: str, text: str) -> None:
        self._listener.complain(text)
