"""The two input forms of the thesis, read without a change (4.1.3, 4.3.6)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict

import pytest

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.registry import write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.plan import FunctionAction, ServerAction, Synchronisation

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
        NetBuilder("net").place("p1", 2).place("p2", 1).place("r1", 3)
        .exponential("t1", inputs="p1", outputs=["p2", "r1"])
        .immediate("t2", inputs="p2", outputs="p1").immediate("t3", inputs="p2", outputs="p1").build()
    )  # fmt: skip
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
        ("robot_1", "p2"), ("robot_2", "p1"), ("robot_3", "p1")]  # fmt: skip
    assert plan.policy.places == ("p2", "p1")
    assert plan.policy.rows[0].counts == (1, None)
    assert plan.seed == 0
    assert any("net.xml does not exist; took" in note for note in plan.notes)


def test_the_ros_form_with_values_that_are_json_already(folder: Path) -> None:
    data = dict(ROS, place_to_client_mapping={"p1": ["ExecGSPN", "s1"], "p2": ["ExecGSPN", "s2"]},
                resources_list=["r1"], places_tuple=["p2", "p1"], full_synchronization=False)  # fmt: skip
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
