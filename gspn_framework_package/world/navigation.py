"""The navigator of one robot: drives it to a goal among walls and parked, dead and moving robots.

It has no side effects: ``step`` takes the robot's knowledge and returns the command for its motors.
Its parts:

- The path: the cheapest on the room's grid, around standing robots (:mod:`.grid`).
- The next velocity: a dynamic window (:mod:`.avoidance`).
- The right of way: the older goal takes precedence. A stuck robot announces this; a robot in its
  path with less right of way *yields*: it moves to the nearest spot off that path, and meanwhile
  inherits the right of way, so that those behind it make room in turn (priority inheritance; PIBT,
  Okumura et al. 2019). This is how two robots resolve a corridor too narrow for both, and four
  robots a crossing.
- Recovery: a robot that is still stuck tries another path, then steps aside at random, then gives
  up and gives the reason.
"""

from __future__ import annotations

import enum
import math
import random
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

from gspn_framework_package.model.net import Point
from gspn_framework_package.world import avoidance
from gspn_framework_package.world.avoidance import GAP, STANDING_GAP, OtherRobot, Rank, wrap
from gspn_framework_package.world.grid import Disc, Field, Grid
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.yielding import (
    distance_to_path,
    spot_at_random,
    spot_off_the_path,
    standing_for,
)

STUCK_AFTER = 2.5
"""Seconds without progress towards the goal after which a robot announces that it is stuck."""

DETOUR_AFTER = 8.0
"""Seconds without progress after which it looks for a path around robots that hardly move."""

ESCAPE_AFTER = 14.0
"""Seconds without progress after which it steps aside at random."""

GIVE_UP_AFTER = 60.0
"""Seconds without progress after which the goal is given up, not counting the time spent making
room for others. Without any path, half of this suffices."""

_GOAL_TOLERANCE = 0.06  # metres
_YAW_TOLERANCE = 0.15  # radians
_LOOK_AHEAD = 0.9  # metres of path searched for a target in sight
_NEIGHBOURHOOD = 1.4  # metres within which other robots count


class NavigationStatus(enum.Enum):
    """The state of a navigator."""

    IDLE = "idle"
    """No goal."""

    DRIVING = "driving"
    """Driving to the goal."""

    YIELDING = "yielding"
    """Making room for another robot, or stepping aside, before it continues to the goal."""

    REACHED = "reached"
    """The last goal was reached."""

    FAILED = "failed"
    """The last goal was given up; ``Navigator.reason`` says why."""


@dataclass(frozen=True)
class Observation:
    """A robot's knowledge at one moment.

    :param time: the time in seconds.
    :param pose: its own pose.
    :param peers: the other robots.
    """

    time: float
    pose: Pose
    peers: Tuple[OtherRobot, ...] = ()


@dataclass
class _Yield:
    """The state of making room."""

    to: str
    rank: Rank
    field: Field
    spot: Point
    since: float
    arrived: Optional[float] = None


