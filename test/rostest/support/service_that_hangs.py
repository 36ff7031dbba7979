"""A node with a service that takes any request and never answers; its name is the argument."""

import sys
import time

import rospy
from std_srvs.srv import Trigger

rospy.init_node("service_that_hangs")
service = rospy.Service(sys.argv[1], Trigger, lambda request: time.sleep(600))
rospy.spin()
