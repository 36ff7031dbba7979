#!/usr/bin/env python3
"""A place server as those of the thesis are: a node for each place, in the robot's namespace, named
as the server."""

import actionlib
import rospy

from gspn_framework_package.msg import ExecGSPNAction, ExecGSPNFeedback, ExecGSPNResult


class Place:
    def __init__(self):
        self.server = actionlib.SimpleActionServer(
            rospy.get_name(), ExecGSPNAction, self.execute, auto_start=False
        )
        self.server.start()

    def execute(self, goal):
        self.server.publish_feedback(ExecGSPNFeedback([1]))
        while goal.place == "p2" and not rospy.is_shutdown():  # works until it is called off
            if self.server.is_preempt_requested():
                self.server.set_preempted()
                return
            rospy.sleep(0.05)
        self.server.set_succeeded(ExecGSPNResult("t1"))


if __name__ == "__main__":
    rospy.init_node("place")
    place = Place()
    rospy.spin()
