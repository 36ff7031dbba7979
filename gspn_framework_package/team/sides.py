"""The interfaces that a replica's host needs in addition to a carrier: for actions, for events, and
for reports. They are implemented with ROS and in plain Python."""

from __future__ import annotations

from typing import Any, Callable, Mapping, NamedTuple, Optional, Protocol

from gspn_framework_package.execution.agreement.interface import Input
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.model.plan import Plan

LOOK_AGAIN = 0.01
"""Seconds between two polls of an action side that waits for something."""


class ActionSide(Protocol):
    """Carries out the actions of one robot, one at a time. The host's worker thread calls all
    methods but :meth:`why_not`."""

    def start(self, command: StartAction, now: float) -> None:
        """Start an action, cancelling the previous one if it still runs.

        :param now: the time (monotonic seconds).
        """

    def cancel(self) -> None:
        """Cancel the running action, if any; nothing more is reported about it."""

    def doing(self) -> str:
        """What the current action waits for, in words; "" if it is running or there is none."""

    def poll(self, now: float) -> Optional[float]:
        """Do what is due at ``now`` (monotonic seconds). Returns when to call this next; None if no
        time is set."""

    def why_not(self, plan: Plan, present: Plan) -> str:
        """Why the robot cannot carry out ``plan``; "" if it can. May take some seconds; called on a
        separate thread.

        :param present: the plan that the robot follows now.
        :raises GspnError: the robot cannot, for this reason.
        """

    def follow(self, plan: Plan) -> None:
        """Start the actions of another plan from now on; a running action continues.

        :raises GspnError: the robot cannot carry out the plan.
        """

    def close(self) -> None:
        """Cancel the running action, and end all threads."""


class EventSide(Protocol):
    """Watches for the events of one robot, and for tasks, under one plan."""

    def subscribe(self) -> None:
        """Subscribe to the sources of events."""

    def start(self) -> None:
        """Start the functions; called once the host is running."""

    def visit_began(self) -> None:
        """Restart the functions: their reports on the last visit, and on its data, are out of
        date."""

    def close(self) -> None:
        """Stop watching."""


class EventListener(NamedTuple):
    """The interface of the host for sources of events; all but ``give`` may be called from any
    thread."""

    enqueue: Callable[..., None]
    """Has the worker thread call a function with arguments."""
    give: Callable[[Input], None]
    """Gives an input to the replica, on the worker thread."""
    watches: Callable[[str], bool]
    """Whether an event could interrupt the robot in its present visit."""
    complain: Callable[[str], None]
    """Reports an error of a source."""
    data_of: Callable[[str], Mapping[str, Any]] = lambda robot: {}
    """Returns the data that a robot ("" for the team) may read."""


class Reporter(Protocol):
    """Prints lines for people, and publishes the robot's diagnosis."""

    def say(self, text: str) -> None:
        """Print a line."""

    def warn(self, text: str) -> None:
        """Print a warning."""

    def error(self, text: str, traceback: bool = False) -> None:
        """Print an error.

        :param traceback: also print the exception that is being handled.
        """

    def is_asked(self) -> bool:
        """Whether anybody receives the reports of :meth:`diagnose`."""

    def diagnose(self, level: int, message: str, values: Mapping[str, Any]) -> None:
        """Publish the robot's diagnosis.

        :param level: 0 if all is well, 1 if the robot waits or another one is lost, 2 if it needs
            the operator.
        """
