"""A signal-safe event that says whether a process should end."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from typing import Any, List, Optional


class Ending:
    """A signal-safe ``threading.Event``.

    ``threading.Event`` can deadlock when a handler calls ``set()`` during another ``set()``. A main
    thread that waits for it may also fail to wake up when two signals reach two threads at once, as
    roslaunch and ``gspn_team`` send them (this happened in 13 of 60 processes that got SIGINT and
    SIGTERM together). This class therefore uses a flag and a pipe: the C signal handler itself
    writes to the pipe, in whichever thread it runs.

    :ivar signals: the numbers of the signals received.
    """

    def __init__(self) -> None:
        self.signals: List[int] = []
        self._set = False
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._reader, False)
        os.set_blocking(self._writer, False)

    def listen(self, *numbers: int) -> None:
        """Set the event when one of these signals arrives. Call this in the main thread."""
        signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        for number in numbers:
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: Any) -> None:
        self.signals.append(number)
        self.set()

    def set(self) -> None:
        """Request that the process ends. May be called at any time, from any thread."""
        self._set = True
        with contextlib.suppress(BlockingIOError):  # the pipe is full, which also wakes up waiters
            os.write(self._writer, b"\0")

    def is_set(self) -> bool:
        """Whether the process should end."""
        return self._set

    def wait(self, timeout: Optional[float] = None) -> bool:
        """Wait up to ``timeout`` seconds until the process should end; returns whether it
        should."""
        deadline = None if timeout is None else time.monotonic() + timeout
        poll = select.poll()
        poll.register(self._reader, select.POLLIN)
        while not self._set:
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0:
                break
            poll.poll(None if left is None else 1000 * left)
            if not self._set:  # woken by some other signal
                with contextlib.suppress(BlockingIOError):
                    os.read(self._reader, 1000)
        return self._set
