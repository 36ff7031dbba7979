"""Doors, lifts, parking and the size of robots in plans of maps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Mapping

import pytest
import yaml

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.state_space.space import explore
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.site_plan import SitePlan, build_site_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.testing import Scenario

HALLS = "nodes: {west: [0, 0], mid: [5, 0], east: [10, 0]}\nedges: [[west, mid], [mid, east]]\n"
OPEN = {"seconds": 4, "action": {"service": "/gate/open", "type": "std_srvs/Trigger"}}
GATE = {"edges": ["mid_east"], "open": OPEN, "close": {"seconds": 2}}
BOTH_ENDS: Dict[str, Any] = {
    "start": ["west"],
    "tasks": {
        "Pick": {"at": ["west"], "seconds": 5.0, "again_after": 20.0},
        "Drop": {"at": ["east"], "seconds": 5.0, "again_after": 20.0},
    },
}


def built(folder: Path, text: str, tasks: Mapping[str, Any], robots: int = 2) -> SitePlan:
    (folder / "map.yaml").write_text(text)
    (folder / "tasks.yaml").write_text(json.dumps(tasks))
    made = build_site_plan(str(folder / "map.yaml"), str(folder / "tasks.yaml"), robots)
    made.write(str(folder / "made"))
    return made


def written(folder: Path) -> Plan:
    plan = read_plan(str(folder / "made"))
    assert check(plan).exit_code == 0
    return plan


def most_robots(plan: Plan, places: List[str]) -> int:
    """The largest number of robots that are ever in all of these places together."""
    names = [place.name for place in plan.net.places]
    columns = [names.index(place) for place in places]
    return max(sum(int(m[c]) for c in columns) for m in explore(plan.net).markings())


@pytest.mark.parametrize("where", ["map", "tasks"])
def test_robots_open_a_door_before_they_drive_and_close_it_behind_them(
    tmp_path: Path, where: str
) -> None:
    doors = {"doors": {"gate": GATE}}
    text = HALLS + (yaml.safe_dump(doors) if where == "map" else "")
    made = built(tmp_path, text, {**BOTH_ENDS, **(doors if where == "tasks" else {})})
    plan = written(tmp_path)
    inside = [
        "Open_gate_mid_east", "Drive_mid_east", "Close_gate_mid_east",
        "Open_gate_east_mid", "Drive_east_mid", "Close_gate_east_mid",
    ]  # fmt: skip
    assert most_robots(plan, inside) == 1
    for place in inside:
        assert "Free_door_gate" in plan.on_evict[place]
    assert plan.durations["Open_gate_mid_east"].mean == 4.0
    assert made.ros_actions["Open_gate_mid_east"] == OPEN["action"]
    assert made.ros_actions["Close_gate_east_mid"]["function"] == "actions.TakeTime"
    assert all(node.position for node in (*plan.net.places, *plan.net.transitions))
    run = Scenario(plan, functions=True, drawn=True)
    run.until_fired("Finished_Drop_east")
    run.until_fired("Closed_gate_east_mid")
    passing = [name for name in run.fired if name.endswith(("_mid_east", "_east_mid"))]
    first = [name for name in passing if name.endswith("_mid_east")][:4]
    assert first == [
        "Go_mid_east", "Opened_gate_mid_east", "Arrive_mid_east", "Closed_gate_mid_east"
    ]  # fmt: skip
    assert read_plan(str(tmp_path / "made" / "plan_ros.json")).net == plan.net


def test_a_door_without_actions_is_only_exclusive(tmp_path: Path) -> None:
    doors = {"gate": {"edges": ["west_mid", "mid_east"], "capacity": 2}}
    built(tmp_path, HALLS, {**BOTH_ENDS, "doors": doors, "capacity": None}, robots=3)
    plan = written(tmp_path)
    assert not [name for name in plan.actions if name.startswith(("Open_", "Close_"))]
    assert most_robots(plan, [name for name in plan.actions if name.startswith("Drive_")]) == 2


def test_a_lift_is_taken_until_its_robot_has_left_and_closed_it(tmp_path: Path) -> None:
    lift = {"nodes": ["mid"], "open": OPEN, "close": {"seconds": 2}}
    built(tmp_path, HALLS, {**BOTH_ENDS, "doors": {"lift": lift}}, robots=3)
    plan = written(tmp_path)
    assert most_robots(plan, [n for n in plan.actions if n.count("_") > 1 or n == "At_mid"]) == 1
    opened = {name for name in plan.actions if name.startswith("Open_")}
    closed = {name for name in plan.actions if name.startswith("Close_")}
    # it is opened on the way in, and closed on the way out
    assert opened == {"Open_lift_west_mid", "Open_lift_east_mid"}
    assert closed == {"Close_lift_mid_west", "Close_lift_mid_east"}
    assert "Free_door_lift" in plan.on_evict["At_mid"]


@pytest.mark.parametrize("topic", [None, {"below": {"low": 0.4}, "empty": 0.05}])
def test_a_door_is_closed_at_any_level_of_the_battery(tmp_path: Path, topic: Any) -> None:
    tasks = {
        **BOTH_ENDS,
        "doors": {"gate": GATE},
        "battery": {"full": 0.2, "low": 0.2},
        "docks": {"west": 1},
        **({} if topic is None else {"battery_topic": topic}),
    }
    built(tmp_path, HALLS, tasks)
    plan = written(tmp_path)
    inside = [
        name
        for name in plan.actions
        if name.startswith(("Open_", "Close_", "Drive_mid_east", "Drive_east_mid"))
    ]
    assert "Close_gate_mid_east_low" in inside
    assert most_robots(plan, inside) == 1


def test_idle_robots_park_and_those_that_are_not_full_charge(tmp_path: Path) -> None:
    tasks = {
        "tasks": {"Drop": {"at": ["mid"], "seconds": 5.0, "again_after": 1e6}},
        "parking": ["east"],
        "docks": {"west": 1},
        "battery": {"full": 0.5, "low": 0.1},
    }
    built(tmp_path, HALLS, tasks, robots=1)
    plan = written(tmp_path)
    assert plan.net.place("At_east_full").tokens == 1
    run = Scenario(plan)
    run.action("Drive_east_mid_full", result="Arrive_east_mid_full")
    run.action("Drive_mid_east_full", result="Arrive_mid_east_full")
    run.until_fired("Arrive_mid_east_full")
    run.advance(1000.0)
    assert run.marking["At_east_full"] == 1
    low = Scenario(plan)
    low.action("Drive_east_mid_full", result="Drain_east_mid_full")
    low.action("Drive_mid_west_low", result="Arrive_mid_west_low")
    low.until_fired("Dock_west_low")


AREA = "[{x: -0.3, y: -0.3}, {x: 0.3, y: -0.3}, {x: 0.3, y: 0.3}]"
TOPOLOGICAL = (
    """
