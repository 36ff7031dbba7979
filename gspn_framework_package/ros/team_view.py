"""The node ``team_view``: shows a team in rviz, rqt_image_view and Foxglove.

While somebody subscribes, it publishes once a second

- ``gspn_markers`` (visualization_msgs/MarkerArray): places, robots, their names and their goals;
- ``gspn_net/compressed`` (sensor_msgs/CompressedImage, PNG): the net with its current marking.

The location of a place is taken from the goal of its action, or from the room of the simulated
world (``/world/room``). A robot is drawn at the origin of its frame, so tf moves it. When the team
adopts another plan, the node asks a robot for it and draws that plan. No robot waits for this node,
and it gives no orders.

Private parameters: ``plan`` (file or folder), ``robots`` (size of the team; 0 for the plan's),
``run`` (name of the run; "" takes the first one of this plan), ``robot_frame`` (frame of a robot,
with ``{robot}`` and ``{namespace}``), ``map_frame`` (frame of the simulated room).
"""

from __future__ import annotations

import json
import threading
from typing import Any, Dict, List, Optional, Tuple

import rospy
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from gspn_framework_package.formats.dot import net_graph, render
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.msg import Marking, RobotActivity
from gspn_framework_package.ros.options import launched_file
from gspn_framework_package.ros.service_line import ask_node, status_in
from gspn_framework_package.ros.team_markers import Spot, TeamMarkers, spots_of_goals, spots_of_room
from gspn_framework_package.ros.transport.ending import Ending
from gspn_framework_package.ros.transport.node_process import run_node
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, published_topics
from gspn_framework_package.team.carrier import OperatorRequest
from gspn_framework_package.team.deployed_plan import DeployedPlan, read_deployed
from gspn_framework_package.team.operator_client import UnreachableError

VIEW_PERIOD = 1.0
"""Seconds of wall time between two messages on a topic."""

SCAN_PERIODS = 2
"""How many periods lie between two searches for robots."""

DRAWING_TIME = 20.0
"""Time limit for Graphviz, in seconds."""

_ACTIVITY, MARKING = "/robot_activity", "/marking"


def run_team_view() -> int:
    """Run the node; returns the exit code of the process."""
    return run_node("team_view", _show)


def _show(ending: Ending) -> int:
    path = str(rospy.get_param("~plan", ""))
    if not path:
        raise UsageError("no plan", element="parameter ~plan", hint="the team's plan file")
    plan = read_plan(launched_file(path, "parameter ~plan"))
    robots = rospy.get_param("~robots", 0)
    if not isinstance(robots, int) or isinstance(robots, bool) or robots < 0:
        raise UsageError("%r is not a number of robots" % (robots,), element="parameter ~robots")
    frame = str(rospy.get_param("~robot_frame", "{namespace}/base_footprint"))
    try:
        frame.format(robot="", namespace="")
    except (KeyError, IndexError, ValueError):
        raise UsageError(
            "'%s' has braces around words other than robot and namespace" % frame,
            element="parameter ~robot_frame",
        ) from None
    view = TeamView(
        plan.for_robots(robots) if robots else plan,
        str(rospy.get_param("~run", "")),
        frame,
        str(rospy.get_param("~map_frame", "map")),
    )
    while not ending.wait(VIEW_PERIOD):
        view.publish()
    return 0


