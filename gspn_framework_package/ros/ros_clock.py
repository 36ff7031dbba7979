"""ROS time as a clock that never goes back, although a simulator that is reset restarts its
time."""

from __future__ import annotations

import threading
import time
from typing import Optional

import rospy

from gspn_framework_package.execution.actions import Cancellation
from gspn_framework_package.team.clock import Clock

LOOK_EVERY = 0.05
"""Seconds between two readings of simulated time, which may pass at any rate."""


_NAP = 0.01
"""Seconds between two readings while a function sleeps."""

STANDS_AFTER = 5.0
"""Seconds without a step after which simulated time is said to stand still."""


class RosClock(Clock):
    """The elapsed ROS time. Simulated time may pass slower, faster or not at all, but this clock
    never goes back. Read it regularly: a jump is detected at the next reading."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._passed, self._last = 0.0, 0.0
        self._moved_at = time.monotonic()

    def seconds(self) -> float:
        """See :class:`Clock`."""
        if rospy.rostime.is_wallclock():
            return time.monotonic()
        with self._lock:
            now = rospy.get_time()
            step = now - self._last if self._last else 0.0  # 0 before the first /clock
            if step < 0.0:
                self.times_back += 1
                self.back_by = -step
            if now != self._last:
                self._moved_at = time.monotonic()
            self._passed += max(0.0, step)
            self._last = now
            return self._passed

    def stands(self) -> str:
        """See :class:`Clock`."""
        self.seconds()
        if rospy.rostime.is_wallclock() or time.monotonic() - self._moved_at < STANDS_AFTER:
            return ""
        return "simulated time stands still (/clock), so no time limit of the plan passes"

    def look_at(self, due: float, now: float) -> float:
        """See :class:`Clock`."""
        if rospy.rostime.is_wallclock():
            return due
        return now + min(LOOK_EVERY, max(0.0, due - self.seconds()))


ROS_CLOCK = RosClock()
"""The clock of this process."""


class RosCancellation(Cancellation):
    """Lets an action check whether it should end, and sleep in ROS time."""

    def wait(self, seconds: Optional[float] = None) -> bool:
        """See :class:`Cancellation`."""
        if seconds is None or rospy.rostime.is_wallclock():
            return super().wait(seconds)
        due = ROS_CLOCK.seconds() + seconds
        while ROS_CLOCK.seconds() < due and not super().wait(_NAP):
            pass
        return self()
