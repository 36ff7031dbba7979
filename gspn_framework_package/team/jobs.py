"""Actions that run on threads of the robot's process: Python functions, commands, and on ROS all
kinds other than action servers."""

from __future__ import annotations

from typing import Any, Callable, Mapping, NamedTuple, Optional

from gspn_framework_package.execution.actions import (
    ActionContext,
    ActionFailed,
    Cancellation,
    error_text,
    no_feedback,
)
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.local_kinds import LocalAction
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.model.action import outcomes_of
from gspn_framework_package.model.errors import DataError
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.clock import MACHINE_CLOCK, Clock
from gspn_framework_package.team.patience import Patience


class JobEnd(NamedTuple):
    """How an attempt ended: an ``outcome`` that the plan maps to a transition is not a failure."""

    outcome: Outcome
    text: str = ""
    transition: str = ""
    """The transition that the action named, if any."""
    data: Mapping[str, Any] = NOTHING


CANCELLED = JobEnd(Outcome.PREEMPTED, "cancelled")


class JobAttempt:
    """An attempt at a job, as seen by the thread that runs it.

    :param command: what to do.
    :param patience: how long each step may take.
    :param changed: called when the attempt reports something new.
    :param clock: the clock that times the action.
    :param has_timeout: report, too, when the action itself begins.
    """

    def __init__(
        self,
        command: StartAction,
        patience: Patience,
        changed: Callable[[], None],
        clock: Clock = MACHINE_CLOCK,
        has_timeout: bool = False,
    ) -> None:
        self.command, self.patience = command, patience
        self.is_cancelled = Cancellation()
        self.waits_for = ""
        self.begun_at: Optional[float] = None
        """When the action itself began, in seconds of its clock; its timeout counts from here."""
        self._changed, self._clock, self._has_timeout = changed, clock, has_timeout

    def wait_for(self, what: str) -> None:
        """Report what the attempt waits for; "" if only for its own end."""
        self.waits_for = what
        self._changed()

    def begin(self) -> None:
        """Note that the action itself begins."""
        self.begun_at = self._clock.seconds()
        if self._has_timeout:
            self._changed()


class Job:
    """An action of one robot in one place that runs on a thread of the robot's process.

    :param action: the action, of the kind that this class handles.
    """

    def __init__(self, place: str, action: Any) -> None:
        self.place, self.action = place, action
        self.outcomes: Mapping[str, str] = outcomes_of(action)

    def open(self) -> None:
        """Set up what has to exist before the action starts."""

    def clash(self, types: Mapping[str, str]) -> Optional[str]:
        """How the system contradicts the plan; None if it does not. Called before :meth:`open`.

        :param types: topic -> type of its messages, if there are topics.
        """
        return None

    def missing(self) -> Optional[str]:
        """What this action needs that does not exist yet; None if nothing is missing."""
        return None

    def prepare(self, data: Mapping[str, Any]) -> Any:
        """The request to send, with data filled in.

        :raises DataError: data is missing.
        :raises PlanError: data does not fit.
        """

    def run(self, prepared: Any, attempt: JobAttempt) -> JobEnd:
        """Carry the action out, on its own thread; returns soon after it is cancelled.

        :raises ActionFailed: the action did not succeed.
        :raises DataError: the data that the action wrote cannot be stored.
        """
        raise NotImplementedError

    def transition_of(self, end: JobEnd) -> Optional[str]:
        """The transition that an end selects; "" to let the policy decide, None for a failure."""
        if end.outcome == Outcome.SUCCEEDED and end.transition:
            return end.transition
        return self.outcomes.get(end.outcome, "" if end.outcome == Outcome.SUCCEEDED else None)


class LocalJob(Job):
    """A Python function, or an action of another kind that needs no ROS.

    :param do: carries out the action.
    :param feedback: receives its progress, on the action's thread.
    """

    def __init__(
        self,
        plan: Plan,
        place: str,
        action: Any,
        do: LocalAction,
        feedback: Callable[..., None] = no_feedback,
    ) -> None:
        super().__init__(place, action)
        self._plan, self._do, self._feedback = plan, do, feedback

    def run(self, prepared: Any, attempt: JobAttempt) -> JobEnd:
        """See :meth:`Job.run`."""
        attempt.begin()
        context = ActionContext.of(attempt.command, self._feedback, attempt.is_cancelled)
        result = self._do(context)
        transition = self._plan.transition_meant(self.place, result.transition)
        return JobEnd(Outcome.SUCCEEDED, "", transition, result.data)


def attempt_job(work: Job, prepared: Any, attempt: JobAttempt) -> JobEnd:
    """Carry out a job; every exception becomes a failure."""
    try:
        return work.run(prepared, attempt)
    except ActionFailed as error:
        return JobEnd(Outcome.ABORTED, error_text(error) or "the action failed")
    except DataError as error:
        return JobEnd(Outcome.BAD_RESULT, error.message)
    except BaseException as error:
        return JobEnd(Outcome.ABORTED, "%s: %s" % (type(error).__name__, error_text(error)))
