"""How many streams of server-sent events are open."""

from __future__ import annotations

import threading
from typing import Dict

from gspn_framework_package.visualizer.guard import is_loopback

PING = 3.0
"""Seconds of silence after which a stream sends a keep-alive."""


class Streams:
    """Counts the active streams: at most ``limit``, and at most half of them for one remote
    peer."""

    def __init__(self, limit: int) -> None:
        self._condition = threading.Condition()
        self._limit, self._taken = limit, 0
        self._by_peer: Dict[str, int] = {}
        self.closing = False

    def take(self, peer: str = "") -> bool:
        """Count a new stream of ``peer``; False if there are as many as allowed."""
        with self._condition:
            own = self._by_peer.get(peer, 0)
            share = self._limit if not peer or is_loopback(peer) else max(2, self._limit // 2)
            if self.closing or self._taken >= self._limit or own >= share:
                return False
            self._taken += 1
            self._by_peer[peer] = own + 1
            return True

    def give_back(self, peer: str = "") -> None:
        """Uncount a stream of ``peer``."""
        with self._condition:
            self._taken -= 1
            self._by_peer[peer] -= 1
            if not self._by_peer[peer]:
                del self._by_peer[peer]
            self._condition.notify_all()

    def close(self) -> None:
        """Ask all streams to end soon."""
        self.closing = True

    def wait(self, timeout: float) -> bool:
        """Wait at most ``timeout`` seconds for all streams to end; return whether they have."""
        with self._condition:
            return self._condition.wait_for(lambda: self._taken == 0, timeout)
