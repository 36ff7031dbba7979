"""A robot's reporter on ROS: lines on the screen, and ``/diagnostics``."""

from __future__ import annotations

import json
from typing import Any, Mapping

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue


class RosReporter:
    """The reporter of one robot.

    It publishes ``/diagnostics`` (diagnostic_msgs/DiagnosticArray, once a second).

    :param namespace: absolute namespace of the robot.
    """

    def __init__(self, robot: str, namespace: str, run: str) -> None:
        self._robot, self._namespace, self._run = robot, namespace, run
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)

    def say(self, text: str) -> None:
        """See :class:`Reporter`."""
        rospy.loginfo("%s: %s", self._robot, text)

    def warn(self, text: str) -> None:
        """See :class:`Reporter`."""
        rospy.logwarn("%s: %s", self._robot, text)

    def error(self, text: str, traceback: bool = False) -> None:
        """See :class:`Reporter`."""
        if traceback:
            rospy.logfatal("%s: %s", self._robot, text, exc_info=True)
        else:
            rospy.logerr("%s: %s", self._robot, text)

    def is_asked(self) -> bool:
        """See :class:`Reporter`."""
        return bool(self._diagnostics.get_num_connections())

    def diagnose(self, level: int, message: str, values: Mapping[str, Any]) -> None:
        """See :class:`Reporter`."""
        name = "%s: gspn %s, run %s" % (self._namespace, self._robot, self._run)
        self._diagnostics.publish(diagnostic_array(name, self._robot, level, message, values))


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
