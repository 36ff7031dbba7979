#!/usr/bin/env python3
"""Services called by hand, and the operator's verbs, on a team of two nodes."""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import rosgraph
import rospy

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from robots import ROOT, Robot, RobotTestCase, chain
from waiting import PATIENCE, wait_for

from gspn import RefusedError, Team
from gspn_framework_package.cli.main import main
from gspn_framework_package.msg import FiredTransition, Marking, RobotActivity, TeamState
from gspn_framework_package.srv import GetPlace, GetState, SetPlace

ACTIONS = """
from gspn_framework_package.execution.actions import ActionFailed

def work(is_cancelled):
    is_cancelled.wait(60)

def fails(attempt):
    if attempt == 1:
        raise ActionFailed("once")
"""


def gspn(*words):
    """The command line, in this process: (exit code, output)."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        code = main(words)
    return code, output.getvalue()


class ServicesTest(RobotTestCase):
    def start(self, mode="full"):
        net = chain(["A", "B", "C"])
        net["places"].append({"name": "stock", "tokens": 2})
        net["transitions"].append({"name": "arrives", "timed": True, "servers": None})
        net["arcs"].append({"from": "arrives", "to": "stock"})
        plan = {
            "net": net,
            "actions": {"A": "actions.work", "B": "actions.fails", "C": None},
            "resource_places": ["stock"],
            "robots": {"robot_1": "A", "robot_2": "A"},
            "synchronisation": mode,
            "agreement": {"evict_after": 0},
        }
        team = self.team(plan, ("robot_1", "robot_2"), actions=ACTIONS).start()
        for robot in team:
            wait_for(
                lambda: robot.state().state == "Doing" and robot.status()["active"],
                20,
                "the start",
            )
        return team

    def test_services_answer_by_hand_with_nothing_filled_in(self):
        for mode in ("full", "partial"):
            team = self.start(mode)
            robot = team["robot_1"]
            place = robot.call("get_place", GetPlace, "", "")
            self.assertEqual((place.robot, place.place, place.visit), ("robot_1", "A", 1))
            state = robot.call("get_state", GetState, "", "")
            self.assertEqual((state.robot, state.place, state.state), ("robot_1", "A", "Doing"))
            self.assertEqual(
                dict(zip(state.places, state.counts)), {"A": 2, "B": 0, "C": 0, "stock": 2}
            )
            self.typed_messages_say_the_same(robot)
            nothing = robot.call("set_place", SetPlace, "", "", "", "")
            self.assertFalse(nothing.success)
            self.assertIn("no place was given", nothing.message)
            unknown = robot.call("set_place", SetPlace, "Z", "", "", "")
            self.assertFalse(unknown.success)
            self.assertIn("Z", unknown.message)
            stranger = robot.call("set_place", SetPlace, "C", "robot_2", "", "another_run")
            self.assertFalse(stranger.success)
            self.assertIn("run '%s', not in run 'another_run'" % team.run, stranger.message)
            moved = robot.call("set_place", SetPlace, "C", "robot_2", "", "")
            self.assertTrue(moved.success, moved.message)
            wait_for(lambda: team["robot_2"].state().place == "C", what="the move")
            self.assertEqual(team["robot_1"].state().place, "A")
            nodes = ["/robot_1/executor", "/robot_2/executor"]
            subprocess.check_call(
                ["rosnode", "kill", *nodes], stdout=subprocess.DEVNULL, timeout=60 * PATIENCE
            )
            self.assertEqual([robot.exit_code() for robot in team], [0, 0])
            for node in nodes:  # nothing is left for 'rosnode cleanup'
                with self.assertRaises(rosgraph.MasterException):
                    rosgraph.Master("/test").lookupNode(node)

    def typed_messages_say_the_same(self, robot):
        def latest(topic, kind):
            return rospy.wait_for_message(
                "/%s/%s" % (robot.name, topic), kind, timeout=20 * PATIENCE
            )

        own = latest("robot_activity", RobotActivity)
        self.assertEqual((own.robot, own.place, own.place_number), ("robot_1", "A", 0))
        self.assertEqual((own.state, own.state_name), (RobotActivity.DOING, "Doing"))
        marking = latest("marking", Marking)
        self.assertEqual(
            dict(zip(marking.places, marking.counts)), {"A": 2, "B": 0, "C": 0, "stock": 2}
        )
        team = latest("team_state", TeamState)
        self.assertEqual(
            [(r.robot, r.place, r.state) for r in team.robots],
            [("robot_1", "A", RobotActivity.DOING), ("robot_2", "A", RobotActivity.DOING)],
        )
        self.assertEqual((team.run, team.plan, team.ended), (own.run, own.plan, False))
        self.assertGreater(team.header.stamp.to_sec(), 0)

    def test_the_operators_verbs(self):
        team = self.start()
        robot_1, robot_2 = team["robot_1"], team["robot_2"]

        program = [sys.executable, "-m", "gspn_framework_package", "status"]
        output = subprocess.check_output(program, text=True, cwd=ROOT, timeout=60 * PATIENCE)
        self.assertRegex(output, r"robot_1 +A +Doing +1 ")
        code, output = gspn("status", "--json")
        self.assertEqual(json.loads(output)["/robot_2"]["robot"], "robot_2")

        self.assertEqual(gspn("fire", "arrives")[0], 0)
        self.assertEqual(robot_1.state().counts[3], 3)
        code, output = gspn("fire", "T1")
        self.assertEqual(code, 1, output)
        code, output = gspn("fire", "no_such_transition")
        self.assertEqual(code, 1, output)
        self.assertIn("no_such_transition", output)

        status = json.loads(gspn("status", "--data", "--json")[1])["/robot_1"]
        self.assertEqual(status["data"]["team"], {})
        self.assertEqual(status["robots"][0]["data"], {})
        code, output = gspn("breakpoints", "no_such_place")
        self.assertEqual(code, 1, output)
        self.assertIn("no_such_place", output)
        code, output = gspn("breakpoints", "T2", "--json")
        self.assertEqual(code, 0, output)
        self.assertEqual(sorted(json.loads(output)), ["/robot_1", "/robot_2"])

        self.assertEqual(gspn("pause", "robot_1")[0], 0)
        wait_for(lambda: robot_1.state().state == "Paused", what="the pause")
        self.assertEqual(robot_2.state().state, "Doing")
        self.assertEqual(gspn("resume", "robot_1")[0], 0)
        wait_for(lambda: robot_1.state().state == "Doing", what="the end of the pause")
        self.assertEqual(gspn("pause")[0], 0)
        wait_for(lambda: robot_2.state().state == "Paused", what="the pause of the team")
        self.assertEqual(gspn("resume")[0], 0)

        code, output = gspn("set-place", "robot_2", "B", "--json")
        self.assertTrue(json.loads(output)["done"], output)
        wait_for(lambda: "operator" in robot_2.status()["waits_for"], what="the failure")
        self.assertEqual(gspn("retry", "robot_2")[0], 0)
        wait_for(lambda: robot_2.state().state == "Paused", what="the stop at the breakpoint")
        self.assertEqual((robot_2.state().place, robot_1.state().state), ("B", "Doing"))
        self.assertEqual(gspn("breakpoints", "--clear")[0], 0)
        self.assertEqual(gspn("resume", "robot_2")[0], 0)
        wait_for(lambda: robot_2.state().place == "C", what="the second attempt")
        wait_for(lambda: team.transitions()[-1:] == ["T2"], what="the news of it")

        code, output = gspn("set-place", "robot_9", "B")
        self.assertEqual(code, 1, output)
        code, output = gspn("retry")
        self.assertEqual(code, 2, output)

        # no other node ends this one by its name: neither one of another run, nor of this one
        for run in ("another", team.run):
            others = self.team(team.plan, ("robot_1",), robots=2)
            others.run = run
            other = others.start()["robot_1"]
            self.assertEqual(other.exit_code(), 1)
            self.assertIn(
                "/robot_1 is taken: robot_1 of run '%s' is running there" % team.run, other.said()
            )
            self.assertTrue(robot_1.status()["active"])

        self.assertEqual(gspn("stop")[0], 0)
        self.assertEqual([robot.exit_code() for robot in team], [1, 1])
        code, output = gspn("status")
        self.assertEqual(code, 1)
        self.assertIn("no execution node", output)

        over = "the run '%s' was over before this node started: stopped by the operator" % team.run
        robot_1.start()
        self.assertEqual(robot_1.exit_code(), 1)
        self.assertIn(over, robot_1.said())
        robot_2.parameters["stay"] = True
        robot_2.start()
        state = robot_2.state()
        self.assertEqual((state.state, state.place), ("Inactive", "C"))
        self.assertIn(over, robot_2.said())
        status = robot_2.status()
        self.assertEqual((status["ended"], status["waits_for"]), ("stopped by the operator", ""))

    def test_the_client_for_own_nodes(self):
        robots = self.start()
        text = (Path(ROOT) / "docs" / "python.md").read_text("utf-8")
        code = re.search(r"## A running team\n.*?```python\n(.*?)```", text, re.DOTALL).group(1)
        assert 'rospy.init_node("dispatcher")\n' in code
        names = {}
        exec(code.replace('rospy.init_node("dispatcher")\n', ""), names)
        names["team"].close()

        fired = []
        with contextlib.closing(Team("/", run=robots.run)) as team:
            self.assertEqual(sorted(team.status()), ["/robot_1", "/robot_2"])
            team.on_fired(fired.append)
            heard = rospy.Publisher("/fired_transitions", FiredTransition, queue_size=1)
            wait_for(lambda: heard.get_num_connections() > 0, what="the subscriber")
            heard.publish(run="another", transition="T1")
            team.set_place("robot_2", "C")
            wait_for(lambda: robots["robot_2"].state().place == "C", what="the move")
            team.pause("robot_1", stop=True)
            wait_for(lambda: robots["robot_1"].state().state == "Paused", what="the pause")
            team.resume("robot_1")
            wait_for(lambda: robots["robot_1"].state().state == "Doing", what="the end of it")
            team.fire("arrives")
            wait_for(lambda: fired, what="the firing")
            self.assertEqual({(f.run, f.transition) for f in fired}, {(robots.run, "arrives")})
            self.assertEqual(fired[-1].marking["stock"], 3)
            with self.assertRaisesRegex(RefusedError, "order"):
                team.submit("order")
            self.assertEqual(team.tasks()["tasks"], [])
        with contextlib.closing(Team("/robot_2", run=robots.run)) as team:
            self.assertEqual(sorted(team.status()), ["/robot_2"])
        with self.assertRaisesRegex(RefusedError, "no execution node in /robot is known"):
            Team("/robot").status()

    def test_join_leave_and_both_kinds_of_eviction(self):
        team = self.start()
        team.robots["robot_3"] = Robot(team, "robot_3", "/robot_3", place="A")
        robot_3 = team["robot_3"].start()
        wait_for(lambda: robot_3.state().place == "A", 20, "the joining")
        self.assertEqual(dict(zip(robot_3.state().places, robot_3.state().counts))["A"], 3)

        self.assertEqual(gspn("leave", "robot_2")[0], 0)
        self.assertEqual(team["robot_2"].exit_code(), 0)
        wait_for(lambda: robot_3.state().counts[0] == 2, what="the smaller team")

        robot_3.signal(signal.SIGSTOP)
        code, output = gspn("status")
        self.assertEqual(code, 1)
        self.assertIn("the node in /robot_3 does not answer", output)
        code, output = gspn("force-evict", "robot_3")
        self.assertEqual(code, 0, output)
        wait_for(lambda: team["robot_1"].state().counts[0] == 1, what="the eviction")
        code, output = gspn("fire", "arrives")
        self.assertEqual(code, 0, output)
        robot_3.signal(signal.SIGCONT)


class NamesakeTest(RobotTestCase):
    start = ServicesTest.start

    def see_that_it_waits(self, mode):
        """A second process of a robot, with a log and in a namespace of its own."""
        team = self.start(mode)
        others = self.team(team.plan, ("robot_1",), {"robot_1": "/spare"}, robots=2)
        others.run = team.run
        for _ in range(2):
            spare = others.start()["robot_1"]
            wait_for(
                lambda: "another process runs as robot_1" in spare.status()["waits_for"],
                what="the spare to say what it waits for",
            )
            self.assertTrue(team["robot_1"].status()["active"])
            spare.signal(signal.SIGTERM)
            spare.exit_code()
        team["robot_1"].kill()
        team["robot_1"].start()  # at once, though the master still lists the one that was killed
        wait_for(lambda: team["robot_1"].status()["active"], what="the restart")

    def test_it_waits_with_full_synchronisation(self):
        self.see_that_it_waits("full")

    def test_it_waits_with_partial_synchronisation(self):
        self.see_that_it_waits("partial")


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_services")
    rostest.rosrun("gspn_framework_package", "services", __name__)
