"""The patrol's actions on a ROS robot, which plans/patrol runs in its action places.

They only use ``move_base``, ``amcl_pose`` and ``temperature`` in the robot's namespace, and so work
with simulated and real robots. They wait for messages from the robot, and in ROS time
(``use_sim_time``).

Parameters, searched upwards from the node: ``room`` (the room file), ``patrol/threshold`` (degrees
Celsius above which a location is too hot, 30), ``patrol/alarm_seconds`` (5),
``patrol/wait_seconds`` (4).
"""

from __future__ import annotations

import threading
from typing import Any, Dict, Optional, Tuple

import rospy

from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.ros.options import launched_file
from gspn_framework_package.world import patrol
from gspn_framework_package.world.base_client import (
    BaseClient,
    Feedback,
    IsCancelled,
    carry_out,
    client_of,
)
from gspn_framework_package.world.room import Room
from gspn_framework_package.world.room_file import load_room

_lock = threading.Lock()
_rooms: Dict[str, Room] = {}


def check_temperature(
    place: str, robot: str, feedback: Feedback, is_cancelled: IsCancelled
) -> Optional[str]:
    """Sweep the place's location, and request its ``Temperature_High`` or ``Temperature_Low``."""
    number, location = _read(place)
    client, room = _connect(robot, location)
    threshold = float(_parameter("patrol/threshold", 30.0))
    high, low = patrol.temperature_transitions(number, location)
    steps = patrol.measure_temperature(client, room, location, threshold, high, low)
    return carry_out(steps, client, place, feedback, is_cancelled)


def alarm(place: str, robot: str, feedback: Feedback, is_cancelled: IsCancelled) -> Optional[str]:
    """Stand in the location and sound the alarm; the place's only transition follows."""
    _, location = _read(place)
    client, _ = _connect(robot, location)
    seconds = float(_parameter("patrol/alarm_seconds", 5.0))
    steps = patrol.sound_alarm(client, location, seconds)
    return carry_out(steps, client, place, feedback, is_cancelled)


def decide(place: str, robot: str, feedback: Feedback, is_cancelled: IsCancelled) -> Optional[str]:
    """Do nothing: the policy decides."""
    _read(place)
    return None


def wait(place: str, robot: str, feedback: Feedback, is_cancelled: IsCancelled) -> Optional[str]:
    """Wait in a free slot of the bay after the location; the place's only transition follows."""
    _, location = _read(place)
    client, room = _connect(robot, location)
    seconds = float(_parameter("patrol/wait_seconds", 4.0))
    steps = patrol.wait_in_bay(client, room, location, seconds, patrol.preferred_slot(robot))
    return carry_out(steps, client, place, feedback, is_cancelled)


def _read(place: str) -> Tuple[int, str]:
    """The number and the location in the name of a place.

    :raises ActionFailed: the place does not belong to the patrol.
    """
    match = patrol.PATROL_PLACE.match(place)
    if match is None:
        raise ActionFailed(
            "'%s' is not a place of the patrol, such as p1:Check_Temperature_L1" % place
        )
    return int(match.group(1)), match.group("location")


def _parameter(name: str, default: Any) -> Any:
    found = rospy.search_param(name)
    return default if found is None else rospy.get_param(found, default)


def _connect(robot: str, location: str) -> Tuple[BaseClient, Room]:
    """The robot and the room, created once per process.

    :param location: a location that the room must have.
    :raises ActionFailed: no room is published, it cannot be read, it lacks the location, or the
      robot is not available.
    """
    file = _parameter("room", "")
    if not file:
        raise ActionFailed("no parameter 'room', which names the room file with the locations")
    with _lock:
        if file not in _rooms:
            try:
                _rooms[file] = load_room(launched_file(str(file), "parameter room"))
            except GspnError as error:
                raise ActionFailed(str(error)) from None
        room = _rooms[file]
    client = client_of(robot)
    if location not in room.locations:
        known = ", ".join(room.locations) or "none"
        raise ActionFailed(
            "the room '%s' has no location '%s'; its locations: %s" % (file, location, known)
        )
    client.connect()
    return client, room
