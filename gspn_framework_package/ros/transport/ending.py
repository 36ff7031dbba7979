"""Whether a process should end, according to its signals and its threads."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from typing import Any, List, Optional


class Ending:
    """A signal-safe ``threading.Event``. ``threading.Event`` can deadlock when a handler calls
    ``set()`` during another ``set()``, and a main thread that waits for it may sleep on when two
    signals reach two threads at once (13 of 60 processes did that got SIGINT and SIGTERM together).
    roslaunch and ``gspn_team`` send both. So this is a flag and a pipe: the C signal handler
    already writes to the pipe, in whichever thread it runs.

    :ivar signals: the numbers of the signals that have come.
    """

    def __init__(self) -> None:
        self.signals: List[int] = []
        self._set = False
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._reader, False)
        os.set_blocking(self._writer, False)

    def listen(self, *numbers: int) -> None:
        """Be set by these signals. To be called in the main thread."""
        signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        for number in numbers:
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: Any) -> None:
        self.signals.append(number)
        self.set()

    def set(self) -> None:
        """The process should end. May be called at any moment, from any thread."""
        self._set = True
        with contextlib.suppress(BlockingIOError):  # full: a waiting thread wakes up anyway
            os.write(self._writer, b"\0")

    def is_set(self) -> bool:
        """Whether the process should end."""
        return self._set

    def wait(self, timeout: Optional[float] = None) -> bool:
        """Wait at most ``timeout`` seconds until the process should end; returns whether it
        should."""
        deadline = None if timeout is None else time.monotonic() + timeout
        poll = select.poll()
        poll.register(self._reader, select.POLLIN)
        while not self._set:
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0:
                break
            poll.poll(None if left is None else 1000 * left)
            if not self._set:  # another signal
                with contextlib.suppress(BlockingIOError):
                    os.read(self._reader, 1000)
        return self._set
