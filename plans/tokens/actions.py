"""The load of the thesis's scaling experiments (6.1), and none at all."""


def loop(place, is_cancelled):
    """Four rounds of an addition and a sleep of 0.2 s."""
    total = 0
    for number in range(4):
        total += number
        if is_cancelled.wait(0.2):
            return None
    return TRANSITIONS.get(place)


def instant(place):
    """Return at once."""
    return TRANSITIONS.get(place)


TRANSITIONS = {"p1": "t1", "p2": "t2", "p3": "t3", "p5": "t4", "p7": "t7"}
"""What follows in each place; in p6 the policy decides."""
