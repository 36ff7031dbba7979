#!/usr/bin/env python3
"""``move_base`` of a robot as a user might write it, who knows only the topics of a TurtleBot3: it
plans on /map and on the robot's scan, and drives by cmd_vel. It knows nothing of the other robots
but what the scan shows.

Run it in the namespace of the robot, with the private parameter ``frame`` (``robot_1``): the prefix
of its frames.
"""

import math
import random
import threading

import actionlib
import numpy as np
import rospy
from geometry_msgs.msg import Twist
from move_base_msgs.msg import MoveBaseAction
from nav_msgs.msg import OccupancyGrid
from scipy import ndimage, sparse
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

RADIUS = 0.105
"""Of a robot, metres."""

SPEEDS = np.array([-0.06, 0.0, 0.06, 0.12, 0.18])
TURNS = np.linspace(-1.6, 1.6, 13)
TIMES = np.arange(0.1, 1.01, 0.1)
"""Candidates of the speed (m/s), of the turn rate (rad/s), and the times (s) at which each is
looked at."""

REACHED, ALIGNED = 0.06, 0.15
"""How near a goal has to be: metres and radians."""

PLAN_PERIOD = 1.0
"""Seconds between two plans."""

PATIENCE = 6.0
"""Seconds without progress after which the robot steps back for a while, and tries anew."""


def yaw_of(rotation):
    return math.atan2(
        2 * (rotation.w * rotation.z + rotation.x * rotation.y),
        1 - 2 * (rotation.y**2 + rotation.z**2),
    )


def along(first, second):
    """A pose in the frame of another."""
    (x, y, yaw), (u, v, turn) = first, second
    return (
        x + u * math.cos(yaw) - v * math.sin(yaw),
        y + u * math.sin(yaw) + v * math.cos(yaw),
        math.remainder(yaw + turn, math.tau),
    )


class Costmap:
    """The map, and what the scan shows beside it.

    :param message: nav_msgs/OccupancyGrid.
    """

    def __init__(self, message):
        info = message.info
        self.resolution = info.resolution
        self.origin = np.array([info.origin.position.x, info.origin.position.y])
        self.shape = (info.height, info.width)
        occupied = np.array(message.data).reshape(self.shape) > 50
        self.clearance = ndimage.distance_transform_edt(~occupied) * self.resolution
        numbers = np.arange(occupied.size).reshape(self.shape)
        pairs, lengths = [], []
        for dy, dx, length in (
            (0, 1, 1.0),
            (1, 0, 1.0),
            (1, 1, math.sqrt(2)),
            (1, -1, math.sqrt(2)),
        ):
            left = numbers[: self.shape[0] - dy, max(-dx, 0) : self.shape[1] - max(dx, 0)]
            right = numbers[dy:, max(dx, 0) : self.shape[1] + min(dx, 0)]
            pairs.append(np.stack([left.ravel(), right.ravel()]))
            lengths.append(np.full(left.size, length))
        self.pairs, self.lengths = np.concatenate(pairs, axis=1), np.concatenate(lengths)

    def cells(self, points):
        """The row and the column of points, moved into the map."""
        found = ((np.asarray(points)[..., :2] - self.origin) / self.resolution).astype(int)
        return np.clip(found[..., ::-1], 0, np.array(self.shape) - 1)

    def is_known(self, points):
        """Whether points are on what the map shows."""
        rows, columns = self.cells(points).T
        return self.clearance[rows, columns] < 0.12

    def path(self, start, goal, seen):
        """The cheapest way from a point to another around the map and what was seen.

        :param seen: points, of shape (n, 2).
        :returns: points, of shape (n, 2); None if there is no way.
        """
        cost = np.where(self.clearance > RADIUS + 0.02, 1.0, np.inf)
        cost += 4.0 * np.clip(0.35 - self.clearance, 0.0, None) / 0.35
        if len(seen):
            free = np.ones(self.shape, bool)
            free[tuple(self.cells(seen).T)] = False
            away = ndimage.distance_transform_edt(free) * self.resolution
            cost[away < RADIUS + 0.05] = np.inf
            cost += 12.0 * np.clip(0.5 - away, 0.0, None) / 0.5
        near = np.hypot(*(np.indices(self.shape) - self.cells(start)[:, None, None]))
        cost[(near * self.resolution < 0.15) & ~np.isfinite(cost)] = (
            20.0  # it stands there, so it can
        )
        flat = cost.ravel()
        weights = self.lengths * (flat[self.pairs[0]] + flat[self.pairs[1]]) / 2
        usable = np.isfinite(weights)
        graph = sparse.csr_matrix(
            (weights[usable], self.pairs[:, usable]), shape=(flat.size, flat.size)
        )
        begin, end = (
            np.ravel_multi_index(self.cells(point), self.shape) for point in (start, goal)
        )
        _, before = sparse.csgraph.dijkstra(
            graph, directed=False, indices=end, return_predecessors=True
        )
        if before[begin] < 0 and begin != end:
            return None
        way = [begin]
        while way[-1] != end:
            way.append(before[way[-1]])
        rows, columns = np.unravel_index(way, self.shape)
        points = (np.stack([columns, rows], axis=1) + 0.5) * self.resolution + self.origin
        points[-1] = goal[:2]
        return points


