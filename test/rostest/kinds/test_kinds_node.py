#!/usr/bin/env python3
"""Actions that are no action servers: services, messages, programs; and data from one to the
next."""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import rospy
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [HERE, os.path.join(os.path.dirname(HERE), "support")]

from robots import RobotTestCase, chain
from waiting import PATIENCE, wait_for
from worker import PATIENT, Worker, plan_in

from gspn_framework_package.execution.agreement.interface import AttemptFailed
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.model.action import (
    CommandAction,
    PublishAction,
    ServiceAction,
    WaitAction,
)
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.plan import RobotSpec
from gspn_framework_package.ros.action_kinds import jobs, look_at_actions
from gspn_framework_package.ros.event_sources import look_at_events
from gspn_framework_package.ros.robot_actions import open_jobs
from gspn_framework_package.ros.transport.registration import topic_types
from gspn_framework_package.team.job_runner import JobRunner

SET_BOOL, TRIGGER, STRING = "std_srvs/SetBool", "std_srvs/Trigger", "std_msgs/String"


plan_of = partial(plan_in, HERE)


class Robot:
    """A job runner with a worker thread of its own, as the execution node has one."""

    def __init__(self, plan, namespace, patience=PATIENT):
        self.ended, self.faults = queue.Queue(), []
        self._worker = Worker()
        self.jobs = jobs(plan, "robot_1", namespace)
        open_jobs(self.jobs)
        self.runner = JobRunner(
            self.jobs,
            plan.timeout,
            self._worker.put,
            self.ended.put,
            patience,
            plan.cancel_grace,
            self.faults.append,
        )
        self._visits = 0
        self._worker.drive(self.runner)

    def send(self, place, delay=0.0, **data):
        self._visits += 1
        data = {name.replace("_", ".", 1): value for name, value in data.items()}
        command = StartAction("robot_1", place, 1, self._visits, 1, delay, data)
        self._worker.put(self.runner.start, command, time.monotonic())

    def end(self):
        ended = self.ended.get(timeout=20 * PATIENCE)
        if isinstance(ended, AttemptFailed):
            return "", ended.reason, ended.detail, {}
        return ended.result, "", "", ended.data

    def do(self, place, **data):
        self.send(place, **data)
        return self.end()

    def cancel(self):
        self._worker.put(self.runner.cancel)

    def close(self):
        self._worker.close()


