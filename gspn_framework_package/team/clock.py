"""The clock by which the times of a plan pass for a robot's actions."""

from __future__ import annotations

import time


class Clock:
    """The machine's own clock, which never goes back; ``ros.ros_clock`` has that of a simulation.

    :ivar times_back: how often the time of the world went back.
    :ivar back_by: by how many seconds it did the last time.
    """

    times_back = 0
    back_by = 0.0

    def seconds(self) -> float:
        """Seconds that have passed since some moment in the past."""
        return time.monotonic()

    def look_at(self, due: float, now: float) -> float:
        """When to look whether this clock has come to ``due``, in monotonic seconds.

        :param due: seconds of this clock.
        :param now: the present in monotonic seconds.
        """
        return due


MACHINE_CLOCK = Clock()
