#!/usr/bin/env python3
"""Somebody on the master of a running team that has a key tries every attack, and changes no
firing."""

import contextlib
import io
import json
import os
import sys
import time

import rospy

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from robots import Robot, RobotTestCase, chain
from waiting import wait_for

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.agreement.messages import PROTOCOL_VERSION
from gspn_framework_package.msg import Agreement
from gspn_framework_package.ros.inbound import said
from gspn_framework_package.srv import Command, GetPlace, SetPlace
from gspn_framework_package.team.carrier import OperatorRequest
from gspn_framework_package.team.seal import SEALED, Seal, make_team_key, read_team_key

ROBOTS = ("robot_1", "robot_2", "robot_3")
ACTIONS = """
def work(is_cancelled):
    is_cancelled.wait(0.1)
"""


class AttacksTest(RobotTestCase):
    def setUp(self):
        net = chain(["A", "B"], B="A")
        plan = {
            "net": net,
            "actions": {"A": "actions.work", "B": "actions.work"},
            "robots": dict.fromkeys(ROBOTS, "A"),
            "synchronisation": "partial",  # so that messages come in calls as well
        }
        self.running = self.team(plan, ROBOTS, actions=ACTIONS)
        self.key = self.new_key("team.key")
        self.thiefs_key = read_team_key(self.new_key("another.key"))
        for robot in self.running:
            robot.parameters["team_key_file"] = self.key
        self.heard = []
        rospy.Subscriber("/gspn_agreement", Agreement, self.heard.append)
        self.out = rospy.Publisher("/gspn_agreement", Agreement, queue_size=100_000)
        self.running.start()
        self.running.wait_for_firings(30, 60)

    def new_key(self, name):
        path = os.path.join(self.running.folder, name)
        make_team_key(path)
        return path

    def news(self, sender, body, to="", sealed=True):
        """A message as an outsider makes it."""
        purpose = said("/" + sender, "rosrpc://localhost:1")
        if sealed:
            body = Seal(self.thiefs_key, self.running.run, sender).close(to, body, purpose)
        return Agreement(
            run=self.running.run,
            sender=sender,
            namespace="/" + sender,
            service_uri="rosrpc://localhost:1",
            to=to,
            body=body,
        )

    def refused(self, robot="robot_1"):
        """What a robot refused of us: (who, why) -> times."""
        return {
            (kind["robot"], kind["why"]): kind["times"]
            for kind in self.running[robot].status()["refused"]
        }

    def wait_until_refused(self, who, *why):
        found = "%s (node %s)" % (who, rospy.get_name()) if who else "node " + rospy.get_name()
        wait_for(
            lambda: any(
                found == w and any(y in reason for y in why) for w, reason in self.refused()
            ),
            30,
            "the refusal of %s: %s" % (who, " or ".join(why)),
        )

    def goes_on(self):
        self.running.wait_for_firings(30, 60)

    def test_no_attack_changes_a_firing(self):
        self.messages_are_refused()
        self.orders_are_refused()
        self.an_unknown_robot_is_not_let_in()
        self.a_flood_and_a_large_message_are_endured()
        with contextlib.redirect_stdout(io.StringIO()) as output:
            for order in (["pause"], ["resume"], ["stop"]):
                self.assertEqual(main([*order, "--team-key-file", self.key]), 0, output)
        for robot in self.running:
            robot.exit_code()
        self.assertIsNone(self.running.verify())
        by = {
            origin[0]
            for robot in self.running
            for record in robot.log().records
            if record["kind"] == "slot"
            for origin in record["origins"]
        }
        self.assertLessEqual(by, {"", *ROBOTS})
        orders = [
            (record["command"], record["proof"])
            for robot in self.running
            for record in robot.log().records
            if record["kind"] == "order"
        ]
        kept = [(command, "team key") for command in ("pause", "resume", "stop")]
        self.assertEqual(sorted(orders), sorted(kept))

    def messages_are_refused(self):
        body = json.dumps({"from": "robot_2", "version": PROTOCOL_VERSION, "kind": "pull"})
        recorded = wait_for(
            lambda: [
                news
                for news in list(self.heard)
                if news.sender == "robot_2" and news.to in ("", "robot_1")
            ],
            30,
            "traffic",
        )
        forged = "not sealed with the key"
        wait_for(lambda: self.out.get_num_connections() >= 3, 30, "connections")
        for news, why in (
            (self.news("robot_2", body, sealed=False), "without the key"),
            (self.news("robot_2", body), forged),  # the name of the run, and another key
        ):
            self.out.publish(news)
            self.wait_until_refused("robot_2", why)
        for _ in range(2):  # if robot_1 had not heard robot_2 yet, the first only comes late
            self.out.publish(recorded[0])
        # the second if robot_2 has sent many since
        self.wait_until_refused("robot_2", "a repeated message", "too late")
        changed = recorded[-1]
        changed.service_uri = "rosrpc://localhost:1"
        self.out.publish(changed)
        self.goes_on()
        answer = self.running["robot_1"].call("get_place", GetPlace, "robot_2", body)
        self.assertEqual(answer.agreement, "")

    def orders_are_refused(self):
        robot = self.running["robot_1"]
        run = self.running.run
        request = OperatorRequest("stop", "", "", run)
        sealed = Seal(self.thiefs_key, run, "ann").close(
            "robot_1", json.dumps(request._asdict()), "order"
        )
        answers = [
            robot.command("stop", run=run),
            robot.command("breakpoints", argument='["A"]'),
            robot.call("set_place", SetPlace, "A", "robot_2", "", ""),
            robot.call("command", Command, SEALED, "", sealed, run),
        ]
        self.assertEqual([answer.success for answer in answers], [False] * 4)
        for answer in answers:
            self.assertIn("key", answer.message)
        self.wait_until_refused("", "an order without the key")
        self.goes_on()

    def an_unknown_robot_is_not_let_in(self):
        stranger = Robot(self.running, "robot_4", "/robot_4", place="A")
        self.running.robots["robot_4"] = stranger
        stranger.start()
        wait_for(
            lambda: any(who.startswith("robot_4 (") for who, _ in self.refused()), 60, "its refusal"
        )
        names = [robot["robot"] for robot in self.running["robot_1"].status()["robots"]]
        self.assertEqual(sorted(names), list(ROBOTS))
        stranger.kill()
        os.remove(stranger.log_file)
        del self.running.robots["robot_4"]

    def a_flood_and_a_large_message_are_endured(self):
        self.out.publish(self.news("robot_3", "x" * 10_000_000, sealed=False))
        self.wait_until_refused("robot_3", "too large")
        flood = self.news("robot_2", json.dumps({"from": "robot_2", "kind": "hello"}))
        ends = time.monotonic() + 3.0
        while time.monotonic() < ends:
            for _ in range(100):
                self.out.publish(flood)
            time.sleep(0.01)
        self.goes_on()


