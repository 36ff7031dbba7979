"""Fields of messages: as plans write them, and as JSON values."""

import json

import pytest

pytest.importorskip("rospy")
pytest.importorskip("move_base_msgs.msg")

import genpy
from geometry_msgs.msg import PoseArray, PoseStamped
from move_base_msgs.msg import MoveBaseGoal
from sensor_msgs.msg import BatteryState, Image, LaserScan
from std_msgs.msg import String

from gspn_framework_package.model.errors import ExpressionError, PlanError
from gspn_framework_package.model.message_condition import MessageCondition, parse_field
from gspn_framework_package.ros.message_fields import (
    action_fields,
    check_condition,
    check_field,
    check_fields,
    field_tree,
    fill_message,
    installed_types,
    message_class,
    message_to_json,
    service_class,
)

POSE = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 2}, "orientation": {"w": 1}}}


def test_a_message_comes_back_from_its_json():
    pose = PoseStamped()
    fill_message(pose, {**POSE, "header": {"frame_id": "Küche", "stamp": {"secs": 3}}}, "goal")
    value = json.loads(json.dumps(message_to_json(pose), allow_nan=False))
    assert value["header"]["stamp"] == {"secs": 3, "nsecs": 0}
    again = PoseStamped()
    fill_message(again, value, "goal")
    assert again == pose


def test_what_json_cannot_hold_is_reported_in_another_way():
    assert message_to_json(Image(data=b"\x00\xff"))["data"] == [0, 255]
    assert message_to_json(LaserScan(ranges=[1.5, float("inf"), float("nan")]))["ranges"] == [
        1.5,
        None,
        None,
    ]
    assert message_to_json(genpy.Duration(1, 2)) == {"secs": 1, "nsecs": 2}


@pytest.mark.parametrize(
    "fields",
    [
        {"target_pose": {"from": "task.pose"}},
        {"target_pose": {"pose": {"from": "task.pose"}}},
        {"target_pose": {"header": {"stamp": {"from": "t"}, "frame_id": {"from": "frame"}}}},
        {"from": "task.goal"},
    ],
)
def test_a_reference_fits_where_there_is_a_field(fields):
    check_fields(MoveBaseGoal(), fields, "goal")


def test_a_reference_fits_in_a_list():
    check_fields(PoseArray(), {"poses": [{"from": "task.pose"}, {"position": {"x": 1}}]}, "message")
    check_fields(PoseArray(), {"poses": {"from": "task.poses"}}, "message")
    check_fields(LaserScan(), {"ranges": [{"from": "x"}, 2.5]}, "message")


@pytest.mark.parametrize(
    "fields, named",
    [
        ({"target": {"from": "task.pose"}}, "target"),
        ({"target_pose": {"poes": {"from": "task.pose"}}}, "poes"),
        ({"target_pose": {"header": {"frame_id": 3}}}, "frame_id"),
        ({"target_pose": {"header": {"seq": -1, "frame_id": {"from": "x"}}}}, "seq"),
        ({"target_poes": {}}, "no field 'target_poes'; did you mean 'target_pose'"),
        (
            {"target_pose": {"pose": {"positon": {"x": 1}, "orientation": {"w": 1}}}},
            "no field 'target_pose.pose.positon'; did you mean 'target_pose.pose.position'",
        ),
    ],
)
def test_what_does_not_fit_is_named(fields, named):
    with pytest.raises(
        PlanError, match="its goal does not fit move_base_msgs/MoveBaseGoal.*" + named
    ):
        check_fields(MoveBaseGoal(), fields, "goal")


@pytest.mark.parametrize(
    "owner, field",
    [
        (BatteryState, "percentage"),
        (PoseStamped, "pose.position.x"),
        (PoseStamped, "header.stamp.secs"),
        (LaserScan, "ranges"),
        (LaserScan, "ranges[3]"),
        (PoseArray, "poses[0].position"),
        (String, "data"),
    ],
)
def test_a_field_that_is_there(owner, field):
    check_field(owner, parse_field(field))


