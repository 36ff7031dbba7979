"""A robot without ROS: the host of its replica, with Python functions as actions and events."""

from __future__ import annotations

import contextlib
import json
import sys
import threading
from typing import Any, Callable, Mapping, Tuple

from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.carrier import Carrier
from gspn_framework_package.team.function_actions import FunctionActions
from gspn_framework_package.team.function_sources import FunctionSources
from gspn_framework_package.team.host import HostOptions, ReplicaHost
from gspn_framework_package.team.sides import Reporter


def make_agent(
    plan: Plan,
    robot: str,
    options: HostOptions,
    reporter: Reporter,
    carrier: Callable[[ReplicaHost], Carrier],
    allow_commands: bool = False,
) -> ReplicaHost:
    """Create the host of a robot without ROS, ready to start.

    :param plan: the checked plan, with the team at the start of the run.
    :param carrier: creates the carrier of the robot's messages.
    :param allow_commands: whether the plan may run programs.
    :raises GspnError: an action needs ROS, the log cannot be used, or no other process can be
        reached.
    """
    witness = robot in plan.witness
    host = ReplicaHost(
        plan,
        robot,
        options,
        reporter,
        lambda plan, listener: FunctionSources(plan, robot, witness, listener, topics=False),
    )
    with contextlib.ExitStack() as undo:
        undo.callback(host.discard)
        actions = FunctionActions(host, plan, allow_commands)
        undo.callback(actions.close)
        host.connect(carrier(host), actions)
        undo.pop_all()
    return host


class PrintedReporter:
    """A :class:`Reporter` that prints a robot's messages to standard error, for a terminal.

    :param quiet: whether only warnings and errors are printed.
    """

    def __init__(self, robot: str, quiet: bool = False) -> None:
        self._robot, self._quiet = robot, quiet

    def say(self, text: str) -> None:
        """See :class:`Reporter`."""
        if not self._quiet:
            self._print(text)

    def warn(self, text: str) -> None:
        """See :class:`Reporter`."""
        self._print("warning: " + text)

    def error(self, text: str, traceback: bool = False) -> None:
        """See :class:`Reporter`."""
        self._print("error: " + text + _cause(traceback))

    def is_asked(self) -> bool:
        """See :class:`Reporter`: nothing reads diagnoses here."""
        return False

    def diagnose(self, level: int, message: str, values: Mapping[str, Any]) -> None:
        """See :class:`Reporter`."""

    def _print(self, text: str) -> None:
        print("%s: %s" % (self._robot, text), file=sys.stderr, flush=True)


class JsonReporter:
    """A :class:`Reporter` for programs: prints a JSON object per line to standard output. Its key
    ``event`` is ``say``, ``warning`` or ``error``, with a ``text``, or ``diagnosis``, with the
    values that a robot publishes for diagnostics, printed whenever they change."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._lock = threading.Lock()
        self._last: Tuple[int, str] = (-1, "")

    def say(self, text: str) -> None:
        """See :class:`Reporter`."""
        self.write("say", text=text)

    def warn(self, text: str) -> None:
        """See :class:`Reporter`."""
        self.write("warning", text=text)

    def error(self, text: str, traceback: bool = False) -> None:
        """See :class:`Reporter`."""
        self.write("error", text=text + _cause(traceback))

    def is_asked(self) -> bool:
        """See :class:`Reporter`."""
        return True

    def diagnose(self, level: int, message: str, values: Mapping[str, Any]) -> None:
        """See :class:`Reporter`."""
        if (level, message) != self._last:
            self._last = (level, message)
            self.write("diagnosis", level=level, message=message, values=dict(values))

    def write(self, event: str, **more: Any) -> None:
        """Print a line about the robot.

        :param event: what kind of line.
        :param more: the other keys.
        """
        with self._lock:
            print(json.dumps({"event": event, "robot": self._robot, **more}), flush=True)


def _cause(traceback: bool) -> str:
    """The exception that is being handled, for the end of a line, if it is wanted."""
    error = sys.exc_info()[1] if traceback else None
    return "" if error is None else " (%s: %s)" % (type(error).__name__, error)
