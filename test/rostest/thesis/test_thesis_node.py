#!/usr/bin/env python3
"""The topic and the services of the thesis, for a team that runs its input file on its place
servers."""

import ast
import os
import sys
import unittest

import rospy

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from waiting import wait_for

from gspn_framework_package.msg import GSPNFiringData
from gspn_framework_package.srv import CurrentPlace, FireSyncTransition


def call(service, service_class, *arguments):
    rospy.wait_for_service(service, 30)
    return rospy.ServiceProxy(service, service_class)(*arguments)


def answer(number):
    try:
        place = call("/robot_%d/current_place_robot_%d" % (number, number), CurrentPlace)
    except rospy.ServiceException:  # its node does not answer yet
        return None
    return place.current_place, place.current_status, place.robot_id


class ThesisTest(unittest.TestCase):
    def test_the_team_speaks_as_the_thesis_does(self):
        heard = []
        rospy.Subscriber("/TRANSITIONS_FIRED", GSPNFiringData, heard.append)
        for number in (1, 2):
            wait_for(
                lambda: answer(number) == ("p2", "DOING", number), 60, "robot_%d in p2" % number
            )
        for number, done in ((1, 3), (2, 4)):
            flag = call(
                "/robot_%d/fire_sync_transition_%d" % (number, number), FireSyncTransition, "p1"
            )
            self.assertEqual(flag.success_flag, "SUCCESS")
            fired = wait_for(
                lambda: next(
                    (m for m in heard if m.robot_id == number and "'done': %d" % done in m.marking),
                    None,
                ),
                30,
                "the next firing of robot_%d" % number,
            )
            self.assertEqual(fired.transition, "t1")
            self.assertEqual(ast.literal_eval(fired.marking), {"p1": 0, "p2": 2, "done": done})
            self.assertGreater(int(fired.timestamp), 0)
        refused = call("/robot_1/fire_sync_transition_1", FireSyncTransition, "nowhere")
        self.assertIn("nowhere", refused.success_flag)


if __name__ == "__main__":
    import rostest

    rospy.init_node("thesis_test")
    rostest.rosrun("gspn_framework_package", "thesis", ThesisTest)
