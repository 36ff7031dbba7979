"""The actions of one robot on ROS: goals for action servers, jobs of all other kinds, and the place
servers of this process."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Optional, Set, Tuple

import rospy

from gspn_framework_package.execution.agreement.interface import ActionDone, AttemptFailed
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.local_kinds import refuse_commands
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros import action_kinds
from gspn_framework_package.ros.action_caller import ActionCaller, ActionEnded
from gspn_framework_package.ros.action_targets import action_targets
from gspn_framework_package.ros.goal_id import GoalIdentity
from gspn_framework_package.ros.options import NodeOptions
from gspn_framework_package.ros.place_servers import PlaceServer, PlaceServers
from gspn_framework_package.ros.ros_clock import ROS_CLOCK
from gspn_framework_package.ros.transport.registration import published_topics, registered_together
from gspn_framework_package.team.host import ReplicaHost
from gspn_framework_package.team.job_runner import JobRunner
from gspn_framework_package.team.jobs import Job
from gspn_framework_package.team.patience import earliest

_ALLOW = "~allow_commands, allow_commands:=true"


class RobotActions:
    """The action side of a robot's host (see :class:`ActionSide`).

    :param plan: the plan with which the robot starts.
    :param namespace: absolute namespace of the robot.
    :param options: see :class:`NodeOptions`.
    :raises GspnError: the actions cannot be used.

    :ivar jobs: the robot's actions other than action servers, by place.
    :ivar foreign_servers: the robot's goals for action servers that this process does not serve.
    """

    def __init__(self, host: ReplicaHost, plan: Plan, namespace: str, options: NodeOptions) -> None:
        self._host, self._namespace, self._options = host, namespace, options
        self._robot = robot = host.robot
        # a witness votes, but has no token and runs no actions
        self._witness = robot in plan.witness
        targets = {} if self._witness else action_targets(plan, robot, namespace)
        serves = options.place_servers and not self._witness
        self._servers = PlaceServers(plan, robot, namespace) if serves else None
        served = set(self._servers.names) if self._servers else set()
        self.foreign_servers = [t for t in targets.values() if t.server not in served]
        self.jobs = {} if self._witness else jobs_of(plan, robot, namespace, options)
        self._caller = ActionCaller(
            robot,
            targets,
            plan.timeout,
            host.enqueue,
            self._ended,
            self._feedback,
            options.patience,
            options.max_connections,
            self._own_servers(),
            plan.cancel_grace,
            host.warn,
        )
        open_jobs(self.jobs)
        self._runner = JobRunner(
            self.jobs,
            plan.timeout,
            host.enqueue,
            host.attempt_ended,
            options.patience,
            plan.cancel_grace,
            host.warn,
            ROS_CLOCK,
        )

    def _own_servers(self) -> Optional[Mapping[str, PlaceServer]]:
        """The servers in this process that receive goals directly."""
        if self._servers is None or not self._options.direct_actions:
            return None
        return self._servers.servers

    def serve(self) -> None:
        """Start the place servers, if this process has them."""
        if self._servers is not None:
            self._servers.start()

    def stop_serving(self) -> None:
        """Stop the place servers."""
        if self._servers is not None:
            self._servers.stop()

    def start(self, command: StartAction, now: float) -> None:
        """See :class:`ActionSide`."""
        self.cancel()
        if command.place in self.jobs:
            self._runner.start(command, now)
        else:
            self._caller.start(command, now)

    def cancel(self) -> None:
        """See :class:`ActionSide`."""
        self._caller.cancel()
        self._runner.cancel()

    def doing(self) -> str:
        """See :class:`ActionSide`."""
        return self._caller.doing() or self._runner.doing()

    def poll(self, now: float) -> Optional[float]:
        """See :class:`ActionSide`."""
        return earliest(self._caller.poll(now), self._runner.poll(now))

    def close(self) -> None:
        """See :class:`ActionSide`."""
        self._caller.close()
        self._runner.close()

    def why_not(self, plan: Plan, present: Plan) -> str:
        """See :class:`ActionSide`. Starts servers for functions of the plan."""
        targets = action_targets(plan, self._robot, self._namespace)
        if self._options.check:
            published = action_kinds.live_types(published_topics)
            for clash in filter(None, (t.clash(published) for t in targets.values())):
                return clash
        jobs_of(plan, self._robot, self._namespace, self._options)
        if self._servers is not None:
            self._servers.prepare(plan)
            return ""
        new = sorted(_functions(plan, self._robot) - _functions(present, self._robot))
        if not new:
            return ""
        return (
            "'%s' runs in place servers of another process, which cannot switch plans" % new[0][1]
        )

    def follow(self, plan: Plan) -> None:
        """See :class:`ActionSide`."""
        if self._witness:
            return
        if self._servers is not None:
            self._servers.follow(plan)
        targets = action_targets(plan, self._robot, self._namespace)
        jobs = jobs_of(plan, self._robot, self._namespace, self._options)
        open_jobs(jobs)
        self.jobs = jobs
        self._runner.take_jobs(jobs, plan.timeout)
        self._caller.follow(targets, plan.timeout, self._own_servers())

    def _ended(self, ended: ActionEnded) -> None:
        attempt = ended.identity.age
        if ended.outcome is not Outcome.SUCCEEDED:
            self._host.attempt_ended(AttemptFailed(*attempt, ended.outcome, ended.detail))
        else:
            self._host.attempt_ended(ActionDone(*attempt, ended.result, ended.data))

    def _feedback(self, identity: GoalIdentity, feedback: Any) -> None:
        self._host.attempt_progress(list(getattr(feedback, "time_passed", ())))


def jobs_of(plan: Plan, robot: str, namespace: str, options: NodeOptions) -> Dict[str, Job]:
    """The actions of a robot other than action servers, by place.

    :raises GspnError: an action does not fit its type or the ROS graph, or is not allowed.
    """
    if not options.allow_commands:
        refuse_commands(plan, _ALLOW)
    found = action_kinds.jobs(plan, robot, namespace)
    types = action_kinds.live_types() if found and options.check else {}
    for place, job in found.items():
        clash = job.clash(types) if options.check else None
        if clash:
            raise ExecutionError(clash, file=plan.file, element="action of '%s'" % place)
    return found


def open_jobs(jobs: Mapping[str, Job]) -> None:
    """Register the topics that jobs need with the master, before they start.

    :raises ExecutionError: a topic has two types in this process.
    """
    with registered_together():
        for place, job in jobs.items():
            try:
                job.open()
            except rospy.ROSException as error:
                raise ExecutionError(str(error), element="action of '%s'" % place) from None


def _functions(plan: Plan, robot: str) -> Set[Tuple[str, str]]:
    """(place, function) of every Python action of a robot."""
    bound = ((place, plan.action(robot, place)) for place in plan.action_places)
    return {(place, a.function) for place, a in bound if isinstance(a, FunctionAction)}
