"""The patrol without a world: each action takes its time, and the temperature is drawn."""

import random

CHECK_SECONDS = (0.8, 1.6)
HOT = 0.15
"""How often a location is found too hot."""


def check_temperature(place, is_cancelled, feedback):
    """Sweep the location of the place's name, then say whether it is too hot there."""
    for second in range(2):
        feedback(second)
        if is_cancelled.wait(random.uniform(*CHECK_SECONDS) / 2):
            return None
    number, location = int(place[1 : place.index(":")]), place[-2:]
    first = (number // 4) * 6
    if random.random() < HOT:
        return "t%d:Temperature_High_%s" % (first + 1, location)
    return "t%d:Temperature_Low_%s" % (first + 3, location)


def alarm(is_cancelled):
    """Sound the alarm; the place's only transition follows."""
    is_cancelled.wait(0.5)


def decide(is_cancelled):
    """Think for a moment, and leave it to the policy."""
    is_cancelled.wait(0.1)


def wait(is_cancelled):
    """Wait in the bay beside the location."""
    is_cancelled.wait(0.5)
