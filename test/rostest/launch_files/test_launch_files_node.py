#!/usr/bin/env python3
"""The teams that launch files start do what the files promise."""

import json
import os
import shutil
import signal
import subprocess
import sys
import unittest
import urllib.request
import xmlrpc.client
from collections import Counter

import rosgraph
import rospy

HERE = os.path.dirname(os.path.abspath(__file__))
TESTS = os.path.dirname(HERE)
sys.path[:0] = [os.path.join(TESTS, "support"), os.path.join(TESTS, "..", "..")]

from robots import chain, write_plan
from waiting import PATIENCE, wait_for

from benchmarks.harness.ports import free_port
from gspn_framework_package.cli.main import main
from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.srv import Command, GetState


class LaunchFilesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.moves = Counter()
        cls.subscriber = rospy.Subscriber("/fired_transitions", FiredTransition, cls.on_fired)

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(rospy.get_param("/log_dir"), ignore_errors=True)

    @classmethod
    def on_fired(cls, message):
        cls.moves.update((message.run, robot) for robot in message.robots)

    def wait_for_moves(self, run, robot, number):
        wanted = self.moves[run, robot] + number
        wait_for(lambda: self.moves[run, robot] >= wanted, 40, "moves of %s" % robot)

    def state(self, namespace):
        rospy.wait_for_service(namespace + "/get_state", 20 * PATIENCE)
        return rospy.ServiceProxy(namespace + "/get_state", GetState)()

    def test_a_team_moves_and_a_robot_that_dies_is_started_again_and_goes_on(self):
        run = "team_of_two"
        for robot in ("robot_1", "robot_2"):
            self.wait_for_moves(run, robot, 3)
        before = self.state("/team/robot_2")
        master = rosgraph.Master("/test")
        self.assertTrue(master.lookupNode("/team/robot_2/place_servers"))
        os.kill(self.process("/team/robot_2/executor"), signal.SIGKILL)
        self.wait_for_moves(run, "robot_2", 3)
        after = self.state("/team/robot_2")
        self.assertEqual((before.incarnation, after.incarnation), (0, 1))
        self.assertGreater(after.visit, before.visit)

        # the process that has forked all of them
        executors = [self.process("/team/robot_%d/executor" % number) for number in (1, 2)]
        with open("/proc/%d/stat" % executors[0]) as file:
            parent = int(file.read().rpartition(")")[2].split()[1])
        os.kill(parent, signal.SIGKILL)
        wait_for(
            lambda: not any(os.path.exists("/proc/%d" % executor) for executor in executors),
            40,
            "the end of the robots' processes",
        )
        for robot in ("robot_1", "robot_2"):
            self.wait_for_moves(run, robot, 3)
        self.assertEqual(self.state("/team/robot_2").incarnation, 2)

    def process(self, name):
        """The process id of a node."""
        node = xmlrpc.client.ServerProxy(rosgraph.Master("/test").lookupNode(name))
        return node.getPid("/test")[2]

    def test_hosted_robots_move_each_in_a_namespace_of_its_own(self):
        for number in (1, 2, 3):
            robot = "robot_%d" % number
            self.wait_for_moves("hosted_three", robot, 3)
            self.assertEqual(self.state("/hosted/" + robot).robot, robot)

    def test_robots_may_be_nodes_of_roslaunch(self):
        for number in (1, 2):
            robot = "robot_%d" % number
            self.wait_for_moves("nodes_two", robot, 3)
            self.assertEqual(self.state("/nodes/" + robot).robot, robot)
        parameters = rospy.get_param("/nodes/robot_2/executor")
        self.assertEqual((parameters["number"], parameters["run"]), (2, "nodes_two"))

    def test_two_teams_that_are_launched_at_once_do_not_touch_each_other(self):
        """Each with its page. One is stopped; the other then comes to its own end."""
        folder = rospy.get_param("/log_dir")
        os.makedirs(folder, exist_ok=True)
        gate = os.path.join(folder, "gate")
        plan = {
            "net": chain(["P1", "P2", "P3"]),
            "actions": {"P1": None, "P2": "actions.wait", "P3": None},
            "robots": {"robot_1": "P1", "robot_2": "P1"},
        }
        ends = write_plan(plan, GATED % gate)
        self.addCleanup(shutil.rmtree, ends)
        runs = {"stops": os.path.join(HERE, "plan"), "ends": ends}
        ports = {run: free_port() for run in runs}
        launches = {
            run: subprocess.Popen(
                [
                    "roslaunch",
                    os.path.join(HERE, "team_and_page.launch"),
                    "plan:=" + runs[run],
                    "run:=" + run,
                    "port:=%d" % ports[run],
                    "log_dir:=" + folder,
                ],
                stdout=subprocess.DEVNULL,
            )
            for run in runs
        }
        for launch in launches.values():
            self.addCleanup(self.end, launch)
        for run in runs:
            for number in (1, 2):
                wait_for(
                    lambda: self.state("/%s/robot_%d" % (run, number)).visit > 1,
                    40,
                    "a move of robot %d of %s" % (number, run),
                )
                self.assertEqual(self.status(run, number)["run"], run)
            wait_for(lambda: self.shows_a_run(ports[run]), 60, "the page of " + run)
            self.assertEqual(self.board(ports[run])["status"]["run"], run)

        stop = rospy.ServiceProxy("/ends/robot_1/command", Command)("stop", "", "", "ends")
        self.assertIn("only orders with its key", stop.message, "a team has a key by itself")
        self.assertEqual(main(["stop", "--run", "stops"]), 0, "which the verbs find")
        wait_for(lambda: self.board(ports["stops"])["status"]["ended"], 30, "the end on its page")
        self.assertTrue(self.board(ports["ends"])["status"]["running"])
        self.assertEqual(self.status("ends", 2)["ended"], None)
        with open(gate, "w"):
            pass
        wait_for(
            lambda: self.board(ports["ends"])["status"]["ended"],
            40,
            "the other's own end on its page",
        )
        board = self.board(ports["ends"])
        self.assertEqual((board["status"]["finished"], board["status"]["fault"]), (True, False))
        self.assertFalse(self.board(ports["stops"])["status"]["finished"])

    @staticmethod
    def end(launch):
        launch.send_signal(signal.SIGINT)
        launch.wait(40)

    def status(self, run, number):
        name = "/%s/robot_%d/command" % (run, number)
        return json.loads(rospy.ServiceProxy(name, Command)("status", "", "", run).message)

    def shows_a_run(self, port):
        try:
            return self.board(port)["status"]["running"]
        except OSError:  # nobody serves the page yet
            return False

    def board(self, port):
        with urllib.request.urlopen(
            "http://127.0.0.1:%d/api/poll?id=live" % port, timeout=20 * PATIENCE
        ) as answer:
            return json.load(answer)["snapshot"]["board"]


GATED = """
import os

def wait(is_cancelled):
    while not os.path.exists(%r) and not is_cancelled.wait(0.05):
        pass
"""


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_launch_files")
    rostest.rosrun("gspn_framework_package", "launch_files", LaunchFilesTest)
