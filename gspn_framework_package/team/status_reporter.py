"""Reports a robot's work to people: lines on the screen, its activity, and its diagnosis."""

from __future__ import annotations

import time
from typing import Any, Callable, Dict, Mapping, Tuple

from gspn_framework_package.execution.team_messages import MessageFields
from gspn_framework_package.team.carrier import Carrier
from gspn_framework_package.team.sides import Reporter

LINES_PER_SECOND = 4
"""Maximum number of lines on the screen per second; further lines are only counted."""

ACTIVITY_PERIOD = 0.1
"""Minimum number of seconds between two publications of the activity."""

UNHEARD_PERIOD = 1.0
"""The same, while nobody is watching."""

TEAM_PERIOD = 0.2
"""Minimum number of seconds between two publications of the marking and the team's state."""

DIAGNOSIS_PERIOD = 1.0
"""Seconds between two diagnoses."""

Diagnosis = Tuple[int, str, Mapping[str, Any]]
"""A diagnosis of the robot: (level, message, values), see :meth:`Reporter.diagnose`."""

WAITING_TIME = 1.0
"""Seconds after which a waiting robot reports what it waits for."""


class StatusReporter:
    """Reports what one robot does. All methods belong to the host's worker thread.

    :param reporter: prints the lines, and receives the diagnoses.
    """

    def __init__(self, reporter: Reporter) -> None:
        self._reporter = reporter
        self._reported: Dict[str, Any] = {}
        self._changed = True
        self._activity_at = 0.0
        self._watched, self._look_at = False, 0.0
        self._team_reported: Tuple[MessageFields, MessageFields] = ({}, {})
        self._team_at = 0.0
        self._diagnosis_at = 0.0
        self._reason = ""
        self._reason_since = 0.0
        self._reason_reported = ""
        self._second = 0
        self._lines = 0

    def say(self, text: str) -> None:
        """Print a line about an occurrence, unless there were too many lines in this second."""
        second = int(time.monotonic())
        if second != self._second:
            if self._lines > LINES_PER_SECOND:
                self._reporter.say("and %d more lines" % (self._lines - LINES_PER_SECOND))
            self._second, self._lines = second, 0
        self._lines += 1
        if self._lines <= LINES_PER_SECOND:
            self._reporter.say(text)

    def note_change(self) -> None:
        """Note that the activity may have changed."""
        self._changed = True

    def poll(
        self,
        now: float,
        carrier: Carrier,
        activity: Callable[[], Dict[str, Any]],
        team: Callable[[], Tuple[MessageFields, MessageFields]],
        diagnosis: Callable[[], Diagnosis],
    ) -> float:
        """Publish what is due; returns when to call this next, unless something changes earlier.

        :param now: the time (monotonic seconds).
        :param carrier: publishes the activity.
        :param activity: returns the robot's activity, a JSON object.
        :param team: returns the marking and the state of the team, as :meth:`Carrier.publish_team`
            takes them.
        :param diagnosis: returns the robot's diagnosis.
        """
        if now >= self._look_at:
            self._look_at = now + ACTIVITY_PERIOD
            self._watched = carrier.is_watched()
        period = ACTIVITY_PERIOD if self._watched else UNHEARD_PERIOD
        self._activity_at = min(self._activity_at, now + period)
        if self._changed and now >= self._activity_at:
            self._changed = False
            self._activity_at = now + period
            reported = activity()
            if reported != self._reported:
                self._reported = reported
                carrier.publish_activity(reported)
            self._note_reason(reported["waits_for"], now)
        self._report_reason(now)
        if now >= self._team_at:
            watched = carrier.is_team_watched()
            self._team_at = now + (TEAM_PERIOD if watched else UNHEARD_PERIOD)
            if watched:
                state = team()
                if state != self._team_reported:
                    self._team_reported = state
                    carrier.publish_team(*state)
        if now >= self._diagnosis_at:
            self._diagnosis_at = now + DIAGNOSIS_PERIOD
            if self._reporter.is_asked():
                self._reporter.diagnose(*diagnosis())
        due = min(self._team_at, self._diagnosis_at)
        return min(self._activity_at, due) if self._changed else due

    def _note_reason(self, reason: str, now: float) -> None:
        if reason != self._reason:
            self._reason, self._reason_since = reason, now

    def _report_reason(self, now: float) -> None:
        """Print what the robot waits for, once it has waited for a while."""
        if self._reason != self._reason_reported and now >= self._reason_since + WAITING_TIME:
            self._reason_reported = self._reason
            if self._reason:
                self.say(self._reason)


def level_of(needs_operator: bool, waits: bool) -> int:
    """The level of a diagnosis: 0 if all is well, 1 if the robot waits, another one is lost or
    messages were refused, 2 if it needs the operator."""
    return 2 if needs_operator else 1 if waits else 0
