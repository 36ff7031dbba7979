"""Passes the feedback of actions to the page: each robot's latest, a few times a second."""

from __future__ import annotations

import threading
from typing import Dict, Optional

from gspn_framework_package.visualizer.hub import Hub

FEEDBACK_EVERY = 0.2


class FeedbackStream:
    """Collects feedback and passes it to a hub at most every :data:`FEEDBACK_EVERY`."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._lock = threading.Lock()
        self._said: Dict[str, str] = {}
        self._timer: Optional[threading.Timer] = None

    def show(self, robot: str, text: str) -> None:
        """Store the feedback ``text`` of ``robot``. May be called from any thread."""
        with self._lock:
            self._said[robot] = text[:200]
            if self._timer is None:
                self._timer = threading.Timer(FEEDBACK_EVERY, self._hand_over)
                self._timer.daemon = True
                self._timer.start()

    def forget(self, robot: str) -> None:
        """Drop the feedback of ``robot``, whose action is over."""
        with self._lock:
            known = self._said.pop(robot, None)
        if known is not None:
            self._hand_over()

    def _hand_over(self) -> None:
        with self._lock:
            self._timer = None
            said = dict(self._said)
        self._hub.set_latest("feedback", said)
