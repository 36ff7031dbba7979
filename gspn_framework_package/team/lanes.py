"""Lanes let a burst of messages pass a router that drops floods.

The only rate limit of a Zenoh router drops a message that follows the previous one under the same
key too soon. A robot therefore rotates among several keys, its lanes, and pauses before it uses a
lane again. The router's limit is somewhat higher than the robot's rate, because messages arrive
less evenly than they were sent.
"""

from __future__ import annotations

from typing import Any, Dict, List, Tuple

LANES = 32
"""Number of lanes of a channel, which is also the longest burst of messages."""

PAUSE = 0.04
"""Seconds between two messages of a robot in the same lane, which allows 800 per second in a
channel. Messages that wait in the meantime are sent together as one."""

PASSED_BY_ROUTER = 0.02
"""Minimum number of seconds between two messages in the same lane for a router to forward both."""


class Lanes:
    """A sender's lanes in one channel.

    :param lanes: number of lanes.
    """

    def __init__(self, lanes: int = LANES) -> None:
        self._free_at = [0.0] * lanes
        self._next = 0

    def take(self, now: float) -> Tuple[int, float]:
        """The lane of the next message, and how many seconds to wait before it is sent.

        :param now: a monotonic clock, in seconds.
        """
        lane = self._next
        self._next = (lane + 1) % len(self._free_at)
        wait = max(0.0, self._free_at[lane] - now)
        self._free_at[lane] = now + wait + PAUSE
        return lane, wait


def router_limits(channels: List[str]) -> List[Dict[str, Any]]:
    """The Zenoh configuration that makes a router drop floods; applies to each connection
    separately.

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
