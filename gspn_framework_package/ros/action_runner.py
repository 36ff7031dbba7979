"""Carries out the actions of one robot on ROS: goals for action servers, and jobs."""

from __future__ import annotations

from typing import Any, Mapping, Optional

import rospy

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.action_caller import ActionCaller
from gspn_framework_package.ros.action_targets import ActionTarget
from gspn_framework_package.ros.place_servers import PlaceServer
from gspn_framework_package.ros.transport.registration import registered_together
from gspn_framework_package.team.job_runner import JobRunner
from gspn_framework_package.team.jobs import Job
from gspn_framework_package.team.patience import earliest


def open_jobs(jobs: Mapping[str, Job]) -> None:
    """Register with the master what jobs need before they begin.

    :raises ExecutionError: a topic has two types in this process.
    """
    with registered_together():
        for place, job in jobs.items():
            try:
                job.open()
            except rospy.ROSException as error:
                raise ExecutionError(str(error), element="action of '%s'" % place) from None


class ActionRunner:
    """The actions of one robot, one at a time, of whatever kind.

    :param caller: sends goals to action servers.
    :param runner: does the jobs.
    :param jobs: the places with jobs.
    """

    def __init__(self, caller: ActionCaller, runner: JobRunner, jobs: Mapping[str, Any]) -> None:
        self._caller, self._runner, self._jobs = caller, runner, jobs

    def start(self, command: StartAction, now: float) -> None:
        """Start an action; cancels the previous one if it still runs."""
        self.cancel()
        if command.place in self._jobs:
            self._runner.start(command, now)
        else:
            self._caller.start(command, now)

    def follow(
        self,
        plan: Plan,
        targets: Mapping[str, ActionTarget],
        jobs: Mapping[str, Job],
        own_servers: Optional[Mapping[str, PlaceServer]],
    ) -> None:
        """From now on start the actions of another plan; the one that is under way goes on.

        :raises ExecutionError: see :func:`open_jobs`.
        """
        open_jobs(jobs)
        self._runner.follow(jobs, plan.timeout)
        self._caller.follow(targets, plan.timeout, own_servers)
        self._jobs = jobs

    def cancel(self) -> None:
        """Cancel the running action, if any; nothing more is reported about it."""
        self._caller.cancel()
        self._runner.cancel()

    def close(self) -> None:
        """Cancel the running action, and end all threads."""
        self._caller.close()
        self._runner.close()

    def doing(self) -> str:
        """What the current action waits for, in words; "" if it runs or there is none."""
        return self._caller.doing() or self._runner.doing()

    def poll(self, now: float) -> Optional[float]:
        """Do what is due at ``now`` (monotonic seconds); returns when to call this next, None if no
        time is set."""
        return earliest(self._caller.poll(now), self._runner.poll(now))
