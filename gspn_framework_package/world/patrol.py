"""The actions of the patrol (thesis 6.2), as a robot does them: drive, look, measure, wait.

Each action is a generator: it yields feedback, one line at a time, while it goes on, and returns
the name of a transition, or None when the policy decides. It asks nothing but a :class:`Robot`: a
base that goes to poses (``move_base``), a thermometer, and the poses of the others. The same
actions therefore run on simulated and on real robots, and without ROS in tests and benchmarks.
"""

from __future__ import annotations

import re
import zlib
from typing import Dict, Generator, Optional, Protocol, Sequence

from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.world.room import Location, Pose, Room

Action = Generator[str, None, Optional[str]]
"""Yields feedback; returns a transition or None."""


class Robot(Protocol):
    """What the actions need of a robot."""

    name: str

    def now(self) -> float:
        """The time, seconds."""

    def pose(self) -> Pose:
        """Where it is."""

    def others(self) -> Dict[str, Pose]:
        """Where the other robots are or were last seen, by name."""

    def temperature(self) -> float:
        """What its thermometer reads, degrees Celsius."""

    def go(self, goal: Pose) -> None:
        """Start driving to a pose, instead of the goal before."""

    def arrived(self) -> Optional[bool]:
        """None on the way; then whether the last goal was reached."""

    def trouble(self) -> str:
        """Why the last goal was not reached."""

    def stop(self) -> None:
        """Drop the goal."""


def occupant(location: Location, robots: Dict[str, Pose], radius: float) -> Optional[str]:
    """The robot that is in the location, if only with its edge; the first by name."""
    inside = (
        name
        for name, pose in sorted(robots.items())
        if location.area.distance((pose.x, pose.y)) < radius
    )
    return next(inside, None)


def drive(robot: Robot, goal: Pose, tries: int = 3) -> Generator[str, None, None]:
    """Go to a pose, once more when the base gives up.

    :raises ActionFailed: it gave up ``tries`` times.
    """
    for attempt in range(tries):
        robot.go(goal)
        while robot.arrived() is None:
            yield "driving, %.1f m to go" % robot.pose().distance(goal)
        if robot.arrived():
            return
        yield "try %d of %d failed: %s" % (attempt + 1, tries, robot.trouble())
    raise ActionFailed("cannot reach (%.2f, %.2f): %s" % (goal.x, goal.y, robot.trouble()))


def check_temperature(
    robot: Robot, room: Room, location: str, threshold: float, high: str, low: str
) -> Action:
    """Sweep a location and read the thermometer.

    It enters only once nobody else is in the location, seen from the poses, and waits at the entry
    until then: a robot that is leaving, or one that was lost there, still occupies it.

    :param location: name of the location.
    :param threshold: degrees Celsius above which it is too hot.
    :param high: the transition to ask for when it was too hot anywhere ...
    :param low: ... and when it was not.
    :raises ActionFailed: a point cannot be reached.
    """
    place = room.locations[location]
    radius = room.robot.radius
    who = occupant(place, robot.others(), radius)
    if who is not None:
        # if the entry cannot be reached, because a lost robot stands there, any place outside will
        # do
        robot.go(place.entry)
    while who is not None:
        yield "waiting at the entry of %s, %s is in it" % (location, who)
        who = occupant(place, robot.others(), radius)
    hottest = robot.temperature()
    for count, (x, y) in enumerate(place.sweep):
        for feedback in drive(robot, Pose(x, y, robot.pose().yaw)):
            hottest = max(hottest, robot.temperature())
            part = count / len(place.sweep)
            yield "%d %% swept, %.1f degrees at most, %s" % (100 * part, hottest, feedback)
        hottest = max(hottest, robot.temperature())
    return high if hottest > threshold else low


def alarm(robot: Robot, location: str, seconds: float) -> Action:
    """Stand in the location and sound the alarm for some seconds."""
    start = robot.now()
    while robot.now() - start < seconds:
        yield "ALARM in %s: %.1f degrees" % (location, robot.temperature())
    return None


def wait(robot: Robot, room: Room, location: str, seconds: float, first_slot: int = 0) -> Action:
    """Go to a free slot of the bay after a location and wait there for some seconds.

    :param first_slot: the slot to prefer; different robots prefer different ones.
    :raises ActionFailed: no slot can be reached.
    """
    bay = room.locations[location].bay
    yield from _park(robot, bay, first_slot, room.robot.radius)
    start = robot.now()
    while robot.now() - start < seconds:
        yield "waiting after %s" % location
    return None


def preferred_slot(robot: str) -> int:
    """The slot of a bay for a robot to try first: another for each, the same one each time,
    whatever they are called."""
    number = re.search(r"(\d{1,6})$", robot)
    return int(number.group(1)) if number is not None else zlib.crc32(robot.encode())


def _park(
    robot: Robot, bay: Sequence[Pose], first: int, radius: float
) -> Generator[str, None, None]:
    here = robot.pose()
    if any(here.distance(slot) < 0.15 for slot in bay):
        return

    def is_taken(slot: Pose) -> bool:
        return any(pose.distance(slot) < 2 * radius + 0.03 for pose in robot.others().values())

    trouble = "the bay has no slots"
    for step in range(2 * len(bay)):
        slot = bay[(first + step) % len(bay)]
        if is_taken(slot):
            trouble = "every slot is taken"
            continue
        robot.go(slot)
        while robot.arrived() is None and not is_taken(slot):
            yield "driving, %.1f m to go" % robot.pose().distance(slot)
        if robot.arrived():
            return
        # given up, or somebody else was there first
        trouble = robot.trouble() or "every slot is taken"
    raise ActionFailed(trouble)
