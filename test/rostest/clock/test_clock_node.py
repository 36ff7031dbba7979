#!/usr/bin/env python3
"""Actions while simulated time is paused, fast, and goes back."""

import os
import queue
import sys
import threading
import time
import unittest
from functools import partial

import actionlib
import rospy
from actionlib.msg import TestAction

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [HERE, os.path.join(os.path.dirname(HERE), "support")]

from simulated_clock import SimulatedClock
from waiting import PATIENCE, wait_for
from worker import PATIENT, Worker, plan_in

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.model.action import ServerAction
from gspn_framework_package.ros.action_caller import ActionCaller
from gspn_framework_package.ros.action_targets import action_targets

plan_of = partial(plan_in, HERE)

SILENT = 1.0 * PATIENCE
"""After so long without a status (s) a server counts as dead. Python servers send five a second."""


class ClockTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.clock = SimulatedClock()

    def setUp(self):
        self.clock.rate = 1.0
        self.ended, self.faults = queue.Queue(), []
        self.release = threading.Event()
        self.name = "/" + self._testMethodName
        self.server = actionlib.SimpleActionServer(self.name, TestAction, self.act, False)
        self.server.start()

    def act(self, goal):
        while not self.release.wait(0.01) and not self.server.is_preempt_requested():
            pass
        if self.server.is_preempt_requested():
            self.server.set_preempted()
        else:
            self.server.set_succeeded()

    def robot(self, **options):
        action = ServerAction("actionlib/TestAction", self.name)
        plan = plan_of({"P1": action}, timeouts=options.pop("timeouts", {}))
        self.worker = Worker()
        self.caller = ActionCaller(
            "robot_1",
            action_targets(plan, "robot_1", "/"),
            plan.timeout,
            self.worker.put,
            self.ended.put,
            patience=PATIENT._replace(**options),
            fault=self.faults.append,
        )
        self.worker.drive(self.caller)
        self.addCleanup(self.worker.close)

    def send(self, visit, **options):
        command = StartAction("robot_1", "P1", 1, visit, 1, **options)
        self.worker.put(self.caller.start, command, time.monotonic())

    def is_under_way(self):
        goal = self.caller._goal
        return goal is not None and bool(goal.acknowledged_by)

    def test_goals_go_on_when_time_goes_back(self):
        self.robot(status=SILENT)
        self.send(1)
        wait_for(self.is_under_way, what="the server to take the goal")
        self.clock.now = 500.0
        wait_for(lambda: rospy.get_time() < 900.0, what="the clock to go back")
        wait_for(
            lambda: rospy.get_time() > 501.0 + SILENT, what="longer than the server may be silent"
        )
        self.release.set()
        self.assertEqual(self.ended.get(timeout=20 * PATIENCE).outcome, "succeeded")
        self.release.clear()
        self.send(2)
        wait_for(self.is_under_way, what="the server to take the next goal")
        sent = rospy.get_time()
        wait_for(
            lambda: rospy.get_time() > sent + 0.5 + SILENT,
            what="longer than the server may be silent",
        )
        self.release.set()
        self.assertEqual(self.ended.get(timeout=20 * PATIENCE).outcome, "succeeded")
        self.assertEqual(len(self.faults), 1, self.faults)
        self.assertRegex(self.faults[0], r"time went back by \d{3}\.\d s \(/clock\)")

    def test_a_timeout_passes_by_simulated_time(self):
        self.robot(timeouts={"P1": 30.0})
        self.send(1)
        wait_for(self.is_under_way, what="the server to take the goal")
        self.clock.rate = 100.0
        self.assertEqual(self.ended.get(timeout=15).outcome, "timeout")

    def test_a_paused_simulation_is_neither_silence_nor_the_time_of_an_action(self):
        self.robot(timeouts={"P1": 0.6}, status=SILENT)
        self.send(1)
        wait_for(self.is_under_way, what="the server to take the goal")
        self.clock.rate = 0.0
        paused = time.monotonic()
        wait_for(
            lambda: time.monotonic() > paused + 0.5 + SILENT,
            what="longer than the action may take, and its server may be silent",
        )
        self.assertTrue(self.ended.empty())
        self.clock.rate = 1.0
        self.assertEqual(self.ended.get(timeout=20 * PATIENCE).outcome, "timeout")

    def test_the_delay_of_an_attempt_passes_by_simulated_time(self):
        self.robot()
        self.release.set()
        self.clock.rate = 100.0
        self.send(1, delay=30.0)
        self.assertEqual(self.ended.get(timeout=15).outcome, "succeeded")


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_clock")
    rostest.rosrun("gspn_framework_package", "clock", ClockTest)
