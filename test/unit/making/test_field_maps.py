"""Maps in the shapes that are found in the field: each is read, or refused with the line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Optional

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.restrictions import Restriction
from gspn_framework_package.making.site_map import read_map
from gspn_framework_package.making.site_plan import SitePlan, build_site_plan
from gspn_framework_package.model.errors import ExpressionError, InputError
from gspn_framework_package.testing import Scenario


def entry(name: str, x: float, *edges: Dict[str, Any], **more: Any) -> Dict[str, Any]:
    """A node of a .tmap2 file, with the keys that all of them have."""
    meta = {"map": "m", "node": name, "pointset": "m", **more.pop("meta", {})}
    pose = {"position": {"x": x, "y": -1.5, "z": 0.0}, "orientation": {"w": 1.0}}
    return {"meta": meta, "node": {"name": name, "pose": pose, "edges": list(edges), **more}}


def written(folder: Path, content: Any, name: str = "map.tmap2") -> str:
    path = folder / name
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return str(path)


def built(folder: Path, content: Any, tasks: Optional[Dict[str, Any]], robots: int = 2) -> SitePlan:
    path = None if tasks is None else written(folder, tasks, "tasks.yaml")
    return build_site_plan(written(folder, content), path, robots)


def two(edge: Dict[str, Any], **more: Any) -> Dict[str, Any]:
    """A map of two nodes and an edge between them."""
    return {"nodes": [entry("A", 0.0, {"node": "B", **edge}), entry("B", 4.0)], **more}


GOAL = {"target_pose": {"header": {"frame_id": "$node.parent_frame"}, "pose": "$node.pose"}}

#: shape -> edge from A to B, and what else is in the map -> type, server, speed of the drive
EDGES: Dict[str, Any] = {
    "strings": ({"action": "move_base", "action_type": "move_base_msgs/MoveBaseGoal", "goal": GOAL,
                 "restrictions_planning": "True", "restrictions_runtime": "obstacleFree_1"}, {},
                "move_base_msgs/MoveBaseAction", "move_base", None),
    "booleans": ({"action": "move_base", "restrictions_planning": True}, {},
                 "move_base_msgs/MoveBaseAction", "move_base", None),
    "nothing": ({}, {}, "move_base_msgs/MoveBaseAction", "move_base", None),
    "nulls": ({"action": None, "goal": None, "config": None, "restrictions_planning": None}, {},
              "move_base_msgs/MoveBaseAction", "move_base", None),
    "no id": ({"edge_id": "", "map_2d": "", "action": "move_base", "top_vel": 0.55}, {},
              "move_base_msgs/MoveBaseAction", "move_base", 0.55),
    "settings as a mapping": ({"action": "undock", "action_type": "undock_msgs/UndockGoal",
                               "config": {"inflation_radius": 0.0, "top_vel": 0.3},
                               "goal": {"target_pose": "$node.pose"},
                               "restrictions": {"robot_type": "", "task_name": ""}}, {},
                              "undock_msgs/UndockAction", "undock", 0.3),
    "settings as a list": ({"action": "row_traversal", "fail_policy": "fail", "config": [
        {"namespace": "row_traversal", "name": "in_row", "value": True, "reset": False}],
        "action_type": "move_base_msgs/MoveBaseGoal"}, {},
        "move_base_msgs/MoveBaseAction", "row_traversal", None),
    "the pose without a header": ({"action_type": "move_base_msgs/MoveBaseGoal",
                                   "goal": {"target_pose": "$node.pose"}}, {},
                                  "move_base_msgs/MoveBaseAction", "move_base", None),
    "a server in a namespace": ({"action": "row_change/move_base",
                                 "action_type": "move_base_msgs/MoveBaseGoal"}, {},
                                "move_base_msgs/MoveBaseAction", "row_change/move_base", None),
    "not an action type": ({"action": "NavigateToPose", "action_type": "geometry_msgs/PoseStamped",
                            "goal": GOAL}, {},
                           "move_base_msgs/MoveBaseAction", "NavigateToPose", None),
    "a type of ROS 2": ({"action": "NavigateToPose", "goal": GOAL,
                         "action_type": "nav2_msgs/action/NavigateToPose"}, {},
                        "nav2_msgs/NavigateToPoseAction", "NavigateToPose", None),
    "actions of their own": ({"action": "go", "properties": {"max_speed": 0.8}}, {
        "transformation": {"topo_frame_id": "farm", "parent": "map"},
        "definitions": {"tree": "<root/>"},
        "actions": {"go": {"action_type": "nav2_msgs.action.NavigateToPose",
                           "action_server": "/navigate_to_pose",
                           "action_goal_template": {
                               "pose": {"header": {"frame_id": "${node.nav_frame}"},
                                        "pose": "${node.pose}"},
                               "behavior_tree": "${definitions.tree}"}}}},
        "nav2_msgs/NavigateToPoseAction", "/navigate_to_pose", 0.8),
}  # fmt: skip


@pytest.mark.parametrize("shape", EDGES)
def test_edges_of_all_shapes_become_goals(tmp_path: Path, shape: str) -> None:
    edge, more, type_, server, speed = EDGES[shape]
    path = written(tmp_path, two(edge, **more))
    assert read_map(path).edges[0].speed == speed
    drive = build_site_plan(path, None, 1).ros_actions["Drive_A_B"]
    assert (drive["type"], drive["server"]) == (type_, server)
    assert "$" not in json.dumps(drive)
    if type_.startswith("move_base"):
        assert drive["goal"]["target_pose"]["header"]["frame_id"] == "map"
        assert drive["goal"]["target_pose"]["pose"]["position"] == {"x": 4.0, "y": -1.5, "z": 0.0}
    if more:
        assert drive["goal"]["pose"]["header"]["frame_id"] == "farm"
        assert drive["goal"]["behavior_tree"] == "<root/>"


def test_a_long_list_of_shared_zones_and_a_lonely_node(tmp_path: Path) -> None:
    text = """
