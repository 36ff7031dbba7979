"""Plans are built from maps: topological maps of three ages, and plain graphs."""

import json
from pathlib import Path

import pytest

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.site_map import read_map
from gspn_framework_package.making.site_plan import build_site_plan
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.testing import Scenario

MAPS = Path(__file__).parent / "maps"
SITE = Path(__file__).parents[3] / "plans" / "inspection" / "site.tmap2"


def made(tmp_path, name, tasks=None, robots=2):
    found = build_site_plan(str(MAPS / name), str(MAPS / tasks) if tasks else None, robots)
    found.write(str(tmp_path / "made"))
    return found, read_plan(str(tmp_path / "made"))


@pytest.mark.parametrize(
    "name, tasks",
    [
        ("orchard.tmap2", None),
        ("office.tmap", None),
        ("oldest.tmap", None),
        ("graph.yaml", "graph_tasks.yaml"),
    ],
)
def test_the_plan_of_a_map_may_run_and_runs(tmp_path, name, tasks):
    _, plan = made(tmp_path, name, tasks)
    report = check(plan)
    assert report.exit_code == 0
    assert not [item for item in report.items if item.severity.name != "OK"]
    assert all(node.position for node in (*plan.net.places, *plan.net.transitions))
    run = Scenario(plan, functions=True, drawn=True)
    run.advance(600.0)
    run.check_no_faults()
    assert len(run.fired) > 10
    assert read_plan(str(tmp_path / "made" / "plan_ros.json")).net == plan.net


def test_a_map_of_the_field(tmp_path):
    found, plan = made(tmp_path, "orchard.tmap2")
    notes = " ".join(found.notes)
    for said in (
        "the node old is left out: restrictions_planning is False",
        "edges from a node to itself are left out (1)",
        "left out: 1",
        "'robot_short & ~robot_tall' (1 times) is not applied",
        "'obstacleFree_1' (2 times) applies at run time",
        "no type for the action 'row_change'",
        "no robot can get there: island",
    ):
        assert said in notes
    assert {name for name in plan.actions if name.startswith("At_")} == {
        "At_shed", "At_row 1", "At_turn",
    }  # fmt: skip
    # two nodes at one position: the drive takes the shortest time
    assert plan.durations["Drive_row 1_turn"].mean == 0.1
    assert plan.durations["Drive_shed_row 1"].mean == 16.0  # 8 m at 0.5 m/s


