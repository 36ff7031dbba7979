"""What the robots do where there is no ROS: their actions only take their time."""

import random


class TakeTime:
    """Does a task, charges, or is carried to a dock."""

    def __init__(self, seconds, shape):
        self.seconds = seconds
        self.shape = shape

    def __call__(self, is_cancelled):
        """Take the time."""
        is_cancelled.wait(random.gammavariate(self.shape, self.seconds / self.shape))


class Drive(TakeTime):
    """Drives along an edge, and reads the battery there."""

    def __init__(self, seconds, shape, drained, arrive, drain):
        super().__init__(seconds, shape)
        self.drained = drained
        self.arrive = arrive
        self.drain = drain

    def __call__(self, is_cancelled):
        """Drive; return the transition for what is left in the battery."""
        super().__call__(is_cancelled)
        return self.drain if random.random() < self.drained else self.arrive
