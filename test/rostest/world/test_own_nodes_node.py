#!/usr/bin/env python3
"""A robot of the world as Gazebo has it: no move_base and no amcl but those of the user, and the
topics, frames and services that a TurtleBot3 in Gazebo has for them."""

import json
import math
import os
import sys
import threading
import time
import unittest
import xml.etree.ElementTree as ElementTree

import rosgraph
import rospy
import rostest
import yaml
from geometry_msgs.msg import Point, Pose, Quaternion, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from nav_msgs.srv import GetMap
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, LaserScan
from std_msgs.msg import String
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage

from gspn_framework_package.msg import ModelState, ModelStates
from gspn_framework_package.srv import (
    Command,
    DeleteModel,
    GetModelState,
    SetModelState,
    SpawnModel,
)

DEADLINE = 60.0 * float(os.environ.get("GSPN_PATIENCE", "1"))
"""Seconds of wall time; far more than any test here needs."""


BOX = (
    '<robot name="box"><link name="base"><collision><geometry><box size="%s"/></geometry>'
    "</collision></link></robot>"
)


class Heard:
    """The messages of a topic, from the time at which it is made."""

    def __init__(self, topic, kind):
        self.messages = []
        self._news = threading.Condition()
        self._subscriber = rospy.Subscriber(topic, kind, self._heard, queue_size=100)

    def _heard(self, message):
        with self._news:
            self.messages.append(message)
            self._news.notify_all()

    def wait(self, condition=lambda message: True):
        """Wait until the last message satisfies a condition; return it."""
        self._wait(lambda: self.messages and condition(self.messages[-1]))
        return self.messages[-1]

    def take(self, number):
        """Wait for some messages in a row."""
        self._wait(lambda: len(self.messages) >= number)
        return self.messages[:number]

    def until(self, condition):
        """Wait until all messages satisfy a condition; return them."""
        self._wait(lambda: condition(self.messages))
        return list(self.messages)

    def _wait(self, condition):
        end = time.monotonic() + DEADLINE
        with self._news:
            while not condition():
                if not self._news.wait(end - time.monotonic()):
                    raise AssertionError("not in time; last: %s" % self.messages[-1:])

    def close(self):
        self._subscriber.unregister()


def seconds_apart(messages):
    """The seconds of world time between each message and the next."""
    stamps = [message.header.stamp.to_sec() for message in messages]
    return [after - before for before, after in zip(stamps, stamps[1:])]


