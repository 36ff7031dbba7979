"""Draws a team in a map, as markers for rviz and Foxglove: places, robots, names and goals."""

from __future__ import annotations

import re
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from gspn_framework_package.model.action import ServerAction
from gspn_framework_package.model.goal_pose import goal_pose
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.robot_colours import colour_of
from gspn_framework_package.msg import RobotActivity

PLACE_WIDTH, ROBOT_WIDTH, TEXT_HEIGHT = 0.3, 0.24, 0.14
"""Sizes of the markers, in metres."""

GREY, GREEN, INK = "#9aa4b2", "#15803d", "#1b2430"


class Spot(NamedTuple):
    """The location of one or several places.

    :ivar frame: the frame of the pose.
    :ivar pose: position and orientation (metres, quaternion).
    :ivar places: the places of the net at this location.
    """

    frame: str
    pose: Pose
    places: Tuple[str, ...]


def spots_of_goals(plan: Plan) -> Dict[str, Spot]:
    """Place -> the pose to which its goal sends robots, for goals with a stamped pose in the plan
    itself. Poses from data are known only when the robot is in the place."""
    found: Dict[str, Spot] = {}
    for place, action in plan.bindings():
        stamped = _stamped_pose(action.goal) if isinstance(action, ServerAction) else None
        if stamped is not None:
            found.setdefault(place, Spot(stamped[0], stamped[1], (place,)))
    return found


def spots_of_room(room: Mapping[str, Any], frame: str, places: Iterable[str]) -> Dict[str, Spot]:
    """Place -> its location in a simulated room. A location belongs to the places whose names
    contain its name as a word, such as ``Wait_L1`` for ``L1``.

    :param room: the object on ``/world/room``.
    """
    found: Dict[str, Spot] = {}
    listed = list(places)
    for name, location in room["locations"].items():
        (left, low), (right, high) = location["area"]
        there = tuple(place for place in listed if name in re.split("[^A-Za-z0-9]+", place))
        pose = Pose(Point((left + right) / 2, (low + high) / 2, 0.0), Quaternion(0, 0, 0, 1))
        found.update({place: Spot(frame, pose, there) for place in there})
    return found


def _stamped_pose(goal: Any) -> Optional[Tuple[str, Pose]]:
    """The first stamped pose in the fields of a goal."""
    found = goal_pose(goal)
    if found is None:
        return None
    return found.frame, Pose(Point(*found.position), Quaternion(*found.orientation))


class TeamMarkers:
    """Draws a team, and removes obsolete markers.

    :param robot_frame: the frame of a robot, with ``{robot}`` for its name and ``{namespace}`` for
        its namespace.
    """

    def __init__(self, robot_frame: str) -> None:
        self._robot_frame = robot_frame
        self._shown: Dict[Tuple[str, int], str] = {}
        self._numbers: Dict[str, int] = {}

    def draw(
        self,
        spots: Mapping[str, Spot],
        robots: Mapping[str, RobotActivity],
        tokens: Mapping[str, int],
    ) -> MarkerArray:
        """Draw all.

        :param spots: place -> its location.
        :param robots: namespace -> the activity of its robot.
        :param tokens: place -> number of tokens.
        """
        markers: List[Marker] = []
        for name, spot in sorted({spot.places[0]: spot for spot in spots.values()}.items()):
            markers += self._place(name, spot, tokens)
        for namespace, robot in sorted(robots.items()):
            gone = robot.state in (RobotActivity.LOST, RobotActivity.LEFT)
            if not gone:
                markers += self._robot(namespace, robot, spots.get(robot.place))
        present = {(m.ns, m.id): m.header.frame_id for m in markers}
        for (kind, number), frame in self._shown.items():
            if (kind, number) not in present:
                gone_marker = self._marker(kind, "", frame, Marker.CYLINDER, GREY)
                gone_marker.id, gone_marker.action = number, Marker.DELETE
                markers.append(gone_marker)
        self._shown = present
        return MarkerArray(markers)

    def _place(self, name: str, spot: Spot, tokens: Mapping[str, int]) -> List[Marker]:
        held = {place: tokens.get(place, 0) for place in spot.places}
        disc = self._marker(
            "places", name, spot.frame, Marker.CYLINDER, GREEN if any(held.values()) else GREY, 0.6
        )
        disc.pose = spot.pose
        disc.scale = Vector3(PLACE_WIDTH, PLACE_WIDTH, 0.02)
        lines = ["%s: %d" % item for item in held.items() if item[1] or len(held) == 1]
        text = self._text("place_names", name, spot.frame, lines or spot.places[:1])
        where = spot.pose.position
        text.pose.position = Point(where.x, where.y - PLACE_WIDTH, where.z + 0.02)
        return [disc, text]

    def _robot(self, namespace: str, robot: RobotActivity, spot: Optional[Spot]) -> List[Marker]:
        frame = self._robot_frame.format(robot=robot.robot, namespace=namespace.strip("/"))
        colour = colour_of(robot.robot)
        body = self._marker("robots", robot.robot, frame, Marker.CYLINDER, colour)
        body.pose.position.z = ROBOT_WIDTH / 2
        body.scale = Vector3(ROBOT_WIDTH, ROBOT_WIDTH, ROBOT_WIDTH)
        lines = [robot.robot, "%s %s" % (robot.state_name, robot.place)]
        text = self._text("robot_names", robot.robot, frame, lines)
        text.pose.position.z = ROBOT_WIDTH + 2 * TEXT_HEIGHT
        body.frame_locked = text.frame_locked = True  # moves with the robot
        if spot is None or robot.state != RobotActivity.DOING:
            return [body, text]
        goal = self._marker("goals", robot.robot, spot.frame, Marker.ARROW, colour, 0.8)
        goal.pose = spot.pose
        goal.scale = Vector3(PLACE_WIDTH, 0.05, 0.05)
        return [body, text, goal]

    def _text(self, kind: str, name: str, frame: str, lines: Sequence[str]) -> Marker:
        marker = self._marker(kind, name, frame, Marker.TEXT_VIEW_FACING, INK)
        marker.scale.z = TEXT_HEIGHT
        marker.text = "\n".join(lines)
        return marker

    def _marker(
        self, kind: str, name: str, frame: str, shape: int, colour: str, alpha: float = 1.0
    ) -> Marker:
        """A marker at the origin of a frame; time 0 means the latest known pose of the frame."""
        marker = Marker(ns=kind, type=shape, action=Marker.ADD)
        marker.id = self._numbers.setdefault(name, len(self._numbers))
        marker.header.frame_id, marker.header.stamp = frame, rospy.Time(0)
        marker.pose.orientation.w = 1.0
        red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
        marker.color = ColorRGBA(red, green, blue, alpha)
        return marker
