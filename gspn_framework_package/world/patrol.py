"""The actions of the patrol (thesis 6.2) on a robot: drive, look, measure, wait.

Each action is a generator: it yields feedback, one line at a time, while it runs, and returns the
name of a transition, or None if the policy decides. It only needs a :class:`Robot`: a base that
drives to poses (``move_base``), a thermometer, and the poses of the others. The same actions
therefore run on simulated and on real robots, and without ROS in tests and benchmarks.
"""

from __future__ import annotations

import re
import zlib
from typing import Dict, Generator, Optional, Protocol, Sequence, Tuple

from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.world.room import Location, Pose, Room

ActionSteps = Generator[str, None, Optional[str]]
"""Yields feedback; returns a transition or None."""


class Robot(Protocol):
    """The interface that the actions need from a robot."""

    name: str

    def now(self) -> float:
        """The time in seconds."""

    def pose(self) -> Pose:
        """The pose of the robot."""

    def others(self) -> Dict[str, Pose]:
        """The last known poses of the other robots, by name."""

    def temperature(self) -> float:
        """The reading of its thermometer, in degrees Celsius."""

    def go(self, goal: Pose) -> None:
        """Start driving to a pose, which replaces the previous goal."""

    def arrived(self) -> Optional[bool]:
        """None while driving; afterwards whether the last goal was reached."""

    def trouble(self) -> str:
        """Why the last goal was not reached."""

    def stop(self) -> None:
        """Drop the goal."""


PATROL_PLACE = re.compile(
    r"^p(\d+):(?P<what>Check_Temperature|Alarm|Decide|Wait)_(?P<location>\w+)$"
)
"""The names of the patrol's action places (thesis 6.2.2)."""


def temperature_transitions(number: int, location: str) -> Tuple[str, str]:
    """The transitions that a check names if the location was too hot, and if it was not.

    The net has four numbered places and six numbered transitions per location (thesis 6.2.2): p1 to
    p4 and t1 to t6, p5 to p8 and t7 to t12, ...

    :param number: the number of the place.
    """
    first = (number - 1) // 4 * 6 + 1
    high = "t%d:Temperature_High_%s" % (first, location)
    return high, "t%d:Temperature_Low_%s" % (first + 2, location)


def occupant(location: Location, robots: Dict[str, Pose], radius: float) -> Optional[str]:
    """The robot that is in the location, even if only with its edge; the first by name, None if
    there is none."""
    inside = (
        name
        for name, pose in sorted(robots.items())
        if location.area.distance((pose.x, pose.y)) < radius
    )
    return next(inside, None)


def drive(robot: Robot, goal: Pose, tries: int = 3) -> Generator[str, None, None]:
    """Drive to a pose, and try again if the base gives up.

    :raises ActionFailed: the base gave up ``tries`` times.
    """
    for attempt in range(tries):
        robot.go(goal)
        while robot.arrived() is None:
            yield "driving, %.1f m to go" % robot.pose().distance(goal)
        if robot.arrived():
            return
        yield "try %d of %d failed: %s" % (attempt + 1, tries, robot.trouble())
    raise ActionFailed("cannot reach (%.2f, %.2f): %s" % (goal.x, goal.y, robot.trouble()))


def measure_temperature(
    robot: Robot, room: Room, location: str, threshold: float, high: str, low: str
) -> ActionSteps:
    """Sweep a location and read the thermometer.

    The robot waits at the entry until no other robot is in the location according to the poses: a
    robot that is leaving, or that was lost there, still occupies it.

    :param threshold: temperature above which it is too hot, in degrees Celsius.
    :param high: the transition to request if it was too hot at any point.
    :param low: the transition to request otherwise.
    :raises ActionFailed: a point cannot be reached.
    """
    place = room.locations[location]
    radius = room.robot.radius
    who = occupant(place, robot.others(), radius)
    if who is not None:
        # if a lost robot blocks the entry, any position outside will do
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


def sound_alarm(robot: Robot, location: str, seconds: float) -> ActionSteps:
    """Stand in the location and sound the alarm for ``seconds``."""
    start = robot.now()
    while robot.now() - start < seconds:
        yield "ALARM in %s: %.1f degrees" % (location, robot.temperature())
    return None


def wait_in_bay(
    robot: Robot, room: Room, location: str, seconds: float, first_slot: int = 0
) -> ActionSteps:
    """Drive to a free slot of the bay after a location and wait there for ``seconds``.

    :param first_slot: the preferred slot, different for different robots.
    :raises ActionFailed: no slot can be reached.
    """
    bay = room.locations[location].bay
    yield from park(robot, bay, first_slot, room.robot.radius)
    start = robot.now()
    while robot.now() - start < seconds:
        yield "waiting after %s" % location
    return None


def preferred_slot(robot: str) -> int:
    """The slot of a bay that a robot tries first: always the same for one name, and usually a
    different one for each robot."""
    number = re.search(r"(\d{1,6})$", robot)
    return int(number.group(1)) if number is not None else zlib.crc32(robot.encode())


def park(
    robot: Robot, bay: Sequence[Pose], first: int, radius: float
) -> Generator[str, None, None]:
    """Drive to a free slot of a bay, unless the robot stands in one already.

    :param first: the slot that it tries first.
    :param radius: radius of a robot, in metres.
    :raises ActionFailed: no slot can be reached.
    """
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
        # the base gave up, or another robot got there first
        trouble = robot.trouble() or "every slot is taken"
    raise ActionFailed(trouble)
