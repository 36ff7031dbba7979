"""Goal ids of the action protocol, which identify the robot that sends a goal (the goal message
contains only ``place``)."""

from __future__ import annotations

import uuid
from typing import NamedTuple, Optional, Tuple


class GoalIdentity(NamedTuple):
    """The fields that make a goal unique.

    ``tag`` is new for each start of a node, because a server keeps the ids of old goals for some
    seconds and silently ignores a goal whose id it knows.
    """

    robot: str
    incarnation: int
    visit: int
    attempt: int
    tag: str

    def __str__(self) -> str:
        return "%s-%d-%d-%d-%s" % self

    @property
    def age(self) -> Tuple[int, int, int]:
        """A key that sorts the goals of one robot in one run from old to new."""
        return self.incarnation, self.visit, self.attempt


def new_tag() -> str:
    """Make a tag for this start of a node (eight random hex digits)."""
    return uuid.uuid4().hex[:8]


def parse_goal_id(text: str) -> Optional[GoalIdentity]:
    """The identity in a goal id; None if the goal does not come from an execution node."""
    parts = text.rsplit("-", 4)
    if len(parts) != 5 or not all(part.isdigit() for part in parts[1:4]):
        return None
    return GoalIdentity(parts[0], int(parts[1]), int(parts[2]), int(parts[3]), parts[4])
