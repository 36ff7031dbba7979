"""The actions of a robot without ROS: Python functions and commands, run on threads of its
process."""

from __future__ import annotations

from typing import Any, Dict

from gspn_framework_package.execution.local_kinds import (
    load_local_actions,
    refuse_commands,
    refuse_ros,
)
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.host import ReplicaHost
from gspn_framework_package.team.job_runner import JobRunner
from gspn_framework_package.team.jobs import Job, LocalJob

_ALLOW = "gspn agent --allow-commands"

_GIVE_FUNCTIONS = (
    "run this robot with roslaunch, or give it a function for that place ('actions' of the robot)"
)


class FunctionActions(JobRunner):
    """The action side of a robot's host (see :class:`ActionSide`).

    :param plan: the plan with which the robot starts.
    :param allow_commands: whether the plan may run programs.
    :raises PlanError: an action needs ROS, or a function is missing or broken.
    :raises RefusedError: an action is a command, and they are not allowed.
    """

    def __init__(self, host: ReplicaHost, plan: Plan, allow_commands: bool) -> None:
        self._host, self._allow_commands = host, allow_commands
        super().__init__(
            self._jobs_of(plan),
            plan.timeout,
            host.enqueue,
            host.attempt_ended,
            cancel_grace=plan.cancel_grace,
            fault=host.warn,
        )

    def _jobs_of(self, plan: Plan) -> Dict[str, Job]:
        if self._host.robot in plan.witness:
            return {}  # a witness votes, but has no token
        if not self._allow_commands:
            refuse_commands(plan, _ALLOW)
        actions = {place: plan.action(self._host.robot, place) for place in plan.action_places}
        refuse_ros(plan, actions.items(), _GIVE_FUNCTIONS)
        return {
            place: LocalJob(plan, place, actions[place], do, self._feedback)
            for place, do in load_local_actions(plan, self._host.robot).items()
        }

    def _feedback(self, *progress: Any) -> None:
        """The argument ``feedback`` of a function, called on its thread with whole numbers or an
        iterable of them."""
        values = (
            progress[0] if len(progress) == 1 and hasattr(progress[0], "__iter__") else progress
        )
        self._host.enqueue(self._host.attempt_progress, [int(value) for value in values])

    def why_not(self, plan: Plan, present: Plan) -> str:
        """See :class:`ActionSide`."""
        self._jobs_of(plan)
        return ""

    def follow(self, plan: Plan) -> None:
        """See :class:`ActionSide`."""
        self.take_jobs(self._jobs_of(plan), plan.timeout)
