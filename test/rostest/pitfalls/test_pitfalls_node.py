#!/usr/bin/env python3
"""Where the published framework breaks, on teams of real nodes; named after the numbers of its
faults."""

import os
import signal
import subprocess
import sys
import unittest

import rospy

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from robots import ROOT, RobotTestCase, Team, chain, copy_plan, start_node
from waiting import wait_for

from gspn_framework_package.formats.plan_file import read_plan

NAMESPACES = {"picker_1": "/alpha", "carrier_1": "/my_robot_1", "carrier_2": "/de/ep/R"}
ACTIONS = """
def good():
    pass

def until_cancelled(is_cancelled):
    is_cancelled.wait(60)
    with open(CANCELLED, "a") as file:
        file.write("cancelled\\n" if is_cancelled() else "timed out\\n")
"""


class Meeting:
    """One team that meets and shares a tool, with a bystander on its topic; the tests look at what
    it did."""

    FIRINGS = 60

    @classmethod
    def setUpClass(cls):
        cls.plan = read_plan(os.path.join(ROOT, "plans", "rendezvous"))
        folder = copy_plan("plans/rendezvous", synchronisation=cls.MODE)
        cls.bystander = subprocess.Popen(
            ["rostopic", "echo", "-p", "/fired_transitions"], stdout=subprocess.DEVNULL
        )
        cls.shared = Team(folder, [robot.name for robot in cls.plan.robots], NAMESPACES)
        try:
            cls.shared.start()
            cls.shared.wait_for_firings(cls.FIRINGS, 120)
            answer = cls.shared["picker_1"].command("pause")
            assert answer.success, answer.message
            cls.end = cls.shared.wait_for_agreement()
        except BaseException:
            # the runner hides stdout here
            print(cls.shared.outputs(), file=sys.__stderr__, flush=True)
            cls.tearDownClass()
            raise
        cls.fired = list(cls.shared.fired)

    @classmethod
    def tearDownClass(cls):
        cls.bystander.kill()
        cls.bystander.wait()
        cls.shared.close()
        cls.shared.discard()

    def firings(self, *transitions):
        found = [message for message in self.fired if message.transition in transitions]
        self.assertTrue(found, "%s never fired" % (transitions,))
        return found

    def marking_after(self, message):
        return dict(zip(message.places, message.counts))

    def test_01_the_robot_that_acquires_a_resource_moves(self):
        for message in self.firings("Plug_In"):
            self.assertEqual(
                (message.robots, message.robot_places), ([message.robot], ["Charging"])
            )

    def test_03_one_tool_is_never_with_two_robots(self):
        for message in self.fired:
            self.assertLessEqual(self.marking_after(message)["Charging"], 1)

    def test_04_resource_tokens_are_neither_lost_nor_made(self):
        for message in self.fired:
            marking = self.marking_after(message)
            self.assertEqual(marking["Charger"] + marking["Charging"], 1)
            robots = sum(marking.values()) - marking["Charger"]
            self.assertEqual(robots, 4)

    def test_07_partners_that_meet_go_to_different_places_once(self):
        for message in self.firings("Hand_Over"):
            went = dict(zip(message.robots, message.robot_places))
            self.assertEqual(sorted(went.values()), ["Empty", "Loaded"])
            for robot, place in went.items():
                self.assertEqual(place, "Empty" if robot.startswith("picker") else "Loaded")

    def test_15_a_bystander_is_no_robot(self):
        self.assertIsNone(self.bystander.poll())
        self.assertEqual(
            sorted(r["robot"] for r in self.shared["picker_2"].status()["robots"]),
            ["carrier_1", "carrier_2", "picker_1", "picker_2"],
        )

    def test_21_any_namespace_will_do(self):
        for name, namespace in NAMESPACES.items():
            self.assertEqual(self.shared[name].namespace, namespace)
            self.assertEqual(self.shared[name].state().robot, name)

    def test_every_replica_ends_up_with_the_same_marking(self):
        counts = {tuple(robot.state().counts) for robot in self.shared}
        self.assertEqual(len(counts), 1)

    def test_the_logs_tell_one_valid_story(self):
        self.assertIsNone(self.shared.verify(settled=True))


class FullTest(Meeting, unittest.TestCase):
    MODE = "full"

    def test_02_16_17_what_was_published_is_one_valid_sequence(self):
        net, marking = self.plan.net, self.plan.net.initial_marking
        positions = [(message.slot, message.index) for message in self.fired]
        self.assertEqual(len(set(positions)), len(positions), "published twice")
        for message in sorted(self.fired, key=lambda m: (m.slot, m.index)):
            marking = net.fire(marking, net.transition_number(message.transition))
            self.assertEqual(tuple(message.counts), marking)
        self.assertEqual(tuple(self.end.counts), marking)

    def test_06_a_bystanding_robot_sees_the_meetings_of_others(self):
        for message in self.firings("Hand_Over"):
            self.assertEqual(
                sum(message.counts) - dict(zip(message.places, message.counts))["Charger"], 4
            )


class PartialTest(Meeting, unittest.TestCase):
    MODE = "partial"

    def test_local_transitions_are_published_too(self):
        private = {message.transition for message in self.fired if message.private_move}
        self.assertLessEqual({"Fetched", "Return"}, private)
        self.assertFalse(private & {"Hand_Over", "Plug_In", "Unplug"})


