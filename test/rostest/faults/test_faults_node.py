#!/usr/bin/env python3
"""Faults on real nodes, with a ROS master of the test's own, which it can kill."""

import os
import signal
import subprocess
import sys
from unittest import mock

HERE = os.path.dirname(os.path.abspath(__file__))
TESTS = os.path.dirname(HERE)
sys.path[:0] = [os.path.join(TESTS, "support"), os.path.join(TESTS, "..", "..")]

from benchmarks.harness.ports import free_port

PORT = free_port()
os.environ["ROS_MASTER_URI"] = "http://localhost:%d" % PORT

import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from robots import Robot, RobotTestCase, copy_plan
from waiting import wait_for

from gspn_framework_package.execution.log_damage import BOOT_ID
from gspn_framework_package.ros.transport.master_watch import MasterWatch

ACTIONS = '''
def instant(place, is_cancelled):
    """Take a moment."""
    if not is_cancelled.wait(0.05):
        return TRANSITIONS.get(place)

TRANSITIONS = {"p1": "t1", "p2": "t2", "p3": "t3", "p5": "t4", "p7": "t7"}
'''
TEAM = ("robot_1", "robot_2", "robot_3")


def start_master():
    process = subprocess.Popen(
        ["rosmaster", "--core", "-p", str(PORT)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wait_for(rosgraph.is_master_online, 20, "the ROS master")
    return process


class Faults:
    """The tests of one mode of synchronisation."""

    def start(self, evict_after, names=TEAM, size=3, witnesses=()):
        timing = {"evict_after": evict_after, "witnesses": list(witnesses)}
        folder = copy_plan("plans/tokens", synchronisation=self.MODE, agreement=timing)
        os.replace(os.path.join(folder, "instant.json"), os.path.join(folder, "unused.json"))
        with open(os.path.join(folder, "actions.py"), "w") as file:
            file.write(ACTIONS.replace("def instant", "def loop"))
        team = self.team(folder, names, robots=size).start()
        team.wait_for_firings(20, 40)
        return team

    def moves_of(self, team, name):
        return sum(name in message.robots for message in list(team.fired))

    def wait_for_moves(self, team, name, number, seconds=40):
        wanted = self.moves_of(team, name) + number
        wait_for(
            lambda: self.moves_of(team, name) >= wanted, seconds, "%d moves of %s" % (number, name)
        )

    def end_and_verify(self, team):
        """Pause the team, see that all replicas agree, end it, and verify the logs."""
        answer = wait_for(lambda: self.pause(team), 30, "the pause")
        self.assertTrue(answer.success, answer.message)
        team.wait_for_agreement()
        team.close()
        self.assertIsNone(team.verify(settled=True))

    def pause(self, team):
        answer = team["robot_1"].command("pause")
        return answer if answer.success else None

    def see_the_others_go_on_or_say_what_they_miss(self, team):
        """With full synchronisation a majority goes on. With partial synchronisation what is
        coordinated needs an answer of every member: once the others have come to such a move, they
        wait, and say for whom."""
        if self.MODE != "partial":
            team.wait_for_firings(10)
            return
        wait_for(
            lambda: any(
                "robot_2" in team[name].status()["waits_for"] for name in ("robot_1", "robot_3")
            ),
            30,
            "a robot that waits for robot_2",
        )

    def test_a_robot_that_is_killed_and_restarted_goes_on_where_it_was(self):
        team = self.start(evict_after=30.0)
        victim = team["robot_2"]
        victim.kill()
        before = victim.log()
        visits = [r["visit"] for r in before.records if r["kind"] == "goal"]
        self.see_the_others_go_on_or_say_what_they_miss(team)
        victim.start()
        self.wait_for_moves(team, "robot_2", 10)
        self.wait_for_moves(team, "robot_1", 10)
        after = [r for r in victim.log().records if r["kind"] == "goal"][len(visits) :]
        self.assertLessEqual(after[0]["visit"], visits[-1] + 1, "a visit was skipped")
        self.assertGreater(after[0]["incarnation"], 0)
        self.end_and_verify(team)

    def test_a_team_whose_machines_all_lost_power_waits_for_the_last_and_goes_on(self):
        team = self.start(evict_after=0)
        boots = mock.patch.dict(os.environ, {BOOT_ID: "another"})
        boots.start()
        self.addCleanup(boots.stop)
        for robot in team:
            robot.kill()
        before = [r for r in team["robot_1"].log().records if r["kind"] == "slot"]
        late = team["robot_3"]
        for name in ("robot_1", "robot_2"):
            team[name].start()

        def misses_the_last():
            told = [team[name].status() for name in ("robot_1", "robot_2")]
            return all(s["stuck"] and s["missing"] == ["robot_3"] for s in told) and told

        told = wait_for(misses_the_last, 30, "two robots that say that they are stuck")
        for status in told:
            self.assertTrue(status["needs_operator"])
            self.assertIn("not heard: robot_3", status["waits_for"])
            logs = {r["robot"]: r["log"] for r in status["robots"]}
            self.assertEqual(logs, {"robot_1": "torn", "robot_2": "torn", "robot_3": ""})
        refused = team["robot_1"].command("resume")
        self.assertFalse(refused.success)
        self.assertIn("gspn trust", refused.message)
        late.start()
        for name in TEAM:
            self.wait_for_moves(team, name, 3)
        after = [r for r in team["robot_1"].log().records if r["kind"] == "slot"]
        self.assertEqual(after[: len(before)], before)
        self.end_and_verify(team)

    def test_a_robot_that_is_paused_beyond_its_eviction_comes_back(self):
        team = self.start(evict_after=2.0)
        victim = team["robot_2"]
        victim.signal(signal.SIGSTOP)

        def state_of_victim():
            robots = team["robot_1"].status()["robots"]
            return next(r["state"] for r in robots if r["robot"] == "robot_2")

        diagnostics = []
        listener = rospy.Subscriber(
            "/diagnostics", DiagnosticArray, lambda array: diagnostics.extend(array.status)
        )
        self.addCleanup(listener.unregister)
        wait_for(lambda: state_of_victim() == "Lost", 30, "the eviction")
        for name in ("robot_1", "robot_3"):
            wait_for(
                lambda: "%s: robot_2 is lost; the team continues" % name in team[name].said(),
                what="the loss on the screen of " + name,
            )
        title = "%s: gspn robot_1, run %s" % (team["robot_1"].namespace, team.run)
        wait_for(
            lambda: any(
                s.name == title and "lost: robot_2" in s.message for s in list(diagnostics)
            ),
            what="the loss on /diagnostics",
        )
        self.wait_for_moves(team, "robot_1", 10)
        self.wait_for_moves(team, "robot_3", 10)
        victim.signal(signal.SIGCONT)
        self.wait_for_moves(team, "robot_2", 10)
        self.assertGreater(victim.state().incarnation, 0)
        self.assertNotEqual(state_of_victim(), "Lost")
        wait_for(
            lambda: "robot_1: robot_2 is back in the team" in team["robot_1"].said(),
            what="the return on the screen",
        )
        self.end_and_verify(team)

    def test_the_team_survives_its_master_and_late_joiners_find_it(self):
        team = self.start(evict_after=30.0)
        # by now each robot is connected to all of its servers, or will be in a moment
        for name in TEAM:
            self.wait_for_moves(team, name, 15)
        global master
        master.kill()
        master.wait()
        self.assertFalse(rosgraph.is_master_online())
        for name in TEAM:
            self.wait_for_moves(team, name, 20)
        master = start_master()
        wait_for(self.everybody_is_registered, 30, "all nodes at the new master")
        team.robots["late"] = Robot(team, "late", "/late", place="p1", robots=len(TEAM))
        team["late"].start()
        self.wait_for_moves(team, "late", 10)
        self.end_and_verify(team)

    def everybody_is_registered(self):
        publishers, _, services = rosgraph.Master("/test").getSystemState()
        names = dict(publishers).get("/fired_transitions", [])
        return all("/%s/executor" % name in names for name in TEAM) and all(
            "/%s/get_state" % name in dict(services) for name in TEAM
        )


class FullTest(Faults, RobotTestCase):
    MODE = "full"

    def test_with_a_witness_either_of_two_robots_may_die(self):
        team = self.start(2.0, ("robot_1", "robot_2", "judge"), 2, ["judge"])
        team["robot_1"].kill()
        self.wait_for_moves(team, "robot_2", 40)
        judge = team["judge"].state()
        self.assertEqual(
            (judge.place, dict(zip(judge.places, judge.counts))["p1"] in (0, 1)), ("", True)
        )
        lost = [r["robot"] for r in team["judge"].status()["robots"] if r["state"] == "Lost"]
        self.assertEqual(lost, ["robot_1"])
        team.close()
        self.assertIsNone(team.verify())

    def test_when_those_for_whom_the_policy_lets_others_wait_die_the_rest_goes_on(self):
        """Nobody goes through the gate while a robot decides (no row speaks of the gate) or
        measures (an empty choice); the two at the gate go when both of those are lost."""
        names = ("decides", "measures", "first", "second")
        places = ("Decide", "Measure", "Gate", "Gate")
        transitions = [
            ("decided", "Decide", "Through", False),
            ("measured", "Measure", "Through", True),
            ("go", "Gate", "Through", False),
        ]
        net = {
            "places": [{"name": name} for name in ("Decide", "Measure", "Gate", "Through")],
            "transitions": [{"name": t, "timed": timed} for t, _, _, timed in transitions],
            "arcs": [
                arc
                for t, source, target, _ in transitions
                for arc in ({"from": source, "to": t}, {"from": t, "to": target})
            ],
        }
        rows = [([1, "-"], {"decided": 1}), ([0, 1], {}), ([0, 0], {"go": 1})]
        team = self.team(
            {
                "net": net,
                "policy": {
                    "places": ["Decide", "Measure"],
                    "rows": [{"marking": cells, "choose": choice} for cells, choice in rows],
                },
                "strict": True,
                "actions": {
                    **dict.fromkeys(("Decide", "Measure"), "actions.until_cancelled"),
                    **dict.fromkeys(("Gate", "Through")),
                },
                "robots": dict(zip(names, places)),
                "agreement": {"evict_after": 2},
            },
            names,
            actions="def until_cancelled(is_cancelled):\n    is_cancelled.wait(600)\n",
        ).start()

        def all_active():
            return all(team[name].status()["active"] for name in names)

        wait_for(all_active, 40, "a robot that never took part cannot be lost")

        def reason():
            (robot,) = [r for r in team["first"].status()["robots"] if r["robot"] == "first"]
            return robot["waits_for"]

        for victim, why in (("decides", "no policy row applies"), ("measures", "makes it wait")):
            wait_for(lambda why=why: why in reason(), 40, "a robot at the gate: " + why)
            self.assertEqual(team.transitions(), [])
            team[victim].kill()
        self.assertEqual([team[name].exit_code(40) for name in names[2:]], [0, 0])
        self.assertEqual(team["first"].logged_transitions(), ["go", "go"])
        self.assertIsNone(team.verify())


class PartialTest(Faults, RobotTestCase):
    MODE = "partial"


master = None

if __name__ == "__main__":
    import rostest

    master = start_master()
    try:
        rospy.init_node("test_faults")
        MasterWatch(period=0.5).start()
        rostest.rosrun("gspn_framework_package", "faults", __name__)
    finally:
        master.kill()
        master.wait()
