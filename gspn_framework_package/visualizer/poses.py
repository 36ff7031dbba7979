"""Where robots are and were: read from messages, and kept by the page for the time line."""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from typing import Any, Collection, Dict, List, Mapping, Optional, Tuple

import numpy as np

from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.model.goal_pose import yaw_of

SPARSE = 0.5
"""Seconds between two moments of a track; the page draws what lies between."""

MOST_MOMENTS = 40_000
"""Maximum number of moments of a track: more than five hours of robots that never stand still."""

POSES_AT_ONCE = 60.0
"""Seconds of a track that the page gets at once, half of them before the requested time."""

WIDEST_MAP = 400
"""Largest number of cells of the drawn map on a side; a finer map is reduced."""

POSE_TOPICS: Mapping[str, str] = {
    "/amcl_pose": "geometry_msgs/PoseWithCovarianceStamped",
    "/odom": "nav_msgs/Odometry",
}
"""The topics of a robot's pose in its namespace, the best one first, and their types."""

MAP_TYPE = "nav_msgs/OccupancyGrid"

_OCCUPIED, _FREE, _UNKNOWN = 2, 1, 0

RobotPose = Mapping[str, Any]
"""``pose``: x and y (m) and yaw (rad). ``by``: the topic that reports it, for a real robot."""


class PoseTrack:
    """Where the robots of one run were, twice a second.

    A moment is kept only if a robot has moved since. The last one is always what was reported last.

    :ivar room: the room or map of the run as the page shows it, if known.
    """

    def __init__(self) -> None:
        self.room: Optional[Dict[str, Any]] = None
        self._times: List[float] = []
        self._texts: List[str] = []  # a fifth of the memory that the objects take

    def __len__(self) -> int:
        return len(self._times)

    def add(self, t: float, robots: Mapping[str, RobotPose]) -> None:
        """Keep where the robots are.

        :param t: seconds since the run began, not before those of the last moment.
        """
        kept = {
            name: {key: robot[key] for key in ("pose", "by") if key in robot}
            for name, robot in robots.items()
        }
        text = compact(kept)
        if text == (self._texts[-1] if self._texts else "{}"):
            return
        if len(self._times) > 1 and t - self._times[-2] < SPARSE:
            self._times.pop()
            self._texts.pop()
        self._times.append(round(t, 3))
        self._texts.append(text)
        if len(self._times) > MOST_MOMENTS:
            del self._times[: MOST_MOMENTS // 4], self._texts[: MOST_MOMENTS // 4]

    def first(self) -> Dict[str, RobotPose]:
        """Where the robots were first seen."""
        robots: Dict[str, RobotPose] = json.loads(self._texts[0]) if self._texts else {}
        return robots

    def around(self, t: float, now: float = math.inf) -> Dict[str, Any]:
        """The ``moments`` around a time (``t``, in seconds, and ``robots``: robot -> pose), which
        are complete ``from`` one time ``to`` another.

        :param now: the time up to which the track is known (s).
        """
        begin, end = max(0.0, t - POSES_AT_ONCE / 2), min(now, t + POSES_AT_ONCE / 2)
        first = max(0, bisect_right(self._times, begin) - 1)
        last = bisect_right(self._times, end) + 1
        moments = [
            {"t": moment, "robots": json.loads(text)}
            for moment, text in zip(self._times[first:last], self._texts[first:last])
        ]
        return {"from": begin, "to": max(begin, end), "moments": moments}


def robot_pose(message: Any, topic: str) -> Optional[RobotPose]:
    """The pose in a message on one of :data:`POSE_TOPICS`; None if it is not a number."""
    at, q = message.pose.pose.position, message.pose.pose.orientation
    if not all(map(math.isfinite, (at.x, at.y, q.x, q.y, q.z, q.w))):
        return None
    turned = yaw_of(q.x, q.y, q.z, q.w)
    return {"pose": [round(at.x, 3), round(at.y, 3), round(turned, 3)], "by": topic[1:]}


def pose_sources(topics: Mapping[str, str], names: Collection[str]) -> Dict[str, Tuple[str, str]]:
    """The best recorded topic of each robot's pose, as topic -> robot and suffix. A robot's
    namespace ends in its name; a single robot may have none.

    :param topics: those of a bag, each with its type.
    :param names: those of the robots.
    """
    found: Dict[str, Tuple[str, str]] = {}
    for name in names:
        for suffix, kind in POSE_TOPICS.items():
            ends = ["/" + name + suffix] + ([suffix] if len(names) == 1 else [])
            of_robot = [
                topic
                for topic, recorded in topics.items()
                if recorded == kind and (topic.endswith(ends[0]) or topic in ends[1:])
            ]
            if of_robot:
                found[min(of_robot, key=len)] = (name, suffix)
                break
    return found


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
