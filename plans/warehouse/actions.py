"""The warehouse without a world: actions that only take their time, and the sources of its events.

An order is a task with a pose. Where a robot is, it writes to its data (``robot.at``); the battery
is a sensor, which actions run down and the events ``low`` and ``low_on_the_way`` read.
"""

import math
import random
import time

SPEED = 4.0
"""Metres per second: these robots are in a hurry, so that a short run shows everything."""

STEP = 0.05
"""Seconds between two looks at whether the action was cancelled."""

RANGE = 40.0
"""Metres that a robot drives with a full battery."""

LOW = 0.3
"""A robot whose battery is below this goes to the charger."""

CHARGE_SECONDS = 2.0
"""Seconds that it takes to charge an empty battery."""

PARKING = (1.5, -2.4)
STATIONS = {"counter": (3.4, 0.0), "charger": (-1.0, -2.5)}
SHELVES = {
    "A1": (-2.4, 2.2),
    "A2": (0.0, 2.2),
    "A3": (2.4, 2.2),
    "B1": (-2.4, -0.1),
    "B2": (0.0, -0.1),
}

batteries = {}
"""Robot -> level of its battery, from 0 to 1."""


class Drive:
    """Drives to a goal.

    Each robot has its own instance, so an action that continues an interrupted visit has only the
    rest of its way before it.
    """

    def __init__(self):
        self.left = 0.0

    def drive(self, robot, data, goal, is_cancelled, resumed_from=0):
        """Drive; return the data of the robot that is there, or None if it was stopped."""
        if not resumed_from:
            x, y = data.get("robot.at", PARKING)
            self.left = math.hypot(goal[0] - x, goal[1] - y)
        while self.left > 0.0:
            if is_cancelled.wait(STEP):
                return None
            self.left -= SPEED * STEP
            batteries[robot] = max(batteries.get(robot, 1.0) - SPEED * STEP / RANGE, 0.0)
        return {"at": list(goal)}


class Fetch(Drive):
    """Drives to the pose of the robot's order, and takes what was ordered."""

    def __call__(self, robot, data, resumed_from, is_cancelled):
        """Drive; ``picked`` follows."""
        position = data["task.pose"]["position"]
        there = self.drive(robot, data, (position["x"], position["y"]), is_cancelled, resumed_from)
        return ("picked", there) if there else None


class Park(Drive):
    """Drives to the parking places."""

    def __call__(self, robot, data, is_cancelled):
        """Drive; ``parked`` follows."""
        there = self.drive(robot, data, PARKING, is_cancelled)
        return ("parked", there) if there else None


class Approach(Drive):
    """Drives to a station."""

    def __init__(self, station):
        super().__init__()
        self.goal = STATIONS[station]

    def __call__(self, robot, data, resumed_from, is_cancelled):
        """Drive; the place's only transition follows."""
        there = self.drive(robot, data, self.goal, is_cancelled, resumed_from)
        return ("", there) if there else None


def dock_in(is_cancelled):
    """Dock; the place's only transition follows."""
    is_cancelled.wait(0.2)


def hand_over(data, is_cancelled):
    """Hand over what was ordered, and count it; take it back if the order was cancelled."""
    if "task.id" not in data:
        return "taken_back"
    if is_cancelled.wait(0.3):
        return None
    return "delivered", {"handed_over": data.get("robot.handed_over", 0) + 1}


def charge(robot, is_cancelled):
    """Charge until the battery is full."""
    while batteries.get(robot, 1.0) < 1.0:
        if is_cancelled.wait(STEP):
            return None
        batteries[robot] = batteries.get(robot, 1.0) + STEP / CHARGE_SECONDS
    return "charged"


# -- events ------------------------------------------------------------------------------------


class Customers:
    """Order something now and then: called every half second, it returns an order or nothing."""

    def __init__(self):
        self.orders = 0

    def __call__(self):
        """Return a new order, or nothing."""
        if random.random() > 0.35:
            return None
        self.orders += 1
        shelf = random.choice(sorted(SHELVES))
        return {"id": "order_%d" % self.orders, "shelf": shelf, "pose": pose(*SHELVES[shelf])}


def pose(x, y):
    """Return a pose as ROS writes it (geometry_msgs/Pose)."""
    return {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}


def person():
    """Return whether somebody walks between the shelves: two seconds out of ten."""
    return time.monotonic() % 10 < 2


def nobody():
    """Return whether nobody walks there."""
    return not person()


def battery(robot):
    """Return whether the battery is low, and if so, how low it is."""
    level = batteries.get(robot, 1.0)
    return {"level": round(level, 2)} if level < LOW else False
