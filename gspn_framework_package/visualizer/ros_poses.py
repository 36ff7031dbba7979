"""Where real robots are, for the page: from their localisation, or else their odometry, and the map
that they share. In a simulated world the world itself says so (``/world/state``)."""

from __future__ import annotations

import math
import threading
import time
from typing import Any, Callable, Collection, Dict, List, Mapping, Tuple, Type

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry

from gspn_framework_package.model.goal_pose import yaw_of

POSES_PERIOD = 1 / 15
"""Seconds between two reports of all poses; the page draws what lies between."""

WIDEST_MAP = 400
"""Largest number of cells of the drawn map on a side; a finer map is reduced."""

_OCCUPIED, _FREE, _UNKNOWN = 2, 1, 0

_SOURCES: Tuple[Tuple[str, Type[Any]], ...] = (
    ("/amcl_pose", PoseWithCovarianceStamped),
    ("/odom", Odometry),
)
"""The topics of a robot's pose, the best one first, in the robot's namespace."""

Subscribe = Callable[[str, Type[Any], Callable[[Any], None]], None]
Tell = Callable[[str, Any], None]


class RosPoses:
    """Subscribes to the poses of robots and to their map.

    :param subscribe: subscribes to a topic.
    :param tell: takes ``"poses"`` with namespace -> (x, y, yaw, topic), in metres and radians, and
        ``"map"`` with the object that :func:`map_to_json` makes.
    """

    def __init__(self, subscribe: Subscribe, tell: Tell) -> None:
        self._subscribe, self._tell = subscribe, tell
        self._lock = threading.Lock()
        self._topics: Dict[str, int] = {}
        self._has_map = False
        self._poses: Dict[str, Tuple[float, float, float, str]] = {}
        self._told: Mapping[str, Any] = {}
        self._told_at = 0.0

    def find(self, published: Mapping[str, str], namespaces: Collection[str]) -> None:
        """Listen to what is published, and tell the latest poses.

        :param published: topic -> type.
        :param namespaces: those of the robots of the team.
        """
        if "/world/state" in published:
            return
        if not self._has_map and published.get("/map") == OccupancyGrid._type:
            self._has_map = True
            self._subscribe("/map", OccupancyGrid, self._on_map)
        for namespace in namespaces:
            for rank, (topic, kind) in enumerate(_SOURCES):
                if rank >= self._topics.get(namespace, len(_SOURCES)):
                    break
                if published.get(namespace + topic) == kind._type:
                    self._topics[namespace] = rank
                    self._subscribe(namespace + topic, kind, self._taker(namespace, rank))
                    break
        self._tell_poses(0.0)

    def _taker(self, namespace: str, rank: int) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            if self._topics[namespace] == rank:  # not after a better topic was found
                pose = message.pose.pose
                at = pose.position
                if all(map(math.isfinite, (at.x, at.y))):
                    q = pose.orientation
                    turned = yaw_of(q.x, q.y, q.z, q.w)
                    where = round(at.x, 3), round(at.y, 3), round(turned, 3), _SOURCES[rank][0][1:]
                    with self._lock:
                        self._poses[namespace] = where
                    self._tell_poses(POSES_PERIOD)

        return take

    def _tell_poses(self, period: float) -> None:
        """Tell the poses if they have changed, and were last told ``period`` seconds ago."""
        now = time.monotonic()
        with self._lock:
            if self._poses == self._told or now - self._told_at < period:
                return
            self._told, self._told_at = dict(self._poses), now
            told = self._told
        self._tell("poses", told)

    def _on_map(self, message: Any) -> None:
        self._tell("map", map_to_json(message))


def map_to_json(grid: Any) -> Dict[str, Any]:
    """A map as a room of the page: its ``bounds`` in metres, and ``grid`` with ``width``,
    ``height`` and ``runs``: values and how often each repeats, row by row from the bottom. 2 is
    occupied, 1 free, 0 unknown. A map that is turned is shown as if it was not.

    :param grid: a ``nav_msgs/OccupancyGrid``.
    """
    width, height, size = grid.info.width, grid.info.height, grid.info.resolution
    cells = np.asarray(grid.data, np.int8).reshape(height, width)
    kinds = np.where(cells < 0, _UNKNOWN, np.where(cells >= 50, _OCCUPIED, _FREE)).astype(np.uint8)
    step = max(1, math.ceil(max(width, height) / WIDEST_MAP))
    if step > 1:  # a wall stays a wall
        rows, columns = -(-height // step), -(-width // step)
        padded = np.zeros((rows * step, columns * step), np.uint8)
        padded[:height, :width] = kinds
        kinds = padded.reshape(rows, step, columns, step).max(axis=(1, 3))
    flat = kinds.ravel()
    starts = [0, *(np.flatnonzero(flat[1:] != flat[:-1]) + 1)] if flat.size else []
    lengths = np.diff([*starts, flat.size])
    runs: List[int] = [int(v) for start, n in zip(starts, lengths) for v in (flat[start], n)]
    left, low = grid.info.origin.position.x, grid.info.origin.position.y
    across, up = kinds.shape[1] * step * size, kinds.shape[0] * step * size
    return {
        "bounds": [[left, low], [left + across, low + up]],
        "grid": {"width": kinds.shape[1], "height": kinds.shape[0], "runs": runs},
    }
