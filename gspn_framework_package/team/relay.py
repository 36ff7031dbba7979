"""A loop that runs on one thread at a time, and short functions on the thread of the loop.

Handing a function over to another thread costs two wake-ups, which is more than many functions
take. The loop therefore calls *guests* itself: functions that have been quick so far. A second
thread checks whether a guest holds the loop up, and then continues the loop, as the Go runtime does
when a system call blocks. The guest keeps its thread, which ends with it.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Callable, Deque, Optional

PERIOD = 0.01
"""Seconds between two checks; a guest holds the loop up for at most twice as long."""

_IDLE_CHECKS = 20
"""Number of checks without any guest after which the second thread sleeps until the next one."""


class Relay:
    """Runs a loop; see the module.

    :param loop: called on the loop's first thread and on each later one. It must return as soon as
        :meth:`run_guests` returns False, and must call :meth:`end` when the loop is over.
    :param name: of its threads.
    """

    def __init__(self, loop: Callable[[], None], name: str) -> None:
        self._loop, self._name = loop, name
        self._lock = threading.Lock()
        self._guests: Deque[Callable[[], None]] = deque()
        self._running = self._number = 0  # the guest under way (0 for none), and the newest one
        self._has_relief = False
        self._wanted = threading.Event()
        self._started, self._over = False, threading.Event()

    def start(self) -> None:
        """Start the loop."""
        self._started = True
        self._start_thread(self._loop, self._name)

    def join(self, timeout: Optional[float] = None) -> None:
        """Wait up to ``timeout`` seconds until the loop is over; return at once if it was never
        started."""
        if self._started:
            self._over.wait(timeout)

    # -- called by the loop ------------------------------------------------------------------------

    def invite(self, guest: Callable[[], None]) -> None:
        """Have a function called by the next :meth:`run_guests`; it must not raise."""
        self._guests.append(guest)

    def run_guests(self) -> bool:
        """Call the guests. Returns whether the loop is still on this thread."""
        while self._guests:
            guest = self._guests.popleft()
            self._number += 1
            number = self._running = self._number
            if not self._has_relief:
                self._has_relief = True
                self._start_thread(self._relieve, self._name + " relief")
            elif not self._wanted.is_set():
                self._wanted.set()
            guest()
            with self._lock:
                if self._running != number:
                    return False
                self._running = 0
        return True

    def end(self) -> None:
        """The loop is over."""
        self._over.set()
        self._wanted.set()

    # -- the second thread -------------------------------------------------------------------------

    def _relieve(self) -> None:
        """Continue the loop as soon as a guest holds it up."""
        before, idle = 0, 0
        while not self._over.is_set():
            time.sleep(PERIOD)
            running, newest = self._running, self._number
            if running == before != 0 and self._takes_over(running):
                self._loop()
                return
            idle = idle + 1 if newest == before and not running else 0
            before = newest
            if idle > _IDLE_CHECKS:
                idle = 0
                self._wanted.clear()
                if self._number == newest and not self._over.is_set():
                    self._wanted.wait()

    def _takes_over(self, guest: int) -> bool:
        with self._lock:
            held_up = self._running == guest
            if held_up:
                self._running, self._has_relief = 0, False
        return held_up

    def _start_thread(self, function: Callable[[], None], name: str) -> None:
        threading.Thread(target=function, name=name, daemon=True).start()
