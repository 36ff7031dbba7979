"""Finds the spots to which a robot steps aside when it makes room for another."""

from __future__ import annotations

import random
from typing import Optional, Sequence

import numpy as np

from gspn_framework_package.model.net import Point
from gspn_framework_package.world.avoidance import GAP, STANDING_GAP, OtherRobot
from gspn_framework_package.world.grid import Disc, Grid

FARTHEST = 4.0
"""Largest (weighted) distance that a robot drives to make room, in metres."""


def standing_for(other: OtherRobot, peers: Sequence[OtherRobot], apart: float) -> Sequence[Disc]:
    """The obstacles for a robot that makes room for ``other``: that robot, and all standing ones.

    :param apart: distance of two robots that touch, in metres.
    """
    return [
        (peer.pose.x, peer.pose.y, apart + (0.01 if peer.active else STANDING_GAP))
        for peer in peers
        if not peer.active or peer.name == other.name
    ]


def spot_off_the_path(
    grid: Grid, here: Point, other: OtherRobot, peers: Sequence[OtherRobot]
) -> Optional[Point]:
    """The nearest spot off the announced path of ``other``; None if there is none.

    :param peers: all other robots, ``other`` among them.
    """
    apart = 2 * grid.room.robot.radius
    cost = grid.field(here, standing_for(other, peers, apart)).costs
    cells = np.flatnonzero(np.isfinite(cost) & (cost < FARTHEST))
    xs, ys = grid.xs[cells], grid.ys[cells]
    good = grid.clearance[cells] > grid.room.robot.radius + 0.02
    good &= distances_to_path(other, xs, ys) > apart + GAP + 0.04
    price = cost[cells].copy()
    for peer in peers:
        away = np.hypot(xs - peer.pose.x, ys - peer.pose.y)
        good &= (away > apart + 0.03) | (peer.active and peer.name != other.name)
        # an occupied spot is possible, but only if its robot makes room in turn
        price += np.where(away < apart + 0.05, 1.0, 0.0)
    if not good.any():
        return None
    best = int(cells[good][int(np.argmin(price[good]))])
    return (float(grid.xs[best]), float(grid.ys[best]))


def spot_at_random(
    grid: Grid, here: Point, peers: Sequence[OtherRobot], source: random.Random
) -> Optional[Point]:
    """A random free spot nearby; None if there is none."""
    apart = 2 * grid.room.robot.radius
    cells = grid.cells_near(here, 0.7)
    good = grid.clearance[cells] > grid.room.robot.radius + 0.02
    for peer in peers:
        good &= np.hypot(grid.xs[cells] - peer.pose.x, grid.ys[cells] - peer.pose.y) > apart + 0.03
    if not good.any():
        return None
    best = int(source.choice(list(cells[good])))
    return (float(grid.xs[best]), float(grid.ys[best]))


def distance_to_path(peer: OtherRobot, point: Point) -> float:
    """The distance from a point to the announced path of a peer, in metres."""
    return float(distances_to_path(peer, np.array([point[0]]), np.array([point[1]]))[0])


def distances_to_path(peer: OtherRobot, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """The distance from each point to the announced path of a peer, in metres."""
    path = np.array([(peer.pose.x, peer.pose.y), *peer.path])
    nearest = np.hypot(xs - path[0, 0], ys - path[0, 1])
    for (x1, y1), (x2, y2) in zip(path, path[1:]):
        dx, dy = x2 - x1, y2 - y1
        length = dx * dx + dy * dy
        if length < 1e-12:
            continue
        part = np.clip(((xs - x1) * dx + (ys - y1) * dy) / length, 0.0, 1.0)
        nearest = np.minimum(nearest, np.hypot(xs - x1 - part * dx, ys - y1 - part * dy))
    return nearest
