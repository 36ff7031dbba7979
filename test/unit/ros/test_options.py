"""The private parameters of a node."""

import os
from dataclasses import replace

import pytest

pytest.importorskip("rospy")

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan, RobotSpec, Transport
from gspn_framework_package.ros.node_main import robot_of
from gspn_framework_package.ros.options import launched_file, options_from
from gspn_framework_package.team.patience import Patience


def test_what_is_not_given_has_its_default():
    options = options_from({"plan": "folder", "robot": "robot_1"})
    assert (options.run, options.robots, options.place_servers, options.server_timeout) == (
        "run",
        0,
        True,
        10.0,
    )


def test_numbers_and_names_of_yaml_are_taken_as_meant():
    options = options_from(
        {"plan": "folder", "run": 42, "robot": 7, "server_timeout": 9, "result_timeout": 0.5}
    )
    assert (options.run, options.robot, options.patience) == (
        "42",
        "7",
        Patience(9.0, 3.0, 5.0, 0.5),
    )


@pytest.mark.parametrize(
    "given, message",
    [
        ({}, "no plan was given"),
        ({"plan": "p", "plam": "q"}, "~plam: unknown parameter .known parameters: plan, robot"),
        ({"plan": "p", "robots": "three"}, "~robots: 'three' is not of type int"),
        ({"plan": "p", "robots": True}, "~robots: True is not of type int"),
        ({"plan": "p", "check": "no"}, "~check: 'no' is not of type bool"),
        ({"plan": True}, "~plan: True is not of type str"),
        ({"plan": "p", "run": "a/b"}, "~run: 'a/b' is not a valid name for a run"),
        ({"plan": "p", "run": ".."}, "is not a valid name for a run"),
    ],
)
def test_what_is_wrong_is_said(given, message):
    with pytest.raises(UsageError, match=message):
        options_from(given)


def test_the_plan_of_the_room_is_taken_while_there_is_a_room():
    given = {"plan": "plan.json", "room_plan": "room.json"}
    assert [options_from(given, room=room).plan for room in (False, True)] == [
        "plan.json",
        "room.json",
    ]
    assert options_from({"plan": "plan.json"}, room=True).plan == "plan.json"


def test_the_log_is_in_the_folder_of_the_run(monkeypatch):
    monkeypatch.setenv("ROS_HOME", "/home/of/ros")
    options = options_from({"plan": "p", "run": "monday"})
    assert options.log_file("carol") == os.path.join(
        "/home/of/ros", "gspn", "monday", "carol.jsonl"
    )
    assert options._replace(log_dir="/logs").log_file("carol") == os.path.join(
        "/logs", "monday", "carol.jsonl"
    )


@pytest.fixture
def plan():
    net = NetBuilder().place("P1", tokens=2).build()
    robots = (RobotSpec("carol", "P1"), RobotSpec("dave", "P1"))
    return Plan(net, robots=robots, spawn=("P1",), witness=("judge",))


@pytest.mark.parametrize(
    "given, robot",
    [
        ({"robot": "dave"}, "dave"),
        ({"number": 1}, "carol"),
        ({"robots": 3, "number": 3}, "robot_3"),
        ({"robot": "judge"}, "judge"),
        ({"robot": "erin", "place": "P1"}, "erin"),
    ],
)
def test_which_robot_is_meant(plan, given, robot):
    assert robot_of(plan, options_from({"plan": "p", **given}))[1] == robot


@pytest.mark.parametrize(
    "given, message",
    [
        ({}, "which robot is this"),
        ({"robot": "erin"}, "the plan has no robot 'erin'.*carol, dave"),
        ({"number": 3}, "no robot 3 in a team of 2"),
        ({"robots": 1, "robot": "dave"}, "no robot 'dave'"),
    ],
)
def test_a_robot_that_cannot_be_meant(plan, given, message):
    with pytest.raises(UsageError, match=message):
        robot_of(plan, options_from({"plan": "p", **given}))


def test_a_file_is_looked_for_where_roslaunch_was_started_too(tmp_path, monkeypatch):
    """roslaunch has its nodes run in ~/.ros."""
    shell, node = tmp_path / "shell", tmp_path / "node"
    for folder in (shell / "plans" / "mine", node / "own"):
        folder.mkdir(parents=True)
    monkeypatch.chdir(node)
    monkeypatch.setenv("PWD", str(shell))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert launched_file("plans/mine", "~plan") == str(shell / "plans" / "mine")
    assert launched_file("own", "~plan") == "own"
    assert launched_file("~/shell", "~plan") == str(shell)
    assert launched_file("/no/such/plan", "~plan") == "/no/such/plan"  # whoever reads it says so
    with pytest.raises(UsageError) as caught:
        launched_file("plans/other", "~plan")
    for part in ("~plan", "plans/other", str(node), str(shell), '"$PWD/plans/other"'):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"transport": "pigeon"}, "unknown transport 'pigeon'"),
        ({"transport": "zenoh"}, "needs a router"),
        ({"router": "tcp/x:1"}, "cannot be used with the transport ros"),
        ({"keys": "keys"}, "cannot be used with the transport ros"),
        (
            {"transport": "zenoh", "router": "tcp/x:1", "team_key_file": "k"},
            "a team key cannot be used with the transport zenoh",
        ),
        ({"team_key_file": "no/such.key"}, "~team_key_file"),
    ],
)
def test_a_transport_that_makes_no_sense_is_refused(plan, given, says):
    with pytest.raises(UsageError, match=says):
        options_from({"plan": "p", **given}).for_plan(plan)


def test_a_robot_takes_the_transport_of_its_plan_unless_it_is_given_one(plan, tmp_path):
    on_zenoh = replace(plan, transport=Transport.ZENOH)
    with_router = options_from({"plan": "p", "router": "tcp/x:1", "keys": str(tmp_path)})
    assert options_from({"plan": "p"}).for_plan(plan).transport == "ros"
    assert with_router.for_plan(on_zenoh).transport == "zenoh"
    assert with_router._replace(transport="zenoh").for_plan(plan).transport == "zenoh"
    assert options_from({"plan": "p", "transport": "ros"}).for_plan(on_zenoh).transport == "ros"
    with pytest.raises(UsageError, match="needs a router"):
        options_from({"plan": "p"}).for_plan(on_zenoh)
    with pytest.raises(UsageError, match="~keys"):
        with_router._replace(keys="no/such/keys").for_plan(on_zenoh)
