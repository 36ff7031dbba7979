"""Carries out the actions of one robot: goals for action servers, and jobs of all other kinds."""

from __future__ import annotations

import time
from collections import deque
from typing import Any, Callable, Deque, Mapping, NamedTuple, Optional

import rospy

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.model.errors import DataError, ExecutionError, PlanError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.action_caller import ActionCaller, ActionEnded
from gspn_framework_package.ros.action_kinds import Job, JobAttempt, JobEnd, attempt_job
from gspn_framework_package.ros.action_targets import ActionTarget
from gspn_framework_package.ros.goal_id import GoalIdentity
from gspn_framework_package.ros.patience import DEFAULT_PATIENCE, Patience, earliest
from gspn_framework_package.ros.place_servers import PlaceServer
from gspn_framework_package.ros.transport.registration import registered_together

LAST_WORDS = 1.0
"""Seconds that a job which is cancelled has to end before its node does."""


class _Running:
    """A job under way; it begins at ``start_at`` (monotonic seconds)."""

    def __init__(
        self, job: Job, attempt: JobAttempt, identity: GoalIdentity, start_at: float
    ) -> None:
        self.job, self.attempt, self.identity = job, attempt, identity
        self.start_at = start_at
        self.started = self.over = False


class _Cancelled(NamedTuple):
    running: _Running
    report_at: float


class JobRunner:
    """Has the interface of :class:`ActionCaller`, for jobs. All methods belong to the node's worker
    thread; each job runs on a thread of its own.

    :param robot: name of the robot.
    :param jobs: its jobs by place.
    :param timeout: see :class:`ActionCaller`, like all that follow.
    :raises ExecutionError: a topic has two types in this process.
    """

    def __init__(
        self,
        robot: str,
        jobs: Mapping[str, Job],
        timeout: Callable[[str], Optional[float]],
        enqueue: Callable[..., None],
        ended: Callable[[ActionEnded], None],
        patience: Patience = DEFAULT_PATIENCE,
        cancel_grace: float = Plan.cancel_grace,
        fault: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._robot, self._jobs, self._timeout = robot, jobs, timeout
        self._enqueue, self._ended, self._fault = enqueue, ended, fault
        self._patience, self._cancel_grace = patience, cancel_grace
        self._pool = WorkerPool("job")
        self._current: Optional[_Running] = None
        self._cancelled: Deque[_Cancelled] = deque()
        _open(jobs)

    def follow(self, jobs: Mapping[str, Job], timeout: Callable[[str], Optional[float]]) -> None:
        """From now on do the jobs of another plan; one that is under way goes on.

        :raises ExecutionError: a topic has two types in this process.
        """
        _open(jobs)
        self._jobs, self._timeout = jobs, timeout

    def start(self, command: StartAction, now: float) -> None:
        """Start a job; cancels the previous one if it still runs."""
        self.cancel()
        identity = GoalIdentity(
            self._robot, command.incarnation, command.visit, command.attempt, ""
        )
        attempt = JobAttempt(command, self._patience, lambda: self._enqueue(self._look))
        job = self._jobs[command.place]
        self._current = _Running(job, attempt, identity, now + command.delay)
        self.poll(now)

    def cancel(self) -> None:
        """Cancel the running job, if any; nothing more is reported about it, unless it does not
        end."""
        running, self._current = self._current, None
        if running is not None:
            self._stop(running)

    def close(self) -> None:
        """Cancel the running job, and give it a moment to end."""
        running = self._current
        self.cancel()
        give_up = time.monotonic() + LAST_WORDS
        while running is not None and running.started and not running.over:
            if time.monotonic() > give_up:
                return
            time.sleep(0.01)

    def doing(self) -> str:
        """What the current job waits for, in words; "" if nothing, or if there is none."""
        running = self._current
        if running is None:
            return ""
        if not running.started:
            return "waits before attempt %d" % running.attempt.command.attempt
        return running.attempt.waits_for

    def poll(self, now: float) -> Optional[float]:
        """See :meth:`ActionCaller.poll`."""
        return earliest(self._poll_job(now), self._poll_cancelled(now))

    def _poll_job(self, now: float) -> Optional[float]:
        running = self._current
        if running is None:
            return None
        if not running.started:
            if now < running.start_at:
                return running.start_at
            self._begin(running)
            return self._poll_job(now)
        seconds = self._timeout(running.job.place)
        if seconds is None or running.attempt.begun_at is None:
            return None
        cut_off_at = running.attempt.begun_at + seconds
        if now < cut_off_at:
            return cut_off_at
        self._stop(running)
        self._report(running, JobEnd("timeout", "it took longer than %g s" % seconds))
        return None

    def _poll_cancelled(self, now: float) -> Optional[float]:
        while self._cancelled and (
            now >= self._cancelled[0].report_at or self._cancelled[0].running.over
        ):
            running = self._cancelled.popleft().running
            if not running.over:
                self._fault(
                    "%s in %s has not ended, %g s after it was cancelled"
                    % (running.job.action.label, running.job.place, self._cancel_grace)
                )
        return self._cancelled[0].report_at if self._cancelled else None

    def _begin(self, running: _Running) -> None:
        try:
            prepared = running.job.prepare(running.attempt.command.data)
        except (DataError, PlanError) as error:
            self._report(running, JobEnd("aborted", error.message))
            return
        running.started = True

        def run() -> None:
            end = attempt_job(running.job, prepared, running.attempt)
            running.over = True
            self._enqueue(self._came_to_its_end, running, end)

        try:
            self._pool.submit(run)
        except RuntimeError as error:  # the system cannot create another thread
            running.over = True
            self._report(running, JobEnd("aborted", "the action cannot be started: %s" % error))

    def _stop(self, running: _Running) -> None:
        running.attempt.is_cancelled.cancel()
        if running.started:
            report_at = time.monotonic() + self._cancel_grace
            self._cancelled.append(_Cancelled(running, report_at))

    def _came_to_its_end(self, running: _Running, end: JobEnd) -> None:
        if running is self._current:
            self._report(running, end)

    def _report(self, running: _Running, end: JobEnd) -> None:
        self._current = None
        transition = running.job.transition_of(end)
        if transition is None:
            self._ended(ActionEnded(running.identity, "", end.outcome, end.text))
        else:
            self._ended(ActionEnded(running.identity, transition, data=end.data))

    def _look(self) -> None:
        self.poll(time.monotonic())


def _open(jobs: Mapping[str, Job]) -> None:
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

        :raises ExecutionError: see :meth:`JobRunner.follow`.
        """
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
