"""Where real robots are: which topics are listened to, and what the page is told."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Tuple

import pytest

pytest.importorskip("nav_msgs.msg")

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry

from gspn_framework_package.visualizer import poses, ros_poses
from gspn_framework_package.visualizer.poses import map_to_json
from gspn_framework_package.visualizer.ros_poses import RosPoses

AMCL, ODOM = PoseWithCovarianceStamped._type, Odometry._type


class Heard:
    """A page that listens; ``topics`` are those subscribed to, ``told`` what it was told."""

    def __init__(self) -> None:
        self.topics: Dict[str, Any] = {}
        self.told: List[Tuple[str, Any]] = []
        self.poses = RosPoses(self._subscribe, lambda what, told: self.told.append((what, told)))

    def _subscribe(self, topic: str, kind: Any, callback: Any) -> None:
        assert topic not in self.topics
        self.topics[topic] = callback


def pose(kind: Any, x: float, y: float, yaw: float) -> Any:
    message = kind()
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z = math.sin(yaw / 2)
    message.pose.pose.orientation.w = math.cos(yaw / 2)
    return message


@pytest.fixture(name="heard")
def _heard(monkeypatch: Any) -> Heard:
    monkeypatch.setattr(ros_poses, "POSES_PERIOD", 0.0)
    return Heard()


def test_localisation_replaces_odometry_as_soon_as_there_is_any(heard: Heard) -> None:
    heard.poses.find({"/r1/odom": ODOM, "/r2/amcl_pose": AMCL, "/r2/odom": ODOM}, ["/r1", "/r2"])
    assert set(heard.topics) == {"/r1/odom", "/r2/amcl_pose"}
    heard.topics["/r1/odom"](pose(Odometry, 1, 2, 0.5))
    assert heard.told[-1] == ("poses", {"/r1": {"pose": [1.0, 2.0, 0.5], "by": "odom"}})
    heard.poses.find({"/r1/odom": ODOM, "/r1/amcl_pose": AMCL}, ["/r1", "/r2"])
    heard.topics["/r1/amcl_pose"](pose(PoseWithCovarianceStamped, 7, 8, -1))
    heard.topics["/r1/odom"](pose(Odometry, 1, 2, 0.6))
    assert heard.told[-1] == ("poses", {"/r1": {"pose": [7.0, 8.0, -1.0], "by": "amcl_pose"}})


def test_a_world_says_itself_where_robots_are(heard: Heard) -> None:
    topics = {"/world/state": "std_msgs/String", "/r1/amcl_pose": AMCL, "/map": OccupancyGrid._type}
    heard.poses.find(topics, ["/r1"])
    assert not heard.topics and not heard.told


def test_topics_of_other_robots_and_of_other_types_are_left_alone(heard: Heard) -> None:
    heard.poses.find({"/r9/amcl_pose": AMCL, "/r1/odom": "my_msgs/Odom"}, ["/r1"])
    assert not heard.topics


def test_a_pose_that_is_no_number_is_not_told(heard: Heard) -> None:
    heard.poses.find({"/r1/amcl_pose": AMCL}, ["/r1"])
    heard.topics["/r1/amcl_pose"](pose(PoseWithCovarianceStamped, math.nan, 0, 0))
    assert not heard.told


def test_what_was_not_told_at_once_is_told_with_the_next_search(monkeypatch: Any) -> None:
    monkeypatch.setattr(ros_poses, "POSES_PERIOD", 1e9)
    heard = Heard()
    monkeypatch.setattr(heard.poses, "_reported_at", ros_poses.time.monotonic())
    heard.poses.find({"/r1/amcl_pose": AMCL}, ["/r1"])
    heard.topics["/r1/amcl_pose"](pose(PoseWithCovarianceStamped, 1, 0, 0))
    assert not heard.told
    heard.poses.find({}, ["/r1"])
    assert heard.told == [("poses", {"/r1": {"pose": [1.0, 0.0, 0.0], "by": "amcl_pose"}})]


def grid(rows: List[List[int]], resolution: float = 0.5) -> Any:
    message = OccupancyGrid()
    message.info.width, message.info.height = len(rows[0]), len(rows)
    message.info.resolution = resolution
    message.info.origin.position.x, message.info.origin.position.y = -1.0, 2.0
    message.data = [cell for row in rows for cell in row]
    return message


def cells(room: Any) -> List[int]:
    runs = room["grid"]["runs"]
    return [kind for kind, length in zip(runs[::2], runs[1::2]) for _ in range(length)]


def test_a_map_is_told_as_runs_of_its_cells(heard: Heard) -> None:
    heard.poses.find({"/map": OccupancyGrid._type}, [])
    heard.topics["/map"](grid([[0, 0, 100], [-1, 49, 50]]))
    (what, room) = heard.told[0]
    assert what == "map" and room["bounds"] == [[-1.0, 2.0], [0.5, 3.0]]
    assert (room["grid"]["width"], room["grid"]["height"]) == (3, 2)
    assert cells(room) == [1, 1, 2, 0, 1, 2]


def test_a_fine_map_is_reduced_and_keeps_its_walls(monkeypatch: Any) -> None:
    monkeypatch.setattr(poses, "WIDEST_MAP", 3)
    room = map_to_json(grid([[0, 0, 0, 0, 100], [0, 0, 0, 0, 0], [-1, -1, -1, -1, -1]], 0.1))
    assert (room["grid"]["width"], room["grid"]["height"]) == (3, 2)
    assert cells(room) == [1, 1, 2, 0, 0, 0]
    assert room["bounds"][1] == pytest.approx([-0.4, 2.4])
