#!/usr/bin/env python3
"""A team on a clock that is slow, fast, or set back: the same plan comes to the same end."""

import os
import sys
from collections import Counter

import rospy
import rostest

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from robots import RobotTestCase
from simulated_clock import SimulatedClock
from waiting import PATIENCE, wait_for

ACTIONS = """
def work(is_cancelled):
    is_cancelled.wait(0.4)

def never_ends(is_cancelled):
    is_cancelled.wait(600)
"""

LAPS = 4

PLAN = {
    "net": {
        "places": [{"name": "Work"}, {"name": "Stuck"}, {"name": "Laps"}],
        "transitions": [
            {"name": "worked", "timed": True, "servers": None},
            {"name": "given_up", "timed": True, "servers": None},
        ],
        "arcs": [
            {"from": "Work", "to": "worked"},
            {"from": "worked", "to": "Stuck"},
            {"from": "Stuck", "to": "given_up"},
            {"from": "given_up", "to": "Work"},
            {"from": "given_up", "to": "Laps"},
        ],
    },
    "actions": {"Work": "actions.work", "Stuck": "actions.never_ends"},
    "resource_places": ["Laps"],
    "robots": {"robot_1": "Work", "robot_2": "Work"},
    "timeout": {"Work": 0.8, "Stuck": 0.4},
    "on_failure": {"Stuck": "fire given_up"},
    "until": "Laps >= %d" % LAPS,
}


class TeamClockTest(RobotTestCase):
    @classmethod
    def setUpClass(cls):
        cls.clock = SimulatedClock()

    def start(self, rate):
        self.clock.rate = rate
        return self.team(PLAN, ["robot_1", "robot_2"], actions=ACTIONS).start()

    def end(self, team):
        """Wait for the end of the run. :returns: why actions failed, by the log."""
        for robot in team:
            self.assertEqual(robot.exit_code(60 * PATIENCE), 0, robot.said())
        self.assertIsNone(team.verify())
        moves = Counter(team["robot_1"].logged_transitions())
        self.assertEqual(moves["given_up"], LAPS)
        self.assertIn(moves["worked"] - LAPS, (0, 1))
        entries = [
            entry for record in team["robot_1"].log().records for entry in record.get("entries", ())
        ]
        self.assertFalse([e for e in entries if e["entry"] in ("evict", "leave")])
        return Counter(e["reason"] for e in entries if e["entry"] == "failed")

    def test_a_slow_clock_neither_ends_actions_early_nor_evicts_robots(self):
        self.assertEqual(self.end(self.start(0.2)), {"timeout": LAPS})

    def test_a_fast_clock_comes_to_the_same_end(self):
        self.assertEqual(self.end(self.start(5.0)), {"timeout": LAPS})

    def test_a_clock_that_is_set_back_comes_to_the_same_end(self):
        team = self.start(1.0)
        wait_for(lambda: "given_up" in team.transitions(), 60, "the first lap")
        self.clock.now -= 500.0
        self.assertEqual(self.end(team), {"timeout": LAPS})


if __name__ == "__main__":
    rospy.init_node("test_team_clock")
    rostest.rosrun("gspn_framework_package", "team_clock", __name__)
