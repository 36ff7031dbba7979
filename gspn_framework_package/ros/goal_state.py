"""The life of a goal, as the robot sees it that sends it (actionlib calls this ``CommState``)::

    DELAYED
       | its time has come
       v
    CONNECTING ------------ no server in time ------------+
       | sent                                             |
       v                                                  |
    SENT ------------------ not taken, or not in time ----+
       | acknowledged                                     |
       v                                                  |
    ACTIVE <--+------------ the server is silent, --------+
       |      |             or the action takes too long  |
       |      | connected                                 |
       |      | again                                     |
       v      |                                           |
    RESULT_DUE ------------ no result in time ------------+
                                                          |
    (SENT, ACTIVE, RESULT_DUE: a result) -----------------+
    (every state: cancelled)                              v
                                                        OVER

A goal is RESULT_DUE when its server says that it has ended, no longer knows it, or is no longer
connected: its result may still be on the way.
"""

from __future__ import annotations

import enum
from typing import Dict, FrozenSet


class GoalState(enum.Enum):
    """Where a goal is on its way; see the picture."""

    DELAYED = "delayed"
    """It is to be sent later: an attempt after one that failed."""
    CONNECTING = "connecting"
    """It cannot be sent before the topics of its server are connected."""
    SENT = "sent"
    """The server has not said yet that it has the goal."""
    ACTIVE = "active"
    """The server has the goal."""
    RESULT_DUE = "result due"
    """Only the result is missing."""
    OVER = "over"
    """It has ended, failed or been cancelled; nothing more is heard of it."""

    def then(self, following: GoalState) -> GoalState:
        """The state that follows. :raises IllegalTransitionError: it cannot follow this one."""
        if following not in TRANSITIONS[self]:
            raise IllegalTransitionError(
                "a goal cannot go from %s to %s" % (self.name, following.name)
            )
        return following


class IllegalTransitionError(RuntimeError):
    """A goal was to take a way that its picture does not have: an error of this program."""


TRANSITIONS: Dict[GoalState, FrozenSet[GoalState]] = {
    GoalState.DELAYED: frozenset({GoalState.CONNECTING, GoalState.OVER}),
    GoalState.CONNECTING: frozenset({GoalState.SENT, GoalState.OVER}),
    GoalState.SENT: frozenset({GoalState.ACTIVE, GoalState.OVER}),
    GoalState.ACTIVE: frozenset({GoalState.RESULT_DUE, GoalState.OVER}),
    GoalState.RESULT_DUE: frozenset({GoalState.ACTIVE, GoalState.OVER}),
    GoalState.OVER: frozenset(),
}
"""The states that can follow each state."""


class GoalNews(enum.Enum):
    """What a connection reports of the watched goal, and the value that goes with it."""

    ACKNOWLEDGED = "acknowledged"
    """The server knows the goal; value: caller id of the server."""
    UNKNOWN = "unknown"
    """The server that acknowledged the goal no longer knows it; value: None."""
    ENDED = "ended"
    """The goal has ended, its result may still come; value: (outcome, text)."""
    RESULT = "result"
    """Value: (outcome, text, result message)."""
    FEEDBACK = "feedback"
    """Value: the feedback message."""