class Navigator:
    """Drives the robot to the goals of ``move_base``."""

    def __init__(self):
        self._frame = rospy.get_param("~frame")
        self._lock = threading.RLock()
        self._frames = {}
        self._costmap = None
        self._path, self._planned = None, -math.inf
        self._goal = None
        self._moved, self._where = 0.0, (math.inf, math.inf, 0.0)
        self._back_until = -math.inf
        self._chance = random.Random(self._frame)
        self._commands = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        self._server = actionlib.SimpleActionServer("move_base", MoveBaseAction, auto_start=False)
        self._server.register_goal_callback(self._take)
        rospy.Subscriber("/map", OccupancyGrid, self._read_map)
        rospy.Subscriber("/tf", TFMessage, self._read_frames, queue_size=20)
        rospy.Subscriber("scan", LaserScan, self._read_scan, queue_size=1)
        self._server.start()

    def _take(self):
        with self._lock:
            pose = self._server.accept_new_goal().target_pose.pose
            self._goal = (pose.position.x, pose.position.y, yaw_of(pose.orientation))
            self._planned, self._moved = -math.inf, rospy.get_time()

    def _read_map(self, message):
        with self._lock:
            self._costmap = Costmap(message)

    def _read_frames(self, message):
        with self._lock:
            for transform in message.transforms:
                at = transform.transform
                self._frames[transform.child_frame_id] = (
                    at.translation.x,
                    at.translation.y,
                    yaw_of(at.rotation),
                )

    def _read_scan(self, scan):
        with self._lock:
            odom, base = (
                self._frames.get(self._frame + "/" + n) for n in ("odom", "base_footprint")
            )
            if not self._server.is_active() or None in (odom, base, self._costmap):
                return
            if self._server.is_preempt_requested():
                self._server.set_preempted()
                self._drive(0.0, 0.0)
                return
            ranges = np.array(scan.ranges)
            angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
            hit = np.isfinite(ranges)
            points = ranges[hit, None] * np.stack(
                [np.cos(angles[hit]), np.sin(angles[hit])], axis=1
            )
            self._step(along(odom, base), points)

    def _step(self, pose, points):
        """Choose the speed.

        :param points: what the scan shows, in the frame of the robot.
        """
        goal, now = self._goal, rospy.get_time()
        left = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        if left < REACHED:
            turn = math.remainder(goal[2] - pose[2], math.tau)
            if abs(turn) < ALIGNED:
                self._server.set_succeeded()
                self._drive(0.0, 0.0)
            else:
                self._drive(0.0, math.copysign(min(1.0, max(0.3, abs(turn))), turn))
            return
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        in_map = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
        known = self._costmap.is_known(in_map)
        if math.hypot(pose[0] - self._where[0], pose[1] - self._where[1]) > 0.1:
            self._where, self._moved = pose, now
        elif now - self._moved > PATIENCE and now > self._back_until:
            self._back_until = now + self._chance.uniform(1.0, 6.0)
            self._moved = self._back_until
        if now - self._planned > PLAN_PERIOD:
            self._planned = now
            self._path = self._costmap.path(pose, goal, in_map[~known])
        speed, turn = self._chosen(pose, points, known, now < self._back_until)
        self._drive(speed, turn)

    def _chosen(self, pose, points, known, stepping_back):
        """The speed and the turn rate that bring the robot furthest along its path."""
        speeds, turns = (each.ravel() for each in np.meshgrid(SPEEDS, TURNS, indexing="ij"))
        headings = turns[:, None] * TIMES
        middle = headings / 2
        ways = speeds[:, None] * TIMES * np.sinc(middle / np.pi)
        places = np.stack([ways * np.cos(middle), ways * np.sin(middle)], axis=-1)
        # what moves may come towards the robot while it stops
        margins = np.where(known, 0.02, 0.06) + np.abs(speeds)[:, None] * np.where(known, 0.2, 0.7)
        margins += RADIUS
        near = np.linalg.norm(points, axis=1)
        close = near < 1.0
        points, margins, near = points[close], margins[:, close], near[close]
        gaps = np.linalg.norm(places[:, :, None] - points, axis=-1)
        # nearer than it ought to be, it may only go away
        safe = (gaps > np.minimum(margins, near - 1e-3 * (speeds != 0.0)[:, None])[:, None]).all(
            axis=(1, 2)
        )
        safe |= speeds == 0.0
        if stepping_back or self._path is None:
            others = points[~known[close]]
            if not len(others):
                return 0.0, 0.0
            score = np.linalg.norm(places[:, -1, None] - others, axis=-1).min(axis=1)
            score -= 0.01 * np.abs(turns)
        else:
            score = -self._distance(pose, places[:, -1], headings[:, -1])
        score[~safe] = -np.inf
        best = int(np.argmax(score))
        return speeds[best], turns[best]

    def _distance(self, pose, ends, headings):
        """How far each end of a way, in the frame of the robot, is from a point ahead on the path;
        a heading away from it counts too."""
        away = np.hypot(*(self._path - pose[:2]).T)
        nearest = int(np.argmin(away))
        ahead = np.flatnonzero(away[nearest:] > 0.3)
        target = self._path[nearest + ahead[0] if len(ahead) else -1] - pose[:2]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        point = np.array([target[0] * cos + target[1] * sin, target[1] * cos - target[0] * sin])
        left = point - ends
        turned = np.arctan2(left[:, 1], left[:, 0]) - headings
        turned = np.abs((turned + np.pi) % (2 * np.pi) - np.pi)
        far = np.hypot(*left.T)
        return far + 0.08 * turned * np.minimum(far / 0.1, 1.0)

    def _drive(self, speed, turn):
        twist = Twist()
        twist.linear.x, twist.angular.z = speed, turn
        self._commands.publish(twist)


if __name__ == "__main__":
    rospy.init_node("move_base")
    Navigator()
    rospy.spin()