class StrangersTest(RobotTestCase):
    """A team without a key: anybody can greet in any name."""

    def greet_under_many_names(self, mode):
        plan = {
            "net": chain(["A", "B"], B="A"),
            "actions": {"A": "actions.work", "B": "actions.work"},
            "robots": dict.fromkeys(ROBOTS, "A"),
            "synchronisation": mode,
        }
        team = self.team(plan, ROBOTS, actions=ACTIONS)
        heard = []
        listener = rospy.Subscriber("/gspn_agreement", Agreement, heard.append)
        out = rospy.Publisher("/gspn_agreement", Agreement, queue_size=100_000)
        team.start().wait_for_firings(30, 60)
        hello = wait_for(
            lambda: next((m for m in heard if '"kind":"hello"' in m.body), None), 20, "a greeting"
        )
        listener.unregister()
        body = json.loads(hello.body)

        def descriptors():
            return [len(os.listdir("/proc/%d/fd" % robot.process.pid)) for robot in team]

        before = descriptors()
        for number in range(3_000):
            name = "stranger_%d" % number
            said = {**body, "from": name, "log": name, "active": False, "joining": True}
            out.publish(
                run=hello.run,
                sender=name,
                namespace="/" + name,
                service_uri=hello.service_uri,
                body=json.dumps(said),
            )
        team.wait_for_firings(100, 60)
        team["robot_1"].status()
        wait_for(  # while they come and go, connections to some of them are still to be closed
            lambda: all(now < was + 100 for was, now in zip(before, descriptors())),
            60,
            "the robots to close their connections to strangers",
        )
        out.unregister()

    def test_strangers_with_full_synchronisation(self):
        self.greet_under_many_names("full")

    def test_strangers_with_partial_synchronisation(self):
        self.greet_under_many_names("partial")


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_attacks_node", anonymous=True)
    rostest.rosrun("gspn_framework_package", "attacks", __name__)