- node: {name: wide, verts: %s, pose: {position: {x: 0, y: 0}}, edges: [{node: b}, {node: c}]}
- node: {name: b, pose: {position: {x: 3, y: 0}}, edges: [{node: wide}]}
- node:
    name: c
    pose: {position: {x: 0, y: 3}}
    edges: [{node: wide}]
    properties: {xy_goal_tolerance: 0.1}
"""
    % AREA
)


@pytest.mark.parametrize(
    "diameter, more, limited",
    [
        (None, {}, {}),
        (0.4, {}, {"b": 1, "c": 1}),
        (0.1, {}, {"b": 1}),
        (0.9, {}, {"wide": 1, "b": 1, "c": 1}),
        (0.4, {"nodes": {"b": {"capacity": None}}}, {"c": 1}),
        (0.4, {"node_capacity": 3}, {"wide": 3, "b": 3, "c": 3}),
        (0.4, {"docks": {"b": 2}}, {"b": 2, "c": 1}),
        (0.4, {"docks": {"b": 2}, "battery": {"full": 0.1, "low": 0.1}}, {"c": 1}),
    ],
)
def test_where_two_robots_have_no_room_there_is_one(
    tmp_path: Path, diameter: Any, more: Dict[str, Any], limited: Dict[str, int]
) -> None:
    size = {} if diameter is None else {"diameter": diameter}
    tasks = {"tasks": {"Look": {"at": ["b", "c"], "seconds": 5}}, "start": ["wide"]}
    made = built(tmp_path, TOPOLOGICAL, {**tasks, **size, **more}, robots=1)
    found = {
        place[len("Free_node_") :]: limit.capacity
        for place, limit in made.limits.items()
        if place.startswith("Free_node_")
    }
    assert found == limited
    single = [name for name, capacity in limited.items() if capacity == 1]
    notes = [note for note in made.notes if "have no room there" in note]
    assert len(notes) == bool(single)
    for note in notes:
        assert "one robot at a time" in note and ", ".join(single) in note


BAD = {
    "gate: {edges: [mid_east], capacity: 2, open: {seconds: 1}}": (
        "a robot would close the door before others", "capacity",
    ),
    "gate: {edges: [mid_est]}": ("there is no edge 'mid_est' in the map", "gate"),
    "gate: {nodes: [est]}": ("there is no node 'est' in the map", "gate"),
    "gate: {}": ("no edge leads through the door", "gate"),
    "gate: {edges: [mid_east], open: {}}": ("'seconds' is a required property", "open"),
    "gate: {edges: [mid_east], opens: 1}": ("'opens' was unexpected", "gate"),
    "the_gate: {edges: [mid_east]}": ("does not match", "doors"),
    "[mid_east]": ("is not of type 'object'", "doors"),
}  # fmt: skip


@pytest.mark.parametrize("text", BAD)
@pytest.mark.parametrize("where", ["map", "tasks"])
def test_bad_doors_are_errors_with_their_line(tmp_path: Path, text: str, where: str) -> None:
    said, element = BAD[text]
    content = "doors:\n  %s\n" % text
    whole, tasks = (HALLS + content, "plan: x\n") if where == "map" else (HALLS, content)
    (tmp_path / "map.yaml").write_text(whole)
    (tmp_path / "tasks.yaml").write_text(tasks)
    with pytest.raises(InputError, match=said) as caught:
        build_site_plan(str(tmp_path / "map.yaml"), str(tmp_path / "tasks.yaml"), 1)
    assert caught.value.file == str(tmp_path / ("%s.yaml" % where))
    assert caught.value.line is not None and element in str(caught.value.element)


def test_a_parking_where_nobody_gets_is_an_error(tmp_path: Path) -> None:
    text = HALLS.replace("east: [10, 0]", "east: [10, 0], far: [20, 0]")
    with pytest.raises(InputError, match="to node 'far', where robots should park"):
        built(tmp_path, text, {**BOTH_ENDS, "parking": ["far"]})


def test_robots_in_one_node_have_a_slot_each(tmp_path: Path) -> None:
    text = HALLS.replace("[5, 0]", "{x: 5, y: 0, slots: [[5, 1], [5, -1, 1.5]]}")
    made = built(tmp_path, text, {**BOTH_ENDS, "diameter": 0.4}, robots=1)
    assert made.limits["Free_node_mid"].capacity == 2
    assert not [note for note in made.notes if "slot" in note]
    ros = read_plan(str(tmp_path / "made" / "plan_ros.json"))
    action = ros.actions["Drive_west_mid"]
    assert isinstance(action, FunctionAction)
    slots = [[5.0, 1.0, 0.0], [5.0, -1.0, 1.5]]
    assert action.settings == {"slots": slots, "then": "Arrive_west_mid", "radius": 0.2}


def test_a_node_with_too_few_slots_is_noted(tmp_path: Path) -> None:
    text = HALLS.replace("[5, 0]", "{x: 5, y: 0, capacity: 3, slots: [[5, 1]]}")
    assert "mid has 1 slots for more robots" in built(tmp_path, text, BOTH_ENDS).notes


@pytest.mark.parametrize("slots", ["[5, 1]", "[[5]]", "[[5, east]]", "yes"])
def test_a_slot_that_is_no_pose_is_refused(tmp_path: Path, slots: str) -> None:
    text = HALLS.replace("[5, 0]", "{x: 5, y: 0, slots: %s}" % slots)
    with pytest.raises(InputError) as caught:
        built(tmp_path, text, BOTH_ENDS)
    assert caught.value.file == str(tmp_path / "map.yaml")
    assert "mid" in caught.value.element
