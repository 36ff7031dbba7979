"""How an attempt at an action ends."""

from __future__ import annotations

import enum


class Outcome(str, enum.Enum):
    """How an attempt at an action ended. The values stand in plans, logs and JSON; the first four
    are the words of actionlib."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    """The action itself failed."""
    REJECTED = "rejected"
    """The server did not take the goal, or the service refused the call."""
    PREEMPTED = "preempted"
    """It was cancelled."""
    LOST = "lost"
    """The goal never reached its server, or the server no longer reports on it."""
    TIMEOUT = "timeout"
    """It took longer than the plan allows."""
    NO_SERVER = "no server"
    SERVER_DIED = "server died"
    BAD_RESULT = "bad result"
    """It succeeded, but its result names no transition to fire, or cannot be kept."""

    def __str__(self) -> str:
        return self.value


FAILURES = tuple(outcome for outcome in Outcome if outcome is not Outcome.SUCCEEDED)
"""The outcomes of an attempt that failed, unless the plan leads them to a transition."""