verts:
  verts:
  - verts: &zone [{x: 0.1, y: 0.2}, {x: -0.2, y: 0.1}]
meta: {last_updated: 0}
name: field
nodes:
- meta: {map: m, node: t0-r1-c2, pointset: old}
  node: {name: t0-r1-c2, verts: *zone, pose: {position: {x: -379.5, y: -1e2}}, edges: [{node: B}]}
- meta: {map: m, node: B, pointset: new}
  node: {name: B, pose: {position: {x: -370, y: -100}, orientation: {w: 0.707, z: 0.707}}}
- {meta: {map: m, node: C}, node: {verts: *zone, pose: {position: {x: 0, y: 0}}, edges: []}}
"""
    site = read_map(written(tmp_path, text))
    assert list(site.nodes) == ["t0-r1-c2", "B", "C"] and len(site.edges) == 1
    assert site.nodes["t0-r1-c2"].y == -100.0
    assert "several pointsets are read as one map: old, new" in site.notes


def test_a_graph_whose_edges_have_names(tmp_path: Path) -> None:
    text = "nodes: {v1: {x: 0, y: 0, tags: end}, v2: {x: 3, y: 4}}\nedges: {e12: [v1, v2]}\n"
    site = read_map(written(tmp_path, text, "graph.yaml"))
    assert [(e.source, e.target, e.length) for e in site.edges][0] == ("v1", "v2", 5.0)
    assert site.nodes["v1"].tags == ["end"]


REFUSED = {
    "nodes:\n- node: {name: A, pose: {position: {x: 0, y: 0}},\n    edges: [{node: gone}]}\n": (
        3, "there is no node 'gone'", "remove the edge from 'A' to 'gone'"),
    "nodes:\n- meta: {node: !!python/unicode 'A'}\n": (2, "'!!python/unicode'", "without the tag"),
    "nodes:\n- node:\n    name: A\n    pose: {position: {x: 0, y: 0}}\n    restrictions_planning: "
    "robot_short &\n": (5, "'robot_short &' is not a restriction", "robot_short & ~robot_tall"),
    "nodes:\n- node:\n    name: A\n    pose: {position: {x: 0, y: 0}}\n    edges:\n    - node: A\n"
    "      action: {name: go}\n": (7, "not the name of an action", ""),
    "nodes:\n- meta: {pointset: a}\n  node: {name: A, pose: {position: {x: 0, y: 0}}}\n"
    "- meta: {pointset: b}\n  node: {name: A, pose: {position: {x: 0, y: 0}}}\n": (
        5, "the node 'A' is there twice", "make a separate map of each"),
    "nodes:\n- meta:\n    tag: {a: b}\n  node: {name: A, pose: {position: {x: 0, y: 0}}}\n": (
        3, "not a list of tags", ""),
    "nodes:\n- node:\n    name: A\n    pose:\n      position: {x: 0, y: 0}\n      orientation: {w: up}\n": (
        6, "'up' is not a number", ""),
    "- name: A\n  x: 1\n  y: 2\n": (1, "the node 'A' has no pose with a position", ""),
}  # fmt: skip


@pytest.mark.parametrize("text", REFUSED)
def test_what_is_not_read_is_refused_with_its_line(tmp_path: Path, text: str) -> None:
    line, said, hint = REFUSED[text]
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=said) as caught:
        read_map(path)
    assert (caught.value.file, caught.value.line) == (path, line)
    assert hint in (caught.value.hint or "")


# -- restrictions

SHORT_ONLY = ("robot_short", "'short' in robot", "robot == 'short'", "['short', 'small']",
              "robot_short & ~robot_tall", "not robot_tall", "robot in ['short']")  # fmt: skip


@pytest.mark.parametrize("text", SHORT_ONLY)
def test_restrictions_to_a_type_of_robot(text: str) -> None:
    restriction = Restriction(text)
    assert restriction.holds("Short") is True and restriction.holds("tall") is False
    assert restriction.holds() is None


def test_restrictions_that_stay_open_until_somebody_says_it() -> None:
    assert Restriction("~side_a").holds("short") is None
    assert Restriction("~side_a").holds("short", {"side_a": False}) is True
    assert Restriction("side_a & robot_tall").holds("short") is False
    assert Restriction("side_a | robot_short").holds("short") is True
    assert Restriction("").holds() is Restriction("robot").holds() is True
    assert Restriction("'False'").holds() is False
    assert Restriction("__import__('os').abort()").holds("short") is None


ATOMS = st.sampled_from(["robot_short", "robot_tall", "side_a", "True", "False"])
FORMULAS = st.recursive(
    ATOMS,
    lambda inner: st.one_of(
        inner.map("~({})".format),
        st.tuples(inner, inner).map(lambda pair: "({}) & ({})".format(*pair)),
        st.tuples(inner, inner).map(lambda pair: "({}) | ({})".format(*pair)),
    ),
    max_leaves=8,
)


@settings(derandomize=True, max_examples=100, deadline=None)
@given(FORMULAS, st.booleans())
def test_restrictions_are_evaluated_as_by_python(text: str, side: bool) -> None:
    names = {"robot_short": True, "robot_tall": False, "side_a": side}
    expected = eval(text.replace("~", " not "), {}, names)
    restriction = Restriction(text)
    assert restriction.holds("short", {"side_a": side}) is bool(expected)
    # what is said without knowing the side holds on both
    assert restriction.holds("short") in (None, bool(expected))


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.text("robt_short&|~()[]'\", inTrue=!\\\n", max_size=30))
def test_any_text_is_a_restriction_or_not(text: str) -> None:
    try:
        assert Restriction(text).holds("short") in (True, False, None)
    except ExpressionError as error:
        assert "is not a restriction" in error.message


#: A field with a short cut for short robots, and a tall shed; "far" is behind both.
FARM = {
    "nodes": [
        entry("yard", 0.0, {"node": "cut"}, {"node": "shed"}, meta={"tag": ["dock", "base"]}),
        entry("cut", 3.0, {"node": "far"}, {"node": "yard"}, restrictions_planning="robot_short"),
        entry(
            "shed",
            3.5,
            {"node": "far", "restrictions_planning": "'tall' in robot"},
            {"node": "yard"},
            meta={"tag": ["row"]},
        ),
        entry("far", 6.0, {"node": "cut"}, {"node": "shed"}, meta={"tag": ["row"]}),
    ]
}
LOOK = {"Look": {"at": ["tag:row"], "seconds": 2}}


def drives(made: SitePlan) -> List[str]:
    return sorted(name for name in made.plan["actions"] if name.startswith("Drive_"))


def test_restrictions_hold_for_the_robots_of_the_plan(tmp_path: Path) -> None:
    short = built(tmp_path, FARM, {"types": ["short"], "tasks": LOOK})
    assert "Drive_yard_cut" in drives(short) and "Drive_shed_far" not in drives(short)
    tall = built(tmp_path, FARM, {"types": ["tall"], "tasks": LOOK})
    assert "Drive_shed_far" in drives(tall) and "Drive_yard_cut" not in drives(tall)
    assert not [note for made in (short, tall) for note in made.notes if "not applied" in note]
    unknown = built(tmp_path, FARM, {"tasks": LOOK})
    for text in ("robot_short", "'tall' in robot"):
        assert any("'%s' (1 times) is not applied" % text in note for note in unknown.notes)


def test_robots_of_several_types_keep_to_their_part_of_the_map(tmp_path: Path) -> None:
    tasks = {"types": ["short", "tall"], "tasks": LOOK, "docks": {"tag:dock": 1},
             "battery": {"full": 0.1, "low": 0.1}}  # fmt: skip
    made = built(tmp_path, FARM, tasks, robots=4)
    assert [made.plan["robots"]["robot_%d" % k] for k in (1, 2, 3)] == [
        "At_yard_short_full", "At_yard_tall_full", "At_yard_short_full",
    ]  # fmt: skip
    assert not [name for name in drives(made) if "tall" in name and "cut" in name]
    assert {"Stranded_short", "Stranded_tall", "Charge_yard_tall_low"} <= set(made.plan["actions"])
    made.write(str(tmp_path / "made"))
    plan = read_plan(str(tmp_path / "made"))
    report = check(plan, limit=20_000)
    assert report.exit_code == 0
    assert "never_fire" not in {i.check for i in report.items if i.severity.name != "OK"}
    run = Scenario(plan, functions=True, drawn=True)
    run.advance(900.0)
    run.check_no_faults()
    fired = " ".join(run.fired)
    assert "Finished_Look_far_tall" in fired and "Finished_Look_far_short" in fired


def test_a_way_that_leads_nowhere_back_is_noted(tmp_path: Path) -> None:
    look = {"tasks": {"Look": {"at": ["A", "B"], "seconds": 1.0}}}
    assert built(tmp_path, two({}), look).notes[-1] == (
        "there is no way back from B to A, where there is a task or a dock"
    )
    both = two({}, nodes=[entry("A", 0.0, {"node": "B"}), entry("B", 4.0, {"node": "A"})])
    assert built(tmp_path, both, look).notes == []


def test_conditions_are_said_in_the_tasks(tmp_path: Path) -> None:
    farm = two({"restrictions_planning": "~side_a"})
    assert built(tmp_path, farm, {"conditions": {"side_a": False}}).notes == []
    with pytest.raises(InputError, match="robots have nothing to do: no edge leads away"):
        built(tmp_path, farm, {"conditions": {"side_a": True}})


def test_a_robot_starts_where_it_may_be(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="of type 'tall' may not be where it starts"):
        built(tmp_path, FARM, {"types": ["tall"], "start": ["cut"]})


def test_tags_mean_the_nodes_that_have_them(tmp_path: Path) -> None:
    made = built(tmp_path, FARM, {"start": ["tag:dock"], "tasks": LOOK})
    assert {name for name in made.plan["actions"] if name.startswith("Look")} == {
        "Look_shed", "Look_far",
    }  # fmt: skip
    with pytest.raises(InputError, match="no node of the map has the tag 'rows'") as caught:
        built(tmp_path, FARM, {"tasks": {"Look": {"at": ["tag:rows"], "seconds": 1}}})
    assert caught.value.hint == "its tags are dock, base, row"


def test_words_in_goals_stand_for_what_the_map_says_of_either_node(tmp_path: Path) -> None:
    goal = {
        "initial_pose": {"header": {"frame_id": "+node.parent_frame"}, "pose": "+node.pose"},
        "final_pose": {"header": {"frame_id": "$node.parent_frame"}, "pose": "$node.pose"},
        "tolerance": "$node.properties.xy",
        "began": "+node.properties.xy",
        "x": "$node.pose.position.x",
        "yaw": "$node.pose.orientation.w",
        "corner": "$node.verts.1.x",
        "from": "+node.name",
        "map": "+meta.map",
        "text": "+1 m",
    }
    edge = {"action": "row", "action_type": "row_msgs/RowGoal", "goal": goal, "node": "B"}
    site = {
        "nodes": [
            entry("A", 1.0, edge, parent_frame="yard", properties={"xy": 0.5}),
            entry("B", 9.0, properties={"xy": 0.3}, verts=[{"x": 4}, {"x": 5}]),
        ]
    }
    sent = built(tmp_path, site, None).ros_actions["Drive_A_B"]["goal"]
    assert sent["initial_pose"]["pose"]["position"]["x"] == 1.0
    assert sent["initial_pose"]["header"] == {"frame_id": "yard", "stamp": "now"}
    assert sent["final_pose"]["pose"]["position"]["x"] == 9.0
    assert sent["final_pose"]["header"]["frame_id"] == "map"
    del sent["initial_pose"], sent["final_pose"]
    assert sent == {
        "tolerance": 0.3,
        "began": 0.5,
        "x": 9.0,
        "yaw": 1.0,
        "corner": 5,
        "from": "A",
        "map": "m",
        "text": "+1 m",
    }


@pytest.mark.parametrize(
    "word",
    ["$node.properties.xy", "+node.pse", "$nodes.pose", "${nobody.knows}", "to $node.name", "$x"],
)
def test_words_in_goals_that_are_not_understood_are_named(tmp_path: Path, word: str) -> None:
    edge = {"action": "row", "action_type": "row_msgs/RowGoal", "goal": {"target": word}}
    path = written(tmp_path, two(edge))
    with pytest.raises(InputError) as caught:
        read_map(path)
    assert "'%s' in the goal of the edge from A to B is not understood" % word in str(caught.value)
    assert word in Path(path).read_text().splitlines()[(caught.value.line or 0) - 1]


def test_words_of_a_graph_that_are_not_used_are_named(tmp_path: Path) -> None:
    text = "nodes:\n  a: {x: 0, y: 0, yawn: 1}\n  b: [1, 0]\nedges: [[a, b]]\ngroup: {}\n"
    path = written(tmp_path, text, "graph.yaml")
    assert sorted(read_map(path).notes) == [
        "%s:2: nodes.a.yawn: 'yawn' of the node 'a' is not used" % path,
        "%s:5: group: 'group' of the graph is not used" % path,
    ]


LANE = "nodes: {west: [0, 0], mid: [5, 0], east: [10, 0]}\nedges: [[west, mid], [mid, east]]\n"
ENDS = {
    "start": ["west", "east"],
    "tasks": {
        "Pick": {"at": ["west"], "seconds": 5.0, "again_after": 20.0},
        "Drop": {"at": ["east"], "seconds": 5.0, "again_after": 20.0},
    },
}
ALONE = {"lane": {"nodes": ["mid"], "edges": ["west_mid", "mid_east"]}}


def lane(folder: Path, text: str = LANE, **tasks: Any) -> SitePlan:
    found = built(folder, text, {**ENDS, **tasks})
    found.write(str(folder / "made"))
    return found


@pytest.mark.parametrize("capacity, dead", [(None, False), (1, True)])
def test_robots_that_wait_for_each_others_node_are_found(
    tmp_path: Path, capacity: Optional[int], dead: bool
) -> None:
    text = "nodes: {a: [0, 0], b: [5, 0]}\nedges: [[a, b]]\n"
    found = built(tmp_path, text, {"start": ["a", "b"], "node_capacity": capacity})
    assert ("Nodes hold any number of robots" in found.plan["description"]) is not dead
    found.write(str(tmp_path / "made"))
    said = " ".join(item.text for item in check(read_plan(str(tmp_path / "made"))).items)
    assert ("no dead marking" in said) is not dead


@pytest.mark.parametrize("robots, jam", [(1, False), (2, True)])
def test_robots_that_wait_in_a_lane_while_another_works_are_found(
    tmp_path: Path, robots: int, jam: bool
) -> None:
    """One robot comes back from far, where one waits for it; a third goes on between other nodes."""
    text = """