class PitfallsTest(RobotTestCase):
    def team(self, plan, robots=("robot_1",), **parameters):
        return super().team(plan, robots, actions=parameters.pop("actions", ACTIONS), **parameters)

    def test_05_a_transition_of_the_environment_is_fired_and_published(self):
        net = chain(["P1", "P2"])
        net["places"].append({"name": "parcels", "tokens": 0})
        net["transitions"].append({"name": "arrives", "timed": True, "servers": None})
        net["arcs"].append({"from": "arrives", "to": "parcels", "weight": 3})
        team = self.team(
            {
                "net": net,
                "actions": {"P1": "actions.until_cancelled", "P2": None},
                "robots": {"robot_1": "P1"},
                "resource_places": ["parcels"],
            },
            actions=ACTIONS.replace("CANCELLED", repr(os.devnull)),
        )
        robot = team.start()["robot_1"]
        team.wait_until_heard()
        answer = wait_for(lambda: robot.command("fire", argument="arrives"), what="the order")
        self.assertTrue(answer.success, answer.message)
        wait_for(lambda: team.transitions() == ["arrives"], what="its publication")
        self.assertEqual(dict(zip(team.fired[0].places, team.fired[0].counts))["parcels"], 3)
        self.assertEqual((team.fired[0].robot, team.fired[0].robots), ("", []))
        answer = robot.command("fire", argument="T1")
        self.assertFalse(answer.success)
        self.assertTrue(robot.command("stop").success)
        self.assertEqual(robot.exit_code(), 1)

    def test_10_a_robot_that_waits_for_a_partner_says_so_and_ends_at_once_when_asked(self):
        net = chain(["A", "End"])
        net["places"] += [{"name": "B"}]
        net["arcs"] += [{"from": "B", "to": "T1"}, {"from": "T1", "to": "End"}]
        team = self.team(
            {
                "net": net,
                "actions": {"A": "actions.good", "B": "actions.until_cancelled", "End": None},
                "robots": {"robot_1": "A", "robot_2": "B"},
            },
            ("robot_1", "robot_2"),
            actions=ACTIONS.replace("CANCELLED", repr(os.devnull)),
        )
        team.start()
        waiting = team["robot_1"]
        wait_for(lambda: "needs a robot in B" in waiting.status()["waits_for"], 20, "the reason")
        self.assertEqual(waiting.state().state, "Waiting")
        waiting.signal(signal.SIGTERM)
        self.assertEqual(waiting.exit_code(3), 128 + signal.SIGTERM)

    def test_18_clients_threads_and_descriptors_are_bounded_over_1000_firings(self):
        team = self.team(os.path.join(ROOT, "plans", "tokens", "instant.json"))
        robot = team.start()["robot_1"]
        team.wait_for_firings(200, 40)

        def resources():
            folder = "/proc/%d/" % robot.process.pid
            return len(os.listdir(folder + "task")), len(os.listdir(folder + "fd"))

        before = resources()
        team.wait_for_firings(1000, 40)
        after = resources()
        self.assertLessEqual(after[0], before[0] + 5)
        self.assertLessEqual(after[1], before[1] + 5)

    def test_22_the_end_of_an_executor_cancels_its_goal(self):
        for how in (signal.SIGTERM, signal.SIGKILL, "rosnode kill"):
            team = self.team(
                {
                    "net": chain(["P1", "P2"]),
                    "actions": {"P1": "actions.until_cancelled", "P2": None},
                    "robots": {"robot_1": "P1"},
                },
                place_servers=False,
                server_timeout=20.0,
                actions=ACTIONS.replace("CANCELLED", "__file__ + '.cancelled'"),
            )
            servers = start_node(
                "gspn_place_servers",
                "/robot_1",
                os.path.join(team.folder, "servers.out"),
                "places",
                plan=team.plan,
                robot="robot_1",
            )
            self.addCleanup(servers.kill)
            robot = team.start()["robot_1"]
            wait_for(
                lambda: robot.state().state == "Doing" and not robot.status()["waits_for"],
                20,
                "the goal to be taken",
            )
            if how == "rosnode kill":
                subprocess.check_call(
                    ["rosnode", "kill", "/robot_1/executor"], stdout=subprocess.DEVNULL
                )
                self.assertEqual(robot.exit_code(10), 0)
                self.assertNotIn("Traceback", robot.said())
            else:
                robot.signal(how)
            seen = os.path.join(team.plan, "actions.py.cancelled")
            wait_for(
                lambda: os.path.exists(seen) and open(seen).read() == "cancelled\n",  # noqa: SIM115
                10,
                "the action to be cancelled",
            )
            servers.kill()
            servers.wait()

    def test_24_initial_places_that_contradict_the_marking_are_refused(self):
        net = chain(["P1", "P2"])
        net["places"][1]["tokens"] = 1
        team = self.team(
            {"net": net, "actions": {"P1": None, "P2": None}, "robots": {"robot_1": "P1"}}
        )
        robot = team.start()["robot_1"]
        self.assertEqual(robot.exit_code(), 1)
        self.assertIn("initial", robot.said())
        self.assertNotIn("Traceback", robot.said())


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_pitfalls")
    rostest.rosrun("gspn_framework_package", "pitfalls", __name__)
