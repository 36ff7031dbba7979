"""Sets up PyBullet's window, for use with a display: shows the room from a corner, with the
names of locations and robots."""

from __future__ import annotations

from typing import Any, Mapping

import pybullet

from gspn_framework_package.model.robot_colours import colour_of
from gspn_framework_package.world.bodies import rgba
from gspn_framework_package.world.room import Room

YAW, PITCH = 28.0, -50.0
"""The viewing direction, in degrees."""

_LINE = (0.2, 0.35, 0.65)
_TEXT = (0.1, 0.1, 0.1)


def set_up_window(client: Any, room: Room, robots: Mapping[str, int]) -> None:
    """Make the window show the room and nothing else.

    :param client: the PyBullet connection, with a window.
    :param robots: the bodies of the robots by name, in the order of the team.
    """
    # hide the panes of camera pictures and parameters
    client.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0)
    bounds = room.bounds()
    middle = [(high + low) / 2 for low, high in zip(bounds.low, bounds.high)]
    across = max(high - low for low, high in zip(bounds.low, bounds.high))
    client.resetDebugVisualizerCamera(across * 0.9, YAW, PITCH, [*middle, 0.0])
    for name, place in room.locations.items():
        (west, south), (east, north) = place.area.low, place.area.high
        corners = [
            (west, south, 0.01),
            (east, south, 0.01),
            (east, north, 0.01),
            (west, north, 0.01),
        ]
        for start, end in zip(corners, corners[1:] + corners[:1]):
            client.addUserDebugLine(start, end, _LINE, lineWidth=2)
        client.addUserDebugText(
            name, [(west + east) / 2, (south + north) / 2, 0.02], _LINE, textSize=1.5
        )
    for name, body in robots.items():
        # the window shows all parts of a body in the colour of the first
        client.changeVisualShape(body, -1, rgbaColor=rgba(colour_of(name)))
        client.addUserDebugText(
            name, [0.0, 0.0, 0.25], _TEXT, textSize=1.2, parentObjectUniqueId=body
        )
