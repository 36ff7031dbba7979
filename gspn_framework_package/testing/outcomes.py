"""How the attempts at actions end in a test: as it says, or as the functions of the plan do."""

from __future__ import annotations

import math
from typing import Mapping, Optional, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.actions import (
    ActionContext,
    ActionFailed,
    load_actions,
    no_feedback,
    read_result,
)
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.model.action import outcomes_of
from gspn_framework_package.model.errors import DataError
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.testing.seen import Act, ActionAttempt
from gspn_framework_package.testing.virtual_wait import NeverEnds, VirtualWait


class Outcomes:
    """How attempts at the actions of a plan end.

    :param functions: whether the Python functions of the plan are called.
    :raises GspnError: a function is missing.
    """

    def __init__(self, plan: Plan, functions: bool) -> None:
        self._plan = plan
        names = ["", *(r.name for r in plan.robots if r.actions)] if functions else []
        self._functions = {name: load_actions(plan, name) for name in names}

    def acted(self, command: StartAction, act: Act, attempt: ActionAttempt) -> log_entries.Entry:
        """The end of an attempt that an action of the test carries out."""
        try:
            result = read_result(act(attempt))
        except (ActionFailed, DataError) as error:
            return self.failed(command, Outcome.ABORTED, str(error))
        return self.done(command, *result)

    def called(self, command: StartAction) -> Optional[Tuple[float, log_entries.Entry]]:
        """How long an attempt takes that the function of the plan carries out, and how it ends;
        None where no function is called."""
        own = self._functions.get(command.robot) or self._functions.get("", {})
        function = own.get(command.place)
        if function is None:
            return None
        clock = VirtualWait(self._plan.timeout(command.place))
        context = ActionContext(
            command.place,
            command.robot,
            no_feedback,
            clock,
            command.visit,
            command.attempt,
            command.data,
            command.resumed_from,
        )
        try:
            entry: log_entries.Entry = self.done(command, *function(context))
        except NeverEnds:
            return self.in_time(command, math.inf, self.done(command, "", NOTHING))
        except (ActionFailed, DataError) as error:
            entry = command.failed(Outcome.ABORTED, str(error))
        except Exception as error:  # as in a run
            entry = command.failed(Outcome.ABORTED, "%s: %s" % (type(error).__name__, error))
        return self.in_time(command, clock.seconds, entry)

    def failed(self, command: StartAction, reason: Outcome, detail: str) -> log_entries.Entry:
        """The end of an attempt that failed: as on ROS, a transition if the plan leads this outcome
        of its action to one."""
        action = self._plan.action(command.robot, command.place)
        transition = outcomes_of(action).get(reason)
        if transition is None:
            return command.failed(reason, detail)
        return self.done(command, transition, NOTHING)

    def done(
        self, command: StartAction, result: str, data: Mapping[str, object]
    ) -> log_entries.Done:
        """The end of an attempt that succeeded."""
        meant = self._plan.transition_meant(command.place, result)
        return log_entries.Done(command.robot, command.incarnation, command.visit, meant, data)

    def in_time(
        self, command: StartAction, seconds: float, entry: log_entries.Entry
    ) -> Tuple[float, log_entries.Entry]:
        """The same, or a time-out before it."""
        timeout = self._plan.timeout(command.place)
        if timeout is not None and seconds > timeout:
            return timeout, command.timed_out(timeout)
        return seconds, entry
