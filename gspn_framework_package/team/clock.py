"""The clock that times a robot's actions."""

from __future__ import annotations

import time


class Clock:
    """The machine's monotonic clock; ``ros.ros_clock`` has the clock of a simulation.

    :ivar times_back: how often simulated time went back.
    :ivar back_by: by how many seconds it went back the last time.
    """

    times_back = 0
    back_by = 0.0

    def seconds(self) -> float:
        """Seconds since some fixed moment in the past."""
        return time.monotonic()

    def stands(self) -> str:
        """A sentence if simulated time stands still; "" if it passes."""
        return ""

    def look_at(self, due: float, now: float) -> float:
        """When to check whether this clock has reached ``due``, in monotonic seconds.

        :param due: seconds of this clock.
        :param now: the present in monotonic seconds.
        """
        return due


MACHINE_CLOCK = Clock()