nodes: {hall: [0, 0], mid: [5, 0], far: [15, 0], near: [0, 5]}
edges: [[hall, mid], [mid, far], [hall, near]]
"""
    tasks = {
        "start": ["hall"],
        "tasks": {
            "Look": {"at": ["far"], "seconds": 5, "again_after": 20},
            "See": {"at": ["near"], "seconds": 5, "again_after": 20},
        },
        "battery": {"full": 0.2, "low": 0.2},
        "docks": {"hall": 3},
        "nodes": {"mid": {"capacity": 1}, "far": {"capacity": 1}},
    }
    built(tmp_path, text, tasks, robots=robots + 1).write(str(tmp_path / "made"))
    report = check(read_plan(str(tmp_path / "made")))
    found = report.of("waiting")
    assert (report.doubts == ("can let robots wait forever",)) is jam
    assert {str(item.details["place"]) for item in found} == (
        {"At_mid_full", "At_far_low"} if jam else set()
    )
    for item in found:
        marking = dict(item.details["marking"])
        assert "nothing that takes a robot from %s" % item.details["place"] in item.text
        assert marking["At_mid_full"] and marking["At_far_low"]


@pytest.mark.parametrize(
    "text, tasks",
    [
        (LANE, {"node_capacity": 1}),
        (LANE, {"nodes": {"mid": {"capacity": 1}}}),
        (LANE.replace("mid: [5, 0]", "mid: {x: 5, y: 0, capacity: 1}"), {}),
        (LANE, {"groups": ALONE}),
        (LANE + yaml.safe_dump({"groups": ALONE}), {}),
    ],
)
def test_capacities_of_nodes_and_groups_hold(
    tmp_path: Path, text: str, tasks: Dict[str, Any]
) -> None:
    lane(tmp_path, text, **tasks)
    plan = read_plan(str(tmp_path / "made"))
    whole = "groups" in text or "groups" in tasks
    lost = {"At_mid", "Drive_west_mid", "Drive_east_mid"} | (
        {"Drive_mid_west", "Drive_mid_east"} if whole else set()
    )
    most = 0
    for marking in explore(plan.net).markings():
        found = dict(zip((p.name for p in plan.net.places), map(int, marking)))
        most = max(most, sum(found[name] for name in lost))
    assert most == 1
    assert set(plan.on_evict["At_mid"]) <= {p.name for p in plan.net.places}
    for name in lost:
        assert any(n.startswith(("Free_node_", "Free_group_")) for n in plan.on_evict[name])


@pytest.mark.parametrize(
    "text, tasks, said",
    [
        (LANE, {"start": ["west"], "node_capacity": 1}, "2 robots start in west, where 1 may be"),
        (LANE, {"nodes": {"wst": {"capacity": 1}}}, "there is no node 'wst'"),
        (LANE, {"groups": {"lane": {"edges": ["mid_mid"]}}}, "there is no edge 'mid_mid'"),
        (LANE + "groups: {lane: {nodes: [wst]}}", {}, "there is no node 'wst'"),
        (LANE + "groups: {lane: {node: [west]}}", {}, "not a group of mutual exclusion"),
        (LANE + "groups: [west]", {}, "not a group of mutual exclusion"),
        (
            LANE,
            {
                "battery": {"full": 0.1, "low": 0.1},
                "docks": {"west": 1},
                "nodes": {"west": {"capacity": 1}},
            },
            "brought to west, so it holds any number",
        ),
    ],
)
def test_limits_that_cannot_hold_are_errors(
    tmp_path: Path, text: str, tasks: Dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        lane(tmp_path, text, **tasks)


CLASHES = {
    "nodes: {a: [0, 0], a_b: [1, 0], b_c: [2, 0], c: [3, 0]}\n"
    "edges: [[a, b_c], [a_b, c], [a, c]]\n": {"start": ["a", "a_b"]},
    "nodes: {node: [0, 0], b: [1, 0]}\nedges: [[node, b]]\n": {
        "node_capacity": 1, "start": ["node", "b"]
    },
    "nodes: {dock: [0, 0], b: [1, 0], dock-: [2, 0]}\nedges: [[dock, b], [b, dock-]]\n": {
        "docks": {"b": 1}, "battery": {"full": 0.1}, "tasks": {"Look": {"at": ["dock"], "seconds": 1}}
    },
    "nodes: {door: [0, 0], b: [1, 0]}\nedges: [[door, b]]\ndoors: {b: {edges: [door_b]}}\n": {},
    "nodes: {a_x: [0, 0], a-x: [1, 0], a: [2, 0], x_a: [3, 0]}\n"
    "edges: [[a_x, a], [a, x_a], [a_x, a-x]]\n": {},
}  # fmt: skip


@pytest.mark.parametrize("text", CLASHES)
def test_names_of_nodes_never_collide(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, CLASHES[text], "tasks.yaml")
    made = build_site_plan(written(tmp_path, text), path, 2, all_edges=True)
    made.write(str(tmp_path / "made"))
    plan = read_plan(str(tmp_path / "made"))
    site = yaml.safe_load(text)
    driven = {
        (round(goal["position"]["x"]), name)
        for name, action in made.ros_actions.items()
        if name.startswith("Drive_")
        for goal in [action["goal"]["target_pose"]["pose"]]
    }
    assert len(driven) == 2 * len(site["edges"])
    assert len([name for name in plan.actions if name.startswith("At_")]) == len(site["nodes"])
    assert any("changed in the plan" in note for note in made.notes)


def test_a_task_that_is_called_like_a_place_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two elements of the plan would be called At_mid"):
        built(tmp_path, LANE, {"tasks": {"At": {"at": ["mid"], "seconds": 1}}})


def test_an_edge_whose_name_is_not_clear_is_written_with_an_arrow(tmp_path: Path) -> None:
    text = next(iter(CLASHES))
    with pytest.raises(InputError, match="more than one edge 'a_b_c'"):
        built(tmp_path, text, {"edges": {"a_b_c": {"seconds": 3}}})
    with pytest.raises(InputError, match="more than one edge 'a_b_c'"):
        built(tmp_path, text, {"groups": {"lane": {"edges": ["a_b_c"]}}})
    made = built(tmp_path, text, {"edges": {"a -> b_c": {"seconds": 3}}, "start": ["a", "a_b"]})
    assert made.plan["durations"]["Drive_a_b-c"]["mean"] == 3
