"""Converts between values of the core and ROS messages."""

from __future__ import annotations

from typing import Any, Dict, Optional

import rospy

from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.team.carrier import json_object

FIRED_TOPIC = "/fired_transitions"
"""All teams on a master publish their firings on this topic; each message names its run and
plan."""


def fired_message(fields: Dict[str, Any]) -> FiredTransition:
    """The message that reports a firing on ``fired_transitions``.

    :param fields: see :func:`~gspn_framework_package.team.carrier.firing_fields`.
    """
    message = FiredTransition(**fields)
    message.header.stamp = rospy.get_rostime()
    return message


_STATUS_FIELDS = {
    "robot",
    "run",
    "plan",
    "synchronisation",
    "active",
    "quorum",
    "log_length",
    "marking",
    "paused",
    "ended",
    "finished",
    "fault",
    "waits_for",
    "robots",
}


def read_status(message: str) -> Optional[Dict[str, Any]]:
    """A node's answer to the command ``status``; None if the text is not such an answer."""
    status = json_object(message)
    return status if status is not None and _STATUS_FIELDS <= set(status) else None