class TeamView:
    """Publishes the two pictures of a team; see the module.

    :param plan: the plan of the team.
    :param run: the run to show; "" takes the first one of this plan.
    :param robot_frame: see :class:`TeamMarkers`.
    :param map_frame: the frame of the simulated room.
    """

    def __init__(self, plan: Plan, run: str, robot_frame: str, map_frame: str) -> None:
        self._plan, self._run, self._map_frame = plan, run, map_frame
        self._hash = plan.hash()
        self._lock = threading.Lock()
        self._robots: Dict[str, RobotActivity] = {}
        self._marking: Optional[Marking] = None
        self._spots: Dict[str, Spot] = spots_of_goals(plan)
        self._drawn: Tuple[Optional[Tuple[int, ...]], bytes] = (None, b"")
        self._stage = 0
        self._heard: Dict[str, RobotActivity] = {}
        self._room_text = ""
        self._markers = TeamMarkers(robot_frame)
        self._followed: Dict[str, Any] = {}
        self._teller: Optional[Tuple[str, Any]] = None
        self._turn = 0
        self._marker_topic = rospy.Publisher("gspn_markers", MarkerArray, queue_size=2)
        self._image_topic = rospy.Publisher("gspn_net/compressed", CompressedImage, queue_size=2)
        self._room = rospy.Subscriber("/world/room", String, self._on_room)

    @property
    def plan(self) -> Plan:
        """The plan that is drawn."""
        return self._plan

    def publish(self) -> None:
        """Publish the topics that have subscribers; called once a second."""
        markers = bool(self._marker_topic.get_num_connections())
        image = bool(self._image_topic.get_num_connections())
        if self._turn % SCAN_PERIODS == 0:
            self._look_around(markers or image)
        self._turn += 1
        if markers:
            with self._lock:
                robots, spots = dict(self._robots), dict(self._spots)
            self._marker_topic.publish(self._markers.draw(spots, robots, self._tokens()))
        if image:
            self._publish_image()

    def _look_around(self, watched: bool) -> None:
        """Follow the existing robots, and the marking of one of them while it is shown."""
        try:
            found = {topic for topic in published_topics() if topic.endswith(_ACTIVITY)}
        except MASTER_ERRORS:
            return
        there = {topic[: -len(_ACTIVITY)] for topic in found}
        for namespace in sorted(there - set(self._followed)):
            self._followed[namespace] = rospy.Subscriber(
                namespace + _ACTIVITY, RobotActivity, self._on_activity, namespace
            )
        for namespace in set(self._followed) - there:
            self._followed.pop(namespace).unregister()
        with self._lock:
            self._robots = {name: robot for name, robot in self._robots.items() if name in there}
            ours = sorted(self._robots)
            self._heard = {name: robot for name, robot in self._heard.items() if name in there}
        self._follow_marking(ours if watched else [])
        self._follow_plan()

    def _follow_marking(self, namespaces: List[str]) -> None:
        """Follow the marking published by one of these robots."""
        if self._teller and self._teller[0] not in namespaces:
            self._teller[1].unregister()
            self._teller = None
        if self._teller is None and namespaces:
            topic = namespaces[0] + MARKING
            self._teller = namespaces[0], rospy.Subscriber(topic, Marking, self._on_marking)

    def _follow_plan(self) -> None:
        """Draw the plan that the team follows now; only this thread changes the plan."""
        with self._lock:
            heard = sorted(self._heard.items())
        for namespace, robot in heard:
            if robot.plan == self._hash or (self._run and robot.run != self._run):
                continue
            try:
                if not self._run:
                    status = status_in(namespace)
                    if status is None or status.get("began_with") != self._hash:
                        continue
                question = OperatorRequest("plan", run=robot.run)
                answer = ask_node(namespace, question)
            except UnreachableError:
                return
            found = read_deployed(robot.run, answer.message) if answer and answer.success else None
            if found is not None and found.number > self._stage:
                self._show(found)
                return

    def _show(self, deployed: DeployedPlan) -> None:
        with self._lock:
            self._run, self._stage = deployed.run, deployed.number
            self._plan, self._hash = deployed.plan, deployed.plan.hash()
            self._drawn = (None, b"")
            self._spots = spots_of_goals(self._plan)
        if self._room_text:
            self._place_in_room(self._room_text)
        rospy.loginfo("the team has adopted the plan '%s'", self._plan.name)

    def _on_activity(self, message: RobotActivity, namespace: str) -> None:
        with self._lock:
            self._heard[namespace] = message
            if not self._run and message.plan == self._hash:
                self._run = message.run
            if message.run == self._run:
                self._robots[namespace] = message

    def _on_marking(self, message: Marking) -> None:
        with self._lock:
            if message.run == self._run:
                self._marking = message

    def _on_room(self, message: String) -> None:
        self._room_text = message.data
        self._place_in_room(message.data)

    def _place_in_room(self, text: str) -> None:
        plan = self._plan
        places = [place.name for place in plan.net.places]
        try:
            found = spots_of_room(json.loads(text), self._map_frame, places)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            rospy.logwarn_throttle(60.0, "/world/room cannot be read (%r)" % error)
            return
        with self._lock:
            if plan is self._plan:  # otherwise another plan arrived in the meantime
                self._spots = {**found, **spots_of_goals(plan)}

    def _tokens(self) -> Dict[str, int]:
        """Place -> tokens, as reported by the team; before that, the plan's initial tokens."""
        with self._lock:
            reported = self._marking
        if reported is None:
            return self._plan.net.named(self._plan.net.initial_marking)
        return dict(zip(reported.places, reported.counts))

    def _publish_image(self) -> None:
        tokens = self._tokens()
        marking = tuple(tokens.get(place.name, 0) for place in self._plan.net.places)
        if marking != self._drawn[0]:
            try:
                plan = self._plan
                text = net_graph(plan.net, marking, plan.subnets, plan.group_nodes).text()
                self._drawn = marking, render(text, "png", DRAWING_TIME)
            except GspnError as error:
                rospy.logwarn_throttle(60.0, "the net cannot be drawn: %s" % error)
                return
        image = CompressedImage(format="png", data=self._drawn[1])
        image.header.stamp = rospy.get_rostime()
        self._image_topic.publish(image)
