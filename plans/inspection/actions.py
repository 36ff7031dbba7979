"""The inspection without a world: each action takes a time with a gamma distribution."""

import random


class TakeTime:
    """Inspect, charge, or be carried to the dock; the place's only transition follows."""

    def __init__(self, mean, shape):
        self.mean = mean
        self.shape = shape

    def __call__(self, is_cancelled):
        """Take the time."""
        is_cancelled.wait(random.gammavariate(self.shape, self.mean / self.shape))


class Drive(TakeTime):
    """Drive along an edge, and read the battery when the robot is there."""

    def __init__(self, mean, shape, drained):
        super().__init__(mean, shape)
        self.drained = drained

    def __call__(self, place, is_cancelled):
        """Drive; return the transition for what is left in the battery."""
        super().__call__(is_cancelled)
        edge = place[len("Drive_") :]
        return ("Drain_" if random.random() < self.drained else "Arrive_") + edge
