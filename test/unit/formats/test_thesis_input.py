"""The two input forms of the thesis, read without a change (4.1.3, 4.3.6)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict

import pytest

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.formats.plan_file import read_net_or_plan, read_plan
from gspn_framework_package.formats.registry import write_net
from gspn_framework_package.model.action import FunctionAction, ServerAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.plan import Synchronisation

ROS: Dict[str, Any] = {
    "gspn": "/home/somebody/catkin_ws/src/plan/net.xml",
    "place_to_client_mapping": "{'p1': ['ExecGSPN', 'action_server_1'], 'p2': ['ExecGSPN', 'action_server_2']}",
    "resources_list": "['r1']",
    "places_tuple": "('p2','p1')",
    "policy_dictionary": "{('1', '-'): {'t2': 1}, (0, 2): {'t2': '0.25', 't3': 0.75}}",
    "full_synchronization": "True",
}
STANDALONE: Dict[str, Any] = {
    "project_path": "/home/somebody/project",
    "gspn": "net.xml",
    "place_to_function_mapping": {"p1": "work.count", "p2": "work.list", "r1": None},
    "places_tuple": ["p1", "p2"],
    "policy_dictionary": {"('-', '-')": {"t2": 1.0}},
}


@pytest.fixture()
def folder(tmp_path: Path) -> Path:
    net = (
        NetBuilder("net")
        .place("p1", 2)
        .place("p2", 1)
        .place("r1", 3)
        .exponential("t1", inputs="p1", outputs=["p2", "r1"])
        .immediate("t2", inputs="p2", outputs="p1")
        .immediate("t3", inputs="p2", outputs="p1")
        .build()
    )
    write_net(net, tmp_path / "net.xml", "pipe")
    return tmp_path


def write(folder: Path, data: Dict[str, Any]) -> str:
    path = folder / "input.json"
    path.write_text(json.dumps(data))
    return str(path)


def test_the_ros_form(folder: Path) -> None:
    plan = read_plan(write(folder, ROS))
    assert plan.actions["p1"] == ServerAction(
        "gspn_framework_package/ExecGSPNAction", "action_server_1"
    )
    assert plan.resource_places == {"r1"}
    assert plan.synchronisation is Synchronisation.FULL
    assert [(r.name, r.place) for r in plan.robots] == [
        ("robot_1", "p2"),
        ("robot_2", "p1"),
        ("robot_3", "p1"),
    ]
    assert plan.policy.places == ("p2", "p1")
    assert plan.policy.rows[0].counts == (1, None)
    assert plan.seed == 0
    assert any("net.xml does not exist; took" in note for note in plan.notes)


def test_the_ros_form_with_values_that_are_json_already(folder: Path) -> None:
    data = dict(
        ROS,
        place_to_client_mapping={"p1": ["ExecGSPN", "s1"], "p2": ["ExecGSPN", "s2"]},
        resources_list=["r1"],
        places_tuple=["p2", "p1"],
        full_synchronization=False,
    )
    assert read_plan(write(folder, data)).synchronisation is Synchronisation.PARTIAL


def test_the_standalone_form(folder: Path) -> None:
    plan = read_plan(write(folder, STANDALONE))
    assert plan.actions["p1"] == FunctionAction("work.count", "p1")
    assert plan.folder == str(folder)
    assert [r.name for r in plan.robots][:3] == ["1", "2", "3"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"full_synchronization": None}, "full_synchronization: None is not True or False"),
        ({"full_synchronization": "perhaps"}, "'perhaps' is not True or False"),
        ({"resources_list": "[open('x')]"}, "is not a Python literal"),
        ({"places_tuple": "('p1', 3)"}, "is not a list of names"),
        ({"policy_dictionary": "{('1',): {'t2': 1}}"}, "policy row 1: 1 cells for 2 places"),
        ({"policy_dictionary": "{('>= 1', '-'): {'t2': 1}}"}, "row 1: '>= 1' is not a number"),
        ({"policy_dictionary": "[1]"}, "is not a dictionary from markings"),
        ({"place_to_client_mapping": "{'p1': 'server'}"}, r"is not \[action type, server name\]"),
        ({"gspn": "/gone/other.xml"}, "other.xml does not exist, and there is no other.xml beside"),
    ],
)
def test_what_cannot_be_read_is_named(folder: Path, change: Dict[str, Any], message: str) -> None:
    with pytest.raises(GspnError, match=message) as caught:
        read_plan(write(folder, dict(ROS, **change)))
    assert caught.value.exit_code == 2


def test_a_missing_key_is_named(folder: Path) -> None:
    data = dict(ROS)
    del data["resources_list"]
    with pytest.raises(GspnError, match="the key 'resources_list' is missing"):
        read_plan(write(folder, data))


def test_policy_rows_that_no_robot_can_ask_for_are_left_out_with_a_note(folder: Path) -> None:
    """Files of the thesis fill in the policy for illustration where there is nothing to decide."""
    policy = {
        "('-', '-')": {"t1": 1},  # exponential
        "(1, '-')": {"t9": 1},  # not in the net
        "(2, '-')": {"t1": 0.5, "t2": 0.125, "t3": 0.375},
        "(3, '-')": {"t1": 1, "t2": 0},
    }
    plan = read_plan(write(folder, dict(STANDALONE, policy_dictionary=policy)))
    assert [(row.counts, row.choices) for row in plan.policy.rows] == [
        ((2, None), (("t2", 0.25), ("t3", 0.75)))
    ]
    timed = "left out 't1', which is exponential: a policy chooses among immediate transitions"
    assert [note for note in plan.notes if "policy row" in note] == [
        "policy row 1: %s; and so the row, which has no other choice" % timed,
        "policy row 2: left out 't9', which the net does not have; and so the row, which has no other choice",
        "policy row 3: %s" % timed,
        "policy row 4: %s; and so the row, which has no other choice" % timed,
    ]


def test_a_row_that_is_no_distribution_is_refused_whatever_it_names(folder: Path) -> None:
    policy = {"('-', '-')": {"t1": 0.7, "t2": 0.7}}
    with pytest.raises(GspnError, match="policy row 1: the probabilities sum to 1.4"):
        read_plan(write(folder, dict(STANDALONE, policy_dictionary=policy)))


def test_actions_that_no_robot_comes_to_are_left_out_with_a_note(folder: Path) -> None:
    mapping = {place: ["ExecGSPN", "server_" + place] for place in ("p1", "p2", "r1", "gone")}
    data = dict(ROS, place_to_client_mapping=str(mapping), resources_list="['r1', 'gone']")
    plan = read_plan(write(folder, data))
    assert sorted(plan.actions) == ["p1", "p2"]
    assert plan.resource_places == {"r1"}
    for note in (
        "place_to_client_mapping: the action of 'r1' was left out: that is a resource place",
        "place_to_client_mapping: 'gone' was left out: the net has no such place",
        "resources_list: 'gone' was left out: the net has no such place",
    ):
        assert note in plan.notes
    assert check(plan).exit_code == 0


def test_a_plan_of_our_own_stays_strict_about_its_policy_and_actions(folder: Path) -> None:
    own: Dict[str, Any] = {
        "net": "net.xml",
        "resource_places": ["r1"],
        "actions": {"p1": None, "p2": None},
    }
    policy = {"places": ["p1"], "rows": [{"marking": ["-"], "choose": {"t1": 1}}]}
    with pytest.raises(GspnError, match="'t1' is an exponential transition"):
        read_plan(write(folder, dict(own, policy=policy)))
    with pytest.raises(GspnError, match="the net has no place 'gone'"):
        read_plan(write(folder, dict(own, actions={"p1": None, "p2": None, "gone": None})))
    assert check(
        read_plan(write(folder, dict(own, actions={"p1": None, "p2": None, "r1": None})))
    ).refused


@pytest.mark.parametrize(
    "data",
    [
        {"gspn": "net.xml"},
        {"project_path": "/gone", "gspn": "net.xml"},
        {
            "gspn": "/gone/net.xml",
            "place_to_function_mapping": "",
            "places_tuple": "",
            "policy_dictionary": "",
        },
        dict(STANDALONE, place_to_function_mapping={}, policy_dictionary={}),
    ],
    ids=["net", "project", "empty", "no mapping"],
)
def test_an_input_without_a_mapping_is_its_net(folder: Path, data: Dict[str, Any]) -> None:
    """To look at a net, or to simulate it, neither a mapping nor a policy is needed (5.3)."""
    found = read_net_or_plan(write(folder, data))
    assert found.plan is None
    assert [place.name for place in found.net.places] == ["p1", "p2", "r1"]
    assert "taken for a net, not for a plan: it maps no place to an action" in found.notes


def test_a_mapping_and_a_policy_that_mean_nothing_leave_a_net_where_that_will_do(
    folder: Path,
) -> None:
    path = write(
        folder,
        dict(STANDALONE, place_to_function_mapping="{'p1': 'nothing'}", policy_dictionary="?"),
    )
    with pytest.raises(GspnError, match="'\\?' is not a Python literal"):
        read_net_or_plan(path)
    found = read_net_or_plan(path, net_will_do=True)
    assert found.plan is None
    assert (
        "taken for a net, not for a plan: policy_dictionary: '?' is not a Python literal"
        in found.notes
    )
    assert read_net_or_plan(write(folder, STANDALONE), net_will_do=True).plan is not None


def test_an_input_without_a_mapping_is_no_plan(folder: Path) -> None:
    with pytest.raises(GspnError, match="the key 'place_to_function_mapping' is missing"):
        read_plan(write(folder, {"project_path": ".", "gspn": "net.xml"}))
