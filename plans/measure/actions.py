"""Measure a temperature, sound the alarm, restart: each takes its time."""

import random


def measure(is_cancelled):
    """Take a measurement; one in six is too high."""
    if is_cancelled.wait(random.uniform(0.5, 1.0)):
        return None
    return "T2" if random.random() < 1 / 6 else "T1"


def alarm(is_cancelled):
    """Sound the alarm; T3 follows."""
    is_cancelled.wait(0.5)


def restart(is_cancelled):
    """Restart the robot's system, to keep it fresh; T6 follows."""
    is_cancelled.wait(1.5)
