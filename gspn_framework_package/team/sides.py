"""What the host of a replica needs besides a carrier: somebody who acts, somebody who watches for
events, and a reporter. A robot with ROS has them on ROS, one without in Python."""

from __future__ import annotations

from typing import Any, Callable, Mapping, NamedTuple, Optional, Protocol

from gspn_framework_package.execution.agreement.interface import Input
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.model.plan import Plan

LOOK_AGAIN = 0.01
"""Seconds after which an action side that waits for something is polled again."""


class ActionSide(Protocol):
    """Carries out the actions of one robot, one at a time. The host's worker thread calls all
    methods but :meth:`why_not`."""

    def start(self, command: StartAction, now: float) -> None:
        """Start an action; cancels the previous one if it still runs.

        :param now: the time (monotonic seconds).
        """

    def cancel(self) -> None:
        """Cancel the running action, if any; nothing more is reported about it."""

    def doing(self) -> str:
        """What the current action waits for, in words; "" if it runs or there is none."""

    def poll(self, now: float) -> Optional[float]:
        """Do what is due at ``now`` (monotonic seconds); returns when to call this next, None if no
        time is set."""

    def why_not(self, plan: Plan, present: Plan) -> str:
        """Why the robot cannot act as ``plan`` says; "" if it can. May take some seconds; called on
        a thread of its own.

        :param present: the plan that the robot follows now.
        :raises GspnError: another way to say that it cannot.
        """

    def follow(self, plan: Plan) -> None:
        """From now on start the actions of another plan; the one that is under way goes on.

        :raises GspnError: the robot cannot act as the plan says.
        """

    def close(self) -> None:
        """Cancel the running action, and end all threads."""


class EventSide(Protocol):
    """Watches for the events of one robot, and for tasks, under one plan."""

    def subscribe(self) -> None:
        """Begin to listen to what comes from outside."""

    def start(self) -> None:
        """Start the functions; the host works by now."""

    def visit_began(self) -> None:
        """Ask the functions anew: what they said of the last visit, or of the data then, is out of
        date."""

    def close(self) -> None:
        """End watching."""


class EventListener(NamedTuple):
    """What those who watch for events need of the host; all but ``give`` may be called from any
    thread."""

    enqueue: Callable[..., None]
    """Has the worker thread call a function with arguments."""
    give: Callable[[Input], None]
    """Gives an input to the replica, on the worker thread."""
    watches: Callable[[str], bool]
    """Whether an event could interrupt the robot in its present visit."""
    complain: Callable[[str], None]
    """Reports a fault of a source."""
    data_of: Callable[[str], Mapping[str, Any]] = lambda robot: {}
    """The data that a robot, or "" the team, may read."""


class Reporter(Protocol):
    """Prints lines for people, and says how the robot is."""

    def say(self, text: str) -> None:
        """Print a line."""

    def warn(self, text: str) -> None:
        """Print a warning."""

    def error(self, text: str, traceback: bool = False) -> None:
        """Print an error.

        :param traceback: also print the exception that is being handled.
        """

    def is_asked(self) -> bool:
        """Whether anybody listens to :meth:`diagnose`."""

    def diagnose(self, level: int, message: str, values: Mapping[str, Any]) -> None:
        """Say how the robot is.

        :param level: 0 if all is well, 1 if the robot waits or another one is lost, 2 if it needs
            the operator.
        """
