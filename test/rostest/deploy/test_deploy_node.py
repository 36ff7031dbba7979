#!/usr/bin/env python3
"""Another plan for a running team: staged, voted on and adopted by real nodes, one of which is
killed at a step of staging."""

import contextlib
import io
import os
import shutil
import sys
import tempfile

import rospy

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from robots import RobotTestCase, chain, write_plan
from waiting import wait_for

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.ros.team_view import TeamView
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.ros_watch import RosConnection
from gspn_framework_package.visualizer.team_watch import TeamWatch

ACTIONS = """
def work(is_cancelled):
    is_cancelled.wait(0.2)
"""

WAITS = """
import os, time
while not os.path.exists(%r):
    time.sleep(0.01)
"""


def round_of(places):
    """The net of a patrol: each place leads to the next, the last one to the first."""
    net = chain(places)
    net["transitions"].append({"name": "again", "timed": True})
    net["arcs"] += [{"from": places[-1], "to": "again"}, {"from": "again", "to": places[0]}]
    return net


def patrol(places, mode, **more):
    """A plan for two robots that go round."""
    return {
        "plan": "%d places" % len(places),
        "net": round_of(places),
        "actions": dict.fromkeys(places, "actions.work"),
        "robots": {"robot_1": "A", "robot_2": "A"},
        "synchronisation": mode,
        "agreement": {"evict_after": 0},
        **more,
    }


def gspn(*words):
    """The command line, in this process: (exit code, output)."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        code = main(words)
    return code, output.getvalue()


class DeployTest(RobotTestCase):
    def start(self, mode):
        team = self.team(patrol("ABCD", mode), ("robot_1", "robot_2"), actions=ACTIONS).start()
        team.wait_for_firings(2)
        return team

    def plan(self, places, mode, actions=ACTIONS, **more):
        return os.path.join(write_plan(patrol(places, mode, **more), actions), "plan.json")

    def watched(self, team):
        """The hub of a page that watches a team, and was given the plan that it began with."""
        watch = TeamWatch(
            read_plan(os.path.join(team.plan, "plan.json")), RosConnection(), team.run
        )
        hub = Hub("", Board(0, []))
        watch.begin(hub)
        self.addCleanup(watch.end)
        return hub

    def wait_for_the_page(self, hub, what):
        """Wait until the page shows a robot in E, and firings of the net that has it."""

        def is_shown():
            board = hub.board()
            fired = [e for e in hub.events(0, board.n) if e["k"] == "fire" and e.get("p") == 1]
            return board.plan == 1 and board.marking[4] > 0 and len(fired) > 2

        wait_for(is_shown, 30, what)

    def wait_for_the_view(self, team):
        """Wait until what rviz is shown follows the team, with the plan that it began with."""
        first = read_plan(os.path.join(team.plan, "plan.json"))
        view = TeamView(first, team.run, "{robot}", "map")

        def follows():
            view.publish()
            return view.plan.name == "5 places"

        wait_for(follows, 30, "the new plan for rviz")

    def test_a_patrol_gets_a_fifth_location_without_stopping(self):
        for mode in ("full", "partial"):
            team = self.start(mode)
            page = self.watched(team)
            wait_for(lambda: sum(page.board().counts) > 0, 20, "firings on the page")
            broken = self.plan("ABCDE", mode, actions="def other():\n    pass\n")
            code, text = gspn("deploy", broken)
            self.assertEqual(code, 1)
            self.assertIn("work", text)
            self.assertIsNone(team["robot_1"].status()["staged"])
            other = "partial" if mode == "full" else "full"
            code, text = gspn("deploy", self.plan("ABCDE", other))
            self.assertEqual(code, 1)
            self.assertIn("synchronisation", text)
            code, text = gspn("deploy", self.plan("ABCDE", mode))
            self.assertEqual(code, 0, text)
            for robot in team:
                wait_for(lambda: robot.status()["plan_name"] == "5 places", 10, "the new plan")
                wait_for(lambda: robot.status()["marking"].get("E", 0) > 0, 30, "a robot in E")
            self.wait_for_the_page(page, "the fifth location on the page")
            late = self.watched(team)
            self.wait_for_the_page(late, "the fifth location on a page that was opened later")
            self.wait_for_the_view(team)
            self.assertEqual({r["incarnation"] for r in team["robot_1"].status()["robots"]}, {0})
            team["robot_2"].kill()  # it learns of the plan from its log
            team["robot_2"].start()
            wait_for(lambda: team["robot_2"].status()["active"], 20, "its return")
            self.assertEqual(team["robot_2"].status()["plan_name"], "5 places")
            firings = len(team["robot_1"].logged_transitions())
            wait_for(
                lambda: len(team["robot_1"].logged_transitions()) > firings + 5, 30, "more firings"
            )
            self.assertIsNone(team.verify())
            team.close()

    def test_a_robot_that_is_killed_while_it_looks_at_a_plan_votes_when_it_is_back(self):
        team = self.start("full")
        go = os.path.join(tempfile.mkdtemp(prefix="gspn_rostest_"), "go")
        self.addCleanup(shutil.rmtree, os.path.dirname(go))
        stage = self.plan("ABCDE", "full", actions=WAITS % go + ACTIONS)
        code, text = gspn("deploy", stage, "--wait", "0.2")
        self.assertEqual(code, 1)
        self.assertIn("no vote", text)
        team["robot_2"].kill()
        team["robot_2"].start()
        wait_for(lambda: team["robot_2"].status()["active"], 20, "its return")
        open(go, "w").close()
        code, text = gspn("deploy", stage)
        self.assertEqual(code, 0, text)
        self.assertIsNone(team.verify())


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_deploy")
    rostest.rosrun("gspn_framework_package", "deploy", __name__)