@pytest.mark.parametrize(
    "owner, field, missing",
    [
        (BatteryState, "percent", "percent"),
        (PoseStamped, "pose.x", "pose.x"),
        (PoseStamped, "pose[0]", r"pose\[0\]"),
        (LaserScan, "ranges.x", "ranges.x"),
        (LaserScan, "ranges[0][1]", r"ranges\[0\]\[1\]"),
        (PoseArray, "poses[0].x", r"poses\[0\].x"),
        (PoseStamped, "header.stamp.x", "header.stamp.x"),
        (String, "data.x", "data.x"),
    ],
)
def test_a_field_that_is_not_there_is_named(owner, field, missing):
    with pytest.raises(ExpressionError, match="%s has no field '%s'$" % (owner._type, missing)):
        check_field(owner, parse_field(field))


def test_the_fields_of_a_condition_are_checked():
    check_condition(BatteryState, MessageCondition("percentage < 0.2 and voltage > 3"))
    with pytest.raises(ExpressionError, match="charging"):
        check_condition(BatteryState, MessageCondition("percentage < 0.2 and not charging"))


@pytest.mark.parametrize("find, kind", [(message_class, "message"), (service_class, "service")])
@pytest.mark.parametrize("name", ["std_msgs/NoSuch", "no_such_msgs/String", "String", "a/b/c"])
def test_a_type_that_is_not_here_is_named(find, kind, name):
    with pytest.raises(PlanError, match="%s type '%s'" % (kind, name)):
        find(name)


def defaults(tree):
    """The message that a tree of fields describes."""
    return {
        field["name"]: [defaults(field["fields"]) if "fields" in field else field["default"]]
        * (field["length"] or 0)
        if field["array"]
        else defaults(field["fields"])
        if "fields" in field
        else field["default"]
        for field in tree
    }


@pytest.mark.parametrize("owner", [BatteryState, Image, LaserScan, MoveBaseGoal, PoseArray])
def test_the_tree_of_a_type_has_its_fields_and_their_defaults(owner):
    tree = json.loads(json.dumps(field_tree(owner)))
    fill_message(owner(), defaults(tree), "message")
    assert defaults(tree) == message_to_json(owner())


def test_a_tree_says_what_is_an_array_and_what_holds_messages():
    poses = {field["name"]: field for field in field_tree(PoseArray)}["poses"]
    assert (poses["type"], poses["array"], poses["length"]) == ("geometry_msgs/Pose", True, None)
    assert [field["name"] for field in poses["fields"]] == ["position", "orientation"]
    stamp = field_tree(PoseStamped)[0]["fields"][1]
    assert (stamp["type"], stamp["default"]) == ("time", {"secs": 0, "nsecs": 0})


def test_the_fields_of_each_kind_of_action():
    def names(kind, type_name):
        found = action_fields(kind, type_name)
        return {
            way: tree if tree is None else [field["name"] for field in tree]
            for way, tree in found.items()
        }

    move = "move_base_msgs/MoveBaseAction"
    assert names("server", move) == {"sent": ["target_pose"], "received": []}
    assert names("service", "std_srvs/SetBool") == {
        "sent": ["data"],
        "received": ["success", "message"],
    }
    assert names("publish", "std_msgs/String") == {"sent": ["data"], "received": None}
    assert names("wait_for", "std_msgs/String") == {"sent": None, "received": ["data"]}
    for kind, wrong in (
        ("server", "std_msgs/String"),
        ("server", "std_msgs/None"),
        ("service", "std_msgs/String"),
        ("publish", "nowhere/String"),
    ):
        with pytest.raises(PlanError):
            action_fields(kind, wrong)
    types = installed_types()
    assert move in types["server"] and "std_srvs/SetBool" in types["service"]
    assert "std_msgs/String" in types["publish"] and types["publish"] == types["wait_for"]
    parts = {"move_base_msgs/MoveBaseGoal", "move_base_msgs/MoveBaseActionGoal", move}
    assert not parts & set(types["publish"])
