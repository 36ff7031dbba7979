#!/usr/bin/env python3
"""Four robots drive in the critical room by nodes of the user, which see each other by their scans
alone."""

import json
import math
import os
import sys
import unittest

import actionlib
import rospy
import rostest
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose, PoseWithCovarianceStamped, Quaternion
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from std_msgs.msg import String

DEADLINE = 90.0 * float(os.environ.get("GSPN_PATIENCE", "1"))
"""Seconds of world time, and of wall time until a server is there; far more than the test needs."""

GOALS = {
    "robot_1": (1.5, -1.5),
    "robot_2": (-0.5, -1.5),
    "robot_3": (-1.5, 1.5),
    "robot_4": (0.5, 1.5),
}
"""Two and two meet head-on: without their scans they would touch."""


class TestNavigators(unittest.TestCase):
    def test_four_robots_that_meet_arrive_and_touch_nothing(self):
        clients = {}
        for robot, (x, y) in GOALS.items():
            client = actionlib.SimpleActionClient("/%s/move_base" % robot, MoveBaseAction)
            self.assertTrue(client.wait_for_server(rospy.Duration(DEADLINE)), robot)
            goal = MoveBaseGoal()
            goal.target_pose.header.frame_id = "map"
            goal.target_pose.pose = Pose(Point(x, y, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
            clients[robot] = (client, goal)
        for client, goal in clients.values():
            client.send_goal(goal)
        for robot, (client, goal) in clients.items():
            self.assertTrue(client.wait_for_result(rospy.Duration(3 * DEADLINE)), robot)
            self.assertEqual(client.get_state(), GoalStatus.SUCCEEDED, robot)
            topic = "/%s/amcl_pose" % robot
            at = rospy.wait_for_message(topic, PoseWithCovarianceStamped, DEADLINE).pose.pose
            to = goal.target_pose.pose.position
            self.assertLess(math.hypot(at.position.x - to.x, at.position.y - to.y), 0.15)
        report = json.loads(rospy.wait_for_message("/world/referee", String, DEADLINE).data)
        touches = (report["contacts_between_robots"], report["contacts_with_solids"])
        self.assertEqual(touches, (0, 0))
        self.assertGreater(report["distance"], 4 * 2.0)


if __name__ == "__main__":
    rospy.init_node("test_navigators")
    rostest.rosrun("gspn_framework_package", "navigators", TestNavigators, sys.argv)
