#!/usr/bin/env python3
"""Place servers, and how goals are sent to them and to servers of others."""

import json
import os
import queue
import subprocess
import sys
import threading
import time
import unittest
from functools import partial

import actionlib
import rospy
from actionlib.msg import TestAction, TestRequestAction, TestResult
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from move_base_msgs.msg import MoveBaseAction
from std_msgs.msg import Header

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [HERE, os.path.join(os.path.dirname(HERE), "support")]

from waiting import PATIENCE, wait_for
from worker import PATIENT, Worker, plan_in

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.model.action import FunctionAction, ServerAction
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import RobotSpec
from gspn_framework_package.msg import (
    ExecGSPNAction,
    ExecGSPNActionGoal,
    ExecGSPNActionResult,
    ExecGSPNGoal,
    ExecGSPNResult,
)
from gspn_framework_package.ros.action_caller import ActionCaller
from gspn_framework_package.ros.action_kinds import look_at_actions
from gspn_framework_package.ros.action_targets import action_targets
from gspn_framework_package.ros.goal_id import parse_goal_id
from gspn_framework_package.ros.node_main import await_servers
from gspn_framework_package.ros.place_servers import KEPT_ENDED, PlaceServers
from gspn_framework_package.ros.transport.ending import Ending
from gspn_framework_package.ros.transport.registration import published_topics

MOVE_BASE = "move_base_msgs/MoveBaseAction"
EXEC = "gspn_framework_package/ExecGSPNAction"


plan_of = partial(plan_in, HERE)


class Robot:
    """An action caller with a worker thread of its own, as the execution node has one."""

    def __init__(self, plan, namespace, robot="robot_1", **options):
        self.robot = robot
        self.ended, self.feedback = queue.Queue(), []
        self._worker = Worker()
        options.setdefault("patience", PATIENT)
        self.caller = ActionCaller(
            robot,
            action_targets(plan, robot, namespace),
            plan.timeout,
            self._worker.put,
            self.ended.put,
            lambda identity, message: self.feedback.append(message),
            **options,
        )
        self._visits = 0
        self._worker.drive(self.caller)

    def send(self, place, incarnation=1, attempt=1, visit=None, **given):
        self._visits += 1
        command = StartAction(
            self.robot, place, incarnation, visit or self._visits, attempt, **given
        )
        self._worker.put(self.caller.start, command, time.monotonic())

    def do(self, place, seconds=20.0, **options):
        self.send(place, **options)
        return self.ended.get(timeout=seconds)

    def cancel(self):
        self._worker.put(self.caller.cancel)

    def is_under_way(self):
        """Whether a server has taken the goal."""
        goal = self.caller._goal
        return goal is not None and bool(goal.acknowledged_by)

    def close(self):
        self._worker.close()


class Server:
    """A plain action server in this process; its goals wait until the test ends them."""

    def __init__(self, name, action_type, on_goal=None):
        self.goals = queue.Queue()
        self.cancelled = []
        self._on_goal = on_goal or self.goals.put
        self.server = actionlib.ActionServer(
            name, action_type, self._on_goal, self.cancelled.append, auto_start=False
        )
        self.server.start()

    def next(self):
        """The next goal, once its result would be heard: a client knows of its connection a moment
        earlier."""
        goal = self.goals.get(timeout=20 * PATIENCE)
        wait_for(self.server.result_pub.get_num_connections, what="a client of the results")
        return goal


