"""Makes ROS messages of values of the core."""

from __future__ import annotations

from typing import Any, Callable

import rospy

FIRED_TOPIC = "/fired_transitions"
"""All teams on a master publish their firings on this topic; each message names its run and
plan."""

TASKS_TOPIC = "/finished_tasks"
"""All teams on a master report on this topic the tasks that ended; each message names its run."""


def stamped_message(kind: Callable[[], Any], **fields: Any) -> Any:
    """A message of the class ``kind`` with these fields, and the present time in its header.

    Passing the fields to the constructor would search a list for each of them, which takes eight
    times as long, and robots send thousands of messages a second.
    """
    message = kind()
    for name, value in fields.items():
        setattr(message, name, value)
    message.header.stamp = rospy.get_rostime()
    return message
