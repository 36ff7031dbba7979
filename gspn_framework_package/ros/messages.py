"""Converts between values of the core and ROS messages."""

from __future__ import annotations

from typing import Any, Dict

import rospy

from gspn_framework_package.msg import FiredTransition

FIRED_TOPIC = "/fired_transitions"
"""All teams on a master publish their firings on this topic; each message names its run and
plan."""


def fired_message(fields: Dict[str, Any]) -> FiredTransition:
    """The message that reports a firing on ``fired_transitions``.

    :param fields: see :func:`~gspn_framework_package.execution.team_messages.firing_fields`.
    """
    message: FiredTransition = stamped(FiredTransition(**fields))
    return message


def stamped(message: Any) -> Any:
    """The message, with the present time in its header."""
    message.header.stamp = rospy.get_rostime()
    return message
