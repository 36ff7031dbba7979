"""Pictures of the world without a display, by PyBullet's software renderer."""

from __future__ import annotations

import math
import os
from collections import deque
from typing import Any, Deque, Dict, Optional, Tuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gspn_framework_package.model.net import Point
from gspn_framework_package.model.robot_colours import colour_of
from gspn_framework_package.world.bodies import rgba
from gspn_framework_package.world.physics import Physics

VIEWS: Dict[str, Tuple[float, float]] = {"corner": (28.0, -50.0), "top": (0.0, -89.9)}
"""Views by name: yaw and pitch of the camera in degrees; pitch -90 looks straight down."""

FIELD_OF_VIEW = 36.0
"""Vertical field of view, in degrees."""

TRAIL = 150
"""Length of a robot's trail, in pictures."""

_AREA_COLOR = "#b7cbe4"
_SLOT_COLOR = "#c5c9d2"
_HEAT_COLOR = "#f7a491"
_SKY = (245, 247, 250)


class Camera:
    """Takes pictures of a world: its bodies, with the locations, the waiting bays and the heat
    painted on the floor.

    :param physics: the world.
    :param width: width of the pictures in pixels.
    :param height: height of the pictures in pixels.
    :param view: a key of :data:`VIEWS`.
    """

    def __init__(
        self, physics: Physics, width: int = 960, height: int = 720, view: str = "corner"
    ) -> None:
        self._physics = physics
        self._size = (width, height)
        bounds = physics.room.bounds()
        yaw, pitch = VIEWS[view]
        middle = [(high + low) / 2 for low, high in zip(bounds.low, bounds.high)]
        across = (
            max(high - low for low, high in zip(bounds.low, bounds.high))
            + 2 * physics.room.wall_thickness
        )
        distance = (
            across / 2 / math.tan(math.radians(FIELD_OF_VIEW / 2)) * (1.04 if pitch < -80 else 1.3)
        )
        target = [middle[0], middle[1], 0.0]
        self._view = self._physics.client.computeViewMatrixFromYawPitchRoll(
            target, distance, yaw, pitch, 0, 2
        )
        far = 3 * distance
        self._projection = self._physics.client.computeProjectionMatrixFOV(
            FIELD_OF_VIEW, width / height, 0.5, far
        )
        # both are stored in column-major order
        self._matrix = np.reshape(self._projection, (4, 4)).T @ np.reshape(self._view, (4, 4)).T
        self._font = scalable_font(max(12, height // 42))
        self._trails: Dict[str, Deque[Point]] = {
            name: deque(maxlen=TRAIL) for name in physics.robots
        }
        self._heat = [
            self._disc(spot.radius, _HEAT_COLOR) for spot in physics.room.temperature.hot_spots
        ]
        self._paint_floor()

    def _paint_floor(self) -> None:
        room, client = self._physics.room, self._physics.client
        for place in room.locations.values():
            half = [(high - low) / 2 for low, high in zip(place.area.low, place.area.high)]
            middle = [(high + low) / 2 for low, high in zip(place.area.low, place.area.high)]
            look = client.createVisualShape(
                self._physics.client.GEOM_BOX,
                halfExtents=[half[0], half[1], 0.001],
                rgbaColor=rgba(_AREA_COLOR),
                specularColor=[0, 0, 0],
            )
            client.createMultiBody(0, -1, look, [middle[0], middle[1], 0.001])
            for slot in place.bay:
                body = self._disc(room.robot.radius, _SLOT_COLOR)
                client.resetBasePositionAndOrientation(body, [slot.x, slot.y, 0.002], [0, 0, 0, 1])

    def _disc(self, radius: float, color: str) -> int:
        """Create a flat disc, hidden below the floor until it is placed; return its id."""
        client = self._physics.client
        corners = [math.tau * i / 40 for i in range(40)]
        rim = [[radius * math.cos(a), radius * math.sin(a), 0.0] for a in corners]
        triangles = [index for i in range(40) for index in (0, 1 + i, 1 + (i + 1) % 40)]
        look = client.createVisualShape(
            self._physics.client.GEOM_MESH,
            vertices=[[0.0, 0.0, 0.0], *rim],
            indices=triangles,
            normals=[[0.0, 0.0, 1.0]] * 41,
            uvs=[[0.0, 0.0]] * 41,
            rgbaColor=rgba(color),
            specularColor=[0, 0, 0],
        )
        return int(client.createMultiBody(0, -1, look, [0, 0, -1]))

    def _place_heat(self, time: float) -> None:
        for body, spot in zip(self._heat, self._physics.room.temperature.hot_spots):
            x, y = spot.at(time)
            height = 0.004 if spot.burns(time) else -1.0
            self._physics.client.resetBasePositionAndOrientation(body, [x, y, height], [0, 0, 0, 1])

    def pixel(self, x: float, y: float, z: float = 0.0) -> Tuple[float, float]:
        """The pixel coordinates of a point of the world."""
        clip = self._matrix @ np.array([x, y, z, 1.0])
        width, height = self._size
        return ((clip[0] / clip[3] + 1) / 2 * width, (1 - clip[1] / clip[3]) / 2 * height)

    def picture(self, time: float, caption: str = "") -> Image.Image:
        """Take a picture of the current world.

        :param time: seconds, for the heat and the clock in the picture.
        :param caption: a line of text in the lower left corner.
        """
        self._place_heat(time)
        width, height = self._size
        taken = self._physics.client.getCameraImage(
            width,
            height,
            self._view,
            self._projection,
            lightDirection=[2, -3, 7],
            lightColor=[1, 1, 1],
            lightAmbientCoeff=0.6,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=self._physics.client.ER_TINY_RENDERER,
        )
        pixels = np.reshape(np.asarray(taken[2], dtype=np.uint8), (height, width, 4))[
            :, :, :3
        ].copy()
        pixels[np.reshape(np.asarray(taken[4]), (height, width)) < 0] = _SKY
        image = Image.fromarray(pixels)
        self._write(ImageDraw.Draw(image, "RGBA"), time, caption)
        return image

    def _write(self, draw: Any, time: float, caption: str) -> None:
        room, height = self._physics.room, self._size[1]
        for name, place in room.locations.items():
            low, high = place.area.low, place.area.high
            x, y = self.pixel((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
            self._text(draw, (x, y), name, (70, 95, 130, 190))
        for name in self._physics.robots:
            pose = self._physics.pose(name)
            trail = self._trails[name]
            trail.append((pose.x, pose.y))
            color = tuple(int(255 * part) for part in rgba(colour_of(name))[:3])
            points = [self.pixel(*point, 0.003) for point in trail]
            for age, (start, end) in enumerate(zip(points, points[1:])):
                draw.line([start, end], fill=(*color, 40 + 150 * age // TRAIL), width=3)
            x, y = self.pixel(pose.x, pose.y, 0.15)
            at, number = (x, y - height / 28), name.rpartition("_")[2]
            self._text(draw, at, number, (*color, 255), back=(255, 255, 255, 210))
        line = "%d:%04.1f" % (int(time // 60), time % 60) + ("   " + caption if caption else "")
        draw.text((12, height - 14), line, (40, 45, 55), self._font, "ls")

    def _text(
        self,
        draw: Any,
        middle: Tuple[float, float],
        text: str,
        color: Tuple[int, ...],
        back: Optional[Tuple[int, ...]] = None,
    ) -> None:
        left, top, right, bottom = draw.textbbox(middle, text, self._font, "mm")
        if back is not None:
            draw.rounded_rectangle((left - 4, top - 3, right + 4, bottom + 3), 5, fill=back)
        draw.text(middle, text, color, self._font, "mm")


def scalable_font(size: int) -> Any:
    """A scalable font if Matplotlib provides one, otherwise Pillow's default."""
    try:
        import matplotlib

        return ImageFont.truetype(
            os.path.join(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans-Bold.ttf"), size
        )
    except (ImportError, OSError):
        return ImageFont.load_default()
