"""The actions of a robot without ROS: Python functions and commands, run on threads of its
process."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Optional

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.local_kinds import (
    LOCAL_KINDS,
    load_local_actions,
    refuse_commands,
)
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.job_runner import AttemptEnd, JobRunner
from gspn_framework_package.team.jobs import Job, LocalJob

_ALLOW = "gspn agent --allow-commands"


class FunctionActions:
    """The action side of a robot's host (see :class:`ActionSide`).

    :param plan: the plan with which the robot starts.
    :param allow_commands: whether the plan may run programs.
    :param enqueue: has the worker thread call ``function(*arguments)`` soon.
    :param ended: called once when an attempt ends.
    :param progress: receives the feedback of the running action, whole numbers.
    :param warn: prints a warning.
    :raises PlanError: an action needs ROS, or a function is missing or broken.
    :raises RefusedError: an action is a command, and they are not allowed.
    """

    def __init__(
        self,
        plan: Plan,
        robot: str,
        allow_commands: bool,
        enqueue: Callable[..., None],
        ended: Callable[[AttemptEnd], None],
        progress: Callable[[List[int]], None],
        warn: Callable[[str], None],
    ) -> None:
        self._robot, self._allow_commands = robot, allow_commands
        self._enqueue, self._progress = enqueue, progress
        self._runner = JobRunner(
            self._jobs_of(plan),
            plan.timeout,
            enqueue,
            ended,
            cancel_grace=plan.cancel_grace,
            fault=warn,
        )

    def _jobs_of(self, plan: Plan) -> Dict[str, Job]:
        if self._robot in plan.witness:
            return {}  # a witness votes, but has no token
        if not self._allow_commands:
            refuse_commands(plan, _ALLOW)
        for place in plan.action_places:
            action = plan.action(self._robot, place)
            if not (action is None or isinstance(action, (FunctionAction, *LOCAL_KINDS))):
                raise PlanError(
                    "its action '%s' needs ROS" % action.label,
                    file=plan.file,
                    element="place '%s'" % place,
                    hint="run this robot with roslaunch, or give it a function for that place "
                    "('actions' of the robot)",
                )
        return {
            place: LocalJob(plan, place, plan.action(self._robot, place), do, self._feedback)
            for place, do in load_local_actions(plan, self._robot).items()
        }

    def _feedback(self, *progress: Any) -> None:
        """The argument ``feedback`` of a function, called on its thread with whole numbers or an
        iterable of them."""
        values = (
            progress[0] if len(progress) == 1 and hasattr(progress[0], "__iter__") else progress
        )
        self._enqueue(self._progress, [int(value) for value in values])

    def start(self, command: StartAction, now: float) -> None:
        """See :class:`ActionSide`."""
        self._runner.start(command, now)

    def cancel(self) -> None:
        """See :class:`ActionSide`."""
        self._runner.cancel()

    def doing(self) -> str:
        """See :class:`ActionSide`."""
        return self._runner.doing()

    def poll(self, now: float) -> Optional[float]:
        """See :class:`ActionSide`."""
        return self._runner.poll(now)

    def why_not(self, plan: Plan, present: Plan) -> str:
        """See :class:`ActionSide`."""
        self._jobs_of(plan)
        return ""

    def follow(self, plan: Plan) -> None:
        """See :class:`ActionSide`."""
        self._runner.follow(self._jobs_of(plan), plan.timeout)

    def close(self) -> None:
        """See :class:`ActionSide`."""
        self._runner.close()
