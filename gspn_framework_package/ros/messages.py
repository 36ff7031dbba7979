"""Converts between values of the core and ROS messages."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Optional, Tuple

import rospy

from gspn_framework_package.execution.agreement.interface import Fired
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.msg import FiredTransition

FIRED_TOPIC = "/fired_transitions"
"""All teams on a master publish their firings on this topic; each message names its run and
plan."""


def fired_message(fired: Fired, net: Net, plan_hash: str, run: str) -> FiredTransition:
    """The message that reports a firing on ``fired_transitions``.

    :param fired: the firing.
    :param net: the net of the plan.
    :param plan_hash: the hash of the plan.
    :param run: the name of the run.
    """
    firing = fired.firing
    message = FiredTransition()
    message.header.stamp = rospy.get_rostime()
    message.plan, message.run = plan_hash, run
    message.transition = firing.transition
    message.robot, message.incarnation, message.visit = (
        firing.robot,
        firing.incarnation,
        firing.visit,
    )
    moved = [move for move in firing.moves if move.target is not None]
    message.robots = [move.robot for move in moved]
    message.robot_places = [str(move.target) for move in moved]
    message.places, message.counts = marking_fields(firing.marking, net)
    message.slot, message.index = firing.slot, firing.index
    message.private_move = fired.private
    message.hash = fired.hash
    details: Dict[str, Any] = {}
    if firing.cause:
        details["cause"] = dict(firing.cause)
    if firing.tasks:
        details["tasks"] = [list(move) for move in firing.tasks]
    message.details = json.dumps(details) if details else ""
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


def json_object(text: str) -> Optional[Dict[str, Any]]:
    """The JSON object in a field of a message from an untrusted sender; None if there is none."""
    try:
        value = json.loads(text) if text else None
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def marking_fields(marking: Marking, net: Net) -> Tuple[List[str], List[int]]:
    """A marking as two lists, place names and counts, with every place of the net."""
    return [place.name for place in net.places], list(marking)
