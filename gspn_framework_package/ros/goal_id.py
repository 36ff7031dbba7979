"""Who asks for an action is in the goal id of the action protocol (its goal has only ``place``)."""

from __future__ import annotations

import uuid
from typing import NamedTuple, Optional, Tuple


class GoalIdentity(NamedTuple):
    """What makes a goal different from every other one.

    ``tag`` is new for each start of a node: a server keeps the ids of old goals for some seconds,
    and ignores in silence a goal whose id it knows.
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
        """Sorts the goals of one robot in one run from old to new."""
        return self.incarnation, self.visit, self.attempt


def new_tag() -> str:
    """A tag that no other start of a node has."""
    return uuid.uuid4().hex[:8]


def parse_goal_id(text: str) -> Optional[GoalIdentity]:
    """The identity written in a goal id; None for the id of somebody else's goal."""
    parts = text.rsplit("-", 4)
    if len(parts) != 5 or not all(part.isdigit() for part in parts[1:4]):
        return None
    return GoalIdentity(parts[0], int(parts[1]), int(parts[2]), int(parts[3]), parts[4])
