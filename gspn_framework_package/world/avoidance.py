"""The next velocity of one robot among walls and other robots: a dynamic window over directions and
speeds.

A robot that turns on the spot is a disc that can leave in any direction after a turn. The window
therefore covers directions and speeds of the disc (as velocity obstacles do; Fiorini and Shiller
1998, van den Berg et al. 2008), and the robot turns before it follows the chosen one. Other robots
are predicted along the paths that they announce; the right of way decides how far ahead they
count. A final check of each command (:func:`brake`) keeps two robots from ever touching, whatever
was predicted: each stops before it could reach the other (passive safety, Fraichard and Asama
2004).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.model.net import Point
from gspn_framework_package.world.grid import Grid
from gspn_framework_package.world.room import Pose

Rank = Tuple[float, ...]
"""The right of way: the robot with the smaller rank has it."""

HORIZON = 3.0
"""Prediction horizon in seconds for robots that have the right of way, and for standing ones."""

SHORT_HORIZON = 1.0
"""Prediction horizon in seconds for robots without the right of way, which will give way."""

GAP = 0.035
"""Distance between the discs of two active robots, in metres."""

STANDING_GAP = 0.028
"""Distance to a robot that stands, parked or dead, in metres."""

_BRAKING_GAP = 0.025  # least metres between two discs when braking
_STEPS = np.linspace(0.2, HORIZON, 15)
_OFFSETS = np.radians([0, 12, -12, 25, -25, 42, -42, 65, -65, 95, -95, 130, -130, 180])
_TURN = 1.8  # average rate of a turn on the spot, radians per second


@dataclass(frozen=True)
class OtherRobot:
    """A robot's knowledge of another robot, from observation and from its announcements.

    :param name: name of the other robot.
    :param velocity: its velocity east and north, metres per second.
    :param active: whether it is driving to a goal; otherwise it stands, parked or dead.
    :param rank: its right of way.
    :param path: the next part of its path, from its position on; empty if it is not active.
    :param stuck: whether it has a goal but makes no progress.
    """

    name: str
    pose: Pose
    velocity: Tuple[float, float] = (0.0, 0.0)
    active: bool = False
    rank: Rank = (math.inf,)
    path: Tuple[Point, ...] = ()
    stuck: bool = False

    @property
    def speed(self) -> float:
        """Its speed in metres per second."""
        return math.hypot(*self.velocity)

    def ahead(self, full_speed: float) -> np.ndarray:
        """Its predicted positions along its path at the sampled times; shape (times, 2).

        :param full_speed: the largest speed of the robots, metres per second.
        """
        here = np.array([self.pose.x, self.pose.y])
        if not self.active or len(self.path) < 1 or self.stuck:
            return here + np.outer(_STEPS, self.velocity if self.active else (0.0, 0.0))
        points = np.vstack([here, np.array(self.path)])
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        # a robot that is turning on the spot will drive soon
        gone = _STEPS * max(self.speed, 0.5 * full_speed)
        return np.column_stack(
            [np.interp(gone, way, points[:, 0]), np.interp(gone, way, points[:, 1])]
        )


def wrap(angle: float) -> float:
    """The equivalent angle in (-pi, pi]."""
    return math.remainder(angle, math.tau)


def choose_velocity(
    grid: Grid,
    pose: Pose,
    target: Point,
    speed: float,
    peers: Sequence[OtherRobot],
    rank: Rank,
    last: Optional[float],
) -> Tuple[float, float]:
    """Choose the direction and speed of a robot.

    :param pose: the robot's pose.
    :param target: a point in sight to drive to.
    :param speed: the desired speed if nothing is in the way, metres per second.
    :param peers: the other robots nearby.
    :param rank: the robot's right of way.
    :param last: the direction chosen last time, which is preferred unless another is better.
    :returns: direction in radians, and speed in metres per second: 0 if standing still is best.
    """
    robot = grid.room.robot
    wanted = math.atan2(target[1] - pose.y, target[0] - pose.x)
    directions = np.repeat(wanted + _OFFSETS, 2)
    speeds = np.tile([speed, speed / 2], len(_OFFSETS))
    turns = np.abs(np.remainder(directions - pose.yaw + math.pi, math.tau) - math.pi)

    # the trajectory of each choice: first the turn, then straight ahead, at most to the target
    gone = np.clip(_STEPS[None, :] - turns[:, None] / _TURN, 0.0, None) * speeds[:, None]
    gone = np.minimum(gone, max(math.hypot(target[0] - pose.x, target[1] - pose.y), 0.05))
    xs = pose.x + gone * np.cos(directions)[:, None]
    ys = pose.y + gone * np.sin(directions)[:, None]

    offset = np.repeat(_OFFSETS, 2)
    cost = -np.cos(offset) * speeds / robot.max_speed
    cost += 0.12 * turns / math.pi
    # prefer the right of two equal sides, so that two robots that meet do not mirror each other
    cost += np.where(offset > 0.0, 0.04, 0.0)
    if last is not None:
        cost += (
            0.1 * np.abs(np.remainder(directions - last + math.pi, math.tau) - math.pi) / math.pi
        )

    spare = grid.clearance_at(xs, ys) - robot.radius
    least = spare.min(axis=1)
    cost += 0.5 * np.clip(1.0 - least / 0.08, 0.0, 1.0) ** 2
    cost += np.where(least < min(0.01, float(spare[0, 0])) - 1e-3, 10.0, 0.0)

    still = 0.0
    here = np.array([pose.x, pose.y])
    for peer in peers:
        horizon = HORIZON if not peer.active or peer.rank < rank else SHORT_HORIZON
        ahead = peer.ahead(robot.max_speed)
        urgency = np.clip(1.0 - _STEPS / horizon, 0.0, 1.0)
        if not peer.active:
            urgency = np.where(urgency > 0.0, 0.6 + 0.4 * urgency, 0.0)
        keep = GAP if peer.active else STANDING_GAP
        gaps = np.hypot(xs - ahead[:, 0], ys - ahead[:, 1]) - 2 * robot.radius
        cost += _threat(gaps, urgency, keep)
        waiting = np.hypot(here[0] - ahead[:, 0], here[1] - ahead[:, 1]) - 2 * robot.radius
        still += float(_threat(waiting[None, :], urgency, keep)[0])
    best = int(np.argmin(cost))
    # standing still only costs the progress not made
    if still + 0.05 <= cost[best]:
        return (float(directions[best]), 0.0)
    return (float(directions[best]), float(speeds[best]))


def _threat(gaps: np.ndarray, urgency: np.ndarray, keep: float) -> np.ndarray:
    """The cost of approaching to ``gaps`` (metres; shape (choices, times)) at times of this
    ``urgency``."""
    near = np.clip(1.0 - (gaps - keep) / 0.10, 0.0, 1.0)
    hit = gaps < keep
    return ((0.8 * near + 2.5 * hit) * urgency).max(axis=1)


def steer(direction: float, speed: float, yaw: float) -> Tuple[float, float]:
    """The speed and turn rate (metres and radians per second) that bring a robot with heading
    ``yaw`` onto a direction.

    It turns first, and drives once it nearly faces the direction.
    """
    error = wrap(direction - yaw)
    # slow enough to stop the turn in time
    turn = min(2.0, math.sqrt(4.0 * abs(error)), 4.0 * abs(error))
    drive = speed * max(0.0, math.cos(error)) ** 3 if abs(error) < 1.2 else 0.0
    return (drive, math.copysign(turn, error))


def brake(grid: Grid, pose: Pose, speed: float, dt: float, peers: Sequence[OtherRobot]) -> float:
    """Reduce a speed so that the robot can stop before it touches anything.

    It assumes that others keep approaching at their current speed. Driving away from something too
    near is allowed.

    :param speed: the desired forward speed, metres per second.
    :param dt: seconds until the next command.
    :returns: the allowed speed, metres per second.
    """
    robot = grid.room.robot
    least = 2 * robot.radius + _BRAKING_GAP
    if speed <= 0.0:
        return 0.0
    for factor in (1.0, 0.6, 0.3):
        tried = speed * factor
        reach = tried * dt + tried * tried / (2 * robot.acceleration) + 0.008
        x, y = pose.x + reach * math.cos(pose.yaw), pose.y + reach * math.sin(pose.yaw)
        spare, now = (
            float(value) - robot.radius
            for value in grid.clearance_at(np.array([x, pose.x]), np.array([y, pose.y]))
        )
        if spare < 0.006 and spare < now:
            continue
        if all(_stays_clear(pose, (x, y), peer, dt, least) for peer in peers):
            return tried
    return 0.0


def _stays_clear(pose: Pose, there: Point, peer: OtherRobot, dt: float, least: float) -> bool:
    before = pose.distance(peer.pose)
    after = peer.pose.distance(there)
    # The other robot also moves, at worst straight at us. One that is stationary but active
    # may start at any moment.
    coming = max(peer.speed, 0.1 if peer.active else 0.0) * dt * 1.2
    if after - coming >= least:
        return True
    # already too near: only clearly away from it, since a robot that still turns drives a curve
    return after - before > 0.3 * math.dist((pose.x, pose.y), there)


def sort_near(pose: Pose, peers: Sequence[OtherRobot], reach: float) -> List[OtherRobot]:
    """The peers within ``reach`` metres, nearest first."""
    near = [peer for peer in peers if pose.distance(peer.pose) < reach]
    return sorted(near, key=lambda peer: pose.distance(peer.pose))
