"""Topics as sources of events and tasks: what their messages come to, and what makes no sense."""

import json
import math
import queue
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import PATIENCE

pytest.importorskip("rospy")
pytest.importorskip("genpy")
pytest.importorskip("geometry_msgs.msg")
pytest.importorskip("std_msgs.msg")

import genpy
from geometry_msgs import msg as geometry
from std_msgs import msg as std

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.agreement.interface import EventObserved, TaskCame
from gspn_framework_package.execution.log_entries import Submit
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import ExpressionError, GspnError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.message_condition import MessageCondition, parse_field
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros import message_fields
from gspn_framework_package.ros.event_sources import (
    ConditionSource,
    EventSources,
    MomentSource,
    TaskSource,
    cause_of,
    task_of,
)
from gspn_framework_package.team.sides import EventListener


class Node:
    """A host whose worker takes its calls when the test says so."""

    def __init__(self, watched=True):
        self.calls, self.given, self.complaints = [], [], []
        self.watched = watched
        self.host = EventListener(
            lambda *call: self.calls.append(call),
            self.given.append,
            lambda transition: self.watched,
            self.complaints.append,
        )

    def work(self):
        calls, self.calls = self.calls, []
        for function, *arguments in calls:
            function(*arguments)
        given, self.given[:] = list(self.given), []
        return given


def level(value):
    return SimpleNamespace(percentage=value)


def low(node):
    return ConditionSource("low", EventSource("battery", "a/B", "percentage < 0.2"), node.host)


def test_only_changes_of_a_condition_are_told_with_their_cause():
    node = Node()
    source = low(node)
    source.take(level(0.5))
    assert node.calls == []
    source.take(level(0.1))
    assert node.work() == [EventObserved("low", True, {"percentage": 0.1})]
    source.take(level(0.05))
    assert node.calls == []
    source.take(level(0.9))
    assert node.work() == [EventObserved("low", False)]


def test_a_short_rise_is_reported_although_it_is_over():
    node = Node()
    source = low(node)
    for value in (0.1, 0.9):
        source.take(level(value))
    assert node.work() == [
        EventObserved("low", True, {"percentage": 0.1}),
        EventObserved("low", False),
    ]


def test_a_flood_of_changes_asks_a_busy_worker_once():
    node = Node()
    source = low(node)
    for _ in range(1000):
        source.take(level(0.1))
        source.take(level(0.9))
    source.take(level(0.15))
    assert len(node.calls) == 1
    assert node.work() == [EventObserved("low", True, {"percentage": 0.15})]


@given(st.lists(st.sampled_from(["low", "high", "work"])))
def test_the_worker_learns_of_each_change_between_two_of_its_turns(story):
    node = Node()
    source = low(node)
    holds = told = rose = False
    for word in [*story, "work"]:
        if word != "work":
            source.take(level(0.1 if word == "low" else 0.9))
            rose = rose or (word == "low" and not holds)
            holds = word == "low"
            continue
        given = [event.holds for event in node.work()]
        assert (True in given) == rose
        for event in given:
            assert event != told  # each is news
            told = event
        assert told == holds
        rose = False


def test_a_message_that_cannot_be_evaluated_changes_nothing_and_is_reported_once():
    node = Node()
    source = low(node)
    source.take(level(0.1))
    node.work()
    for _ in range(3):
        source.take(level("unknown"))
    assert node.calls == []
    (complaint,) = node.complaints
    assert complaint.startswith("event 'low' (topic battery: percentage < 0.2): the condition")


def test_a_moment_counts_only_where_it_could_interrupt_and_once_for_each_turn():
    node = Node(watched=False)
    source = MomentSource("bump", EventSource("bumper", "std_msgs/String"), node.host)
    source.take(std.String("left"))
    assert node.work() == []
    node.watched = True
    for side in ("left", "right"):
        source.take(std.String(side))
    assert node.work() == [EventObserved("bump", None, {"data": "left"})]
    source.take(std.String("right"))
    assert node.work() == [EventObserved("bump", None, {"data": "right"})]


def test_a_cause_is_short_and_json():
    scan = SimpleNamespace(ranges=[0.4] + [math.inf] * 1000, range=math.inf, stamp=genpy.Time(1, 2))
    condition = MessageCondition("min(ranges) < 0.5 and range > 3 and stamp.secs > 0")
    assert condition.holds(scan)
    cause = cause_of(condition, scan)
    assert cause == {"ranges": "1001 elements, 0.4 to inf", "range": "inf", "stamp.secs": 1}
    json.dumps(cause, allow_nan=False)


# -- tasks -----------------------------------------------------------------------------------------


def stamped(seq, sender="/shop", topic="/orders"):
    message = geometry.PoseStamped()
    message.header.seq, message.header.stamp = seq, genpy.Time(5)
    message.pose.position.x = 1.5
    message._connection_header = {"callerid": sender, "topic": topic}
    return message