def test_goals_come_from_the_poses(tmp_path):
    found, _ = made(tmp_path, "orchard.tmap2")
    there = found.ros_actions["Drive_shed_row 1"]
    assert (there["type"], there["server"]) == ("move_base_msgs/MoveBaseAction", "move_base")
    target = there["goal"]["target_pose"]
    assert target["header"] == {"frame_id": "map", "stamp": "now"}
    assert target["pose"]["position"] == {"x": 8.0, "y": 0.0, "z": 0.0}
    # a quaternion of zeros is no rotation
    assert target["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    back = found.ros_actions["Drive_row 1_shed"]
    assert (back["type"], back["server"]) == ("row_msgs/FollowRowAction", "/row_follower")
    assert back["goal"]["target"]["position"]["x"] == 0.0


def test_the_speed_of_the_map_counts(tmp_path):
    _, plan = made(tmp_path, "office.tmap")
    assert plan.durations["Drive_WayPoint1_ChargingPoint"].mean == 2.0
    assert plan.durations["Drive_ChargingPoint_WayPoint1"].mean == 11.0


def test_the_oldest_form(tmp_path):
    site = read_map(str(MAPS / "oldest.tmap"))
    assert [(edge.source, edge.target, edge.action) for edge in site.edges] == [
        ("Hall", "Lab", "move_base"),
        ("Lab", "Hall", "doorPassing"),
    ]
    assert site.nodes["Hall"].pose["orientation"]["w"] == 0.86
    assert site.edges[0].length == 3.0


def test_tasks_capacities_battery_and_docks(tmp_path):
    found, plan = made(tmp_path, "graph.yaml", "graph_tasks.yaml", robots=3)
    assert plan.name == "round" and len(plan.robots) == 3
    # the map says 2 for one edge, the tasks say any number for all others
    assert [p.tokens for p in plan.net.places if p.name.startswith("Free_")] == [2, 1]
    assert plan.durations["Drive_b_c_full"].mean == 30
    assert plan.durations["Drive_c_a_full"].mean == pytest.approx(6.403 / 2, abs=0.01)
    assert "Drive_a_c_full" not in plan.actions  # one way
    assert plan.on_evict["Charge_a_low"] == {"Free_dock_a": 1}
    assert plan.on_evict["Weigh_c_full"] == {"Due_Weigh_c": 1}
    assert found.ros_actions["Weigh_c_full"] == {"service": "weigh", "type": "std_srvs/Trigger"}


def test_robots_go_to_the_nearest_task_and_to_the_dock(tmp_path):
    _, plan = made(tmp_path, "graph.yaml", "graph_tasks.yaml", robots=1)
    run = Scenario(plan)
    run.action("Drive_a_b_full", result="Arrive_a_b_full")
    run.action("Drive_b_c_full", result="Drain_b_c_full")
    run.until_fired("Charged_a_low")
    assert [name for name in run.fired if name.startswith(("Start", "Dock"))] == [
        "Start_Look_b_full",
        "Dock_a_low",
    ]


def test_one_robot_at_a_time_on_an_edge(tmp_path):
    _, plan = made(tmp_path, "oldest.tmap", robots=5)
    run = Scenario(plan)
    for _ in range(200):
        run.advance(1.0)
        assert run.marking.get("Drive_Hall_Lab", 0) + run.marking.get("Drive_Lab_Hall", 0) <= 1


def test_the_shipped_map(tmp_path):
    site = read_map(str(SITE))
    assert len(site.nodes) == 9 and len(site.edges) == 20
    assert [note for note in site.notes if "obstacleFree_1" not in note] == []


def large_site(folder):
    nodes = {"N%d" % k: [4 * (k % 10), 3 * (k // 10)] for k in range(100)}
    edges = [["N%d" % k, "N%d" % (k + 1)] for k in range(100) if k % 10 < 9]
    edges += [["N%d" % k, "N%d" % (k + 10)] for k in range(90)]
    (folder / "map.json").write_text(json.dumps({"nodes": nodes, "edges": edges}))
    (folder / "tasks.yaml").write_text("tasks:\n  Look: {at: [N3, N50, N77], seconds: 5}\n")
    return str(folder / "map.json"), str(folder / "tasks.yaml")


def test_a_large_map_is_checked_as_far_as_asked(tmp_path):
    found = build_site_plan(*large_site(tmp_path), 20, all_edges=True)
    found.write(str(tmp_path / "made"))
    plan = read_plan(str(tmp_path / "made"))
    assert len(plan.robots) == 20 and len(plan.net.places) > 600
    report = check(plan, limit=200, seconds=0)
    assert report.exit_code == 0
    assert any("not decided" in str(item) for item in report.items)


def test_edges_that_the_policy_does_not_use_are_left_out(tmp_path):
    found = build_site_plan(*large_site(tmp_path), 2)
    assert any("left out" in note and "--all-edges" in note for note in found.notes)
    assert len(found.net.places) < 400
    found.write(str(tmp_path / "made"))
    plan = read_plan(str(tmp_path / "made"))
    used = {name for row in found.policy["rows"] for name in row["choose"]}
    assert used == {t.name for t in plan.net.transitions if t.name.startswith(("Go_", "Start_"))}
    everything = build_site_plan(*large_site(tmp_path), 2, all_edges=True)
    assert used < {t.name for t in everything.net.transitions}


BAD_MAPS = {
    "a: 1\n": ("there are no 'nodes'", 1),
    "nodes: {a: [0, 0]}\nedges:\n- [a, b]\n": ("there is no node 'b'", 3),
    "nodes: {a: [0, 0], b: [0, .nan]}\nedges: []\n": ("is not a number", 1),
    "nodes: {a: [0, 0], b: [0, 1%s]}\nedges: []\n" % (400 * "0"): ("is not a number", 1),
    "nodes: {a: [0, 0]}\nedges:\n- {from: a, to: a, lenght: 3}\n": ("an edge has no 'lenght'", 3),
    "nodes:\n- node: {name: a}\n": ("has no pose", 2),
    "nodes:\n- node:\n    name: a\n    pose: {position: {x: 0, y: up}}\n": ("not a number", 4),
    "nodes:\n- node: {name: a, pose: {position: {x: 0, y: 0}}, edges: [{action: go}]}\n": (
        "does not say to which 'node'", 2,
    ),
    "nodes:\n  a: [0, 0]\n  a: [1, 1]\n": ("occurs twice", 3),
    "nodes: [\n": ("it is not YAML", 2),
    "nodes: !!python/object:os.system {}\n": ("not plain data", 1),
    "node: \n\tA\n\twaypoint:\n\t\t1,2\n": ("seven numbers", 4),
    "nodes: []\nedges: []\n": ("has no nodes", 1),
}  # fmt: skip


@pytest.mark.parametrize("text", BAD_MAPS)
def test_errors_in_maps_name_file_and_line(tmp_path, text):
    said, line = BAD_MAPS[text]
    path = tmp_path / "map.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        read_map(str(path))
    assert caught.value.file == str(path) and caught.value.line == line


BAD_TASKS = {
    "tasks:\n  Look: {at: [a]}\n": ("'seconds' is a required property", 2),
    "tasks:\n  Look: {at: [nowhere], seconds: 1}\n": ("there is no node 'nowhere'", 2),
    "speed: 1\nspede: 2\n": ("'spede' was unexpected", 1),
    "edges:\n  a_c: {capacity: 0}\n": ("less than the minimum", 2),
    "edges:\n  a_x: {capacity: 1}\n": ("there is no edge 'a_x'", 2),
    "battery: {full: 0.1}\n": ("nowhere to charge", 1),
    "start:\n- a\n- a\n": ("'a' is there twice", 3),
    "- a\n": ("is not of type 'object'", 1),
}


@pytest.mark.parametrize("text", BAD_TASKS)
def test_errors_in_tasks_name_file_and_line(tmp_path, capsys, text):
    said, line = BAD_TASKS[text]
    path = tmp_path / "tasks.yaml"
    path.write_text(text)
    words = ["build", str(MAPS / "graph.yaml"), "--tasks", str(path), "-o", str(tmp_path / "x")]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert said in error and "%s:%d: " % (path, line) in error
    assert not (tmp_path / "x").exists()


def test_a_task_where_nobody_gets_is_an_error(tmp_path):
    path = tmp_path / "tasks.yaml"
    path.write_text("start: [shed]\ntasks:\n  Look: {at: [island], seconds: 1}\n")
    with pytest.raises(InputError, match="no robot can get from its start to node 'island'"):
        build_site_plan(str(MAPS / "orchard.tmap2"), str(path), 1)


def test_the_command_tells_what_it_made(tmp_path, capsys):
    folder = str(tmp_path / "made")
    assert main(["build", str(SITE), "--robots", "2", "-o", folder, "--json"]) == 0
    done = json.loads(capsys.readouterr().out)
    assert done["robots"] == 2 and "plan_ros.json" in done["files"]
    assert main(["build", str(SITE), "--robots", "2", "-o", folder]) == 2
    assert "the folder exists already" in capsys.readouterr().err


LEVELS = {"full": 0.2, "half": 0.2, "low": 0.2}


def with_battery(folder, topic, robots=2):
    tasks = {"tasks": {"Look": {"at": ["c"], "seconds": 4}}, "docks": {"a": 1}, "battery": LEVELS}
    path = folder / "tasks.yaml"
    path.write_text(json.dumps({**tasks, "battery_topic": topic}))
    return build_site_plan(str(MAPS / "graph.yaml"), str(path), robots)


def test_the_battery_is_read_on_ros(tmp_path):
    topic = {"below": {"half": 0.6, "low": 0.3}, "empty": 0.1, "charged": 0.9}
    found = with_battery(tmp_path, topic)
    found.write(str(tmp_path / "made"))
    plan = read_plan(str(tmp_path / "made" / "plan_ros.json"))
    assert not any("battery" in note for note in found.notes)
    event = plan.events["Drain_a_b_full"]
    assert (event.topic, event.type) == ("battery", "sensor_msgs/BatteryState")
    assert event.when == "percentage < 0.6"
    assert plan.events["Drain_b_c_low"].when == "percentage < 0.1"
    assert found.ros_actions["Charge_a_low"] == {
        "wait_for": "battery", "type": "sensor_msgs/BatteryState", "when": "percentage > 0.9",
    }  # fmt: skip
    for name in ("plan.json", "plan_ros.json"):
        report = check(read_plan(str(tmp_path / "made" / name)))
        assert report.exit_code == 0
        assert "never_fire" not in {i.check for i in report.items if i.severity.name != "OK"}


def test_a_robot_whose_level_ends_on_an_edge_keeps_it(tmp_path):
    with_battery(tmp_path, {"below": {"half": 0.6, "low": 0.3}}, 1).write(str(tmp_path / "made"))
    run = Scenario(read_plan(str(tmp_path / "made")))
    run.action("Drive_a_b_full", result="Drain_a_b_full")
    run.action("Drive_a_b_half", result="Drain_a_b_half")
    for fired in ("Drain_a_b_full", "Drain_a_b_half", "Arrive_a_b_low"):
        run.until_fired(fired)
        there = [name for name in run.marking if name.startswith(("Drive_a_b", "Drive_b_a"))]
        assert sum(run.marking[name] for name in there) + run.marking.get("Free_a_b", 0) == 1


@pytest.mark.parametrize(
    "topic, said",
    [
        ({"below": {"half": 0.5}}, "does not say where each level but the first begins"),
        ({"below": {"half": 0.3, "low": 0.6}}, "do not fall from 'charged'"),
        ({"below": {"half": 0.6, "low": 0.3}, "empty": 0.3}, "do not fall from 'charged'"),
        ({"below": {}, "fields": 1}, "'fields' was unexpected"),
    ],
)
def test_charges_fall_from_level_to_level(tmp_path, topic, said):
    with pytest.raises(InputError, match=said) as caught:
        with_battery(tmp_path, topic)
    assert caught.value.line == 1
