#!/usr/bin/env python3
"""A robot with ROS and one without run a plan together; Zenoh carries their messages."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import unittest

import rospy
from std_msgs.msg import String

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from meeting import PLAN, WORK
from waiting import wait_for

from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.history import verify
from gspn_framework_package.msg import Agreement


class CarriersTest(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)
        for name, text in (("plan.json", json.dumps(PLAN)), ("work.py", WORK)):
            with open(os.path.join(self.folder, name), "w") as file:
                file.write(text)
        with socket.socket() as there:
            there.bind(("127.0.0.1", 0))
            self.endpoint = "tcp/127.0.0.1:%d" % there.getsockname()[1]

    def log(self, robot):
        return os.path.join(self.folder, "mixed", robot + ".jsonl")

    def start(self, *words):
        process = subprocess.Popen(words, start_new_session=True)
        self.addCleanup(self.end, process)
        return process

    def end(self, process):
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def test_a_robot_with_ros_and_one_without_are_a_team(self):
        told, talk = [], []
        rospy.Subscriber("/robot_2/activity", String, told.append)
        rospy.Subscriber("/gspn_agreement", Agreement, talk.append)
        gspn = [sys.executable, "-m", "gspn_framework_package"]
        agent = self.start(
            *gspn, "agent", self.folder, "--robot", "robot_1", "--listen", self.endpoint,
            "--run", "mixed", "--log", self.log("robot_1"),
        )  # fmt: skip
        wait_for(lambda: os.path.exists(self.log("robot_1")), 60, "the agent")
        node = self.start(
            "roslaunch", "gspn_framework_package", "robot.launch", "plan:=" + self.folder,
            "robot:=robot_2", "run:=mixed", "log_dir:=" + self.folder, "transport:=zenoh",
            "router:=" + self.endpoint,
        )  # fmt: skip

        def statuses():
            asked = [*gspn, "status", "--connect", self.endpoint, "--json"]
            done = subprocess.run(asked, capture_output=True, text=True, timeout=30)
            return set(json.loads(done.stdout)) if done.returncode == 0 else set()

        wait_for(lambda: statuses() == {"robot_1", "robot_2"}, 60, "the robots as one team")
        with open(os.path.join(self.folder, "open"), "w"):
            pass
        self.assertEqual(agent.wait(60), 0)
        wait_for(lambda: node.poll() is not None, 60, "the end of the node")
        logs = [read_log(self.log(robot)) for robot in ("robot_1", "robot_2")]
        self.assertIsNone(verify(logs).violation)
        # what the robot with ROS does is told on ROS; what the robots agree on is not
        self.assertIn("Look", [json.loads(message.data)["place"] for message in told])
        self.assertEqual(talk, [])


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_carriers_node", anonymous=True)
    rostest.rosrun("gspn_framework_package", "carriers", CarriersTest)
