#!/usr/bin/env python3
"""The warehouse as its launch file starts it: an order is delivered; robots stop while a person is
in the room, and go on."""

import json
import os
import shutil
import sys
import unittest

import rospy
import rostest
from std_msgs.msg import Bool, String

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from waiting import wait_for

from gspn_framework_package.msg import FiredTransition

PATIENCE = 180
"""Seconds; far more than is needed."""


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


if __name__ == "__main__":
    rospy.init_node("test_warehouse")
    rostest.rosrun("gspn_framework_package", "warehouse", __name__)
