#!/usr/bin/env python3
"""Events and tasks on two nodes: interrupts, held events, resumed visits, tasks that come in once."""

import contextlib
import io
import json
import os
import signal
import sys
import tempfile

import rospy
from std_msgs.msg import Empty, Float32, String

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [os.path.join(os.path.dirname(HERE), "support")]

from robots import RobotTestCase
from waiting import wait_for

from gspn_framework_package.cli.main import main

ACTIONS = """
import json


def tell(file, *words):
    with open(file, "a") as told:
        told.write(json.dumps(words) + "\\\\n")


def work(file, robot, visit, resumed_from, is_cancelled):
    tell(file, robot, "works", visit, resumed_from)
    is_cancelled.wait()
    tell(file, robot, "stops", visit)


def charge(is_cancelled):
    is_cancelled.wait()


def deliver(file, robot, data):
    tell(file, robot, "delivers", data["task.id"], data.get("task.number"))
""".replace("\\\\n", "\\n")

ROBOTS = ("robot_1", "robot_2")
BATTERY = {"topic": "battery", "type": "std_msgs/Float32"}


def plan_of(file, synchronisation="full", **changes):
    """Two robots work. Their batteries send them to a charger with one dock, and back; a call sends
    one to wait for orders, which it delivers."""
    arcs = {
        "finish": ("Work", "Work"),
        "low": ("Work Dock", "Charge"),
        "full": ("Charge", "Work Dock"),
        "call": ("Work", "Wait"),
        "order": ("", "Orders"),
        "take": ("Wait Orders", "Deliver"),
        "delivered": ("Deliver", "Wait"),
    }
    told = {"settings": {"file": file}}
    plan = {
        "net": {
            "places": [{"name": p} for p in ("Work", "Charge", "Wait", "Deliver")]
            + [{"name": "Dock", "tokens": 1}, {"name": "Orders", "tokens": 0, "capacity": 3}],
            "transitions": [{"name": t, "timed": t != "take"} for t in arcs],
            "arcs": [
                {"from": p, "to": t} for t, (before, _) in arcs.items() for p in before.split()
            ]
            + [{"from": t, "to": p} for t, (_, after) in arcs.items() for p in after.split()],
        },
        "actions": {
            "Work": {"function": "actions.work", **told},
            "Charge": "actions.charge",
            "Wait": None,
            "Deliver": {"function": "actions.deliver", **told},
        },
        "resource_places": ["Orders", "Dock"],
        "robots": dict.fromkeys(ROBOTS, "Work"),
        "synchronisation": synchronisation,
        "events": {
            "low": {**BATTERY, "when": "data < 0.2", "hold": True, "resume": True},
            "full": {**BATTERY, "when": "data > 0.8"},
            "call": {"topic": "call", "type": "std_msgs/Empty"},
            "order": {"topic": "orders", "type": "std_msgs/String", "json": "data"},
        },
        "tasks": {"queues": ["Orders"], "done": ["delivered"]},
    }
    plan["events"].update(changes)
    return plan


def gspn(*words):
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        code = main(words)
    return code, output.getvalue()


