"""One robot of a team without ROS: the host of its replica, with actions and events that are Python
functions."""

from __future__ import annotations

import sys
from typing import Any, Callable, Mapping

from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.carrier import Carrier
from gspn_framework_package.team.function_actions import FunctionActions
from gspn_framework_package.team.function_sources import FunctionSources
from gspn_framework_package.team.host import HostOptions, ReplicaHost
from gspn_framework_package.team.sides import Voice


def make_agent(
    plan: Plan,
    robot: str,
    options: HostOptions,
    voice: Voice,
    carrier: Callable[[ReplicaHost], Carrier],
    allow_commands: bool = False,
) -> ReplicaHost:
    """The host of a robot without ROS, ready to be started.

    :param plan: the checked plan, with the team that begins the run.
    :param carrier: makes the carrier of the robot's messages.
    :param allow_commands: whether the plan may run programs.
    :raises GspnError: an action needs ROS, the log cannot be used, or nobody can be reached.
    """
    witness = robot in plan.witness
    host = ReplicaHost(
        plan,
        robot,
        options,
        voice,
        lambda plan, listener: FunctionSources(plan, robot, witness, listener, topics=False),
    )
    actions = FunctionActions(
        plan,
        robot,
        allow_commands,
        host.enqueue,
        host.attempt_ended,
        host.attempt_progress,
        host.warn,
    )
    host.connect(carrier(host), actions)
    return host


class PrintedVoice:
    """The voice of a robot on a terminal (see :class:`Voice`): lines on standard error.

    :param robot: name of the robot.
    :param quiet: whether only warnings and errors are printed.
    """

    def __init__(self, robot: str, quiet: bool = False) -> None:
        self._robot, self._quiet = robot, quiet

    def say(self, text: str) -> None:
        """See :class:`Voice`."""
        if not self._quiet:
            self._print(text)

    def warn(self, text: str) -> None:
        """See :class:`Voice`."""
        self._print("warning: " + text)

    def error(self, text: str, traceback: bool = False) -> None:
        """See :class:`Voice`."""
        error = sys.exc_info()[1] if traceback else None
        cause = "" if error is None else " (%s: %s)" % (type(error).__name__, error)
        self._print("error: %s%s" % (text, cause))

    def is_asked(self) -> bool:
        """See :class:`Voice`: nobody is there who would listen to diagnoses."""
        return False

    def diagnose(self, level: int, message: str, values: Mapping[str, Any]) -> None:
        """See :class:`Voice`."""

    def _print(self, text: str) -> None:
        print("%s: %s" % (self._robot, text), file=sys.stderr, flush=True)