def test_a_task_is_known_by_publisher_number_and_time_of_its_message():
    source = EventSource("/orders", "geometry_msgs/PoseStamped")
    task = task_of("order", source, stamped(7))
    assert task.id == "/orders /shop:7@5.000000000"
    assert task.data["pose"]["position"] == {"x": 1.5, "y": 0.0, "z": 0.0}
    assert task_of("order", source, stamped(7)) == task
    others = [(8, "/shop", "/orders"), (7, "/door", "/orders"), (7, "/shop", "/robot_2/orders")]
    assert task.id not in {task_of("order", source, stamped(*other)).id for other in others}


def test_a_goal_can_be_filled_with_the_data_of_a_task():
    message = stamped(7)
    message.pose.orientation.w = 1.0
    data = task_of("order", EventSource("/orders", "geometry_msgs/PoseStamped"), message).data
    goal = geometry.PoseStamped()
    genpy.message.fill_message_args(goal, [json.loads(json.dumps(data))])
    assert goal == message


def test_the_id_is_in_the_field_that_the_plan_names():
    by_frame = EventSource("/orders", "geometry_msgs/PoseStamped", id="header.frame_id")
    message = stamped(7)
    message.header.frame_id = "order 12"
    assert task_of("order", by_frame, message).id == "order 12"
    message.header.frame_id = ""
    with pytest.raises(GspnError, match=r"its field 'header.frame_id' is empty"):
        task_of("order", by_frame, message)


def test_the_data_of_a_task_may_be_json_in_a_string():
    source = EventSource("/orders", "std_msgs/String", json="data")
    task = task_of("order", source, std.String('{"id": 12, "pose": [1, 2]}'))
    assert (task.id, task.data["pose"]) == ("12", [1, 2])
    numbered = task_of("order", source._replace(id="order.number"), _order('{"number": "a"}'))
    assert numbered.id == "a"


def _order(order):
    return std.String('{"order": %s}' % order)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "its field 'data' is not JSON"),
        ("[1]", "its field 'data' is not a JSON object"),
        ('{"pose": 1}', "the message has no field 'id' and no header"),
        ('{"id": true}', "not True"),
        ('{"id": [1]}', "the id of a task is text or a whole number"),
        ('{"id": "%s"}' % ("x" * 201), "the id of a task is longer than 200 characters"),
        ('{"id": 1, "not a name": 2}', "is not a name of data"),
        ('{"id": 1, "x": NaN}', "is not JSON"),
        ('{"id": 1, "x": "%s"}' % ("x" * 70_000), "at most 64000 are kept"),
        ("[" * 100_000, "its field 'data' is not JSON"),
    ],
)
def test_a_message_that_is_no_task_is_reported_and_not_taken(text, why):
    node = Node()
    source = TaskSource("order", EventSource("/orders", "a/B", json="data"), node.host)
    source.take(std.String(text))
    assert node.calls == []
    (complaint,) = node.complaints
    assert complaint.startswith(
        "tasks of 'order' (topic /orders): a message cannot be used as a task"
    )
    assert why in complaint
    source.take(std.String('{"id": 3}'))
    ((_, task),) = node.calls
    assert task == TaskCame(task_of("order", EventSource(json="data"), std.String('{"id": 3}')))


# -- functions -------------------------------------------------------------------------------------

WATCH = """
def low(robot, data):
    return {"speed": data["robot.speed"]} if robot == "robot_1" else False

def order(emit):
    emit(pose=[1, 2])
    emit(id="o1", pose=[3, 4])
"""


def test_functions_watch_events_and_let_tasks_in_if_they_give_them_ids(tmp_path):
    (tmp_path / "watch.py").write_text(WATCH)
    net = (
        NetBuilder()
        .place("Work", 1)
        .place("Orders", capacity=3)
        .exponential("low", rate=1, inputs="Work", outputs="Work")
        .exponential("order", rate=1, outputs="Orders")
        .build()
    )
    plan = Plan(
        net,
        actions={"Work": None},
        resource_places=frozenset(["Orders"]),
        events={
            "low": EventSource(function="watch.low"),
            "order": EventSource(function="watch.order"),
        },
        folder=str(tmp_path),
    ).validate()
    calls, complaints = queue.Queue(), queue.Queue()
    host = EventListener(
        lambda function, *arguments: function(*arguments),
        calls.put,
        lambda transition: True,
        complaints.put,
        lambda robot: {"robot.speed": 3} if robot else {},
    )
    sources = EventSources(plan, "robot_1", "/robot_1", False, host)
    sources.start()
    try:
        found = [calls.get(timeout=20 * PATIENCE) for _ in range(2)]
        assert EventObserved("low", True, {"speed": 3}) in found
        assert TaskCame(Submit("order", "o1", {"pose": [3, 4]})) in found
        assert "a task has no id" in complaints.get(timeout=20 * PATIENCE)
        sources.visit_began()
        assert calls.get(timeout=20 * PATIENCE) == EventObserved("low", True, {"speed": 3})
    finally:
        sources.close()


