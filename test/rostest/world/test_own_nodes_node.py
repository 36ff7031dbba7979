#!/usr/bin/env python3
"""A robot of the world as Gazebo has it: no move_base and no amcl but those of the user, and the
topics and frames that they need."""

import sys
import unittest

import rosgraph
import rospy
import rostest
from tf2_msgs.msg import TFMessage


class TestOwnNodes(unittest.TestCase):
    def test_navigation_and_localisation_are_left_to_others(self):
        frames = set()

        def heard(message):
            frames.update((t.header.frame_id, t.child_frame_id) for t in message.transforms)

        rospy.Subscriber("/tf", TFMessage, heard)
        for _ in range(5):
            rospy.wait_for_message("/tf", TFMessage, 60)
        self.assertEqual(frames, {("robot_1/odom", "robot_1/base_footprint")})
        published, subscribed, services = rosgraph.Master("/test").getSystemState()
        names = {name for name, _ in published + subscribed + services}
        theirs = {name for name in names if "move_base" in name or "amcl" in name}
        self.assertEqual(theirs, set())
        self.assertLessEqual({"/robot_1/odom", "/robot_1/scan", "/robot_1/cmd_vel"}, names)


if __name__ == "__main__":
    rospy.init_node("test_own_nodes")
    rostest.rosrun("gspn_framework_package", "own_nodes", TestOwnNodes, sys.argv)
