#!/usr/bin/env python3
"""The node ``visualizer`` beside a team of two, in both modes of synchronisation."""

import json
import os
import signal
import sys
import urllib.error
import urllib.request

import rospy
from diagnostic_msgs.msg import DiagnosticArray

HERE = os.path.dirname(os.path.abspath(__file__))
TESTS = os.path.dirname(HERE)
sys.path[:0] = [os.path.join(TESTS, "support"), os.path.join(TESTS, "..", "..")]

from robots import ROOT, RobotTestCase, copy_plan, start_node
from waiting import PATIENCE, wait_for

from benchmarks.harness.ports import free_port


class Page:
    """The node ``visualizer``, and what its page is told."""

    def __init__(self, plan, namespace="/", **parameters):
        self.plan, self.namespace = plan, namespace
        self.parameters = parameters
        self.refusals = []
        self.port = free_port()
        self.address = "http://127.0.0.1:%d" % self.port
        self.start()

    def start(self):
        self.process = start_node(
            "visualizer_node",
            self.namespace,
            os.devnull,
            "visualizer",
            plan=self.plan,
            port=self.port,
            **self.parameters,
        )
        wait_for(self.snapshot, 30, "the page")

    def snapshot(self):
        try:
            with urllib.request.urlopen(
                self.address + "/api/poll?id=live", timeout=20 * PATIENCE
            ) as answer:
                return json.load(answer)["snapshot"]
        except OSError:
            return None

    def board(self):
        return wait_for(self.snapshot, 30, "an answer of the page")["board"]

    def phases(self):
        return {robot["name"]: robot.get("phase") for robot in self.board()["robots"]}

    def order(self, command, **fields):
        """Order until the team obeys: a robot that does not find the order's place in the log in
        time refuses it."""
        wait_for(lambda: self.obeyed(command, **fields), 60, "the team to obey: " + command)

    def obeyed(self, command, **fields):
        request = urllib.request.Request(
            self.address + "/api/do?id=live",
            json.dumps({"command": command, **fields}).encode(),
            {"Content-Type": "application/json", "X-Gspn-Page": "1"},
        )
        try:
            with urllib.request.urlopen(request, timeout=30 * PATIENCE):
                return True
        except urllib.error.HTTPError as error:
            self.refusals.append((error.code, json.load(error)["error"]))
            return False

    def end(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(15)


class VisualizerTest(RobotTestCase):
    def watch(self, mode):
        plan = copy_plan("plans/patrol", synchronisation=mode, agreement={"evict_after": 5})
        team = self.team(plan, ["robot_1", "robot_2"], robots=2).start()
        team.wait_for_firings(6)
        page = Page(plan)
        self.addCleanup(page.end)
        self.assertEqual(page.snapshot()["mode"], "LIVE")
        self.sees_the_marking(team, page)

        page.process.kill()  # nobody waits for it
        page.process.wait()
        team.wait_for_firings(6)
        page.start()
        self.sees_the_marking(team, page)
        self.assertEqual(len(team["robot_1"].status()["members"]), 2)

        team["robot_2"].kill()
        wait_for(lambda: page.phases().get("robot_2") == "lost", 60, "the page to show the loss")
        wait_for(lambda: sum(page.board()["marking"]) == 1, 30, "the token to be taken out")
        wait_for(
            lambda: page.phases()["robot_1"] in ("doing", "done"),
            15,
            "robot_1 to go on on the page",
        )

        page.order("stop")
        self.assertEqual(team["robot_1"].exit_code(30), 1)
        wait_for(lambda: page.board()["status"]["ended"], 30, "the end on the page")
        team.close()

    def sees_the_marking(self, team, page):
        """While nothing fires, the page and the replicas have one marking; meanwhile it has
        firings."""
        wait_for(
            lambda: set(page.phases()) == {"robot_1", "robot_2"}, 40, "both robots on the page"
        )
        before = page.board()["n"]
        team.wait_for_firings(4)
        wait_for(lambda: page.board()["n"] > before + 3, 40, "firings on the page")
        page.order("pause")
        state = team.wait_for_agreement()
        wait_for(
            lambda: page.board()["marking"] == list(state.counts),
            60,
            "the team's marking on the page",
        )
        wait_for(lambda: page.board()["status"]["paused"], 30, "the pause on the page")
        page.order("resume")
        wait_for(
            lambda: not page.board()["status"]["paused"], 30, "the end of the pause on the page"
        )

    def departs(self, page, run, told):
        """The page and /diagnostics say that the run is slower than its plan predicts."""

        def warned():
            wanted = [s for s in told if s.name.endswith("gspn prediction, run %s" % run)]
            return next((s for s in wanted if "slower than planned" in s.message), None)

        status = wait_for(warned, 240, "the warning on /diagnostics")
        self.assertEqual(ord(status.level) if isinstance(status.level, bytes) else status.level, 1)
        self.assertTrue(any("slower" in value.value for value in status.values))
        notes = [note["text"] for note in page.board()["notes"]]
        self.assertTrue(any("slower than planned" in text for text in notes), notes)

    def test_full_synchronisation(self):
        self.watch("full")

    def test_partial_synchronisation(self):
        self.watch("partial")

    def test_of_two_teams_on_a_master_the_page_shows_and_orders_its_own(self):
        """The robots of both have the same names and the same plan; the other's namespaces come
        first."""
        quick = {"mean": 0.02, "distribution": "gamma", "shape": 20}  # far too short
        with open(os.path.join(ROOT, "plans/patrol/plan.json")) as file:
            durations = dict.fromkeys(json.load(file)["actions"], quick)
        plan = copy_plan("plans/patrol", agreement={"evict_after": 0}, durations=durations)
        told = []
        rospy.Subscriber("/diagnostics", DiagnosticArray, lambda array: told.extend(array.status))
        names = ["robot_1", "robot_2"]
        ours = self.team(plan, names, {name: "/ours/" + name for name in names}, robots=2).start()
        other = self.team(plan, names, {name: "/a/" + name for name in names}, robots=2).start()
        # the topic of the firings is no matter of its namespace
        page = Page(plan, "/desk", run=ours.run)
        self.addCleanup(page.end)
        wait_for(lambda: page.board()["status"]["running"], 30, "the team on the page")
        ours.wait_for_firings(4)
        other.wait_for_firings(4)
        wait_for(lambda: sum(page.board()["counts"]) > 3, 30, "firings on the page")
        self.assertEqual(page.board()["status"]["run"], ours.run)
        self.departs(page, ours.run, told)

        self.assertFalse(page.obeyed("pause", run=other.run))
        code, text = page.refusals[-1]
        self.assertEqual(code, 409)
        self.assertIn(ours.run, text)
        self.assertIn(other.run, text)
        refused = ours["robot_1"].command("pause", run=other.run)
        self.assertFalse(refused.success)
        self.assertIn("run '%s', not in run '%s'" % (ours.run, other.run), refused.message)

        page.order("pause", robot="robot_2", run=ours.run)
        wait_for(lambda: ours["robot_2"].state().state == "Paused", 30, "the pause of one robot")
        self.assertNotEqual(other["robot_2"].state().state, "Paused")
        page.order("resume", robot="robot_2")
        page.order("set_place", robot="robot_2", place="p2:Alarm_L1")
        ours["robot_2"].signal(signal.SIGSTOP)  # while it runs, it joins again at once
        page.order("evict", robot="robot_2")
        wait_for(lambda: page.phases().get("robot_2") == "lost", 60, "the eviction on the page")
        ours["robot_2"].signal(signal.SIGCONT)
        page.order("stop", reason="enough of this")
        self.assertEqual(ours["robot_1"].exit_code(30), 1)
        wait_for(
            lambda: page.board()["status"]["ended"] == "enough of this", 30, "the end on the page"
        )
        other.wait_for_firings(4)
        self.assertTrue(other["robot_1"].status()["active"])


if __name__ == "__main__":
    import rostest

    rospy.init_node("page_test")
    rostest.rosrun("gspn_framework_package", "page", VisualizerTest)