# -- types -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "kind"),
    [
        ("pose.pose.position.x", "float64"),
        ("header.stamp.secs", "int32"),
        ("pose.covariance[35]", "float64"),
        ("pose.covariance", "float64[]"),
        ("header.frame_id", "string"),
        ("pose.covariance.x", None),
        ("pose[0]", None),
        ("pose.x", None),
        ("post", None),
        ("header.seq.x", None),
        ("serialize", None),
        ("_type", None),
    ],
)
def test_fields_of_a_type(field, kind):
    def found():
        return message_fields.check_field(geometry.PoseWithCovarianceStamped, parse_field(field))

    if kind is not None:
        assert found() == kind
        return
    with pytest.raises(ExpressionError, match="PoseWithCovarianceStamped has no field"):
        found()


def test_a_constant_of_a_type_is_a_field():
    status = pytest.importorskip("actionlib_msgs.msg").GoalStatus
    assert message_fields.check_field(status, ("ABORTED",)) == ""
    message_fields.check_condition(status, MessageCondition("status == ABORTED"))


def check(tmp_path, capsys, **event):
    """The exit code of the check of a plan with an event of a robot, or of the environment if it
    is given an ``id`` or ``json``, and its items on events' sources."""
    outside = "id" in event or "json" in event or event.pop("outside", False)
    plan = {
        "net": {
            "places": [{"name": "Work", "tokens": 1}, {"name": "Orders", "capacity": 3}],
            "transitions": [
                {"name": "finish", "timed": True, "servers": None},
                {"name": "go", "timed": True, "servers": None},
                {"name": "take"},
            ],
            "arcs": [
                {"from": "Work", "to": "finish"},
                {"from": "finish", "to": "Work"},
                *([] if outside else [{"from": "Work", "to": "go"}]),
                {"from": "go", "to": "Orders" if outside else "Work"},
                {"from": "Orders", "to": "take"},
            ],
        },
        "actions": {"Work": {"server": "work"}},
        "resource_places": ["Orders"],
        "robots": {"robot_1": "Work"},
        "events": {"go": event},
    }
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    code = main(["check", str(tmp_path), "--json"])
    items = json.loads(capsys.readouterr().out)["items"]
    return code, [(i["severity"], i["text"]) for i in items if i["check"] == "sources"]


POSE = {"topic": "pose", "type": "geometry_msgs/PoseStamped"}
TEXT = {"topic": "/orders", "type": "std_msgs/String"}


@pytest.mark.parametrize(
    "event",
    [
        {**POSE},
        {**POSE, "when": "pose.position.x > 3 and header.frame_id == 'map'"},
        {**TEXT, "json": "data"},
        {**TEXT, "id": "data"},
        {**POSE, "outside": True},
        {"topic": "scan", "type": "std_msgs/Float64MultiArray", "when": "min(data) < data[3] / 2"},
    ],
)
def test_an_event_that_fits_its_type_is_no_matter(tmp_path, capsys, event):
    assert check(tmp_path, capsys, **event)[1] == []


@pytest.mark.parametrize(
    ("event", "why"),
    [
        (
            {**POSE, "when": "pose.x > 3"},
            "'when' (pose.x > 3): geometry_msgs/PoseStamped has no field 'pose.x'",
        ),
        (
            {**POSE, "when": "header.frame_id > 3"},
            "the condition 'header.frame_id > 3' has no value",
        ),
        ({**TEXT, "outside": True}, "std_msgs/String has no field 'id' and no header"),
        ({**POSE, "json": "pose"}, "'json': the field 'pose' is not a string"),
        ({**POSE, "id": "pose.position.x"}, "'pose.position.x' cannot identify a task"),
        ({**POSE, "id": "number"}, "'id': geometry_msgs/PoseStamped has no field 'number'"),
        ({**POSE, "topic": "po se"}, "'po se' is not a legal name of a topic"),
    ],
)
def test_an_event_that_does_not_fit_is_refused(tmp_path, capsys, event, why):
    code, ((severity, text),) = check(tmp_path, capsys, **event)
    assert (code, severity) == (1, "refused")
    assert text.startswith("event 'go'")
    assert why in text


def test_a_type_that_is_not_known_here_is_said(tmp_path, capsys):
    code, ((severity, text),) = check(tmp_path, capsys, topic="x", type="no_such/Thing")
    assert (code, severity) == (0, "warning")
    assert text.startswith("event 'go': ")
    assert "message type 'no_such/Thing'" in text
    assert text.endswith("its messages were not checked")
