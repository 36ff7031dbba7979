"""Reads maps of map_server: a YAML file and an image, whose dark cells are walls."""

from __future__ import annotations

import math
import os
from typing import Any, Dict, List

import numpy as np
from PIL import Image

from gspn_framework_package.formats.source import open_file
from gspn_framework_package.formats.yaml_file import YamlDocument, is_finite_number, read_yaml
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.grid import merged_boxes
from gspn_framework_package.world.room import ROBOT_TYPES, Box
from gspn_framework_package.world.room_check import LARGEST_FLOOR

_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")
_REQUIRED = _KEYS[:3]


def read_occupancy_map(file: str) -> List[Box]:
    """The walls of a map as boxes. Unknown cells are empty, as free ones are.

    :raises InputError: it is not a map, its image cannot be read, or it has no wall.
    """
    document = read_yaml(file)
    data = _checked(document)
    occupied = _occupied(document, data)
    rows, columns = np.nonzero(occupied)
    resolution = float(data["resolution"])
    if len(rows) == 0:
        raise document.error("no cell of the image is occupied", ["image"])
    size = [resolution * (int(np.ptp(cells)) + 1) for cells in (columns, rows)]
    if size[0] * size[1] > LARGEST_FLOOR:
        raise document.error(
            "with cells of %g m the map is %.0f m x %.0f m" % (resolution, *size),
            ["resolution"],
            "up to %.0f square metres can be simulated" % LARGEST_FLOOR,
        )
    narrowest = 2 * min(kind.radius for kind in ROBOT_TYPES.values())
    if min(size) < narrowest:
        raise document.error(
            "with cells of %g m the map is %.2g m x %.2g m" % (resolution, *size),
            ["resolution"],
            "no robot fits into that",
        )
    x, y, yaw = (float(value) for value in data["origin"])
    cos, sin = math.cos(yaw), math.sin(yaw)
    return [
        Box(
            at=(x + box.at[0] * cos - box.at[1] * sin, y + box.at[0] * sin + box.at[1] * cos),
            size=box.size,
            yaw=yaw,
            height=box.height,
        )
        for box in merged_boxes(occupied, resolution, (0.0, 0.0))
    ]


def _checked(document: YamlDocument) -> Dict[str, Any]:
    data = document.data
    if not isinstance(data, dict) or "image" not in data:
        raise InputError(
            "it is not a map of map_server",
            file=document.file,
            hint="the map's YAML file has the key 'image'",
        )
    for key in _REQUIRED:
        if key not in data:
            raise InputError("the key '%s' is missing" % key, file=document.file)
    for key in data:
        if key not in _KEYS:
            raise document.error("there is no key '%s' in a map" % key, [key])
    if not isinstance(data["image"], str) or not data["image"]:
        raise document.error("it is not the name of a file", ["image"])
    if not is_finite_number(data["resolution"]) or not data["resolution"] > 0.0:
        raise document.error(
            "%r is not a resolution: metres per cell, more than 0" % (data["resolution"],),
            ["resolution"],
        )
    origin = data["origin"]
    if not isinstance(origin, list) or len(origin) != 3 or not all(map(is_finite_number, origin)):
        raise document.error("it is not a pose [x, y, yaw]", ["origin"])
    for key in ("occupied_thresh", "free_thresh"):
        if key in data and (not is_finite_number(data[key]) or not 0.0 <= data[key] <= 1.0):
            raise document.error("%r is not a number from 0 to 1" % (data[key],), [key])
    if data.get("negate", 0) not in (0, 1):
        raise document.error("%r is neither 0 nor 1" % (data["negate"],), ["negate"])
    if data.get("mode", "trinary") not in ("trinary", "scale"):
        raise document.error(
            "the mode %r is not read" % (data["mode"],), ["mode"], "trinary and scale are"
        )
    return data


def _occupied(document: YamlDocument, data: Dict[str, Any]) -> np.ndarray:
    """The occupied cells, in an array of bool with a row for each y, the southernmost first."""
    name = os.path.join(os.path.dirname(document.file or ""), data["image"])
    try:
        with open_file(name) as file, Image.open(file) as image:
            light = np.asarray(image.convert("L"), dtype=float)
    except Image.UnidentifiedImageError:
        raise document.error("%s is not an image" % name, ["image"]) from None
    except Image.DecompressionBombError:
        raise document.error("%s is too large an image" % name, ["image"]) from None
    except (OSError, ValueError, SyntaxError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise document.error("cannot read %s: %s" % (name, reason), ["image"]) from None
    dark = light / 255.0 if data.get("negate", 0) else 1.0 - light / 255.0
    occupied: np.ndarray = dark[::-1] > data.get("occupied_thresh", 0.65)
    return occupied
