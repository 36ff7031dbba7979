"""A plan of two robots that meet, and its functions: each looks until the file ``open`` is there."""

PLAN = {
    "net": {
        "places": [{"name": "Look", "tokens": 2}, {"name": "Wait"}, {"name": "Home"}],
        "transitions": [{"name": "seen"}, {"name": "meet"}],
        "arcs": [
            {"from": "Look", "to": "seen"},
            {"from": "seen", "to": "Wait"},
            {"from": "Wait", "to": "meet", "weight": 2},
            {"from": "meet", "to": "Home", "weight": 2},
        ],
    },
    "actions": {"Look": "work.look", "Wait": None, "Home": None},
    "robots": {"robot_1": "Look", "robot_2": "Look"},
    "until": "Home >= 2",
}
WORK = """
import os

GATE = os.path.join(os.path.dirname(__file__), "open")


def look(is_cancelled):
    while not os.path.exists(GATE) and not is_cancelled.wait(0.02):
        pass
"""
