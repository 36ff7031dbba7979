"""Runs the jobs of one robot, one at a time, each on its own thread."""

from __future__ import annotations

import time
from collections import deque
from functools import partial
from typing import Callable, Deque, Mapping, NamedTuple, Optional, Union

from gspn_framework_package.execution.agreement.interface import ActionDone, AttemptFailed
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.model.errors import DataError, PlanError
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.clock import MACHINE_CLOCK, Clock
from gspn_framework_package.team.jobs import Job, JobAttempt, JobEnd, attempt_job
from gspn_framework_package.team.patience import DEFAULT_PATIENCE, Patience, earliest

ENDING_TIME = 1.0
"""Seconds that a cancelled job has to end before its host ends."""

AttemptEnd = Union[ActionDone, AttemptFailed]
"""How an attempt ended, in the form that the replica expects."""


class _Running:
    """A job under way; it begins at ``start_at`` (seconds of the runner's clock)."""

    def __init__(self, job: Job, attempt: JobAttempt, start_at: float) -> None:
        self.job, self.attempt = job, attempt
        self.start_at = start_at
        self.started = self.over = False


class _Cancelled(NamedTuple):
    running: _Running
    report_at: float


class JobRunner:
    """All methods belong to the worker thread of the robot's host; see :class:`ActionSide`.

    :param jobs: the jobs of the robot by place; they are open.
    :param timeout: place -> seconds that its job may take, or None.
    :param enqueue: has the worker thread call ``function(*arguments)`` soon.
    :param ended: called once when an attempt ends.
    :param patience: how long each step may take.
    :param cancel_grace: seconds that a job has to end after it was cancelled.
    :param fault: receives the text of a fault if a job does not end in that time.
    :param clock: the clock that the plan's times refer to.
    """

    def __init__(
        self,
        jobs: Mapping[str, Job],
        timeout: Callable[[str], Optional[float]],
        enqueue: Callable[..., None],
        ended: Callable[[AttemptEnd], None],
        patience: Patience = DEFAULT_PATIENCE,
        cancel_grace: float = Plan.cancel_grace,
        fault: Callable[[str], None] = lambda text: None,
        clock: Clock = MACHINE_CLOCK,
    ) -> None:
        self._jobs, self._timeout = jobs, timeout
        self._enqueue, self._ended, self._fault = enqueue, ended, fault
        self._patience, self._cancel_grace = patience, cancel_grace
        self._clock = clock
        self._pool = WorkerPool("job")
        self._current: Optional[_Running] = None
        self._cancelled: Deque[_Cancelled] = deque()

    def take_jobs(self, jobs: Mapping[str, Job], timeout: Callable[[str], Optional[float]]) -> None:
        """Run the jobs of another plan from now on; a running job continues."""
        self._jobs, self._timeout = jobs, timeout

    def start(self, command: StartAction, now: float) -> None:
        """Start a job, cancelling the previous one if it still runs."""
        self.cancel()
        look = partial(self._enqueue, self._look)
        has_timeout = self._timeout(command.place) is not None
        attempt = JobAttempt(command, self._patience, look, self._clock, has_timeout)
        job = self._jobs[command.place]
        self._current = _Running(job, attempt, self._clock.seconds() + command.delay)
        self.poll(now)

    def cancel(self) -> None:
        """Cancel the running job, if any. Nothing more is reported about it unless it fails to
        end."""
        running, self._current = self._current, None
        if running is not None:
            self._stop(running)

    def close(self) -> None:
        """Cancel the running job, and give it some time to end."""
        running = self._current
        self.cancel()
        give_up = time.monotonic() + ENDING_TIME
        while running is not None and running.started and not running.over:
            if time.monotonic() > give_up:
                return
            time.sleep(0.01)

    def doing(self) -> str:
        """What the current job waits for, in words; "" if it waits for nothing or there is no
        job."""
        running = self._current
        if running is None:
            return ""
        standing = self._clock.stands()
        if standing:
            return standing
        if not running.started:
            return "waits before attempt %d" % running.attempt.command.attempt
        return running.attempt.waits_for

    def poll(self, now: float) -> Optional[float]:
        """See :class:`ActionSide`."""
        return earliest(self._poll_job(now), self._poll_cancelled(now))

    def _poll_job(self, now: float) -> Optional[float]:
        running = self._current
        if running is None:
            return None
        if not running.started:
            if self._clock.seconds() < running.start_at:
                return self._clock.look_at(running.start_at, now)
            self._begin(running)
            return self._poll_job(now)
        seconds = self._timeout(running.job.place)
        if seconds is None or running.attempt.begun_at is None:
            return None
        cut_off_at = running.attempt.begun_at + seconds
        if self._clock.seconds() < cut_off_at:
            return self._clock.look_at(cut_off_at, now)
        self._stop(running)
        text = "the action took longer than %g s (timeout in the plan)"
        self._report(running, JobEnd(Outcome.TIMEOUT, text % seconds))
        return None

    def _poll_cancelled(self, now: float) -> Optional[float]:
        while self._cancelled and (
            now >= self._cancelled[0].report_at or self._cancelled[0].running.over
        ):
            running = self._cancelled.popleft().running
            if not running.over:
                self._fault(
                    "%s in %s has not ended, %g s after it was cancelled (cancel_grace in the plan)"
                    % (running.job.action.label, running.job.place, self._cancel_grace)
                )
        return self._cancelled[0].report_at if self._cancelled else None

    def _begin(self, running: _Running) -> None:
        try:
            prepared = running.job.prepare(running.attempt.command.data)
        except (DataError, PlanError) as error:
            self._report(running, JobEnd(Outcome.ABORTED, error.message))
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
            self._report(
                running, JobEnd(Outcome.ABORTED, "the action cannot be started: %s" % error)
            )

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
        command = running.attempt.command
        attempt = command.incarnation, command.visit, command.attempt
        if transition is None:
            self._ended(AttemptFailed(*attempt, end.outcome, end.text))
        else:
            self._ended(ActionDone(*attempt, transition, end.data))

    def _look(self) -> None:
        self.poll(time.monotonic())
