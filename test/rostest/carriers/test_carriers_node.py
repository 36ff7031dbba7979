#!/usr/bin/env python3
"""Teams that Zenoh connects: robots on several masters and without ROS, with keys."""

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

from meeting import WORK, meeting_of
from waiting import PATIENCE, wait_for

from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.msg import Agreement
from gspn_framework_package.team.keys import NewMember, make_team

GSPN = [sys.executable, "-m", "gspn_framework_package"]


class CarriersTest(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)
        self.keys = os.path.join(self.folder, "keys")
        self.endpoint = "tls/127.0.0.1:%d" % free_port()
        self.told, self.talk = [], []
        rospy.Subscriber("/robot_2/activity", String, self.told.append)
        rospy.Subscriber("/gspn_agreement", Agreement, self.talk.append)

    def write(self, robots, **more):
        """A plan for so many robots that talk through Zenoh, and a router with their keys."""
        plan = {**meeting_of(robots), "transport": "zenoh", **more}
        for name, text in (("plan.json", json.dumps(plan)), ("work.py", WORK)):
            with open(os.path.join(self.folder, name), "w") as file:
                file.write(text)
        members = [NewMember(robot, "robot") for robot in plan["robots"]]
        members += [NewMember("ann", "operator"), NewMember("hub", "router", ("127.0.0.1",))]
        make_team(self.keys, members, 2)
        self.start(*GSPN, "router", "--listen", self.endpoint, "--keys", self.keys_of("hub"))

    def keys_of(self, name):
        return os.path.join(self.keys, name)

    def log(self, robot):
        return os.path.join(self.folder, "mixed", robot + ".jsonl")

    def start(self, *words, **environment):
        process = subprocess.Popen(words, start_new_session=True, env={**os.environ, **environment})
        self.addCleanup(self.end, process)
        return process

    def launch(self, file, *words, **environment):
        return self.start(
            "roslaunch", "gspn_framework_package", file, "plan:=" + self.folder, "run:=mixed",
            "log_dir:=" + self.folder, "router:=" + self.endpoint, *words, **environment,
        )  # fmt: skip

    def end(self, process):
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def await_team(self, *robots):
        def statuses():
            keys = ["--connect", self.endpoint, "--keys", self.keys_of("ann")]
            done = subprocess.run(
                [*GSPN, "status", *keys, "--json"],
                stdout=subprocess.PIPE,
                text=True,
                timeout=30 * PATIENCE,
            )
            return set(json.loads(done.stdout)) if done.returncode == 0 else set()

        wait_for(lambda: statuses() == set(robots), 60, "the robots as one team")

    def let_them_meet(self, *processes):
        with open(os.path.join(self.folder, "open"), "w"):
            pass
        for process in processes:
            self.assertEqual(process.wait(60), 0)

    def check(self, *robots):
        self.assertIsNone(verify([read_log(self.log(robot)) for robot in robots]).violation)
        # what a robot with ROS does is published on its master; what the robots agree on is not
        wait_for(lambda: any(seen(m)["finished"] for m in self.told), 10, "the end on ROS")
        self.assertIn("Look", [seen(message)["place"] for message in self.told])
        self.assertEqual(self.talk, [])

    def test_robots_on_two_masters_and_one_without_ros_are_a_team(self):
        self.write(3, synchronisation="partial")
        agent = self.start(
            *GSPN, "agent", self.folder, "--robot", "robot_1", "--connect", self.endpoint,
            "--keys", self.keys_of("robot_1"), "--run", "mixed", "--log", self.log("robot_1"),
        )  # fmt: skip
        port = free_port()
        self.start("rosmaster", "--core", "-p", str(port))
        nodes = [
            self.launch("robot.launch", "robot:=robot_2", "keys:=" + self.keys_of("robot_2")),
            self.launch(
                "robot.launch", "robot:=robot_3", "keys:=" + self.keys_of("robot_3"),
                ROS_MASTER_URI="http://localhost:%d" % port,
            ),
        ]  # fmt: skip
        self.await_team("robot_1", "robot_2", "robot_3")
        self.let_them_meet(agent, *nodes)
        self.check("robot_1", "robot_2", "robot_3")

    def test_a_launched_team_takes_the_transport_of_its_plan_and_each_robot_its_keys(self):
        self.write(2)
        team = self.launch("team.launch", "robots:=2", "keys:=" + self.keys)
        self.await_team("robot_1", "robot_2")
        self.let_them_meet(team)
        self.check("robot_1", "robot_2")


def seen(message):
    return json.loads(message.data)


def free_port():
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        return there.getsockname()[1]


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_carriers_node", anonymous=True)
    rostest.rosrun("gspn_framework_package", "carriers", CarriersTest)
