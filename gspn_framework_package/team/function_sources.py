"""The Python functions that a plan's events and tasks come from, watched for one robot of a
team."""

from __future__ import annotations

import time
from typing import Any, Mapping, Optional

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.interface import EventObserved, TaskCame
from gspn_framework_package.execution.event_functions import EventFunctions, EventHost
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.sides import EventListener

COMPLAIN_EVERY = 60.0
"""Seconds between two reports that what one source says cannot be used."""


class Complaints:
    """Reports that what a source says cannot be used, once in :data:`COMPLAIN_EVERY`."""

    def __init__(self, listener: EventListener, source: str) -> None:
        self._listener, self._source = listener, source
        self._next = 0.0

    def report(self, text: str) -> None:
        """Report it, unless that was done lately."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + COMPLAIN_EVERY
            self._listener.complain("%s: %s" % (self._source, text))


class FunctionSources:
    """Watches the functions of a robot's events and of the tasks.

    A function that lets tasks in runs in the process of every robot, so it has to give them ids.

    :param witness: whether there is no robot, so that nothing is watched.
    :param listener: the robot's host.
    :param topics: whether topics can be subscribed to: an event with a topic then needs no
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
        """See :class:`EventSide`: functions wait until they are started."""

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

    # -- what functions report, on their threads ---------------------------------------------------

    def _observed(
        self, robot: str, transition: str, holds: Optional[bool], cause: Mapping[str, Any]
    ) -> None:
        if holds is not None or self._listener.watches(transition):
            asked = self._functions.round(robot, transition)
            self._listener.enqueue(
                self._hand_over, asked, robot, EventObserved(transition, holds, cause)
            )

    def _hand_over(self, asked: int, robot: str, given: EventObserved) -> None:
        """Give the replica what a function said, unless it was asked anew since."""
        if asked == self._functions.round(robot, given.transition):
            self._listener.give(given)

    def _submitted(self, task: log_entries.Submit) -> None:
        if task.id:
            self._listener.enqueue(self._listener.give, TaskCame(task))
        else:
            self._without_id.report(
                "a task has no id: the function runs in the node of every robot, so it has to "
                "return an id with each task"
            )

    def _function_failed(self, robot: str, text: str) -> None:
        self._listener.complain(text)