class Navigator:
    """Drives one robot.

    :param index: breaks ties in the right of way; different for each robot.
    """

    def __init__(self, grid: Grid, index: int) -> None:
        self._grid = grid
        self._index = index
        self._random = random.Random(index)
        self.status = NavigationStatus.IDLE
        self.reason = ""
        self.goal: Optional[Pose] = None
        self.rank: Rank = (math.inf, index)
        self.path: Tuple[Point, ...] = ()
        self._turn_at_goal = True
        self._field: Optional[Field] = None
        self._field_key: Tuple[object, ...] = ()
        self._field_time = -math.inf
        self._best = math.inf
        self._progress_time = 0.0
        self._in_vain = 0.0
        self._no_way_since: Optional[float] = None
        self._yield: Optional[_Yield] = None
        self._last_direction: Optional[float] = None
        self._last_moved: Dict[str, Tuple[Point, float]] = {}
        self._escaped = 0.0
        self._turning = False

    # ---- goals -------------------------------------------------------------------------------

    def go(self, goal: Pose, time: float, turn: bool = True) -> None:
        """Accept a goal, which replaces the previous one.

        :param time: seconds; the older of two goals has the right of way.
        :param turn: also turn to ``goal.yaw`` at the goal.
        """
        self.goal = goal
        self.status = NavigationStatus.DRIVING
        self.reason = ""
        self.rank = (round(time, 3), float(self._index))
        self._turn_at_goal = turn
        self._field = None
        self._field_key = ()
        self._best = math.inf
        self._progress_time = time
        self._in_vain = 0.0
        self._no_way_since = None
        self._yield = None
        self._escaped = time
        self._turning = False

    def cancel(self) -> None:
        """Drop the goal and stop."""
        self.goal = None
        self.status = NavigationStatus.IDLE
        self._rest()

    def reset(self, reason: str) -> None:
        """Give up the goal, if there is one, and forget where other robots stood."""
        if self.active:
            self._end(NavigationStatus.FAILED, reason)
        self._last_moved.clear()
        self.plan_anew()

    def use_grid(self, grid: Grid) -> None:
        """Find paths on another grid from now on, since a door has opened or closed."""
        self._grid = grid
        self._yield = None
        self.plan_anew()

    def plan_anew(self) -> None:
        """Search for the path again in the next step."""
        self._field, self._field_key, self._field_time = None, (), -math.inf

    def _rest(self) -> None:
        self.path = ()
        self.rank = (math.inf, float(self._index))
        self._yield = None
        self._last_direction = None

    def _end(self, status: NavigationStatus, reason: str = "") -> None:
        self.goal = None
        self.status = status
        self.reason = reason
        self._rest()

    @property
    def active(self) -> bool:
        """Whether it has a goal."""
        return self.goal is not None

    def stuck_for(self, time: float) -> float:
        """Seconds since the robot last made progress towards its goal; 0 if it has none."""
        return time - self._progress_time if self.goal is not None else 0.0

    def announce(
        self, name: str, pose: Pose, velocity: Tuple[float, float], time: float
    ) -> OtherRobot:
        """This robot's announcement to the others."""
        return OtherRobot(
            name=name,
            pose=pose,
            velocity=velocity,
            active=self.active,
            rank=self._yield.rank if self._yield is not None else self.rank,
            path=self.path,
            stuck=self.stuck_for(time) > STUCK_AFTER,
        )

    # ---- driving -----------------------------------------------------------------------------

    def step(self, seen: Observation, dt: float) -> Tuple[float, float]:
        """Compute the command for the next ``dt`` seconds.

        :returns: speed in metres per second and turn rate in radians per second.
        """
        if self.goal is None:
            return (0.0, 0.0)
        pose, goal = seen.pose, self.goal
        if pose.distance(goal) < _GOAL_TOLERANCE * (1.5 if self._turning else 1.0):
            self._turning = True
            error = wrap(goal.yaw - pose.yaw)
            if not self._turn_at_goal or abs(error) < _YAW_TOLERANCE:
                self._end(NavigationStatus.REACHED)
                return (0.0, 0.0)
            self.path = ((goal.x, goal.y),)
            self._progress_time = seen.time
            return (0.0, avoidance.steer(goal.yaw, 0.0, pose.yaw)[1])
        self._turning = False
        self._watch(seen)
        self._plan(seen)
        if self.goal is None or self._field is None:
            return (0.0, 0.0)
        self._measure(seen, dt)
        if self.goal is None:
            return (0.0, 0.0)
        self._consider_yielding(seen)
        return self._drive(seen, dt)

    def _watch(self, seen: Observation) -> None:
        """Record since when each peer has been standing."""
        for peer in seen.peers:
            point = (peer.pose.x, peer.pose.y)
            before = self._last_moved.get(peer.name)
            if before is None or math.dist(before[0], point) > 0.05:
                self._last_moved[peer.name] = (point, seen.time)

    def _standing(self, peer: OtherRobot, time: float, seconds: float) -> bool:
        return time - self._last_moved[peer.name][1] > seconds

    def _plan(self, seen: Observation) -> None:
        """Find the path, and search again when the standing robots have changed."""
        assert self.goal is not None
        reach = 2 * self._grid.room.robot.radius
        blocked: List[Disc] = []
        dear: List[Disc] = []
        detour = self.stuck_for(seen.time) > DETOUR_AFTER
        for peer in seen.peers:
            # rounded, so that a trembling robot does not cause a new search each time
            step = 0.03 if peer.active else 0.01
            x, y = round(peer.pose.x / step) * step, round(peer.pose.y / step) * step
            if not peer.active:
                # more than the distance kept from it: otherwise the path would lead where the
                # robot refuses to go
                blocked.append((x, y, reach + STANDING_GAP + 0.012))
                dear.append((x, y, reach + 0.06))
            elif self._standing(peer, seen.time, 2.0 if detour else 4.0):
                dear.append((x, y, reach + (0.12 if detour else 0.06)))
        key: Tuple[object, ...] = (self.goal, tuple(blocked), tuple(dear))
        if key != self._field_key and (self._field is None or seen.time - self._field_time > 0.5):
            self._field_key, self._field_time = key, seen.time
            goal = (self.goal.x, self.goal.y)
            field = self._grid.field(goal, blocked, dear)
            if math.isinf(field.cost((seen.pose.x, seen.pose.y))):
                # no path now: go as near as the walls allow, since standing robots may leave
                if self._no_way_since is None:
                    self._no_way_since = seen.time
                field = self._grid.field(goal, (), [(x, y, r + 0.05) for x, y, r in blocked])
                if math.isinf(field.cost((seen.pose.x, seen.pose.y))):
                    self._end(NavigationStatus.FAILED, "no path leads there")
                    return
            else:
                self._no_way_since = None
            self._field = field
            self._best = math.inf
        elif self._no_way_since is not None and seen.time - self._field_time > 1.0:
            self._field_key = ()

    def _measure(self, seen: Observation, dt: float) -> None:
        """Measure the progress, and give up after too long without any."""
        assert self._field is not None
        cost = self._field.cost((seen.pose.x, seen.pose.y))
        if self._best == math.inf:
            # a new field: its costs cannot be compared with the old ones; the timers continue
            self._best = cost
        elif cost < self._best - 0.05:
            self._best = cost
            self._progress_time = seen.time
            self._in_vain = 0.0
        elif self._yield is None or not self._yield.to:
            # the total: seconds before it stepped aside count too
            self._in_vain += dt
        if self._no_way_since is not None and seen.time - self._no_way_since > GIVE_UP_AFTER / 2:
            self._end(NavigationStatus.FAILED, "the way is blocked by standing robots")
        elif self._in_vain > GIVE_UP_AFTER:
            self._end(NavigationStatus.FAILED, "stuck for %d s" % GIVE_UP_AFTER)

    def _drive(self, seen: Observation, dt: float) -> Tuple[float, float]:
        assert self._field is not None and self.goal is not None
        pose, robot = seen.pose, self._grid.room.robot
        rank = self.rank
        field, end = self._field, (self.goal.x, self.goal.y)
        if self._yield is not None:
            field, end, rank = self._yield.field, self._yield.spot, self._yield.rank
        here = (pose.x, pose.y)
        path = field.path(here, _LOOK_AHEAD + 0.6)
        self.path = tuple(path[::3]) + tuple(path[-1:])
        away = math.dist(here, end)
        if self._yield is not None and away < _GOAL_TOLERANCE:
            self.path = (end,)
            return (0.0, 0.0)
        target = self._in_sight(here, path)
        speed = min(robot.max_speed, 1.5 * away + 0.02)
        near = avoidance.sort_near(pose, seen.peers, _NEIGHBOURHOOD)
        direction, speed = avoidance.choose_velocity(
            self._grid, pose, target, speed, near, rank, self._last_direction
        )
        self._last_direction = direction
        if speed == 0.0:
            return (0.0, 0.0)
        drive, turn = avoidance.steer(direction, speed, pose.yaw)
        return (avoidance.brake(self._grid, pose, drive, dt, near), turn)

    def _in_sight(self, here: Point, path: Sequence[Point]) -> Point:
        """The farthest point of the path, within reach, that it can reach in a straight line."""
        # at least the next cell: around the centre of its own it would turn forever
        target = path[min(1, len(path) - 1)] if path else here
        for point in [*path[2::2], *path[-1:]]:
            if math.dist(here, point) > _LOOK_AHEAD or not self._grid.is_clear(here, point, 0.02):
                break
            target = point
        return target

    # ---- making room -------------------------------------------------------------------------

    def _consider_yielding(self, seen: Observation) -> None:
        time, pose = seen.time, seen.pose
        now = self._yield
        if now is not None:
            if now.arrived is None and math.dist((pose.x, pose.y), now.spot) < _GOAL_TOLERANCE:
                now.arrived = time
            if self._may_resume(now, seen):
                self._yield = now = None
                self.status = NavigationStatus.DRIVING
                self._progress_time = time
        rank = now.rank if now is not None else self.rank
        asking = [
            peer
            for peer in seen.peers
            if peer.active
            and peer.stuck
            and peer.rank < rank
            and (now is None or peer.name != now.to)
            and distance_to_path(peer, (pose.x, pose.y))
            < 2 * self._grid.room.robot.radius + GAP + 0.02
        ]
        if asking:
            first = min(asking, key=lambda peer: peer.rank)
            self._make_room(first, seen)
        elif (
            now is None
            and self.stuck_for(time) > ESCAPE_AFTER
            and time - self._escaped > ESCAPE_AFTER
        ):
            self._escape(seen)

    def _may_resume(self, now: _Yield, seen: Observation) -> bool:
        other = next((peer for peer in seen.peers if peer.name == now.to), None)
        if other is None or not other.active:
            return now.arrived is not None or seen.time - now.since > 6.0
        if now.arrived is None:
            return seen.time - now.since > 12.0
        if seen.time - now.arrived > 10.0:
            return True
        if seen.time - now.arrived < 0.5:
            return False
        assert self._field is not None
        # the path is free once that of the other no longer crosses its next section
        ahead = self._field.path((seen.pose.x, seen.pose.y), 0.5)
        apart = 2 * self._grid.room.robot.radius + GAP
        return all(distance_to_path(other, point) > apart for point in ahead)

    def _make_room(self, other: OtherRobot, seen: Observation) -> None:
        """Move to the nearest spot off the path of ``other``."""
        spot = spot_off_the_path(self._grid, (seen.pose.x, seen.pose.y), other, seen.peers)
        if spot is not None:
            blocked = standing_for(other, seen.peers, 2 * self._grid.room.robot.radius)
            rank = (*other.rank, 1.0, float(self._index))
            self._step_aside(other.name, rank, spot, blocked, seen.time)

    def _escape(self, seen: Observation) -> None:
        """Step aside at random, as a last resort."""
        self._escaped = seen.time
        here = (seen.pose.x, seen.pose.y)
        spot = spot_at_random(self._grid, here, seen.peers, self._random)
        if spot is not None:
            self._step_aside("", self.rank, spot, (), seen.time)

    def _step_aside(
        self, to: str, rank: Rank, spot: Point, blocked: Sequence[Disc], time: float
    ) -> None:
        self._yield = _Yield(to, rank, self._grid.field(spot, blocked), spot, time)
        self.status = NavigationStatus.YIELDING
