#!/usr/bin/env python3
"""Failures of actions on real nodes: every rule of a plan, and servers that are not there."""

import os
import signal
import sys

import rospy
from diagnostic_msgs.msg import DiagnosticArray

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from robots import RobotTestCase, chain, start_node
from waiting import wait_for

ACTIONS = '''
import time
from gspn_framework_package.execution.actions import ActionFailed

calls = {}

def fails_twice(place, attempt):
    """The first two attempts fail."""
    if attempt <= 2:
        raise ActionFailed("attempt %d" % attempt)

def fails(place):
    raise ActionFailed("broken")

def fails_first(place):
    """Only the first call in a place fails."""
    calls[place] = calls.get(place, 0) + 1
    if calls[place] == 1:
        raise ActionFailed("broken")

def slow(is_cancelled):
    is_cancelled.wait(60)

def nonsense(place):
    calls[place] = calls.get(place, 0) + 1
    return "T_no_such_thing\\n" * 100000 if calls[place] == 1 else ""

def good():
    pass

def until_cancelled(is_cancelled):
    is_cancelled.wait(60)
'''


class FailuresTest(RobotTestCase):
    def team(self, plan, robots=("robot_1",), **parameters):
        return super().team(plan, robots, actions=ACTIONS, **parameters)

    def wait_until_failed(self, robot, place):
        """Wait until the robot's action in ``place`` has failed for good."""
        return wait_for(
            lambda: (
                (robot.state().place, robot.state().state) == (place, "Failed")
                and robot.status()["waits_for"]
            ),
            20,
            "%s to have failed in %s" % (robot.name, place),
        )

    def test_11_every_rule(self):
        places = ["retried", "fired", "timed_out", "used_up", "waits", "nonsense", "end"]
        team = self.team(
            {
                "net": chain(places, fired="timed_out", timed_out="used_up"),
                "actions": {
                    "retried": "actions.fails_twice",
                    "fired": "actions.fails",
                    "timed_out": "actions.slow",
                    "used_up": "actions.fails",
                    "waits": "actions.fails_first",
                    "nonsense": "actions.nonsense",
                    "end": None,
                },
                "robots": {"robot_1": "retried"},
                "on_failure": {
                    "retried": {"retry": 2, "delay": 0.1},
                    "fired": "fire T_fired",
                    "timed_out": "fire T_timed_out",
                    "used_up": "retry 1",
                },
                "timeout": {"timed_out": 0.5},
            }
        )
        robot = team.start()["robot_1"]
        diagnostics = []
        rospy.Subscriber("/diagnostics", DiagnosticArray, diagnostics.append)

        waits_for = self.wait_until_failed(robot, "used_up")
        self.assertEqual(robot.logged_transitions(), ["T1", "T_fired", "T_timed_out"])
        self.assertIn("aborted: broken", waits_for)
        self.assertIn("operator", waits_for)
        wait_for(
            lambda: any(
                "gspn robot_1" in status.name and ord(bytes(status.level) or b"\0") == 2
                if isinstance(status.level, bytes)
                else "gspn robot_1" in status.name and status.level == 2
                for message in diagnostics
                for status in message.status
            ),
            what="an error on /diagnostics",
        )
        self.assertEqual(robot.status()["robots"][0]["attempt"], 2)

        answer = robot.command("set_place", argument="waits")
        self.assertTrue(answer.success, answer.message)
        self.wait_until_failed(robot, "waits")
        self.assertTrue(robot.command("retry").success)
        waits_for = self.wait_until_failed(robot, "nonsense")
        self.assertIn("bad result", waits_for)
        self.assertIn("T_no_such_thing", waits_for)
        self.assertLess(len(waits_for), 1000)
        self.assertNotIn("\n", waits_for)
        self.assertLess(os.path.getsize(robot.log_file), 100_000)
        self.assertTrue(robot.command("retry").success)
        self.assertEqual(robot.exit_code(), 0)
        self.assertEqual(robot.logged_transitions()[3:], ["T5", "T6"])

    def test_stop_ends_the_whole_team(self):
        team = self.team(
            {
                "net": chain(["P1", "P2"]),
                "actions": {"P1": "actions.until_cancelled", "P2": None},
                "robots": [
                    {"name": "robot_1", "place": "P1", "actions": {"P1": "actions.fails"}},
                    {"name": "robot_2", "place": "P1"},
                ],
                "on_failure": {"P1": "stop"},
            },
            robots=("robot_1", "robot_2"),
        )
        team.start()
        self.assertEqual([robot.exit_code() for robot in team], [1, 1])
        self.assertIn("the run is over: robot_1: the action of P1 failed", team["robot_2"].said())
        self.assertEqual(team.transitions(), [])

    def test_12_a_server_that_is_not_there_refuses_the_start(self):
        team = self.team(
            {
                "net": chain(["P1", "P2"]),
                "actions": {"P1": {"server": "nobody_serves_this"}, "P2": None},
                "robots": {"robot_1": "P1"},
            },
            server_timeout=1.0,
        )
        robot = team.start()["robot_1"]
        self.assertEqual(robot.exit_code(), 1)
        self.assertIn("there is no action server /robot_1/nobody_serves_this", robot.said())
        self.assertNotIn("Traceback", robot.said())

    def test_12_servers_in_a_node_of_their_own_may_die_and_come_back(self):
        team = self.team(
            {
                "net": chain(["P1", "P2", "P3"]),
                "actions": {"P1": "actions.until_cancelled", "P2": "actions.good", "P3": None},
                "robots": {"robot_1": "P1"},
            },
            place_servers=False,
            server_timeout=2.0,
        )

        def serve():
            return start_node(
                "gspn_place_servers",
                "/robot_1",
                os.path.join(team.folder, "servers.out"),
                "places",
                plan=team.plan,
                robot="robot_1",
            )

        servers = serve()
        self.addCleanup(servers.kill)
        team["robot_1"].parameters["server_timeout"] = 20.0
        robot = team.start()["robot_1"]
        wait_for(
            lambda: robot.state().state == "Doing" and not robot.status()["waits_for"],
            20,
            "the goal to be taken",
        )
        servers.kill()
        waits_for = self.wait_until_failed(robot, "P1")
        self.assertIn("server died", waits_for)
        servers = serve()
        self.addCleanup(servers.kill)
        self.assertTrue(robot.command("retry").success)
        wait_for(
            lambda: robot.state().state == "Doing" and not robot.status()["waits_for"],
            20,
            "the goal to be taken again",
        )
        self.assertTrue(robot.command("set_place", argument="P2").success)
        self.assertEqual(robot.exit_code(), 0)
        servers.send_signal(signal.SIGTERM)
        self.assertEqual(servers.wait(10), 128 + signal.SIGTERM)

    def test_broken_plans_get_one_clear_message_and_an_exit_code(self):
        actions = {"P1": "actions.good", "P2": None}
        good = {"net": chain(["P1", "P2"]), "actions": actions, "robots": {"robot_1": "P1"}}
        wide = chain(["P1", "P2"])
        wide["arcs"][1]["weight"] = 2
        for change, code, message in (
            ({"actions": {"P1": "actions.no_such_function", "P2": None}}, 1, "no_such_function"),
            ({"robots": {"robot_2": "P1"}}, 2, "no robot 'robot_1'"),
            ({"robots": {"robot_1": "P9"}}, 2, "P9"),
            ({"net": wide}, 1, "robots cannot be created or destroyed"),
            (
                {"actions": {"P1": {"type": "no_msgs/XAction", "server": "s"}, "P2": None}},
                2,
                "no_msgs/XAction",
            ),
        ):
            robot = self.team({**good, **change}).start()["robot_1"]
            self.assertEqual(robot.exit_code(), code, robot.said())
            self.assertRegex(robot.said(), message)
            self.assertNotIn("Traceback", robot.said())

    def test_a_parameter_that_does_not_exist_is_an_error(self):
        team = self.team(
            {"net": chain(["P1"]), "actions": {"P1": None}, "robots": {"robot_1": "P1"}},
            server_timout=3.0,
        )
        robot = team.start()["robot_1"]
        self.assertEqual(robot.exit_code(), 2)
        self.assertIn("~server_timout: unknown parameter", robot.said())


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_failures")
    rostest.rosrun("gspn_framework_package", "failures", FailuresTest)
