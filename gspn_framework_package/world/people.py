"""People who walk into a room and out again, among the robots.

A person walks around standing robots, and stops in front of one that is too near. Whatever its
navigator or its plan wants, a robot does not drive towards a person nearby (:func:`halted`), like a
robot with the protective field of a safety scanner. So neither runs into the other.
"""

from __future__ import annotations

import math
import random
from dataclasses import replace
from typing import Optional, Sequence

from gspn_framework_package.model.net import Point
from gspn_framework_package.world.grid import Field, Grid
from gspn_framework_package.world.room import Person, Pose, Room

PROTECTED = 0.4
"""Distance in metres within which a robot does not drive towards a person."""

KEPT_DISTANCE = 0.15
"""Distance in metres that a person keeps from robots."""

ENTRANCE = 0.6
"""Radius in metres around the point of entry that must be free of robots when a person comes in."""

PEOPLE_PATIENCE = 5.0
"""Seconds that a person waits for a robot that stands at or near the person's destination."""

WITHIN_REACH = 1.0
"""Distance in metres at which a point counts as reached by a person who has waited for it."""

_ARRIVED = 0.06
_PLANS_AGAIN = 0.5  # seconds
_AHEAD = 0.4  # metres of the path that a step looks at
_AWARE = 1.5  # metres within which robots change the person's way


def halted(pose: Pose, speed: float, radius: float, people: Sequence[Walker]) -> bool:
    """Whether a robot must not drive at this speed, because a person is near in that direction.

    :param pose: of the robot.
    :param speed: metres per second, negative backwards.
    :param radius: of the robot, metres.
    """
    if speed == 0.0:
        return False
    for walker in people:
        if walker.at is None or walker.gap(pose, radius) >= PROTECTED:
            continue
        bearing = math.atan2(walker.at[1] - pose.y, walker.at[0] - pose.x)
        if math.cos(bearing - pose.yaw) * speed > 0.0:
            return True
    return False


class Walker:
    """A person who comes, walks along a path, and goes.

    :param source: random source of the times at which the person comes.

    :ivar at: the person's position; None while absent.
    :ivar visits: number of visits so far.
    """

    def __init__(self, person: Person, room: Room, source: random.Random) -> None:
        self.person = person
        self.at: Optional[Point] = None
        self.visits = 0
        self.use_room(room)
        self._radius = room.robot.radius
        self._source = source
        self._comes = source.expovariate(1.0 / person.away_mean)
        self._leg = 0
        self._stands_until = 0.0
        self._planned = 0.0
        self._moved = 0.0

    def use_room(self, room: Room) -> None:
        """Find paths in another room from now on, since a door has opened or closed."""
        # the grid is that of a robot as large as the person
        self._grid = Grid(replace(room, robot=replace(room.robot, radius=self.person.radius)))
        self._field: Optional[Field] = None

    def come(self, time: float) -> None:
        """Come in at this time in seconds, or as soon as the entrance is free."""
        self._comes = time

    def gap(self, pose: Pose, radius: float) -> float:
        """Metres between the person and a robot; infinite if the person is absent."""
        if self.at is None:
            return math.inf
        return pose.distance(self.at) - radius - self.person.radius

    def step(self, time: float, dt: float, robots: Sequence[Pose]) -> None:
        """Walk for ``dt`` seconds from ``time`` on.

        :param robots: where the robots are.
        """
        path = self.person.path
        if self.at is None:
            near = self._radius + self.person.radius + ENTRANCE
            if time >= self._comes and all(pose.distance(path[0]) >= near for pose in robots):
                self.at = path[0]
                self.visits += 1
                self._leg, self._field, self._moved = 1, None, time
            return
        if time < self._stands_until:
            self._moved = time
            return
        goal = path[self._leg]
        away = math.dist(self.at, goal)
        if away < _ARRIVED or (time - self._moved > PEOPLE_PATIENCE and away < WITHIN_REACH):
            self._arrive(time)
            return
        self._plan(time, goal, robots)
        self._walk(time, dt, goal, robots)

    def _arrive(self, time: float) -> None:
        self._field, self._moved = None, time
        self._leg += 1
        if self._leg < len(self.person.path):
            self._stands_until = time + self.person.stands
        else:
            self.at = None
            self._comes = time + self._source.expovariate(1.0 / self.person.away_mean)

    def _plan(self, time: float, goal: Point, robots: Sequence[Pose]) -> None:
        assert self.at is not None
        near = [pose for pose in robots if pose.distance(self.at) < _AWARE]
        if self._field is not None and (not near or time - self._planned < _PLANS_AGAIN):
            return
        around = self._radius + self.person.radius + KEPT_DISTANCE + 0.03
        field = self._grid.field(goal, [(pose.x, pose.y, around) for pose in near])
        if math.isinf(field.cost(self.at)):
            # no way around them: go as near as they allow until they leave
            field = self._grid.field(goal)
        self._field, self._planned = field, time

    def _walk(self, time: float, dt: float, goal: Point, robots: Sequence[Pose]) -> None:
        assert self.at is not None and self._field is not None
        way = self._field.path(self.at, _AHEAD)
        for point in [goal, *reversed(way)]:
            left = math.dist(self.at, point)
            if 0.0 < left < _AHEAD and self._is_free(point, robots):
                part = min(self.person.speed * dt / left, 1.0)
                self.at = (
                    self.at[0] + part * (point[0] - self.at[0]),
                    self.at[1] + part * (point[1] - self.at[1]),
                )
                self._moved = time
                return

    def _is_free(self, there: Point, robots: Sequence[Pose]) -> bool:
        """Whether the person can go straight to a point: no wall is in the way, and no robot is
        closer to the line than the distance that the person keeps, or than its present distance."""
        assert self.at is not None
        if not self._grid.is_clear(self.at, there, 0.0):
            return False
        least = self._radius + self.person.radius + KEPT_DISTANCE
        return all(
            _distance_to_line(pose, self.at, there) >= min(least, pose.distance(self.at)) - 1e-9
            for pose in robots
        )


def _distance_to_line(pose: Pose, start: Point, end: Point) -> float:
    """Distance (m) from a robot to a straight path."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    part = ((pose.x - start[0]) * dx + (pose.y - start[1]) * dy) / (dx * dx + dy * dy)
    part = min(max(part, 0.0), 1.0)
    return pose.distance((start[0] + part * dx, start[1] + part * dy))
