"""The referee: watches a team and counts laps, distance, contacts, time stuck, two robots in one
location, and overtaking.

It uses the true poses in the world, not those that a robot or plan believes in.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass, field
from typing import Any, Deque, Dict, List, Set, Tuple

from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.navigation import NavigationStatus
from gspn_framework_package.world.room import Pose

STUCK_SECONDS = 20.0
"""A robot with a goal that stays within :data:`STUCK_RADIUS` for longer than this is stuck."""

STUCK_RADIUS = 0.1
"""Radius in metres."""


@dataclass
class Tally:
    """The referee's counts for one robot.

    :ivar distance: distance driven, in metres.
    :ivar entries: number of locations entered.
    :ivar laps: how often all locations were entered, in the order of the room file.
    :ivar stuck: seconds with a goal but without progress, beyond the first :data:`STUCK_SECONDS`.
    :ivar reached: number of goals reached.
    :ivar aborted: number of goals given up by the navigator.
    """

    distance: float = 0.0
    entries: int = 0
    laps: int = 0
    stuck: float = 0.0
    reached: int = 0
    aborted: int = 0


class EntryOrder:
    """Compares the order in which robots enter locations with the order in which the plan sends
    them there.

    It does not judge entries before the first grant.
    """

    def __init__(self) -> None:
        self._granted: Dict[str, Deque[str]] = {}
        self.out_of_turn: List[Tuple[float, str, str]] = []
        """Time, location and robot of each entry that was not the next one granted, that is, of
        each overtaking."""

    def grant(self, robot: str, location: str) -> None:
        """Note that the plan sends a robot into a location."""
        self._granted.setdefault(location, deque()).append(robot)

    def withdraw(self, robot: str) -> None:
        """Cancel the unused grants of a robot that was lost."""
        for queue in self._granted.values():
            while robot in queue:
                queue.remove(robot)

    def enter(self, robot: str, location: str, time: float) -> None:
        """Note that a robot enters a location, at ``time`` in seconds."""
        if not self._granted:
            return
        queue = self._granted.setdefault(location, deque())
        if queue and queue[0] == robot:
            queue.popleft()
            return
        self.out_of_turn.append((time, location, robot))
        if robot in queue:
            queue.remove(robot)


@dataclass
class _Track:
    pose: Pose
    anchor: Pose
    since: float
    status: NavigationStatus = NavigationStatus.IDLE
    inside: Set[str] = field(default_factory=set)
    next_location: int = 0


class Referee:
    """Counts the events of a team; call :meth:`watch` after each of its steps."""

    def __init__(self, team: DrivingTeam) -> None:
        self._team = team
        self.tallies: Dict[str, Tally] = {name: Tally() for name in team.robots}
        self.together: List[Tuple[float, str, Tuple[str, ...]]] = []
        """Time, location and robots of each occasion when several robots were in one location."""
        self.order = EntryOrder()
        """Lists the robots that overtook against the plan, if the plan's grants are given."""
        self.entry_log: List[Tuple[float, str, str]] = []
        """Time, robot and location of each entry."""
        self._tracks = {
            name: _Track(team.physics.pose(name), team.physics.pose(name), team.time)
            for name in team.robots
        }
        self._shared: Set[Tuple[str, Tuple[str, ...]]] = set()
        self._watched = team.time
        self.nearest_to_people = math.inf
        """Least distance between a robot and a person, in metres."""

    def watch(self) -> None:
        """Evaluate the current poses of all robots."""
        team, time = self._team, self._team.time
        names = list(team.room.locations)
        radius = team.room.robot.radius
        residents: Dict[str, List[str]] = {name: [] for name in names}
        for robot, track in self._tracks.items():
            tally, pose = self.tallies[robot], team.physics.pose(robot)
            moved = pose.distance(track.pose)
            driven = 2 * team.room.robot.max_speed * (time - self._watched)
            tally.distance += moved if 1e-4 < moved < driven else 0.0  # else it was carried
            track.pose = pose
            self._watch_goal(robot, track, tally, time)
            for walker in team.people:
                self.nearest_to_people = min(self.nearest_to_people, walker.gap(pose, radius))
            for name in names:
                away = team.room.locations[name].area.distance((pose.x, pose.y))
                if away < radius:
                    residents[name].append(robot)
                # a robot enters with its centre, and has left when its edge is outside
                if away <= 0.0 and name not in track.inside:
                    track.inside.add(name)
                    self._enter(robot, name, track, tally, names)
                elif away >= radius:
                    track.inside.discard(name)
        self._watch_sharing(residents, time)
        self._watched = time

    def _watch_goal(self, robot: str, track: _Track, tally: Tally, time: float) -> None:
        navigator = self._team.navigators[robot]
        if navigator.status is not track.status:
            tally.reached += navigator.status is NavigationStatus.REACHED
            tally.aborted += navigator.status is NavigationStatus.FAILED
            track.status = navigator.status
        if not navigator.active or track.pose.distance(track.anchor) > STUCK_RADIUS:
            track.anchor, track.since = track.pose, time
        elif time - track.since > STUCK_SECONDS:
            tally.stuck += time - max(track.since + STUCK_SECONDS, self._watched)

    def _enter(
        self, robot: str, location: str, track: _Track, tally: Tally, names: List[str]
    ) -> None:
        tally.entries += 1
        if location == names[track.next_location]:
            track.next_location = (track.next_location + 1) % len(names)
            tally.laps += track.next_location == 0
        self.entry_log.append((round(self._team.time, 2), robot, location))
        self.order.enter(robot, location, self._team.time)

    def _watch_sharing(self, residents: Dict[str, List[str]], time: float) -> None:
        shared = {(name, tuple(robots)) for name, robots in residents.items() if len(robots) > 1}
        for name, robots in sorted(shared - self._shared):
            self.together.append((time, name, robots))
        self._shared = shared

    def _report_people(self) -> Dict[str, Any]:
        """The part of the report about people, in a room with people."""
        if not self._team.people:
            return {}
        nearest = self.nearest_to_people
        return {
            "visits_of_people": sum(walker.visits for walker in self._team.people),
            "contacts_with_people": sum(self._team.physics.contacts.people.values()),
            "nearest_to_people": None if math.isinf(nearest) else round(nearest, 3),
        }

    def report(self) -> Dict[str, Any]:
        """All counts, ready for JSON."""
        contacts = self._team.physics.contacts
        tallies = self.tallies.values()
        return {
            "simulated_seconds": round(self._team.time, 3),
            "robots": {name: asdict(tally) for name, tally in self.tallies.items()},
            "laps": sum(tally.laps for tally in tallies),
            "entries": sum(tally.entries for tally in tallies),
            "distance": round(sum(tally.distance for tally in tallies), 2),
            "contacts_between_robots": sum(contacts.robots.values()),
            "contacts_with_solids": sum(contacts.solids.values()),
            **self._report_people(),
            "stuck_minutes": round(sum(tally.stuck for tally in tallies) / 60, 3),
            "goals_reached": sum(tally.reached for tally in tallies),
            "goals_aborted": sum(tally.aborted for tally in tallies),
            "two_in_one_location": len(self.together),
            "overtakings": len(self.order.out_of_turn),
            "entry_log": self.entry_log,
        }
