"""A plan of robots that meet, and its functions: each looks until the file ``open`` is there."""


def meeting_of(robots):
    """The plan for so many robots."""
    return {
        "net": {
            "places": [{"name": "Look", "tokens": robots}, {"name": "Wait"}, {"name": "Home"}],
            "transitions": [{"name": "seen"}, {"name": "meet"}],
            "arcs": [
                {"from": "Look", "to": "seen"},
                {"from": "seen", "to": "Wait"},
                {"from": "Wait", "to": "meet", "weight": robots},
                {"from": "meet", "to": "Home", "weight": robots},
            ],
        },
        "actions": {"Look": "work.look", "Wait": None, "Home": None},
        "robots": {"robot_%d" % n: "Look" for n in range(1, robots + 1)},
        "until": "Home >= %d" % robots,
    }


WORK = """
import os

GATE = os.path.join(os.path.dirname(__file__), "open")


def look(is_cancelled):
    while not os.path.exists(GATE) and not is_cancelled.wait(0.02):
        pass
"""