class TestOwnNodes(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with open(rospy.get_param("/room"), encoding="utf-8") as file:
            cls.start = yaml.safe_load(file)["spawn"][0]

    def heard(self, topic, kind):
        heard = Heard(topic, kind)
        self.addCleanup(heard.close)
        return heard

    def call(self, service, kind):
        rospy.wait_for_service(service, DEADLINE)
        return rospy.ServiceProxy(service, kind)()

    def is_at_start(self, message):
        at, (x, y, _) = message.pose.pose.position, self.start
        return math.hypot(at.x - x, at.y - y) < 0.01

    def assert_rate(self, heard, rate):
        """Messages come at a rate in world time; a busy machine may lose some."""
        heard.until(
            lambda messages: any(abs(apart * rate - 1) < 1e-3 for apart in seconds_apart(messages))
        )
        for apart in seconds_apart(list(heard.messages)):
            self.assertGreater(apart * rate, 0.999)
            self.assertAlmostEqual(apart * rate, round(apart * rate), delta=1e-3)

    def test_1_navigation_and_localisation_are_left_to_others(self):
        frames = set()
        for message in self.heard("/tf", TFMessage).take(5):
            frames.update((t.header.frame_id, t.child_frame_id) for t in message.transforms)
        self.assertEqual(frames, {("robot_1/odom", "robot_1/base_footprint")})
        published, subscribed, services = rosgraph.Master("/test").getSystemState()
        names = {name for name, _ in published + subscribed + services}
        theirs = {name for name in names if "move_base" in name or "amcl" in name}
        self.assertEqual(theirs | (names & {"/robot_1/initialpose"}), set())

    def test_2_the_sensors_have_the_rates_frames_and_errors_of_gazebo(self):
        scans = self.heard("/robot_1/scan", LaserScan)
        odometry = self.heard("/robot_1/odom", Odometry)
        imu = self.heard("/robot_1/imu", Imu)
        joints = self.heard("/robot_1/joint_states", JointState)
        clock = self.heard("/clock", Clock)
        first, second = scans.take(2)
        self.assert_rate(scans, 5)
        self.assertEqual((len(first.ranges), first.header.frame_id), (360, "robot_1/base_scan"))
        self.assertAlmostEqual(first.scan_time, 0.2, delta=1e-6)
        apart = [abs(a - b) for a, b in zip(first.ranges, second.ranges) if math.isfinite(a - b)]
        # it stands: the noise is all that differs, with sqrt(2) times its deviation
        self.assertGreater(len(apart), 100)
        self.assertTrue(0.003 < sum(apart) / len(apart) < 0.03, sum(apart) / len(apart))
        self.assert_rate(odometry, 30)
        where = odometry.messages[0]
        self.assertEqual(
            (where.header.frame_id, where.child_frame_id),
            ("robot_1/odom", "robot_1/base_footprint"),
        )
        self.assertEqual((where.pose.covariance[0], where.pose.covariance[35]), (1e-5, 1e-3))
        self.assert_rate(imu, 30)
        self.assertEqual(imu.messages[0].header.frame_id, "robot_1/imu_link")
        self.assertAlmostEqual(imu.messages[0].linear_acceleration.z, 9.81)
        self.assert_rate(joints, 30)
        self.assertEqual(joints.messages[0].name, ["wheel_left_joint", "wheel_right_joint"])
        ticks = clock.until(
            lambda messages: any(
                (b.clock - a.clock).to_sec() < 0.034 for a, b in zip(messages, messages[1:])
            )
        )
        times = [tick.clock for tick in ticks]
        self.assertEqual(times, sorted(times))

    def test_3_robot_state_publisher_and_the_frames_agree(self):
        frames = self.heard("/tf_static", TFMessage).wait().transforms
        fixed = {t.child_frame_id: (t.header.frame_id, t.transform.translation.z) for t in frames}
        robot = ElementTree.fromstring(rospy.get_param("/robot_1/robot_description"))
        described = {
            "robot_1/" + joint.find("child").get("link"): (
                "robot_1/" + joint.find("parent").get("link"),
                float(joint.find("origin").get("xyz").split()[2]),
            )
            for joint in robot.findall("joint")
            if joint.get("type") == "fixed"
        }
        self.assertEqual(set(fixed), set(described))
        self.assertEqual(
            {frame: below for frame, (below, _) in fixed.items()},
            {frame: below for frame, (below, _) in described.items()},
        )
        for frame, (_, height) in fixed.items():
            self.assertAlmostEqual(height, described[frame][1], places=4)
        self.assertIn("robot_1/base_scan", fixed)

    def test_4_the_map_is_there_as_a_topic_and_as_a_service(self):
        grid = self.heard("/map", OccupancyGrid).wait()
        self.assertEqual(self.call("/static_map", GetMap).map.data, grid.data)

    def test_5_a_node_of_the_user_drives(self):
        odometry = self.heard("/robot_1/odom", Odometry)
        odometry.wait(self.is_at_start)
        wheel = self.heard("/robot_1/joint_states", JointState)
        turned = wheel.wait().position[0]
        hand = rospy.Publisher("/robot_1/cmd_vel", Twist, queue_size=1)
        twist, end = Twist(), time.monotonic() + DEADLINE
        twist.linear.x = 0.2
        while wheel.messages[-1].position[0] < turned + 3.0:  # a tenth of a metre
            self.assertLess(time.monotonic(), end)
            hand.publish(twist)
            time.sleep(0.01)
        hand.publish(Twist())
        odometry.wait(lambda message: message.twist.twist.linear.x == 0.0)
        self.assertFalse(self.is_at_start(odometry.messages[-1]))

    def test_6_a_fault_that_is_ordered_happens_and_one_that_cannot_be_is_refused(self):
        faults = self.heard("/world/faults", String)
        scans = self.heard("/robot_1/scan", LaserScan)
        scans.wait()
        orders = rospy.Publisher("/world/fault", String, queue_size=1, latch=True)
        orders.publish(json.dumps({"fault": "lidar", "robot": "robot_1", "lasts": 2}))
        told = faults.wait(lambda message: json.loads(message.data)["active"])
        (fault,) = json.loads(told.data)["active"]
        end = 1.0 + fault["until"]  # the stamps begin at 1 s
        scans.wait(lambda message: message.header.stamp.to_sec() > end)
        times = [message.header.stamp.to_sec() for message in scans.messages]
        self.assertLess(times[0], end - 2.0)
        self.assertEqual([time for time in times if end - 1.9 < time < end], [])
        orders.publish(json.dumps({"fault": "fire"}))
        refused = faults.wait(lambda message: json.loads(message.data)["refused"])
        self.assertIn("'fault' is not one of", refused.data)
        rospy.wait_for_service("/world/order_fault", DEADLINE)
        serve = rospy.ServiceProxy("/world/order_fault", Command)
        self.assertTrue(serve("network", "robot_1", json.dumps({"delay": 0.5}), "").success)
        faults.wait(
            lambda message: (
                {"fault": "network", "of": "robot_1", "until": None, "delay": 0.5}
                in json.loads(message.data)["active"]
            )
        )
        for command, robot, argument, said in (
            ("fire", "robot_1", "", "'fault' is not one of"),
            ("lidar", "robot_9", "", "there is no robot 'robot_9'"),
            ("lidar", "robot_1", "[1]", "mapping"),
            ("lidar", "robot_1", "{", "line 1"),
        ):
            answer = serve(command, robot, argument, "")
            self.assertFalse(answer.success)
            self.assertIn(said, answer.message)

    def test_7_the_world_stands_still_and_goes_on_and_back_as_in_gazebo(self):
        odometry = self.heard("/robot_1/odom", Odometry)
        odometry.wait()
        self.call("/gazebo/pause_physics", Empty)

        def comes():
            """Whether messages come while the world answers some calls, each in a round of its own."""
            seen = len(odometry.messages)
            for _ in range(20):
                self.call("/gazebo/pause_physics", Empty)
            return len(odometry.messages) > seen

        end = time.monotonic() + DEADLINE
        while comes():  # those that were under way
            self.assertLess(time.monotonic(), end)
        paused = odometry.messages[-1].header.stamp
        self.call("/gazebo/unpause_physics", Empty)
        odometry.wait(lambda message: message.header.stamp > paused)

        self.call("/gazebo/reset_world", Empty)
        back = odometry.wait(self.is_at_start)
        self.assertGreater(back.header.stamp, paused)
        self.call("/gazebo/reset_simulation", Empty)
        odometry.wait(lambda message: message.header.stamp < paused)

    def test_8_models_come_move_and_go_as_in_gazebo(self):
        states = self.heard("/gazebo/model_states", ModelStates)
        states.wait(lambda message: message.name == ["robot_1"])
        crate = BOX % "0.2 0.2 0.4"
        there = Pose(Point(0.0, 0.0, 0.2), Quaternion(0, 0, 0, 1))
        state = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)
        start = state("robot_1", "").pose
        spawn = rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)
        onto = spawn("crate", crate, "", there, "robot_1")
        self.assertFalse(onto.success)
        self.assertIn("robot_1 stands there", onto.status_message)
        self.assertIn("<sdf>", spawn("crate", "<sdf/>", "", there, "").status_message)
        there.position.x = 0.6
        self.assertTrue(spawn("crate", crate, "", there, "robot_1").success)
        states.wait(lambda message: message.name == ["robot_1", "crate"])
        seen = state("crate", "robot_1")
        self.assertAlmostEqual(seen.pose.position.x, 0.6, places=2)
        self.assertAlmostEqual(seen.pose.position.z, 0.2)
        scans = self.heard("/robot_1/scan", LaserScan)
        scans.wait(lambda message: abs(message.ranges[0] - 0.5) < 0.1)  # straight ahead
        put = rospy.ServiceProxy("/gazebo/set_model_state", SetModelState)
        there.position.x = 0.9
        self.assertTrue(put(ModelState("crate", there, Twist(), "robot_1")).success)
        scans.wait(lambda message: abs(message.ranges[0] - 0.8) < 0.1)
        delete = rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)
        self.assertTrue(delete("crate").success)
        scans.wait(lambda message: not message.ranges[0] < 0.85)
        self.assertIn("did you mean 'robot_1'", delete("robot_2").status_message)
        self.assertFalse(delete("robot_1").success)
        there.position.x = 0.3
        self.assertTrue(put(ModelState("robot_1", there, Twist(), "robot_1")).success)
        moved = state("robot_1", "world").pose
        way = (moved.position.x - start.position.x, moved.position.y - start.position.y)
        self.assertAlmostEqual(math.hypot(*way), 0.3, places=2)
        # what clients and servers compare, as gazebo_msgs has it
        for kind, md5sum in (
            (SpawnModel._request_class, "6d0eba5753761cd57e6263a056b79930"),
            (GetModelState._response_class, "ccd51739bb00f0141629e87b792e92b9"),
            (ModelStates, "48c080191eb15c41858319b4d8a609c2"),
        ):
            self.assertEqual(kind._md5sum, md5sum)


if __name__ == "__main__":
    rospy.init_node("test_own_nodes")
    rostest.rosrun("gspn_framework_package", "own_nodes", TestOwnNodes, sys.argv)