class ActionsTest(unittest.TestCase):
    def setUp(self):
        self.namespace = "/" + self._testMethodName
        self._closing = []

    def tearDown(self):
        for close in reversed(self._closing):
            close()

    def serve(self, actions, robot="robot_1"):
        """Place servers for Python actions, and a robot that uses them."""
        plan = plan_of({p: FunctionAction("acts." + f, p) for p, f in actions.items()})
        servers = PlaceServers(plan, robot, self.namespace)
        servers.start()
        self._closing.append(servers.stop)
        return plan, servers

    def robot(self, plan, **options):
        robot = Robot(plan, self.namespace, **options)
        self._closing.append(robot.close)
        return robot

    def acts(self):
        """The module that the servers have loaded from this folder."""
        name = next(n for n in sys.modules if n.startswith("gspn_plan_") and n.endswith("_acts"))
        module = sys.modules[name]
        del module.seen[:], module.ended[:]
        return module

    # -- place servers -----------------------------------------------------------------------------

    def test_a_result_names_the_transition(self):
        plan, _ = self.serve({"P1": "instant", "P2": "instant"})
        robot = self.robot(plan)
        self.assertEqual(robot.do("P1")[1:4], ("T_P1", "succeeded", ""))
        self.assertEqual(robot.do("P2")[1:4], ("T_P2", "succeeded", ""))

    def test_an_action_is_reported_who_asks_and_tells_how_far_it_is(self):
        plan, _ = self.serve({"P1": "tell"})
        acts = self.acts()
        robot = self.robot(plan)

        def listen():
            wait_for(lambda: len(robot.feedback) == 2, what="feedback")
            acts.heard.set()

        acts.heard.clear()
        threading.Thread(target=listen, daemon=True).start()
        self.assertEqual(robot.do("P1", visit=7, attempt=3)[1:4], ("", "succeeded", ""))
        self.assertEqual(acts.seen, [("P1", "robot_1", 7, 3)])
        self.assertEqual([f.time_passed for f in robot.feedback], [(1,), (2, 3)])

    def test_an_exception_aborts_with_its_text(self):
        plan, _ = self.serve({"P1": "breaks", "P2": "leaves", "P3": "bad_feedback"})
        robot = self.robot(plan)
        self.assertEqual(robot.do("P1")[1:4], ("", "aborted", "ValueError: the arm is stuck"))
        self.assertEqual(robot.do("P2")[1:4], ("", "aborted", "SystemExit: 3"))
        self.assertEqual(robot.do("P3")[2], "aborted")

    def test_a_newer_goal_of_the_robot_cancels_its_older_ones(self):
        plan, _ = self.serve({"P1": "until_cancelled", "P2": "instant"})
        acts = self.acts()
        robot = self.robot(plan)
        robot.send("P1", visit=1)
        wait_for(lambda: acts.seen == [1], what="the first action")
        self.assertEqual(robot.do("P2", visit=2).result, "T_P2")
        wait_for(lambda: acts.ended == [(1, True)], what="its end")

    def test_goals_of_a_dead_node_are_cancelled_by_its_successor(self):
        plan, _ = self.serve({"P1": "until_cancelled"})
        acts = self.acts()
        first = self.robot(plan)
        first.send("P1", incarnation=1, visit=4)
        wait_for(lambda: acts.seen == [4], what="the first action")
        second = self.robot(plan)
        second.send("P1", incarnation=2, visit=4, attempt=2)
        wait_for(lambda: acts.ended == [(4, True)], what="its end")
        wait_for(lambda: acts.seen == [4, 4], what="the second attempt")
        second.cancel()
        wait_for(lambda: len(acts.ended) == 2, what="the end of the second attempt")

    def test_the_goal_of_a_node_that_died_is_cancelled(self):
        plan, servers = self.serve({"P1": "until_cancelled"})
        acts = self.acts()
        code = (
            "import rospy, actionlib, time\n"
            "from gspn_framework_package.msg import ExecGSPNAction, ExecGSPNGoal\n"
            "rospy.init_node('dies')\n"
            "c = actionlib.ActionClient('%s/P1', ExecGSPNAction)\n"
            "assert c.wait_for_server(rospy.Duration(10))\n"
            "h = c.send_goal(ExecGSPNGoal('P1'))\n"
            "time.sleep(60)\n" % self.namespace
        )
        process = subprocess.Popen([sys.executable, "-c", code])
        self._closing.append(process.kill)
        wait_for(lambda: acts.seen == [0], 20, "the action")
        (goal,) = servers._running.values()
        wait_for(lambda: goal._was_there, what="the servers to see that the node is there")
        process.kill()
        wait_for(lambda: acts.ended == [(0, True)], 10, "its end")

    def test_the_end_of_the_servers_is_no_result_of_an_action(self):
        plan, servers = self.serve({"P1": "until_cancelled"})
        acts = self.acts()
        robot = self.robot(plan, patience=PATIENT._replace(result=0.3))
        robot.send("P1", visit=4)
        wait_for(lambda: acts.seen == [4], what="the action")
        wait_for(robot.is_under_way, what="the goal to be taken")
        servers.stop()
        wait_for(lambda: acts.ended == [(4, True)], what="its end")
        self.assertEqual(robot.ended.get(timeout=20 * PATIENCE).outcome, "server died")

    def test_a_place_that_is_not_served_is_rejected(self):
        plan = plan_of(
            {
                "P1": FunctionAction("acts.instant", "both"),
                "P2": FunctionAction("acts.instant", "both"),
            }
        )
        servers = PlaceServers(plan, "robot_1", self.namespace)
        servers.start()
        self._closing.append(servers.stop)
        self.assertEqual(servers.names, [self.namespace + "/both"])
        robot = self.robot(plan)
        self.assertEqual(robot.do("P1").result, "T_P1")
        self.assertEqual(robot.do("P2").result, "T_P2")
        other = self.robot(plan_of({"P3": ServerAction(EXEC, "both")}))
        ended = other.do("P3")
        self.assertEqual((ended.outcome, "P3" in ended.detail), ("rejected", True))

    def test_a_client_of_the_thesis_works_against_a_place_server(self):
        _, servers = self.serve({"P1": "instant"})
        client = actionlib.SimpleActionClient(self.namespace + "/P1", ExecGSPNAction)
        self.assertTrue(client.wait_for_server(rospy.Duration(20)))
        (server,) = servers.servers.values()
        wait_for(server.result_pub.get_num_connections, what="the server's side of the connection")
        self.assertEqual(
            client.send_goal_and_wait(ExecGSPNGoal("P1"), rospy.Duration(20)),
            GoalStatus.SUCCEEDED,
        )
        self.assertEqual(client.get_result().transition, "T_P1")

    def test_an_action_that_never_returns_keeps_no_other_waiting(self):
        plan, _ = self.serve({"P1": "hangs", "P2": "instant"})
        acts = self.acts()
        acts.release.clear()
        self._closing.append(acts.release.set)
        robot = self.robot(plan)
        robot.send("P1")
        self.assertEqual(robot.do("P2").result, "T_P2")
        self.assertEqual(robot.do("P2").result, "T_P2")

    # -- data --------------------------------------------------------------------------------------

    def test_python_actions_read_and_write_data_whoever_serves_them(self):
        plan, servers = self.serve({"P1": "count_on", "P2": "instant"})
        for own_servers in (servers.servers, None):  # in the process, or over topics
            robot = self.robot(plan, own_servers=own_servers)
            ended = robot.do("P1", data={"robot.count": 41, "task.where": "Küche"}, resumed_from=7)
            self.assertEqual(ended[1:4], ("T_P1", "succeeded", ""))
            self.assertEqual(
                ended.data, {"count": 42, "team.note": ["Küche", 7], "robot.long": "x" * 60000}
            )
            self.assertEqual(robot.do("P2").data, {})

    def test_data_that_cannot_be_kept_is_a_failure_with_its_name(self):
        plan, servers = self.serve({"P1": "writes_no_data"})
        for own_servers in (servers.servers, None):
            robot = self.robot(plan, own_servers=own_servers)
            ended = robot.do("P1")
            self.assertEqual(ended.outcome, "aborted")
            self.assertTrue(ended.detail.startswith("the value of 'thing' is not JSON"), ended)

    def test_servers_of_others_of_the_thesis_type_read_and_write_data_too(self):
        server = Server(self.namespace + "/foreign", ExecGSPNAction)
        robot = self.robot(plan_of({"P1": ServerAction(EXEC, "foreign")}))
        texts = []
        rospy.Subscriber(
            self.namespace + "/foreign/goal",
            ExecGSPNActionGoal,
            lambda goal: texts.append(goal.header.frame_id),
        )
        for text, given, data, outcome in (
            ('{"pose": [1, 2]}', {"data": {"robot.x": 1}}, {"pose": [1, 2]}, "succeeded"),
            ("all is well", {}, {}, "succeeded"),
            ('{"no name": 1}', {}, {}, "bad result"),
        ):
            robot.send("P1", **given)
            goal = server.next()
            goal.set_accepted()
            goal.set_succeeded(ExecGSPNResult("T1"), text)
            ended = robot.ended.get(timeout=20 * PATIENCE)
            self.assertEqual((ended.data, ended.outcome), (data, outcome))
        self.assertIn("no name", ended.detail)
        wait_for(lambda: len(texts) >= 3, what="the goals")
        self.assertEqual(json.loads(texts[0]), {"data": {"robot.x": 1}, "resumed_from": 0})
        self.assertEqual(texts[-1], "")

    def test_a_goal_refers_to_data_and_a_result_is_kept(self):
        server = Server(self.namespace + "/move_base", MoveBaseAction)
        name = "test_a_goal_refers_to_data"
        fibonacci = Server(self.namespace + "/" + name, TestAction)
        robot = self.robot(
            plan_of(
                {
                    "P1": ServerAction(
                        MOVE_BASE,
                        "move_base",
                        {
                            "target_pose": {
                                "header": {"frame_id": {"from": "team.frame"}, "stamp": "now"},
                                "pose": {"from": "task.pose"},
                            }
                        },
                    ),
                    "P2": ServerAction(
                        "actionlib/TestAction",
                        name,
                        {"goal": {"from": "number"}},
                        {"succeeded": "", "aborted": "T_no"},
                        {"task.answer": "result"},
                    ),
                }
            )
        )
        pose = {"position": {"x": 2, "y": -1.5}, "orientation": {"w": 1}}
        robot.send("P1", data={"task.pose": pose, "team.frame": "Küche"})
        goal = server.next()
        target = goal.get_goal().target_pose
        self.assertEqual((target.header.frame_id, target.pose.position.x), ("Küche", 2.0))
        self.assertGreater(target.header.stamp.to_sec(), 0)
        goal.set_accepted()
        goal.set_succeeded()
        self.assertEqual(robot.ended.get(timeout=20 * PATIENCE).data, {})
        for how, result in (("set_succeeded", ""), ("set_aborted", "T_no")):
            robot.send("P2", data={"robot.number": 3})
            goal = fibonacci.next()
            self.assertEqual(goal.get_goal().goal, 3)
            goal.set_accepted()
            getattr(goal, how)(TestResult(result=8))
            ended = robot.ended.get(timeout=20 * PATIENCE)
            self.assertEqual((ended.result, ended.data), (result, {"task.answer": 8}))
        for data, detail in (
            ({}, "there is no data 'robot.number'"),
            ({"robot.number": "three"}, "its goal does not fit actionlib/TestGoal"),
        ):
            ended = robot.do("P2", data=data)
            self.assertEqual(ended.outcome, "aborted")
            self.assertIn(detail, ended.detail)
        self.assertTrue(fibonacci.goals.empty())

    def test_a_result_that_is_to_be_kept_and_does_not_come_is_lost(self):
        server = Server(self.namespace + "/short", TestAction)
        action = ServerAction(
            "actionlib/TestAction", "short", None, {"succeeded": "T1"}, {"x": "result"}
        )
        robot = self.robot(plan_of({"P1": action}), patience=PATIENT._replace(result=0.3))
        robot.send("P1")
        goal = server.next()
        goal.set_accepted()
        server.server.publish_result = lambda status, result: None
        goal.set_succeeded()
        self.assertEqual(robot.ended.get(timeout=20 * PATIENCE).outcome, "lost")

    # -- the end of cancelled goals ----------------------------------------------------------------

    def test_a_server_that_does_not_end_a_cancelled_goal_is_reported_once(self):
        server = Server(self.namespace + "/stubborn", ExecGSPNAction)
        plan, servers = self.serve({"P2": "hangs", "P3": "until_cancelled"})
        plan = plan_of({**plan.actions, "P1": ServerAction(EXEC, "stubborn")})
        acts = self.acts()
        acts.release.clear()
        self._closing.append(acts.release.set)
        faults = []
        robot = self.robot(plan, own_servers=servers.servers, cancel_grace=0.5, fault=faults.append)
        robot.send("P1")
        goal = server.next()
        goal.set_accepted()
        wait_for(robot.is_under_way, what="the server to take the goal")
        robot.send("P2")  # cancels the goal
        self.assertTrue(wait_for(lambda: faults, what="the fault")[0].startswith(server.server.ns))
        self.assertIn("P1, 0.5 s after it was cancelled", faults[0])
        goal.set_canceled()
        robot.send("P1")
        goal = server.next()
        goal.set_accepted()
        wait_for(lambda: len(faults) == 2, what="the fault of the function that hangs")
        self.assertIn("/P2 has not ended the goal of P2", faults[1])
        wait_for(robot.is_under_way, what="the server to take the goal")
        robot.send("P3")
        wait_for(lambda: len(server.cancelled) == 2, what="the cancel request")
        goal.set_canceled()
        wait_for(lambda: acts.seen, what="the next action")
        robot.cancel()
        wait_for(lambda: not robot.caller._abandoned, what="the time of grace to be over")
        self.assertEqual(len(faults), 2)

    # -- many goals --------------------------------------------------------------------------------

    def test_a_thousand_goals_leave_threads_and_descriptors_bounded(self):
        plan, servers = self.serve({"P%d" % i: "instant" for i in range(1, 6)})
        robot = self.robot(plan)
        places = ["P%d" % i for i in range(1, 6)]
        for i in range(50):
            self.assertEqual(robot.do(places[i % 5]).result, "T_" + places[i % 5])
        wait_for(lambda: robot.caller.connections == 5, what="all connections")
        threads, descriptors = threading.active_count(), len(os.listdir("/proc/self/fd"))
        for i in range(1000):
            self.assertEqual(robot.do(places[i % 5]).result, "T_" + places[i % 5])
        # idle threads of the servers end after a while
        wait_for(lambda: threading.active_count() <= threads + 3, what="the end of idle threads")
        self.assertLessEqual(len(os.listdir("/proc/self/fd")), descriptors + 3)
        self.assertLessEqual(
            max(len(s.status_list) for s in servers.servers.values()), KEPT_ENDED + 2
        )

    def test_connections_are_bounded(self):
        plan, _ = self.serve({"P%d" % i: "instant" for i in range(1, 9)})
        robot = self.robot(plan, limit=3)
        for _ in range(2):
            for i in range(1, 9):
                self.assertEqual(robot.do("P%d" % i).result, "T_P%d" % i)
                self.assertLessEqual(robot.caller.connections, 3)

    # -- servers of the same process ---------------------------------------------------------------

    def test_goals_for_own_servers_need_no_connection_and_are_told_on_topics_all_the_same(self):
        plan, servers = self.serve({"P1": "instant", "P2": "tell", "P3": "breaks"})
        results, statuses = [], []
        name = self.namespace + "/P1"
        rospy.Subscriber(name + "/result", ExecGSPNActionResult, results.append)
        rospy.Subscriber(name + "/status", GoalStatusArray, statuses.append)
        publishers = (servers.servers[name].result_pub, servers.servers[name].status_pub)
        wait_for(
            lambda: all(publisher.get_num_connections() for publisher in publishers),
            what="connections",
        )
        robot = self.robot(plan, own_servers=servers.servers)
        ended = robot.do("P1")
        self.assertEqual(ended[1:4], ("T_P1", "succeeded", ""))
        wait_for(lambda: results, what="the result")
        self.assertEqual(
            (results[0].status.goal_id.id, results[0].result.transition),
            (str(ended.identity), "T_P1"),
        )
        wait_for(
            lambda: any(status.status_list for status in statuses), what="a status with the goal"
        )
        self.acts().heard.set()
        self.assertEqual(robot.do("P2").outcome, "succeeded")
        self.assertEqual([list(f.time_passed) for f in robot.feedback], [[1], [2, 3]])
        self.assertEqual(robot.do("P3").outcome, "aborted")
        self.assertEqual(robot.caller.connections, 0)

    def test_a_goal_for_an_own_server_can_be_cancelled(self):
        plan, servers = self.serve({"P1": "until_cancelled"})
        robot = self.robot(plan, own_servers=servers.servers)
        robot.send("P1")
        wait_for(robot.is_under_way, what="the goal to be taken")
        acts = self.acts()
        acts.ended.clear()
        robot.cancel()
        wait_for(
            lambda: [cancelled for _, cancelled in acts.ended] == [True],
            what="the end of the action",
        )
        self.assertTrue(robot.ended.empty())

    # -- servers that misbehave --------------------------------------------------------------------

    def test_a_missing_server_is_reported_with_its_name(self):
        robot = self.robot(
            plan_of({"P1": ServerAction(EXEC, "nobody")}), patience=PATIENT._replace(server=1)
        )
        robot.send("P1")
        wait_for(lambda: "nobody" in robot.caller.doing(), what="what it waits for")
        ended = robot.ended.get(timeout=20 * PATIENCE)
        self.assertEqual(ended.outcome, "no server")
        self.assertIn(self.namespace + "/nobody", ended.detail)

    def test_a_server_that_comes_late_gets_the_goal(self):
        robot = self.robot(plan_of({"P1": ServerAction(EXEC, "late")}))
        robot.send("P1")
        wait_for(lambda: robot.caller.connections == 1, what="the client's topics")
        server = Server(self.namespace + "/late", ExecGSPNAction)
        goal = server.next()
        goal.set_accepted()
        goal.set_succeeded(ExecGSPNResult("T1"))
        self.assertEqual(robot.ended.get(timeout=20 * PATIENCE).result, "T1")

    def test_a_server_that_dies_with_the_goal_is_noticed(self):
        # of a killed server the closed connections must be noticed, long before its silence is
        for how, signal, status in (("killed", "KILL", 300), ("stopped", "STOP", 1)):
            name = "%s/%s" % (self.namespace, how)
            code = (
                "import rospy, actionlib\n"
                "from gspn_framework_package.msg import ExecGSPNAction\n"
                "rospy.init_node('server_that_is_%s')\n"
                "s = actionlib.ActionServer('%s', ExecGSPNAction, lambda g: g.set_accepted(),\n"
                "                           auto_start=False)\n"
                "s.start()\n"
                "rospy.spin()\n" % (how, name)
            )
            process = subprocess.Popen([sys.executable, "-c", code])
            self._closing.append(process.kill)
            robot = self.robot(
                plan_of({"P1": ServerAction(EXEC, how)}),
                patience=PATIENT._replace(status=status, result=0.3),
            )
            robot.send("P1")
            wait_for(robot.is_under_way, 20, "the server to take the goal")
            subprocess.check_call(["kill", "-" + signal, str(process.pid)])
            ended = robot.ended.get(timeout=20 * PATIENCE)
            self.assertEqual(ended.outcome, "server died", ended.detail)
            limit = "~result_timeout" if how == "killed" else "~status_timeout"
            self.assertIn(limit, ended.detail)

    def test_a_server_that_forgets_the_goal_is_noticed(self):
        server = Server(self.namespace + "/forgets", ExecGSPNAction)
        robot = self.robot(
            plan_of({"P1": ServerAction(EXEC, "forgets")}), patience=PATIENT._replace(result=0.3)
        )
        robot.send("P1")
        server.next().set_accepted()
        wait_for(robot.is_under_way, what="the server to take the goal")
        server.server.status_list = []  # as after a restart
        ended = robot.ended.get(timeout=20 * PATIENCE)
        self.assertEqual(ended.outcome, "server died")
        self.assertIn("no longer knows the goal", ended.detail)

    def test_a_goal_is_sent_once_and_its_late_result_is_reported(self):
        # The topics of a server, and a status that never lists a goal.
        name = self.namespace + "/late"
        spec = ExecGSPNAction()
        goals, cancelled = queue.Queue(), []
        status = rospy.Publisher(name + "/status", GoalStatusArray, latch=True, queue_size=1)
        results = rospy.Publisher(name + "/result", ExecGSPNActionResult, queue_size=1)
        rospy.Publisher(name + "/feedback", type(spec.action_feedback), queue_size=1)
        rospy.Subscriber(name + "/goal", type(spec.action_goal), goals.put)
        rospy.Subscriber(name + "/cancel", GoalID, cancelled.append)
        status.publish(GoalStatusArray())

        def answer(goal):
            wait_for(results.get_num_connections, what="a client of the results")
            done = GoalStatus(goal.goal_id, GoalStatus.SUCCEEDED, "")
            results.publish(
                ExecGSPNActionResult(Header(), done, ExecGSPNResult(transition="T_late"))
            )

        faults = []
        robot = self.robot(
            plan_of({"P1": ServerAction(EXEC, "late")}),
            patience=PATIENT._replace(acknowledgement=0.9),
            fault=faults.append,
        )
        ended = robot.do("P1")
        self.assertEqual(ended.outcome, "lost")
        self.assertIn(
            "did not acknowledge the goal within 0.9 s (~acknowledgement_timeout)", ended.detail
        )
        wait_for(lambda: cancelled, what="the request to cancel it")
        goal = goals.get(timeout=20 * PATIENCE)
        self.assertEqual(parse_goal_id(goal.goal_id.id).robot, "robot_1")
        self.assertTrue(goals.empty(), "it was sent again")
        answer(goal)
        wait_for(lambda: faults, what="the report of the late result")
        self.assertIn("/late reports 'succeeded' for an abandoned goal", faults[0])
        patient = self.robot(plan_of({"P1": ServerAction(EXEC, "late")}))
        patient.send("P1")
        answer(goals.get(timeout=20 * PATIENCE))  # before any status: it counts
        self.assertEqual(patient.ended.get(timeout=20 * PATIENCE).result, "T_late")

    def test_a_server_of_another_type_is_named_with_both_types(self):
        name = self.namespace + "/other"
        Server(name, TestRequestAction)
        plan = plan_of(
            {"P1": ServerAction("actionlib/TestAction", name)},
            robots=(RobotSpec("robot_1", "P1"),),
        )
        text = "server %s is of type actionlib/TestRequestAction, the plan says " % name
        text += "actionlib/TestAction"
        wait_for(lambda: name + "/result" in published_topics(), what="the registration")
        self.assertEqual(look_at_actions(plan).misfits, {"robot_1 in P1": text})
        targets = list(action_targets(plan, "robot_1", self.namespace).values())
        with self.assertRaisesRegex(ExecutionError, text):
            await_servers(targets, 20.0, Ending())
        ended = self.robot(plan).do("P1")  # the server that it began with was another one
        self.assertEqual((ended.outcome, ended.detail), ("no server", text))

    def test_a_server_with_a_rare_status_is_not_dead(self):
        for name, parameter in (
            ("rare", "/actionlib_status_frequency"),
            ("seldom", self.namespace + "/seldom/status_frequency"),
        ):
            rospy.set_param(parameter, 0.05)
            try:
                server = Server(self.namespace + "/" + name, ExecGSPNAction)
                robot = self.robot(
                    plan_of({"P1": ServerAction(EXEC, name)}),
                    patience=PATIENT._replace(status=0.3, acknowledgement=0.3),
                )
                robot.send("P1")
                goal = server.next()
                goal.set_accepted()
                wait_for(robot.is_under_way, what="the server to take the goal")
                connection = robot.caller._goal.connection
                caller = robot.caller._goal.acknowledged_by
                wait_for(lambda: connection.silence(caller) > 1.0, what="a second of silence")
                self.assertTrue(robot.ended.empty())
                goal.set_succeeded(ExecGSPNResult("T1"))
                self.assertEqual(robot.ended.get(timeout=20 * PATIENCE).result, "T1")
            finally:
                rospy.delete_param(parameter)

    def test_a_second_server_of_the_name_does_not_lose_the_goal(self):
        # Its statuses do not list the goal; actionlib's own client reports LOST at once.
        server = Server(self.namespace + "/twice", ExecGSPNAction)
        robot = self.robot(plan_of({"P1": ServerAction(EXEC, "twice")}))
        robot.send("P1")
        goal = server.next()
        goal.set_accepted()
        wait_for(robot.is_under_way, what="the server to take the goal")
        from actionlib_msgs.msg import GoalStatusArray

        code = (
            "import rospy\n"
            "from actionlib_msgs.msg import GoalStatusArray\n"
            "rospy.init_node('second')\n"
            "p = rospy.Publisher('%s/twice/status', GoalStatusArray, queue_size=1)\n"
            "while not rospy.is_shutdown():\n"
            "    p.publish(GoalStatusArray())\n"
            "    rospy.sleep(0.05)\n" % self.namespace
        )
        others = []
        rospy.Subscriber(
            self.namespace + "/twice/status",
            GoalStatusArray,
            lambda m: others.append(m._connection_header["callerid"]),
        )
        process = subprocess.Popen([sys.executable, "-c", code])
        self._closing.append(process.kill)
        wait_for(lambda: others.count("/second") > 10, 20, "statuses of the second server")
        self.assertTrue(robot.ended.empty())
        goal.set_succeeded(ExecGSPNResult("T1"))
        self.assertEqual(robot.ended.get(timeout=20 * PATIENCE).result, "T1")

    def test_an_action_that_takes_too_long_is_cancelled(self):
        server = Server(self.namespace + "/slow", ExecGSPNAction)
        plan = plan_of({"P1": ServerAction(EXEC, "slow")}, timeouts={"P1": 0.5})
        robot = self.robot(plan)
        robot.send("P1")
        server.next().set_accepted()
        ended = robot.ended.get(timeout=20 * PATIENCE)
        self.assertEqual(
            (ended.outcome, ended.detail),
            ("timeout", "the action took longer than 0.5 s (timeout in the plan)"),
        )
        wait_for(lambda: server.cancelled, what="the cancel request")

    def test_what_was_cancelled_is_not_told(self):
        server = Server(self.namespace + "/cancels", ExecGSPNAction)
        robot = self.robot(plan_of({"P1": ServerAction(EXEC, "cancels")}))
        robot.send("P1")
        goal = server.next()
        goal.set_accepted()
        robot.cancel()
        wait_for(lambda: server.cancelled, what="the cancel request")
        goal.set_canceled()
        robot.send("P1")
        second = server.next()
        second.set_accepted()
        second.set_succeeded(ExecGSPNResult("T2"))
        self.assertEqual(robot.ended.get(timeout=20 * PATIENCE).result, "T2")
        self.assertTrue(robot.ended.empty())

    # -- action types of others --------------------------------------------------------------------

    def test_a_move_base_server_gets_the_goal_of_the_plan(self):
        server = Server(self.namespace + "/move_base", MoveBaseAction)
        pose = {
            "header": {"frame_id": "map", "stamp": "now"},
            "pose": {"position": {"x": 2, "y": -1.5}, "orientation": {"w": 1}},
        }
        outcomes = {"succeeded": "T_there", "aborted": "T_blocked"}
        robot = self.robot(
            plan_of(
                {
                    "P1": ServerAction(MOVE_BASE, "move_base", {"target_pose": pose}, outcomes),
                    "P2": ServerAction(MOVE_BASE, "move_base", {"target_pose": pose}),
                }
            )
        )
        robot.send("P1")
        goal = server.next()
        target = goal.get_goal().target_pose
        self.assertEqual((target.header.frame_id, target.pose.position.x), ("map", 2.0))
        self.assertGreater(target.header.stamp.to_sec(), 0)
        goal.set_accepted()
        goal.set_succeeded()
        self.assertEqual(robot.ended.get(timeout=20 * PATIENCE)[1:4], ("T_there", "succeeded", ""))
        for place, how, expected in (
            ("P1", "set_aborted", ("T_blocked", "succeeded", "")),
            ("P2", "set_succeeded", ("", "succeeded", "")),
            ("P2", "set_aborted", ("", "aborted", "no way")),
            ("P2", "set_canceled", ("", "preempted", "no way")),
        ):
            robot.send(place)
            goal = server.next()
            goal.set_accepted()
            getattr(goal, how)(text="no way")
            self.assertEqual(robot.ended.get(timeout=20 * PATIENCE)[1:4], expected, (place, how))
        robot.send("P2")
        server.next().set_rejected(text="not now")
        self.assertEqual(robot.ended.get(timeout=20 * PATIENCE)[1:4], ("", "rejected", "not now"))

    def test_a_goal_that_does_not_fit_is_refused_before_the_run(self):
        from gspn_framework_package.model.errors import PlanError

        for action, message in (
            (ServerAction("no_such_msgs/XAction", "s"), "no action type|cannot load"),
            (ServerAction("move_base_msgs/MoveBaseGoal", "s"), "not an action type"),
            (ServerAction(MOVE_BASE, "s", {"target": {}}), "does not fit"),
            (ServerAction(MOVE_BASE, "s", {"target_pose": {"header": 3}}), "does not fit"),
            (ServerAction(MOVE_BASE, "a b"), "not a legal name"),
            (ServerAction(MOVE_BASE, "s", keep={"x": "pose"}), r"keep.x: .* no field 'pose'"),
            (ServerAction(MOVE_BASE, "s", keep={"a b": "pose"}), "not a name of data"),
        ):
            with self.assertRaisesRegex(PlanError, message):
                action_targets(plan_of({"P1": action}), "robot_1", "/x")


if __name__ == "__main__":
    import rostest

    rospy.init_node("test_actions")
    rostest.rosrun("gspn_framework_package", "actions", ActionsTest)
