"""Progress, cancellation and time limits of long computations."""

from __future__ import annotations

import math
import time
from typing import Callable, Optional

from gspn_framework_package.model.errors import CancelledError, LimitError

Progress = Callable[[str, int, float], None]
"""Called with what is being counted (``"states"``), the count, and the seconds since the start."""

Cancel = Callable[[], bool]
"""Called at intervals; if it returns true, the work stops with a CancelledError."""


class Watch:
    """Reports progress at most every ``interval`` seconds, and stops the work when it is cancelled
    or takes longer than ``seconds``."""

    def __init__(
        self,
        progress: Optional[Progress] = None,
        cancel: Optional[Cancel] = None,
        interval: float = 0.5,
        seconds: float = math.inf,
    ) -> None:
        self._progress = progress
        self._cancel = cancel
        self._interval = interval
        self._seconds = seconds
        self._start = time.monotonic()
        self._last = self._start

    def cancelled(self) -> bool:
        """Whether the work was cancelled."""
        return self._cancel is not None and self._cancel()

    @property
    def left(self) -> float:
        """The time that is left (s)."""
        return max(self._seconds - (time.monotonic() - self._start), 0.0)

    def part(self, share: float, most: float = math.inf) -> Watch:
        """A watch over the next ``share`` of the time that is left, ``most`` seconds of it."""
        seconds = min(share * self.left, most)
        return Watch(self._progress, self._cancel, self._interval, seconds)

    def step(self, what: str, count: int) -> None:
        """Report that ``count`` of ``what`` are done.

        :raises CancelledError: the work was cancelled.
        :raises LimitError: the time limit is exceeded.
        """
        if self.cancelled():
            raise CancelledError("cancelled after %d %s" % (count, what))
        now = time.monotonic()
        if now - self._start > self._seconds:
            raise LimitError(
                "not decided within %g s (%s %s)" % (self._seconds, format(count, ","), what),
                hint="raise --limit-time",
            )
        if self._progress is not None and now - self._last >= self._interval:
            self._last = now
            self._progress(what, count, now - self._start)
