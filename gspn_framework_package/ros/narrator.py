"""Reports to people what a robot does: on the screen, on ``activity`` and on ``/diagnostics``."""

from __future__ import annotations

import json
import time
from typing import Any, Callable, Dict, Mapping, Tuple

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import String

LINES_PER_SECOND = 4
"""Maximum number of lines on the screen per second; further lines are only counted."""

ACTIVITY_PERIOD = 0.1
"""Minimum number of seconds between two messages on ``activity``."""

UNHEARD_PERIOD = 1.0
"""The same while nobody subscribes: the last message is latched."""

DIAGNOSTICS_PERIOD = 1.0
"""Seconds between two messages on ``/diagnostics``."""

Diagnosis = Tuple[int, str, Mapping[str, Any]]
"""The content of ``/diagnostics``: (level, message, values)."""

WAITING_TIME = 1.0
"""Seconds after which a waiting robot reports what it waits for."""


class Narrator:
    """Reports what one robot does. All methods belong to the node's worker thread.

    It publishes ``NAMESPACE/activity`` (std_msgs/String, JSON: robot, run, plan (its hash), place,
    state, visit, attempt, waits_for, needs_operator, feedback, ended, finished, fault; at most ten
    a second, the last one latched) and ``/diagnostics`` (diagnostic_msgs/DiagnosticArray, once a
    second).

    :param robot: name of the robot.
    :param namespace: absolute namespace of the robot.
    :param run: name of the run.
    """

    def __init__(self, robot: str, namespace: str, run: str) -> None:
        self._robot, self._namespace, self._run = robot, namespace, run
        self._activity = rospy.Publisher(
            rospy.names.ns_join(namespace, "activity"), String, latch=True, queue_size=10
        )
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        self._told: Dict[str, Any] = {}
        self._changed = True
        self._activity_at = 0.0
        self._diagnostics_at = 0.0
        self._reason = ""
        self._reason_since = 0.0
        self._reason_told = ""
        self._second = 0
        self._lines = 0

    def say(self, text: str) -> None:
        """Print a line about what happens, unless there were too many in this second."""
        second = int(time.monotonic())
        if second != self._second:
            if self._lines > LINES_PER_SECOND:
                self._log("and %d lines more" % (self._lines - LINES_PER_SECOND))
            self._second, self._lines = second, 0
        self._lines += 1
        if self._lines <= LINES_PER_SECOND:
            self._log(text)

    def _log(self, text: str) -> None:
        rospy.loginfo("%s: %s", self._robot, text)

    def tell(self, text: str) -> None:
        """Print a line regardless of how many there are."""
        self._log(text)

    def warn(self, text: str) -> None:
        """Print a warning."""
        rospy.logwarn("%s: %s", self._robot, text)

    def note_change(self) -> None:
        """Note that what the robot does may have changed."""
        self._changed = True

    def poll(
        self,
        now: float,
        activity: Callable[[], Dict[str, Any]],
        status: Callable[[], Diagnosis],
    ) -> float:
        """Publish what is due; returns when to call this next, unless something changes before.

        :param now: the time (monotonic seconds).
        :param activity: returns what the robot does, a JSON object.
        :param status: returns the content of ``/diagnostics``.
        """
        period = ACTIVITY_PERIOD if self._activity.get_num_connections() else UNHEARD_PERIOD
        self._activity_at = min(self._activity_at, now + period)
        if self._changed and now >= self._activity_at:
            self._changed = False
            self._activity_at = now + period
            told = activity()
            if told != self._told:
                self._told = told
                self._activity.publish(json.dumps(told))
            self._note_reason(told["waits_for"], now)
        self._tell_reason(now)
        if now >= self._diagnostics_at:
            self._diagnostics_at = now + DIAGNOSTICS_PERIOD
            if self._diagnostics.get_num_connections():
                self._publish_diagnostics(*status())
        return (
            min(self._activity_at, self._diagnostics_at) if self._changed else self._diagnostics_at
        )

    def _note_reason(self, reason: str, now: float) -> None:
        if reason != self._reason:
            self._reason, self._reason_since = reason, now

    def _tell_reason(self, now: float) -> None:
        """Print what the robot waits for, once, after it has waited for a while."""
        if self._reason != self._reason_told and now >= self._reason_since + WAITING_TIME:
            self._reason_told = self._reason
            if self._reason:
                self.say(self._reason)

    def _publish_diagnostics(self, level: int, message: str, values: Mapping[str, Any]) -> None:
        self._diagnostics.publish(
            diagnostic_array(
                "%s: gspn %s, run %s" % (self._namespace, self._robot, self._run),
                self._robot,
                level,
                message,
                values,
            )
        )


def diagnostic_array(
    name: str, hardware: str, level: int, message: str, values: Mapping[str, Any]
) -> DiagnosticArray:
    """A message for ``/diagnostics`` with one status."""
    array = DiagnosticArray()
    array.header.stamp = rospy.get_rostime()
    array.status = [
        DiagnosticStatus(
            level=bytes([level]) if isinstance(DiagnosticStatus.OK, bytes) else level,
            name=name,
            message=message,
            hardware_id=hardware,
            values=[
                KeyValue(key, value if isinstance(value, str) else json.dumps(value))
                for key, value in values.items()
            ],
        )
    ]
    return array


def level_of(needs_operator: bool, waits: bool) -> int:
    """The level of ``/diagnostics``: 0 if all is well, 1 if the robot waits or another one is lost,
    2 if it needs the operator."""
    return 2 if needs_operator else 1 if waits else 0
