"""What the core knows, as ROS messages."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Optional, Tuple

import rospy

from gspn_framework_package.execution.agreement.interface import Fired
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.msg import FiredTransition

FIRED_TOPIC = "/fired_transitions"
"""All teams on a master publish what fires on this topic; a message names its run and its plan."""


def fired_message(fired: Fired, net: Net, plan_hash: str, run: str) -> FiredTransition:
    """The news of a firing, for ``fired_transitions``."""
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
    """What a node answered to the command ``status``; None where it is not such an answer."""
    status = json_object(message)
    return status if status is not None and _STATUS_FIELDS <= set(status) else None


def json_object(text: str) -> Optional[Dict[str, Any]]:
    """The JSON object in a field of a message that anybody may have sent; None where there is
    none."""
    try:
        value = json.loads(text) if text else None
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def marking_fields(marking: Marking, net: Net) -> Tuple[List[str], List[int]]:
    """A marking as places and counts, every place of the net."""
    return [place.name for place in net.places], list(marking)
