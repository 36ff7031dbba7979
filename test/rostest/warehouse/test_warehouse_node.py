#!/usr/bin/env python3
"""The warehouse as its launch file starts it: an order is delivered; robots stop while a person is
in the room, and go on."""

import contextlib
import json
import os
import shutil
import sys
import time
import unittest

import rospy
import rostest
from std_msgs.msg import Bool, String

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from waiting import wait_for

import gspn
from gspn_framework_package.execution.team_tasks import OUTCOMES_OF_TASKS
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.srv import Command

PATIENCE = 180
"""Seconds; far more than is needed."""

DELAY = 0.5
"""Seconds that each message takes while the network is slow."""


class Warehouse(unittest.TestCase):
    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(rospy.get_param("/log_dir"), ignore_errors=True)

    def test_an_order_is_done_and_a_person_stops_a_robot_that_then_goes_on(self):
        ordered, receipts, fired, told, seen, report = set(), set(), [], [], [], {}
        for topic, kind, heard in (
            ("/orders", String, lambda m: ordered.add(json.loads(m.data)["id"])),
            ("/delivered", String, lambda m: receipts.add(m.data)),
            ("/fired_transitions", FiredTransition, fired.append),
            ("/person", Bool, lambda m: told.append(m.data)),
            ("/world/state", String, lambda m: seen.extend(json.loads(m.data)["people"])),
            ("/world/referee", String, lambda m: report.update(json.loads(m.data))),
        ):
            rospy.Subscriber(topic, kind, heard, queue_size=1000)

        def stopped_and_released():
            stopped = set()
            for firing in list(fired):
                event = firing.transition.split(".")[-1]
                if event == "person":
                    stopped.update(firing.robots)
                elif event == "clear" and stopped & set(firing.robots):
                    return True
            return False

        wait_for(lambda: receipts, PATIENCE, "a delivery")
        wait_for(stopped_and_released, PATIENCE, "a robot that stops and goes on")
        self.assertLessEqual(receipts, ordered)
        self.assertIn(True, told)
        wait_for(lambda: seen, PATIENCE, "the person in the state of the world")
        self.assertEqual(set(seen[0]), {"at", "radius", "color"})
        wait_for(lambda: report.get("visits_of_people"), PATIENCE, "the referee's report")
        self.assertEqual(report["contacts_with_people"], 0)

    def test_robots_hear_late_on_a_slow_network_and_the_work_goes_on(self):
        receipts, active = [], []
        rospy.Subscriber("/delivered", String, receipts.append, queue_size=100)
        rospy.Subscriber(
            "/world/faults",
            String,
            lambda m: active.append([f["fault"] for f in json.loads(m.data)["active"]]),
        )
        order = rospy.ServiceProxy("/world/order_fault", Command)
        order.wait_for_service(PATIENCE)
        for robot in (1, 2):
            rospy.wait_for_service("/robot_%d/command" % robot, PATIENCE)
        team = gspn.Team("/")
        self.addCleanup(team.close)

        def is_paused():
            status = wait_for(lambda: team.status()["/robot_2"], PATIENCE, "robot_2's status")
            return status["paused"]

        def seconds_to_hear():
            """How long robot_2 takes to hear of an order that robot_1 may decide alone."""
            begin = time.monotonic()
            team.pause()
            wait_for(is_paused, PATIENCE, "a pause of robot_2")
            took = time.monotonic() - begin
            team.resume()
            wait_for(lambda: not is_paused(), PATIENCE, "the end of the pause of robot_2")
            return took

        def answers():  # a robot that has just started, on a busy machine, may not yet
            with contextlib.suppress(GspnError):
                return bool(seconds_to_hear())
            return False

        wait_for(answers, PATIENCE, "an answer of the team")
        slow = {"delay": DELAY}
        self.assertTrue(order("network", "", json.dumps(slow), "").success)
        wait_for(lambda: active and active[-1] == ["network"], PATIENCE, "the fault")
        wait_for(lambda: seconds_to_hear() >= DELAY, PATIENCE, "a slow network")
        self.assertGreaterEqual(min(seconds_to_hear() for _ in range(3)), DELAY)
        ended = []
        team.on_task_ended(ended.append)
        del receipts[:]
        wait_for(lambda: receipts, PATIENCE, "a delivery with the slow network")
        wait_for(lambda: ended, PATIENCE, "word of a task that ended")
        self.assertIn(ended[0]["outcome"], OUTCOMES_OF_TASKS)
        self.assertTrue(order("network", "", json.dumps({**slow, "lasts": 0}), "").success)
        wait_for(lambda: seconds_to_hear() < DELAY, PATIENCE, "a fast network")


if __name__ == "__main__":
    rospy.init_node("test_warehouse")
    rostest.rosrun("gspn_framework_package", "warehouse", __name__)
