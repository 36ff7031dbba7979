#!/usr/bin/env python3
"""The world as a ROS node: what a robot's namespace offers, and a patrol by two execution nodes in
it."""

import json
import math
import os
import signal
import sys
import threading
import time
import unittest
from xmlrpc.client import ServerProxy

import actionlib
import rospy
import rostest
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionResult, MoveBaseGoal
from nav_msgs.msg import OccupancyGrid, Odometry
from nav_msgs.srv import GetPlan
from sensor_msgs.msg import CompressedImage, LaserScan, Temperature
from std_msgs.msg import String
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

PATIENCE = float(os.environ.get("GSPN_PATIENCE", "1"))

DEADLINE = 25.0 * PATIENCE
"""Seconds of wall time; far more than any test here needs, but so short that each can report before
the time of all is over."""

LAP_DEADLINE = 150.0 * PATIENCE
"""The same for a lap of the patrol."""


class World:
    """The process of the world."""

    pid = 0
    began = (0.0, 0.0)

    @classmethod
    def find(cls):
        """Ask the node which process it is."""
        uri = rospy.get_master().lookupNode("/world")[2]
        cls.pid = ServerProxy(uri).getPid("/test_world")[2]
        cls.began = rospy.get_time(), time.monotonic()

    @classmethod
    def late(cls, what):
        """An error for what did not happen in time. If the world stands still, have it print what
        each of its threads does, and end it."""
        before, end = rospy.get_time(), time.monotonic() + 2.0
        while rospy.get_time() == before and time.monotonic() < end:
            time.sleep(0.01)
        stands = rospy.get_time() == before
        if stands and cls.pid:
            os.kill(cls.pid, signal.SIGABRT)  # see PYTHONFAULTHANDLER in world.test
        passed = before - cls.began[0], end - cls.began[1]
        return AssertionError(
            "%s; the world %s after %.0f s of ROS time in %.0f s"
            % ((what, "stands still" if stands else "goes on") + passed)
        )


class Latest:
    """The latest message of a topic, and a wait for one that satisfies a condition."""

    def __init__(self, topic, kind):
        self.message = None
        self._news = threading.Condition()
        self._subscriber = rospy.Subscriber(topic, kind, self._heard, queue_size=10)

    def _heard(self, message):
        with self._news:
            self.message = message
            self._news.notify_all()

    def connect(self):
        """Wait until messages arrive here that are published from now on."""
        end = time.monotonic() + DEADLINE
        while not self._subscriber.get_num_connections():
            if time.monotonic() > end:
                raise World.late("nobody publishes it")
            time.sleep(0.01)
        return self

    def wait(self, condition=lambda message: True, deadline=DEADLINE):
        end = time.monotonic() + deadline
        with self._news:
            while self.message is None or not condition(self.message):
                left = end - time.monotonic()
                if left <= 0:
                    raise World.late("not seen in time; last: %s" % self.message)
                self._news.wait(left)
            return self.message


class Drive:
    """A goal for ``move_base`` of robot_3."""

    def __init__(self, client, x, y, frame="map", w=1.0):
        self._done, self._under_way = threading.Event(), threading.Event()
        self.feedback = []
        goal = MoveBaseGoal()
        goal.target_pose.header.frame_id = frame
        goal.target_pose.pose.position.x, goal.target_pose.pose.position.y = x, y
        goal.target_pose.pose.orientation.w = w
        self.handle = client.send_goal(goal, self._changed, self._progress)

    def _progress(self, _handle, feedback):
        self.feedback.append(feedback)
        self._under_way.set()

    def wait_until_under_way(self):
        """Wait for the first feedback."""
        if not self._under_way.wait(DEADLINE):
            raise World.late("no feedback in time")

    def _changed(self, handle):
        if handle.get_comm_state() == actionlib.CommState.DONE:
            self._done.set()

    def result(self):
        if not self._done.wait(DEADLINE):
            raise World.late("the goal has not ended")
        return self.handle.get_terminal_state(), self.handle.get_goal_status_text()


