"""Faults to order in a simulated room: a wheel slips, a scanner drops out, a robot is blocked or
carried away, a door closes, a person comes, messages between robots are late.

They come from the room file, at their times, and from ``/world/fault``. ``docs/world.md`` describes
them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Mapping, Sequence, Tuple

from gspn_framework_package.formats.yaml_file import is_finite_number
from gspn_framework_package.world.room import Obstacle, Pose, Room, RoomFault

if TYPE_CHECKING:
    from gspn_framework_package.world.people import Walker
    from gspn_framework_package.world.physics import Physics

FAULT_KINDS: Mapping[str, Tuple[Tuple[str, ...], Tuple[str, ...]]] = {
    "slip": (("robot",), ("wheel", "grip", "lasts")),
    "lidar": (("robot",), ("lasts",)),
    "blocked": (("robot",), ("lasts",)),
    "carried": (("robot", "to"), ()),
    "door": (("door",), ("lasts",)),
    "person": (("person",), ()),
    "network": (("delay",), ("robot", "lasts")),
}
"""Kind of fault -> the keys that it needs, and those that it may have."""

WHEELS: Mapping[str, Tuple[int, ...]] = {"left": (0,), "right": (1,), "both": (0, 1)}
"""Name -> numbers of the wheels."""

_DOOR_GAP = 0.02  # metres between a door and a robot beside which it closes


def read_fault(data: Any) -> RoomFault:
    """The fault that a mapping describes: ``{"fault": "lidar", "robot": "robot_1", "lasts": 5}``.

    :raises ValueError: it describes none.
    """
    kind = data.get("fault") if isinstance(data, Mapping) else None
    if not isinstance(kind, str) or kind not in FAULT_KINDS:
        raise ValueError("'fault' is not one of %s" % ", ".join(FAULT_KINDS))
    needed, possible = FAULT_KINDS[kind]
    for key in needed:
        if key not in data:
            raise ValueError("the fault '%s' needs '%s'" % (kind, key))
    for key in data:
        if key not in ("fault", "time", *needed, *possible):
            raise ValueError("the fault '%s' has no '%s'" % (kind, key))
    numbers = {"time": 0.0, "lasts": math.inf, "grip": 0.0, "person": 0, "delay": 0.0}
    for key in numbers:
        value = data.get(key, numbers[key])
        is_number = is_finite_number(value) or (
            value == math.inf and key not in ("person", "delay")
        )
        if not is_number or value < 0.0:
            raise ValueError("'%s' is not a number of at least 0: %r" % (key, value))
        numbers[key] = value
    if data.get("wheel", "both") not in tuple(WHEELS):
        raise ValueError("'wheel' is not one of %s" % ", ".join(WHEELS))
    to = data.get("to", [0.0, 0.0])
    if (
        not isinstance(to, (list, tuple))
        or not 2 <= len(to) <= 3
        or not all(map(is_finite_number, to))
    ):
        raise ValueError("'to' is not a pose [x, y, yaw]")
    return RoomFault(
        kind,
        time=float(numbers["time"]),
        robot=str(data.get("robot", "")),
        wheel=data.get("wheel", "both"),
        grip=float(numbers["grip"]),
        lasts=float(numbers["lasts"]),
        to=Pose(*(float(value) for value in to)),
        door=str(data.get("door", "")),
        person=int(numbers["person"]),
        delay=float(numbers["delay"]),
    )


def check_fault(fault: RoomFault, room: Room) -> None:
    """Check the door or person of a fault. :raises ValueError: the room has none of that name."""
    if fault.kind == "door" and fault.door not in room.doors:
        raise ValueError("there is no door '%s'" % fault.door)
    if fault.kind == "person" and fault.person >= len(room.people):
        raise ValueError("there is no person %d" % fault.person)


class Faults:
    """The faults of a team; at first, those of the room file.

    :param physics: the robots, and the room.
    :param close_doors: closes the doors of these names, and opens all others.
    :param models: returns the solids that were put into the room while it runs.

    :ivar refused: why the last fault that could not happen did not; empty if there is none.
    """

    def __init__(
        self,
        physics: Physics,
        close_doors: Callable[[Sequence[str]], None],
        models: Callable[[], Sequence[Obstacle]] = tuple,
    ) -> None:
        self._physics = physics
        self._room = physics.room
        self._close_doors = close_doors
        self._models = models
        self._coming: List[RoomFault] = list(self._room.faults)
        self._active: Dict[Tuple[str, str], Tuple[RoomFault, float]] = {}
        self._closed: Tuple[str, ...] = ()
        self.refused = ""

    def order(self, fault: RoomFault) -> None:
        """Schedule a fault; if its time is past, it happens at once.

        :raises ValueError: there is no such robot, door or person.
        """
        check_fault(fault, self._room)
        names_one = fault.robot or "robot" in FAULT_KINDS[fault.kind][0]
        if names_one and fault.robot not in self._physics.robots:
            raise ValueError("there is no robot '%s'" % fault.robot)
        self._coming.append(fault)

    def reset(self, time: bool) -> None:
        """End all faults.

        :param time: those of the room file happen again.
        """
        for key in list(self._active):
            self._end(key)
        self._move_doors(())
        if time:
            self._coming = list(self._room.faults)

    def step(self, people: Sequence[Walker]) -> List[str]:
        """Start and end the faults whose time has come; return the robots that were carried away.

        :param people: the people of the room, whether they are there or not.
        """
        time = self._physics.time
        carried: List[str] = []
        for fault in [fault for fault in self._coming if fault.time <= time]:
            self._coming.remove(fault)
            if fault.kind == "person":
                people[fault.person].come(time)
            elif fault.kind == "carried":
                try:
                    self.carry(fault.robot, fault.to)
                    carried.append(fault.robot)
                except ValueError as error:
                    self.refused = str(error)
            else:
                self._start(fault, time)
        for key in [key for key, (_, end) in self._active.items() if end <= time]:
            self._end(key)
        self._move_doors(people)
        return carried

    def has(self, kind: str, robot: str) -> bool:
        """Whether a robot has a fault now."""
        return (kind, robot) in self._active

    def report(self) -> Dict[str, Any]:
        """What happens now, and why a fault was refused, ready for JSON."""
        return {
            "active": [
                {
                    "fault": fault.kind,
                    "of": name,
                    "until": None if math.isinf(end) else round(end, 3),
                    **({"delay": fault.delay} if fault.kind == "network" else {}),
                }
                for (_, name), (fault, end) in sorted(self._active.items())
            ],
            "closed": list(self._closed),
            "refused": self.refused,
        }

    def _start(self, fault: RoomFault, time: float) -> None:
        key = (fault.kind, fault.robot or fault.door)
        self._end(key)
        self._active[key] = (fault, time + fault.lasts)
        if fault.kind == "slip":
            for wheel in WHEELS[fault.wheel]:
                self._physics.grip(fault.robot, wheel, fault.grip)

    def _end(self, key: Tuple[str, str]) -> None:
        fault, _ = self._active.pop(key, (None, 0.0))
        if fault is not None and fault.kind == "slip":
            for wheel in WHEELS["both"]:
                self._physics.grip(fault.robot, wheel, 1.0)

    def carry(self, robot: str, to: Pose) -> None:
        """Carry a robot away. :raises ValueError: there is no room for it."""
        x, y = to.x, to.y
        solids = [*(self._room.doors[name] for name in self._closed), *self._models()]
        near = [float(solid.distance(x, y)) for solid in solids]
        poses = [self._physics.pose(name) for name in self._physics.robots if name != robot]
        radius = self._room.robot.radius
        if min([float(self._room.clearance(x, y)), *near]) < radius:
            raise ValueError("%s does not fit at %g, %g" % (robot, x, y))
        if any(to.distance(pose) < 2 * radius for pose in poses):
            raise ValueError("a robot is at %g, %g" % (x, y))
        self._physics.carry(robot, to)

    def _move_doors(self, people: Sequence[Walker]) -> None:
        """Open the doors that must be open; close the others as soon as nobody stands there."""
        closed = tuple(
            name
            for name in self._room.doors
            if ("door", name) in self._active
            and (name in self._closed or self._is_free(name, people))
        )
        if closed != self._closed:
            self._closed = closed
            self._close_doors(closed)

    def _is_free(self, name: str, people: Sequence[Walker]) -> bool:
        door = self._room.doors[name]
        gap = self._room.robot.radius + _DOOR_GAP
        poses = [self._physics.pose(robot) for robot in self._physics.robots]
        return all(float(door.distance(pose.x, pose.y)) > gap for pose in poses) and all(
            float(door.distance(*walker.at)) > walker.person.radius
            for walker in people
            if walker.at is not None
        )
