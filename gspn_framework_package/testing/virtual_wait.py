"""The waiting of a function in virtual time."""

from __future__ import annotations

import math
from typing import Optional

from gspn_framework_package.execution.actions import Cancellation

LONGEST = 30 * 24 * 3600.0
"""A function of the plan that waits for longer than this (s) counts as one that never ends."""

CALLS_AT_ONCE = 100_000
"""The same for one that asks so often whether it should end, without waiting."""


class NeverEnds(BaseException):
    """Ends a function that waits for ever. Not an Exception: the function must not catch it."""


class VirtualWait(Cancellation):
    """The ``is_cancelled`` of a function whose time is virtual: waiting takes no time.

    :ivar seconds: for how long the function has waited.
    """

    def __init__(self, timeout: Optional[float]) -> None:
        super().__init__()
        self._most = LONGEST if timeout is None else min(timeout, LONGEST)
        self._calls = 0
        self.seconds = 0.0

    def __call__(self) -> bool:
        """Return False: no event cuts the function off. :raises NeverEnds: it asks for ever."""
        self._calls += 1
        if self._calls > CALLS_AT_ONCE:
            raise NeverEnds
        return False

    def wait(self, seconds: Optional[float] = None) -> bool:
        """Let virtual time pass (s). :raises NeverEnds: it waits for ever."""
        self.seconds += math.inf if seconds is None else max(seconds, 0.0)
        if self.seconds > self._most:
            raise NeverEnds
        return self()