class Reacting(RobotTestCase):
    def setUp(self):
        self.file = os.path.join(tempfile.mkdtemp(prefix="gspn_rostest_"), "told")

    def told(self, *words):
        """What the actions have told, of those that begin with these words."""
        if not os.path.exists(self.file):
            return []
        with open(self.file) as file:
            lines = [json.loads(line) for line in file if line.endswith("\n")]
        return [line for line in lines if line[: len(words)] == list(words)]

    def publisher(self, topic, kind):
        publisher = rospy.Publisher(topic, kind, queue_size=10)
        self.addCleanup(publisher.unregister)
        wait_for(lambda: publisher.get_num_connections() == 1, 30, "a subscriber of " + topic)
        return publisher

    def test_in_full_synchronisation(self):
        self.react("full")

    def test_in_partial_synchronisation(self):
        self.react("partial")

    def react(self, synchronisation):
        team = self.team(plan_of(self.file, synchronisation), ROBOTS, actions=ACTIONS).start()
        one, two = (team[name] for name in ROBOTS)
        wait_for(lambda: len(self.told()) == 2, 30, "the work of both")
        battery = {name: self.publisher("/%s/battery" % name, Float32) for name in ROBOTS}
        call = self.publisher("/robot_1/call", Empty)
        orders = {name: self.publisher("/%s/orders" % name, String) for name in ROBOTS}

        def is_in(robot, place):
            wait_for(lambda: robot.state().place == place, what="%s in %s" % (robot.name, place))

        def fired(transition, number):
            wait_for(
                lambda: one.logged_transitions().count(transition) >= number,
                what="%d times %s" % (number, transition),
            )

        # an event interrupts; another one is held until the dock is free; both go on where they were
        battery["robot_1"].publish(0.1)
        is_in(one, "Charge")
        wait_for(lambda: self.told("robot_1", "stops", 1), what="the end of the action")
        battery["robot_2"].publish(0.15)
        wait_for(lambda: "interrupt" in self.kinds_in(two), what="the event in the log")
        self.assertEqual(two.state().place, "Work")
        self.assertEqual(self.told("robot_2", "stops"), [])
        battery["robot_1"].publish(0.9)
        is_in(two, "Charge")
        battery["robot_2"].publish(0.9)
        for name in ROBOTS:
            wait_for(lambda name=name: self.told(name, "works", 3), what="the work goes on")
            self.assertEqual(
                self.told(name, "works"), [[name, "works", n, r] for n, r in ((1, 0), (3, 1))]
            )
        causes = [entry["cause"] for entry in self.entries(two, "interrupt")]
        self.assertEqual(sorted(round(cause["data"], 3) for cause in causes), [0.1, 0.15, 0.9, 0.9])

        # one task that reaches both robots comes in once
        call.publish()
        is_in(one, "Wait")
        for publisher in orders.values():
            publisher.publish('{"id": "both", "number": 7}')
        wait_for(lambda: self.told("robot_1", "delivers"), what="the delivery")
        self.assertEqual(self.told("robot_1", "delivers"), [["robot_1", "delivers", "both", 7]])

        # a task that only one robot got, which is killed before the team has it
        fired("delivered", 1)
        one.signal(signal.SIGSTOP)
        orders["robot_2"].publish('{"id": "kept"}')
        wait_for(lambda: "offered" in self.kinds_in(two), what="the task in its log")
        wait_for(lambda: b'"kept"' in self.bytes_of(two), what="the task in its log")
        two.kill()
        one.signal(signal.SIGCONT)
        two.start()
        wait_for(lambda: self.told("robot_1", "delivers", "kept"), 40, "the delivery")

        # by hand, twice
        code, output = gspn("submit", "order", "--id", "mine", "--data", '{"number": 1}')
        self.assertEqual(code, 0, output)
        wait_for(lambda: self.told("robot_1", "delivers", "mine"), what="the delivery")
        code, output = gspn("submit", "order", "--id", "mine", "--json")
        self.assertEqual(code, 0, output)
        self.assertIn("was submitted before", json.loads(output)["message"])
        code, output = gspn("submit", "finish")
        self.assertEqual(code, 1, output)
        self.assertIn("'finish' does not take tasks", output)
        refused = one.command("submit", argument="order")
        self.assertFalse(refused.success)
        self.assertIn("is not a JSON object with transition", refused.message)

        # a task is cancelled; a pause stops an action, which is taken up again
        self.assertEqual(gspn("pause", "robot_1")[0], 0)
        code, output = gspn("submit", "order", "--id", "no", "--priority", "3")
        self.assertIn("it is in Orders", output)
        told = json.loads(gspn("tasks", "--json")[1])
        self.assertEqual(
            [(task["id"], task["where"], task["priority"]) for task in told["tasks"]],
            [("no", "in Orders", 3)],
        )
        self.assertIn("it was cancelled (in Orders)", gspn("cancel", "no")[1])
        self.assertEqual(gspn("cancel", "no")[0], 1)
        self.assertEqual(gspn("resume", "robot_1")[0], 0)
        works, stops = (len(self.told("robot_2", what)) for what in ("works", "stops"))
        self.assertEqual(gspn("pause", "robot_2", "--stop")[0], 0)
        wait_for(lambda: len(self.told("robot_2", "stops")) > stops, what="the end of the action")
        self.assertIn("its action is stopped", gspn("status")[1])
        self.assertEqual(len(self.told("robot_2", "works")), works)
        self.assertEqual(gspn("resume", "robot_2")[0], 0)
        wait_for(lambda: len(self.told("robot_2", "works")) > works, what="the work goes on")

        team.wait_for_agreement()
        self.assertEqual(
            [line[2] for line in self.told("robot_1", "delivers")], ["both", "kept", "mine"]
        )
        self.assertEqual(one.logged_transitions().count("order"), 4)
        self.assertIsNone(team.verify())

    def test_a_plan_whose_events_do_not_fit_their_topics_does_not_start(self):
        wrong = {**BATTERY, "when": "percentage < 0.2"}
        team = self.team(plan_of(self.file, low=wrong), ROBOTS, actions=ACTIONS)
        robot = team["robot_1"].start()
        self.assertEqual(robot.exit_code(), 2)
        self.assertIn(
            "event of 'low': 'when' (percentage < 0.2): std_msgs/Float32 has no", robot.said()
        )
        self.assertNotIn("Traceback", robot.said())

    def bytes_of(self, robot):
        with open(robot.log_file, "rb") as file:
            return file.read()

    def entries(self, robot, kind):
        """The entries of a kind in a robot's log, of all slots."""
        slots = (r for r in robot.log().records if r["kind"] == "slot")
        return [entry for slot in slots for entry in slot["entries"] if entry["entry"] == kind]

    def kinds_in(self, robot):
        """The kinds of records and of entries in a robot's log."""
        records = robot.log().records
        return {r["kind"] for r in records} | {
            e["entry"] for r in records for e in r.get("entries", ())
        }


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_reacting")
    rostest.rosrun("gspn_framework_package", "reacting", __name__)
