"""Where real robots are, for the page: from their localisation, or else their odometry, and the map
that they share. A simulated world publishes them itself (``/world/state``)."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Collection, Dict, Mapping, Type

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry

from gspn_framework_package.visualizer.poses import (
    MAP_TYPE,
    POSE_TOPICS,
    RobotPose,
    map_to_json,
    robot_pose,
)

POSES_PERIOD = 1 / 15
"""Seconds between two reports of all poses; the page draws what lies between."""

_CLASSES: Mapping[str, Type[Any]] = {
    kind._type: kind for kind in (PoseWithCovarianceStamped, Odometry)
}
_SOURCES = tuple((topic, _CLASSES[kind]) for topic, kind in POSE_TOPICS.items())

Subscribe = Callable[[str, Type[Any], Callable[[Any], None]], None]
Tell = Callable[[str, Any], None]


class RosPoses:
    """Subscribes to the poses of robots and to their map.

    :param subscribe: subscribes to a topic.
    :param tell: takes ``"poses"`` with namespace -> pose, and ``"map"`` with the object that
        :func:`~gspn_framework_package.visualizer.poses.map_to_json` makes.
    """

    def __init__(self, subscribe: Subscribe, tell: Tell) -> None:
        self._subscribe, self._report = subscribe, tell
        self._lock = threading.Lock()
        self._topics: Dict[str, int] = {}
        self._has_map = False
        self._poses: Dict[str, RobotPose] = {}
        self._reported: Mapping[str, Any] = {}
        self._reported_at = 0.0

    def find(self, published: Mapping[str, str], namespaces: Collection[str]) -> None:
        """Subscribe to poses, and report the latest ones.

        :param published: topic -> type.
        :param namespaces: those of the robots of the team.
        """
        if "/world/state" in published:
            return
        if not self._has_map and published.get("/map") == MAP_TYPE:
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
        self._report_poses(0.0)

    def _taker(self, namespace: str, rank: int) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            if self._topics[namespace] == rank:  # not after a better topic was found
                where = robot_pose(message, _SOURCES[rank][0])
                if where is not None:
                    with self._lock:
                        self._poses[namespace] = where
                    self._report_poses(POSES_PERIOD)

        return take

    def _report_poses(self, period: float) -> None:
        """Report the poses if they have changed, at most once every ``period`` seconds."""
        now = time.monotonic()
        with self._lock:
            if self._poses == self._reported or now - self._reported_at < period:
                return
            self._reported, self._reported_at = dict(self._poses), now
            reported = self._reported
        self._report("poses", reported)

    def _on_map(self, message: Any) -> None:
        self._report("map", map_to_json(message))
