"""A team as markers for rviz: where places are, what is drawn, and what is taken away."""

import json
from pathlib import Path

import pytest
import rospy
import yaml
from std_msgs.msg import String
from visualization_msgs.msg import Marker

from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.execution.team_state import StagedPlan
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.msg import Marking, RobotActivity
from gspn_framework_package.ros import team_view as seen
from gspn_framework_package.ros.team_markers import TeamMarkers, spots_of_goals, spots_of_room
from gspn_framework_package.ros.team_view import TeamView
from gspn_framework_package.srv import CommandResponse

ROOT = Path(__file__).parents[3]
ROOM = {"locations": {"L1": {"area": [[0.0, 1.0], [2.0, 3.0]]}, "L2": {"area": [[4, 4], [6, 6]]}}}


def goal(**pose):
    return {"target_pose": {"header": {"frame_id": "map"}, "pose": pose}}


def plan_with(goals):
    """A plan of two places in a ring, each an action server with a goal."""
    names = sorted(goals)
    server = {"server": "move_base", "type": "move_base_msgs/MoveBaseAction"}
    net = {
        "places": [{"name": n, "tokens": int(n == names[0])} for n in names],
        "transitions": [{"name": "from " + n} for n in names],
        "arcs": [{"from": n, "to": "from " + n} for n in names]
        + [{"from": "from " + n, "to": names[i - 1]} for i, n in enumerate(names)],
    }
    actions = {n: {**server, "goal": goals[n]} if goals[n] else None for n in names}
    return plan_from_json({"net": net, "actions": actions, "robots": {"r1": names[0]}})


def robot(place, state=RobotActivity.DOING, name="robot_1"):
    return RobotActivity(robot=name, place=place, state=state, state_name="Doing")


def drawn(markers, kind):
    return {m.id: m for m in markers.markers if m.ns == kind and m.action == Marker.ADD}


def test_places_are_where_their_goals_send_robots():
    there = goal(position={"x": 1, "y": 2.5}, orientation={"w": 1})
    plan = plan_with({"a": there, "b": goal(position={"x": "${x}"}, orientation={"w": 1})})
    (spot,) = spots_of_goals(plan).values()
    assert (spot.frame, spot.places) == ("map", ("a",))
    assert (spot.pose.position.x, spot.pose.position.y, spot.pose.orientation.w) == (1, 2.5, 1)


def test_places_are_in_the_location_whose_name_they_have():
    places = ["p1:Check_L1", "Wait_L1", "L12", "Go L2", "elsewhere"]
    spots = spots_of_room(ROOM, "map", places)
    assert sorted(spots) == ["Go L2", "Wait_L1", "p1:Check_L1"]
    assert spots["Wait_L1"].places == ("p1:Check_L1", "Wait_L1")
    assert spots["Wait_L1"].pose.position.y == 2.0
    plan = read_plan(str(ROOT / "plans/patrol/room.json"))
    assert len(spots_of_room(ROOM, "map", plan.net.place_index)) == 8


def test_a_robot_is_drawn_in_its_own_frame_with_its_name_and_its_goal():
    spots = spots_of_room(ROOM, "map", ["Go L2", "Wait_L1"])
    markers = TeamMarkers("{namespace}/base_{robot}")
    shown = markers.draw(spots, {"/fleet/one": robot("Go L2")}, {"Go L2": 1})
    (body,) = drawn(shown, "robots").values()
    (text,) = drawn(shown, "robot_names").values()
    (arrow,) = drawn(shown, "goals").values()
    assert body.header.frame_id == text.header.frame_id == "fleet/one/base_robot_1"
    assert body.frame_locked and text.text == "robot_1\nDoing Go L2"
    assert arrow.header.frame_id == "map" and arrow.pose.position.x == 5.0
    busy = {m.text for m in drawn(shown, "place_names").values()}
    assert busy == {"Go L2: 1", "Wait_L1: 0"}
    colours = {m.color.g for m in drawn(shown, "places").values()}
    assert len(colours) == 2  # one has a robot
    keys = [(m.ns, m.id) for m in shown.markers]
    assert len(set(keys)) == len(keys)


def test_what_has_gone_is_removed_once():
    spots = spots_of_room(ROOM, "map", ["Go L2"])
    markers = TeamMarkers("{robot}")
    both = {"/a": robot("Go L2"), "/b": robot("elsewhere", RobotActivity.WAITING, "robot_2")}
    first = markers.draw(spots, both, {})
    assert len(drawn(first, "robots")) == 2 and len(drawn(first, "goals")) == 1
    left = {"/a": robot("Go L2", RobotActivity.LOST), "/b": both["/b"]}
    second = markers.draw(spots, left, {})
    gone = [(m.ns, m.action) for m in second.markers if m.action == Marker.DELETE]
    assert sorted(gone) == [(kind, Marker.DELETE) for kind in ("goals", "robot_names", "robots")]
    assert not [m for m in markers.draw(spots, left, {}).markers if m.action == Marker.DELETE]


