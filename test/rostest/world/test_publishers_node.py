#!/usr/bin/env python3
"""A robot of the user beside Debian's robot_state_publisher and joint_state_publisher, and in rviz
where that is installed."""

import os
import shutil
import subprocess
import sys
import tempfile
import threading
import unittest

import rospy
import rostest
from geometry_msgs.msg import Twist
from PIL import ImageGrab, features
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from waiting import wait_for

SCAN = (255, 0, 0)
"""The colour of the scan in cart.rviz."""

DEADLINE = 60.0
"""Seconds of wall time on an idle machine; far more than any test here needs."""


class Frames:
    """The transforms that anybody publishes: child -> the parents, and the last rotation."""

    def __init__(self):
        self.parents = {}
        self.turned = {}
        self._lock = threading.Lock()
        for topic in ("/tf", "/tf_static"):
            rospy.Subscriber(topic, TFMessage, self._heard, queue_size=100)

    def _heard(self, message):
        with self._lock:
            for transform in message.transforms:
                child = transform.child_frame_id
                self.parents.setdefault(child, set()).add(transform.header.frame_id)
                self.turned[child] = transform.transform.rotation

    def now(self):
        with self._lock:
            return dict(self.parents)


class TestPublishers(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.frames = Frames()

    def test_1_every_frame_has_one_parent_and_the_wheels_turn(self):
        expected = {
            "odom": "map",
            "base_footprint": "robot_1/odom",
            "base_link": "robot_1/base_footprint",
            "base_scan": "robot_1/base_link",
            "imu_link": "robot_1/base_link",
            "mast": "robot_1/base_link",
            "wheel_left_link": "robot_1/base_link",
            "wheel_right_link": "robot_1/base_link",
        }
        wanted = {"robot_1/" + child: {parent} for child, parent in expected.items()}
        wait_for(lambda: set(self.frames.now()) >= set(wanted), DEADLINE, "all frames")
        joints = []
        rospy.Subscriber("/robot_1/all/joint_states", JointState, joints.append)
        wait_for(
            lambda: joints and len(joints[-1].name) == 3, DEADLINE, "the joints of mast and wheels"
        )
        before = self.frames.turned["robot_1/wheel_left_link"]
        hand = rospy.Publisher("/robot_1/cmd_vel", Twist, queue_size=1)
        twist = Twist()
        twist.linear.x = 0.2

        def turns():
            hand.publish(twist)
            now = self.frames.turned["robot_1/wheel_left_link"]
            return (
                abs(now.x * before.x + now.y * before.y + now.z * before.z + now.w * before.w) < 0.5
            )

        wait_for(turns, DEADLINE, "a wheel that turns")
        self.assertEqual(self.frames.now(), wanted)

    def test_2_rviz_shows_the_robot_and_its_scan(self):
        for program in ("rviz", "Xvfb"):
            if shutil.which(program) is None:
                self.skipTest("%s is not installed" % program)
        if not features.check("xcb"):
            self.skipTest("Pillow cannot take a picture of a display here")
        reading, writing = os.pipe()
        server = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "800x600x24"]
        with tempfile.TemporaryFile() as said:
            self.start(server, said, pass_fds=(writing,))
            os.close(writing)
            with os.fdopen(reading) as told:
                display = ":" + told.readline().strip()
            rviz = self.start(
                ["rviz", "-d", os.path.join(HERE, "cart.rviz")],
                said,
                env={**os.environ, "DISPLAY": display},
            )

            def shown():
                self.assertIsNone(rviz.poll(), "rviz has ended")
                picture = ImageGrab.grab(xdisplay=display)
                pixels = list(picture.convert("RGB").getdata())
                body = sum(r < 60 and g > 90 and b < 60 for r, g, b in pixels)
                return body > 300 and pixels.count(SCAN) > 300

            wait_for(shown, DEADLINE, "the picture of the robot and its scan")

    def start(self, words, said, **options):
        """Start a program, which ends with the test."""
        program = subprocess.Popen(words, stdout=said, stderr=said, **options)
        self.addCleanup(program.wait)
        self.addCleanup(program.terminate)
        return program


if __name__ == "__main__":
    rospy.init_node("test_publishers")
    rostest.rosrun("gspn_framework_package", "publishers", TestPublishers, sys.argv)
