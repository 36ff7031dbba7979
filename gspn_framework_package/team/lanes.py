"""Lanes: how a burst passes a router that drops a flood.

All that a Zenoh router can do about a rate is to drop what comes too soon after the message before
under the same key. A robot therefore sends each message under the next of some keys, its lanes, and
waits for a lane that it has just used. A router lets through somewhat more than that, because
messages do not arrive as evenly as they were sent.
"""

from __future__ import annotations

from typing import Any, Dict, List, Tuple

LANES = 32
"""Lanes of a channel. So many messages may go out at once."""

PAUSE = 0.04
"""Seconds between two messages of a robot in the same lane: at most 800 a second in a channel. What
waits meanwhile is sent together, as one."""

PASSED_BY_ROUTER = 0.02
"""Seconds between two messages that a router lets through in the same lane."""


class Lanes:
    """The lanes of one channel, for a sender.

    :param lanes: how many.
    :param pause: seconds between two messages in the same one.
    """

    def __init__(self, lanes: int = LANES, pause: float = PAUSE) -> None:
        self._pause = pause
        self._free_at = [0.0] * lanes
        self._next = 0

    def take(self, now: float) -> Tuple[int, float]:
        """The lane of the next message, and how many seconds to wait before it is sent.

        :param now: a monotonic clock, in seconds.
        """
        lane = self._next
        self._next = (lane + 1) % len(self._free_at)
        wait = max(0.0, self._free_at[lane] - now)
        self._free_at[lane] = now + wait + self._pause
        return lane, wait


def router_limits(channels: List[str]) -> List[Dict[str, Any]]:
    """What makes a router drop a flood, as Zenoh reads it; it counts for each connection.

    :param channels: key expressions with "%d" for the lane.
    """
    return [
        {
            "id": "lanes",
            "flows": ["ingress"],
            "messages": ["put", "delete"],
            "rules": [
                {"key_expr": channel % lane, "freq": 1.0 / PASSED_BY_ROUTER}
                for channel in channels
                for lane in range(LANES)
            ],
        }
    ]