class TestWorld(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.client = actionlib.ActionClient("/robot_3/move_base", MoveBaseAction)
        end = time.monotonic() + DEADLINE
        while not cls.client.wait_for_server(rospy.Duration(0.5)):
            assert time.monotonic() < end, "no move_base"
        World.find()

    def test_1_the_interface_is_that_of_a_real_robot(self):
        self.assertGreater(Latest("/robot_3/odom", Odometry).wait().header.stamp.to_sec(), 0)
        pose = Latest("/robot_3/amcl_pose", PoseWithCovarianceStamped).wait()
        self.assertEqual(pose.header.frame_id, "map")
        reading = Latest("/robot_3/temperature", Temperature).wait()
        self.assertAlmostEqual(reading.temperature, 21.0, delta=1.0)
        scan = Latest("/robot_3/scan", LaserScan).wait()
        self.assertEqual(len(scan.ranges), 360)
        self.assertTrue(all(scan.range_min <= r for r in scan.ranges))
        frames = Latest("/tf", TFMessage).wait()
        self.assertIn(
            ("robot_3/odom", "robot_3/base_footprint"),
            [(t.header.frame_id, t.child_frame_id) for t in frames.transforms],
        )
        grid = Latest("/map", OccupancyGrid).wait()
        self.assertEqual(len(grid.data), grid.info.width * grid.info.height)
        self.assertIn(100, grid.data)
        room = json.loads(Latest("/world/room", String).wait().data)
        self.assertEqual(sorted(room["locations"]), ["L1", "L2", "L3", "L4"])
        state = json.loads(Latest("/world/state", String).wait().data)
        self.assertEqual(sorted(state["robots"]), ["robot_1", "robot_2", "robot_3"])

    def test_2_a_goal_is_driven_to_and_a_newer_one_preempts_it(self):
        # among the cylinders: the patrol waits for whoever stands in one of its locations
        first = Drive(self.client, 0.55, 0.55)
        first.wait_until_under_way()
        second = Drive(self.client, 0.55, -0.55)
        self.assertEqual(first.result()[0], GoalStatus.PREEMPTED)
        self.assertEqual(second.result(), (GoalStatus.SUCCEEDED, "reached"))
        self.assertTrue(second.feedback)

        def is_there(message):
            where = message.pose.pose.position
            return math.hypot(where.x - 0.55, where.y + 0.55) < 0.12

        # an older pose may still be on its way
        Latest("/robot_3/amcl_pose", PoseWithCovarianceStamped).wait(is_there)

    def test_2_a_goal_may_come_from_rviz_and_a_path_may_be_asked_for(self):
        states = Latest("/robot_3/move_base/result", MoveBaseActionResult).connect()
        poses = rospy.Publisher("/robot_3/move_base_simple/goal", PoseStamped, queue_size=1)
        goal = PoseStamped()
        goal.header.frame_id = "map"
        goal.pose.position.x, goal.pose.position.y, goal.pose.orientation.w = -0.55, -0.55, 1.0
        end = time.monotonic() + DEADLINE
        while not poses.get_num_connections():
            self.assertLess(time.monotonic(), end)
            time.sleep(0.01)
        poses.publish(goal)
        self.assertEqual(states.wait().status.text, "reached")

        plan = rospy.ServiceProxy("/robot_3/move_base/make_plan", GetPlan)
        start = PoseStamped()
        goal.pose.position.x, goal.pose.position.y = 0.55, -1.5
        path = plan(start, goal, 0.0).plan
        self.assertEqual(path.header.frame_id, "map")
        ends = [path.poses[n].pose.position for n in (0, -1)]
        self.assertLess(math.hypot(ends[0].x + 0.55, ends[0].y + 0.55), 0.15)
        self.assertEqual((ends[1].x, ends[1].y), (0.55, -1.5))
        goal.pose.position.x = goal.pose.position.y = 0.0  # in a wall
        self.assertEqual(plan(start, goal, 0.0).plan.poses, [])
        self.assertTrue(plan(start, goal, 1.0).plan.poses)
        goal.header.frame_id = "odom"
        with self.assertRaisesRegex(rospy.ServiceException, "frame"):
            plan(start, goal, 0.0)
        rospy.ServiceProxy("/robot_3/move_base/clear_costmaps", Empty)()

    def test_3_goals_that_cannot_be_are_refused_or_aborted_with_a_reason(self):
        for goal, status, words in (
            (Drive(self.client, 0.0, 0.0), GoalStatus.ABORTED, "no path leads there"),
            (Drive(self.client, 0.5, 0.5, frame="odom"), GoalStatus.REJECTED, "frame"),
            (Drive(self.client, 0.5, 0.5, w=0.0), GoalStatus.REJECTED, "quaternion"),
            (Drive(self.client, math.nan, 0.5), GoalStatus.REJECTED, "finite"),
        ):
            ended, text = goal.result()
            self.assertEqual(ended, status)
            self.assertIn(words, text)

    def test_4_a_cancelled_goal_stops_the_robot(self):
        odometry = Latest("/robot_3/odom", Odometry).connect()
        goal = Drive(self.client, -0.55, 0.55)
        odometry.wait(lambda m: m.twist.twist.linear.x > 0.1)
        goal.handle.cancel()
        self.assertEqual(goal.result()[0], GoalStatus.PREEMPTED)
        odometry.wait(lambda m: m.twist.twist.linear.x == 0.0 and m.twist.twist.angular.z == 0.0)

    def test_5_cmd_vel_drives_a_robot_without_a_goal(self):
        odometry = Latest("/robot_3/odom", Odometry)
        hand = rospy.Publisher("/robot_3/cmd_vel", Twist, queue_size=1)
        twist = Twist()
        twist.angular.z = 1.0
        end = time.monotonic() + DEADLINE
        while odometry.message is None or odometry.message.twist.twist.angular.z < 0.9:
            self.assertLess(time.monotonic(), end)
            hand.publish(twist)
            time.sleep(0.01)
        # no more commands: it stops by itself
        odometry.wait(lambda m: m.twist.twist.angular.z == 0.0)

    def test_6_the_team_is_shown_in_the_map_and_its_net_as_a_picture(self):
        def frames(found):
            return {m.header.frame_id for m in found.markers if m.ns == "robots"}

        # it shows a robot as soon as it hears it
        drawn = Latest("/gspn_markers", MarkerArray).wait(
            lambda found: len(frames(found)) == 2 and "goals" in {m.ns for m in found.markers}
        )
        self.assertEqual(frames(drawn), {"robot_1/base_footprint", "robot_2/base_footprint"})
        places = [m for m in drawn.markers if m.ns == "places"]
        self.assertEqual([m.header.frame_id for m in places], ["map"] * 4)
        # the goal of a robot goes when its action ends
        self.assertEqual({m.action for m in drawn.markers if m.ns != "goals"}, {Marker.ADD})
        image = Latest("/gspn_net/compressed", CompressedImage).wait()
        self.assertEqual(image.format, "png")
        self.assertEqual(bytes(image.data[:8]), b"\x89PNG\r\n\x1a\n")

    def test_7_two_robots_patrol_a_lap_by_the_rules(self):
        # out of the way of the patrol, among the cylinders
        self.assertEqual(Drive(self.client, 0.55, 0.55).result()[0], GoalStatus.SUCCEEDED)
        before = rospy.get_time(), time.monotonic()

        def lap(message):
            robots = json.loads(message.data)["robots"]
            return min(robots["robot_%d" % n]["laps"] for n in (1, 2)) >= 1

        referee = Latest("/world/referee", String)
        report = json.loads(referee.wait(lap, LAP_DEADLINE).data)
        faster = (rospy.get_time() - before[0]) / (time.monotonic() - before[1])
        self.assertGreater(faster, 1.0)
        for nothing in (
            "contacts_between_robots",
            "contacts_with_solids",
            "two_in_one_location",
            "stuck_minutes",
        ):
            self.assertEqual(report[nothing], 0, nothing)
        for name in ("robot_1", "robot_2"):
            self.assertEqual(report["robots"][name]["aborted"], 0)
            self.assertGreater(report["robots"][name]["distance"], 8.0)


if __name__ == "__main__":
    rospy.init_node("test_world")
    rostest.rosrun("gspn_framework_package", "world", TestWorld, sys.argv)