class KindsTest(RobotTestCase):
    def setUp(self):
        self.namespace = "/" + self._testMethodName
        self.closing = []

    def tearDown(self):
        for close in reversed(self.closing):
            close()
        super().tearDown()

    def robot(self, actions, patience=PATIENT, **more):
        robot = Robot(plan_of(actions, **more), self.namespace, patience)
        self.closing.append(robot.close)
        return robot

    def serve(self, name, kind, answer):
        service = rospy.Service("%s/%s" % (self.namespace, name), kind, answer)
        self.closing.append(service.shutdown)

    # -- services ----------------------------------------------------------------------------------

    def test_a_service_is_called_with_data_and_its_response_is_kept(self):
        def answer(request):
            return SetBoolResponse(request.data, "Tür %s" % ("auf" if request.data else "zu"))

        self.serve("door", SetBool, answer)
        keep = {"team.said": "message"}
        request = {"data": {"from": "task.open"}}
        robot = self.robot(
            {
                "P1": ServiceAction("door", SET_BOOL, request, {}, keep),
                "P2": ServiceAction("door", SET_BOOL, request, {"aborted": "T_no"}, keep),
                "P3": ServiceAction("door", SET_BOOL, request, {"succeeded": "T_yes"}),
            }
        )
        opened, closed = {"team.said": "Tür auf"}, {"team.said": "Tür zu"}
        self.assertEqual(robot.do("P1", task_open=True), ("", "", "", opened))
        self.assertEqual(robot.do("P1", task_open=False)[:3], ("", "aborted", "Tür zu"))
        self.assertEqual(robot.do("P2", task_open=False), ("T_no", "", "", closed))
        self.assertEqual(robot.do("P3", task_open=True), ("T_yes", "", "", {}))
        self.assertEqual(robot.do("P1")[1:3], ("aborted", "there is no data 'task.open'"))
        _, reason, detail, _ = robot.do("P1", task_open="ajar")
        self.assertEqual(reason, "aborted")
        self.assertIn("its request does not fit std_srvs/SetBoolRequest", detail)

    def test_every_failure_of_a_service_has_its_reason(self):
        def breaks(request):
            raise rospy.ServiceException("the arm is stuck")

        self.serve("breaks", Trigger, breaks)
        self.serve("other", SetBool, lambda request: SetBoolResponse())
        robot = self.robot(
            {
                "P1": ServiceAction("breaks", TRIGGER),
                "P2": ServiceAction("other", TRIGGER),
                "P3": ServiceAction("nobody", TRIGGER),
            },
            PATIENT._replace(server=0.5),
        )
        _, reason, detail, _ = robot.do("P1")
        self.assertEqual((reason, "the arm is stuck" in detail), ("aborted", True), detail)
        _, reason, detail, _ = robot.do("P2")
        self.assertEqual(reason, "rejected")
        self.assertTrue(
            detail.endswith("is of type std_srvs/SetBool, not std_srvs/Trigger"), detail
        )
        robot.send("P3")
        name = self.namespace + "/nobody"
        wait_for(lambda: robot.runner.doing() == "waits for the service " + name, what="words")
        self.assertEqual(
            robot.end()[1:3], ("no server", name + " did not answer within 0.5 s (~server_timeout)")
        )

    def test_a_call_that_takes_too_long_or_is_cancelled_is_broken_off(self):
        release, called = threading.Event(), []
        self.closing.append(release.set)

        def hangs(request):
            called.append(1)
            release.wait(60)
            return TriggerResponse(True, "")

        self.serve("hangs", Trigger, hangs)
        action = ServiceAction("hangs", TRIGGER)
        robot = self.robot({"P1": action, "P2": action}, timeouts={"P1": 0.3}, cancel_grace=0.2)
        self.assertEqual(
            robot.do("P1")[1:3],
            ("timeout", "the action took longer than 0.3 s (timeout in the plan)"),
        )
        robot.send("P2")
        wait_for(lambda: len(called) == 2, what="the second call")
        robot.cancel()
        wait_for(lambda: not robot.runner._cancelled, what="the time of grace to be over")
        self.assertEqual((robot.faults, robot.ended.empty()), ([], True))

    def test_a_service_that_comes_late_is_called_and_one_that_dies_is_noticed(self):
        robot = self.robot({"P1": ServiceAction("late", TRIGGER)})
        robot.send("P1")
        wait_for(lambda: robot.runner.doing(), what="the robot to wait")
        killed = os.path.join(os.path.dirname(HERE), "support", "service_that_hangs.py")
        process = self.start_process(killed, self.namespace + "/late")
        wait_for(lambda: robot.runner.doing() == "", what="the call")
        process.send_signal(signal.SIGKILL)
        self.assertEqual(robot.end()[1], "server died")

    def start_process(self, script, *words):
        process = subprocess.Popen([sys.executable, script, *words])
        self.closing.append(process.wait)
        self.closing.append(process.kill)
        return process

    # -- messages ----------------------------------------------------------------------------------

    def test_a_message_reaches_subscribers_that_the_publisher_has_not_met(self):
        heard = []
        subscriber = rospy.Subscriber(self.namespace + "/goal", PoseStamped, heard.append)
        self.closing.append(subscriber.unregister)
        message = {"header": {"stamp": "now"}, "pose": {"from": "task.pose"}}
        robot = self.robot({"P1": PublishAction("goal", "geometry_msgs/PoseStamped", message)})
        pose = {"position": {"x": 2.5}}
        self.assertEqual(robot.do("P1", task_pose=pose), ("", "", "", {}))
        wait_for(lambda: heard, what="the message")
        self.assertEqual(heard[0].pose.position.x, 2.5)
        self.assertGreater(heard[0].header.stamp.to_sec(), 0)
        self.assertEqual(robot.do("P1")[2], "there is no data 'task.pose'")
        self.assertIn("does not fit", robot.do("P1", task_pose={"x": 1})[2])
        self.assertEqual(robot.do("P1", task_pose=pose)[1], "")
        wait_for(lambda: len(heard) == 2, what="the second message")

    def test_a_wait_ends_with_a_message_for_which_its_condition_holds(self):
        publisher = rospy.Publisher(self.namespace + "/level", Float64, queue_size=10)
        self.closing.append(publisher.unregister)
        robot = self.robot(
            {
                "P1": WaitAction("level", "std_msgs/Float64", "1 / data > 2", {"level": "data"}),
                "P2": WaitAction("level", "std_msgs/Float64"),
            },
            timeouts={"P2": 0.3},
        )
        heard = []
        subscriber = rospy.Subscriber(self.namespace + "/level", Float64, heard.append)
        self.closing.append(subscriber.unregister)
        wait_for(publisher.get_num_connections, what="the robot's subscription")
        publisher.publish(0.1)  # before the wait: it does not count
        wait_for(lambda: heard, what="the message")
        robot.send("P1")
        words = "waits for a message on %s/level with 1 / data > 2" % self.namespace
        wait_for(lambda: robot.runner.doing() == words, what="words")
        for level in (0.9, 0.0, 0.8, 0.25, 0.125):
            publisher.publish(level)
        self.assertEqual(robot.end(), ("", "", "", {"level": 0.25}))
        wait_for(lambda: len(heard) == 6, what="the last message, which ends no wait")
        self.assertEqual(
            robot.do("P2")[1:3],
            ("timeout", "the action took longer than 0.3 s (timeout in the plan)"),
        )
        robot.send("P1")
        wait_for(lambda: robot.runner.doing() == words, what="the robot to wait")
        robot.cancel()
        wait_for(lambda: not robot.runner.doing(), what="the end of the wait")
        robot.send("P1")
        wait_for(lambda: robot.runner.doing() == words, what="the robot to wait")
        publisher.publish(0.2)
        self.assertEqual(robot.end()[3], {"level": 0.2})
        self.assertTrue(robot.ended.empty())

    def test_a_latched_message_counts_however_old_it_is(self):
        publisher = rospy.Publisher(self.namespace + "/door", String, latch=True, queue_size=1)
        self.closing.append(publisher.unregister)
        publisher.publish("open")
        robot = self.robot(
            {
                "P1": WaitAction("door", STRING, "data == 'open'"),
                "P2": WaitAction("door", STRING, "data == 'shut'"),
            }
        )
        for _ in range(2):
            self.assertEqual(robot.do("P1")[1], "")
        robot.send("P2")
        wait_for(lambda: robot.runner.doing(), what="the robot to wait")
        publisher.publish("shut")
        self.assertEqual(robot.end()[1], "")
        self.assertEqual(robot.do("P2")[1], "")

    # -- programs ----------------------------------------------------------------------------------

    def test_a_command_is_carried_out_and_ends_when_it_is_cancelled(self):
        robot = self.robot(
            {
                "P1": CommandAction(("printf", "[%s]", {"from": "n"}), keep="team.n"),
                "P2": CommandAction(("sleep", "600")),
                "P3": CommandAction(("sh", "-c", "echo no >&2; exit 2")),
            },
            cancel_grace=0.5,
        )
        self.assertEqual(robot.do("P1", robot_n=3), ("", "", "", {"team.n": [3]}))
        self.assertEqual(robot.do("P3")[1:3], ("aborted", "'sh': exit code 2: no"))
        robot.send("P2")
        robot.cancel()
        wait_for(lambda: not robot.runner._cancelled, what="the end of the command")
        self.assertEqual((robot.faults, robot.ended.empty()), ([], True))

    # -- what does not fit -------------------------------------------------------------------------

    def test_what_does_not_fit_is_refused_before_the_run(self):
        for action, message in (
            (ServiceAction("s", "std_srvs/NoSuch"), "no service type 'std_srvs/NoSuch'"),
            (ServiceAction("s", SET_BOOL, {"dta": True}), "its request does not fit .*dta"),
            (ServiceAction("s", SET_BOOL, {"data": "yes"}), "its request does not fit"),
            (ServiceAction("s", SET_BOOL, {}, {}, {"x": "text"}), "keep.x: .* no field 'text'"),
            (ServiceAction("a b", SET_BOOL), "not a legal name"),
            (PublishAction("t", "std_msgs/NoSuch"), "no message type 'std_msgs/NoSuch'"),
            (PublishAction("t", STRING, {"data": 3}), "its message does not fit std_msgs/String"),
            (WaitAction("t", STRING, "text == 'a'"), "when: std_msgs/String has no field 'text'"),
            (WaitAction("t", STRING, "", {"x": "data.x"}), "keep.x: .* no field 'data.x'"),
        ):
            with self.assertRaisesRegex(PlanError, message) as caught:
                jobs(plan_of({"P1": action}), "robot_1", "/x")
            self.assertEqual(caught.exception.element, "action of 'P1'")

    def test_what_the_graph_knows_otherwise_is_found(self):
        publisher = rospy.Publisher(self.namespace + "/text", String, queue_size=1)
        self.closing.append(publisher.unregister)
        self.serve("door", SetBool, lambda request: SetBoolResponse())
        wait_for(lambda: self.namespace + "/text" in topic_types(), what="the registration")
        name = self.namespace
        actions = {
            "P1": WaitAction(name + "/text", "std_msgs/Float64"),
            "P2": PublishAction(name + "/text", "std_msgs/Float64"),
            "P3": ServiceAction(name + "/door", TRIGGER),
            "P4": WaitAction(name + "/text", STRING),
            "P5": ServiceAction(name + "/door", SET_BOOL),
            "P6": ServiceAction(name + "/nobody", SET_BOOL),
        }
        plan = plan_of(actions, robots=(RobotSpec("robot_1", "P1"),))
        found = look_at_actions(plan)
        text = name + "/text has messages of type std_msgs/String, not std_msgs/Float64"
        door = name + "/door is of type std_srvs/SetBool, not std_srvs/Trigger"
        self.assertEqual(
            found.misfits,
            {"robot_1 in P1": text, "robot_1 in P2": text, "robot_1 in P3": door},
        )
        self.assertEqual(found.unknown, {})
        source = EventSource(name + "/text", "std_msgs/Float64", "data > 1")
        plan = plan_of({"P1": None}, robots=(RobotSpec("robot_1", "P1"),), events={"T1": source})
        self.assertEqual(look_at_events(plan).misfits, {"T1": text})

    # -- execution nodes ---------------------------------------------------------------------------

    def test_data_goes_from_kind_to_kind_in_a_run(self):
        self.serve("door", SetBool, lambda request: SetBoolResponse(True, "open"))
        heard = []
        subscriber = rospy.Subscriber(self.namespace + "/said", String, heard.append)
        self.closing.append(subscriber.unregister)
        publisher = rospy.Publisher(self.namespace + "/go", String, latch=True, queue_size=1)
        self.closing.append(publisher.unregister)
        publisher.publish('"on"')
        folder_file = "ran"
        plan = {
            "net": chain(["Think", "Door", "Tell", "Wait", "Note", "Check", "End"]),
            "actions": {
                "Think": "actions.think",
                "Door": {
                    "service": "door",
                    "type": SET_BOOL,
                    "request": {"data": {"from": "open"}},
                    "keep": {"team.door": "message"},
                },
                "Tell": {
                    "publish": "said",
                    "type": STRING,
                    "message": {"data": {"from": "team.door"}},
                },
                "Wait": {"wait_for": "go", "type": STRING, "keep": {"word": "data"}},
                "Note": {
                    "command": [
                        "sh",
                        "-c",
                        "echo $0; echo $0 > %s" % folder_file,
                        {"from": "word"},
                    ],
                    "keep": "team.noted",
                },
                "Check": "actions.check",
                "End": None,
            },
            "robots": {"robot_1": "Think"},
        }
        actions = (
            "def think():\n"
            "    return 'T1', {'open': True}\n"
            "def check(data):\n"
            "    assert data == {'robot.open': True, 'team.door': 'open', 'robot.word': '\"on\"',\n"
            "                    'team.noted': 'on'}, data\n"
        )
        team = self.team(
            plan, ["robot_1"], {"robot_1": self.namespace}, actions=actions, allow_commands=True
        )
        team.start()
        robot = team["robot_1"]
        self.assertEqual(robot.exit_code(), 0, robot.said())
        self.assertEqual([message.data for message in heard], ["open"])
        self.assertEqual(robot.logged_transitions(), ["T%d" % n for n in range(1, 7)])
        with open(os.path.join(team.plan, folder_file)) as file:
            self.assertEqual(json.loads(file.read()), "on")
        self.assertIsNone(team.verify())

    def test_what_is_missing_or_forbidden_ends_a_node_at_its_start_with_one_message(self):
        self.serve("door", SetBool, lambda request: SetBoolResponse())
        started = []
        for action, words in (
            ({"command": ["true"]}, ["commands are not allowed", "allow_commands:=true"]),
            ({"service": "nobody", "type": TRIGGER}, ["there is no service ", "/nobody"]),
            ({"service": "door", "type": TRIGGER}, ["is of type std_srvs/SetBool", "Trigger"]),
        ):
            plan = {
                "net": chain(["P", "End"]),
                "actions": {"P": action, "End": None},
                "robots": {"robot_1": "P"},
            }
            number = len(started)
            team = self.team(
                plan,
                ["robot_1"],
                {"robot_1": self.namespace if number == 2 else "%s_%d" % (self.namespace, number)},
                server_timeout=0.5,
            )
            started.append((team.start()["robot_1"], words))
        for robot, words in started:
            self.assertEqual(robot.exit_code(), 1, robot.said())
            for word in words:
                self.assertIn(word, robot.said())
            self.assertNotIn("Traceback", robot.said())


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_kinds")
    rostest.rosrun("gspn_framework_package", "kinds", KindsTest)
