"""The states of a goal, as seen by the robot that sends it (``CommState`` in actionlib)::

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

A goal is RESULT_DUE when its server reports that it has ended, no longer knows it, or is no longer
connected; its result may still be on the way.
"""

from __future__ import annotations

import enum
from typing import Dict, FrozenSet


class GoalState(enum.Enum):
    """The state of a goal; see the picture."""

    DELAYED = "delayed"
    """The goal waits for its start time, if an earlier attempt failed."""
    CONNECTING = "connecting"
    """The goal cannot be sent before the topics of its server are connected."""
    SENT = "sent"
    """The server has not acknowledged the goal yet."""
    ACTIVE = "active"
    """The server has the goal."""
    RESULT_DUE = "result due"
    """Only the result is missing."""
    OVER = "over"
    """The goal has ended, failed or been cancelled; further messages about it are ignored."""

    def then(self, following: GoalState) -> GoalState:
        """Returns ``following``. :raises IllegalTransitionError: it cannot follow this state."""
        if following not in TRANSITIONS[self]:
            raise IllegalTransitionError(
                "a goal cannot go from %s to %s" % (self.name, following.name)
            )
        return following


class IllegalTransitionError(RuntimeError):
    """A goal attempted a transition that is not in the picture, which is a bug in this program."""


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
    """What a connection reports about the watched goal, and the value that comes with it."""

    ACKNOWLEDGED = "acknowledged"
    """The server knows the goal; value: caller id of the server."""
    UNKNOWN = "unknown"
    """The server that acknowledged the goal no longer knows it; value: None."""
    ENDED = "ended"
    """The goal has ended, but its result may still arrive; value: (outcome, text)."""
    RESULT = "result"
    """The result has arrived; value: (outcome, text, result message)."""
    FEEDBACK = "feedback"
    """The action reports progress; value: the feedback message."""
