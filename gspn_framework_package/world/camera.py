"""Pictures of the world without a display, from PyBullet's own renderer; films of them."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import numpy as np
import pybullet

from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.world.physics import Physics

View = Tuple[float, float]
"""Where the camera looks from: yaw and pitch in degrees; pitch -90 is from straight above."""

VIEWS: Dict[str, View] = {"top": (0.0, -89.9), "corner": (35.0, -52.0)}
"""The views with a name."""


class Camera:
    """Takes pictures of a world.

    :param physics: the world.
    :param width: pixels.
    :param height: pixels.
    :param view: a key of :data:`VIEWS`.
    """

    def __init__(
        self, physics: Physics, width: int = 800, height: int = 600, view: str = "corner"
    ) -> None:
        bounds = physics.room.bounds()
        self._physics = physics
        self._size = (width, height)
        yaw, pitch = VIEWS[view]
        middle = [(high + low) / 2 for low, high in zip(bounds.low, bounds.high)]
        across = max(high - low for low, high in zip(bounds.low, bounds.high)) + 0.3
        field_of_view = 40.0
        # so far away that the longer side of the room fits into the picture
        distance = across / 2 / math.tan(math.radians(field_of_view / 2))
        distance *= 1.0 if pitch < -80 else 1.12
        self._view = pybullet.computeViewMatrixFromYawPitchRoll(
            [middle[0], middle[1], 0.0], distance, yaw, pitch, 0, 2
        )
        self._projection = pybullet.computeProjectionMatrixFOV(
            field_of_view, width / height, 0.5, 4 * distance
        )

    def picture(self) -> np.ndarray:
        """The world now; shape (height, width, 3), red, green and blue from 0 to 255."""
        width, height = self._size
        image = self._physics.client.getCameraImage(
            width,
            height,
            self._view,
            self._projection,
            lightDirection=[3, -2, 6],
            lightColor=[1, 1, 1],
            lightAmbientCoeff=0.62,
            lightDiffuseCoeff=0.42,
            lightSpecularCoeff=0.05,
            shadow=1,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
        )
        return np.reshape(np.asarray(image[2], dtype=np.uint8), (height, width, 4))[:, :, :3]