def test_the_rviz_file_shows_the_topics_of_the_node():
    config = yaml.safe_load((ROOT / "launch/team.rviz").read_text(encoding="utf-8"))
    displays = {d["Class"]: d for d in config["Visualization Manager"]["Displays"]}
    source = (ROOT / "gspn_framework_package/ros/team_view.py").read_text(encoding="utf-8")
    assert displays["rviz/MarkerArray"]["Marker Topic"] == "/gspn_markers"
    assert displays["rviz/Image"]["Image Topic"] == "/gspn_net"
    assert displays["rviz/Image"]["Transport Hint"] == "compressed"
    assert '"gspn_markers"' in source and '"gspn_net/compressed"' in source
    assert config["Visualization Manager"]["Global Options"]["Fixed Frame"] == "map"
    assert all(d["Class"].startswith("rviz/") and d["Name"] for d in displays.values())
    assert json.dumps(config)  # plain values only


def team_view(monkeypatch, plan, answers):
    """The node, with fake connections: (view, topic -> what it published last). ``answers`` has
    what a robot answers to each command."""
    published = {}

    class Connection:
        def __init__(self, topic, *_, **__):
            self.topic = topic

        def get_num_connections(self):
            return 1

        def publish(self, message):
            published[self.topic] = message

        def unregister(self):
            pass

    monkeypatch.setattr("rospy.Publisher", Connection)
    monkeypatch.setattr("rospy.Subscriber", Connection)
    monkeypatch.setattr("rospy.get_rostime", rospy.Time)
    there = {"/a/robot_activity": "", "/a/marking": ""}
    monkeypatch.setattr(seen, "published_topics", lambda: there)
    monkeypatch.setattr(seen, "ask_node", lambda namespace, question: answers[question.command])
    monkeypatch.setattr(seen, "status_in", lambda namespace: answers["status"])
    monkeypatch.setattr(seen, "render", lambda text, *_: text.encode())
    return TeamView(plan, "", "{robot}", "map"), published


@pytest.mark.parametrize("late", [False, True])
def test_a_team_is_drawn_in_the_plan_that_it_goes_on_under(monkeypatch, late):
    """Whether the node was there when the team changed, or came later with the first plan."""
    there = goal(position={"x": 1}, orientation={"w": 1})
    old, new = plan_with({"a": None, "b": None}), plan_with({"a": None, "b": None, "L1 new": there})
    entry = stage_of(new, {})
    staged = StagedPlan(1, entry.digest, entry.plan)
    answers = {
        "plan": CommandResponse(False, "the team still follows its first plan"),
        "status": {"began_with": old.hash()},
    }
    view, published = team_view(monkeypatch, old, answers)

    def hear(plan, place):
        view._on_activity(RobotActivity(run="r", plan=plan.hash(), robot="a", place=place), "/a")
        counts = [int(p.name == place) for p in plan.net.places]
        names = [p.name for p in plan.net.places]
        view._on_marking(Marking(run="r", plan=plan.hash(), places=names, counts=counts))
        for _ in range(2):  # it looks around every other time
            view.publish()

    view._on_room(String(json.dumps(ROOM)))
    if not late:
        hear(old, "b")
        assert b"L1 new" not in published["gspn_net/compressed"].data
    answers["plan"] = CommandResponse(True, json.dumps(staged.to_json()))
    hear(new, "L1 new")
    hear(new, "L1 new")
    assert b"L1 new" in published["gspn_net/compressed"].data
    names = drawn(published["gspn_markers"], "place_names").values()
    assert [m.text for m in names] == ["L1 new: 1"]
    hear(old, "b")  # a robot that has not heard of it yet
    assert b"L1 new" in published["gspn_net/compressed"].data


@pytest.mark.parametrize("text", ["no JSON", "[]", "{}", '{"locations": {"L1": {"area": 3}}}'])
def test_a_room_that_cannot_be_read_leaves_what_is_known(monkeypatch, text):
    told = []
    monkeypatch.setattr("rospy.logwarn_throttle", lambda period, text: told.append(text))
    view = TeamView.__new__(TeamView)  # no node
    view._plan, view._map_frame, view._spots = plan_with({"a": None, "b": None}), "map", {"a": 1}
    view._on_room(String(text))
    assert view._spots == {"a": 1}
    assert len(told) == 1 and "/world/room cannot be read" in told[0]
