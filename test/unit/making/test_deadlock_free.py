"""``gspn build --deadlock-free``: plans of maps in which robots do not block each other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence, Set, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.site_elements import MapGroup
from gspn_framework_package.making.site_traffic import waiting_circles
from gspn_framework_package.testing import Scenario

LANE = """
nodes: {hall: [0, 0], a: [5, 0], b: [10, 0], c: [0, 5]}
edges: [[hall, a], [a, b], [hall, c]]
"""
LANE_TASKS: Dict[str, Any] = {
    "start": ["hall"],
    "docks": {"hall": 9},
    "nodes": {"a": {"capacity": 1}, "b": {"capacity": 1}},
    "battery": {"full": 0.2, "low": 0.2},
    "tasks": {
        "Look": {"at": ["b"], "seconds": 5, "again_after": 20},
        "See": {"at": ["c"], "seconds": 5, "again_after": 20},
    },
}
RING = """
nodes: {hall: [0, 5], n0: [0, 0], n1: [5, 0], n2: [5, 5], n3: [3, 9], far: [9, 9]}
edges:
- [hall, n0]
- [n2, far]
- {from: n0, to: n1, one_way: true}
- {from: n1, to: n2, one_way: true}
- {from: n2, to: n3, one_way: true}
- {from: n3, to: n0, one_way: true}
"""


def build(folder: Path, text: str, tasks: Mapping[str, Any], robots: int, *words: str) -> int:
    (folder / "map.yaml").write_text(text)
    (folder / "tasks.yaml").write_text(json.dumps(tasks))
    given_words = ["--tasks", str(folder / "tasks.yaml"), "--robots", str(robots), *words]
    return main(["build", str(folder / "map.yaml"), *given_words, "-o", str(folder / "made")])


def test_a_lane_holds_one_robot_so_that_none_waits_for_ever(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert build(tmp_path, LANE, LANE_TASKS, 3, "--deadlock-free", "--json") == 0
    told = json.loads(capsys.readouterr().out)["deadlock_free"]
    assert told["before"]["verdict"] == "violated" and told["before"]["sequence"]
    assert told["groups"] == {"lane_1": {"nodes": ["a", "b"], "capacity": 1}}
    assert [answer["verdict"] for answer in told["answers"]] == ["proven"]
    per_hour = told["per_hour"]
    assert per_hour["what"] == "tasks" and per_hour["before"]["half_width"] > 0
    assert per_hour["after"]["mean"] > 0
    plan = read_plan(str(tmp_path / "made"))
    report = check(plan)
    assert report.exit_code == 0 and not report.of("waiting")
    run = Scenario(plan, functions=True, drawn=True)
    for hour in range(1, 4):
        fired = len(run.fired)
        run.advance(3600.0)
        assert len(run.fired) > fired + 100, hour


def test_a_plan_without_deadlocks_stays_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tasks = {key: value for key, value in LANE_TASKS.items() if key != "nodes"}
    assert build(tmp_path, LANE, tasks, 2, "--deadlock-free") == 0
    told = capsys.readouterr().out
    assert "free of deadlocks as it is" in told and "added" not in told
    written = {path.name: path.read_bytes() for path in (tmp_path / "made").iterdir()}
    (tmp_path / "again").mkdir()
    assert build(tmp_path / "again", LANE, tasks, 2) == 0
    same = {path.name: path.read_bytes() for path in (tmp_path / "again" / "made").iterdir()}
    assert written == same


def test_a_circle_of_one_way_lanes_keeps_a_node_free(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tasks = {
        "start": ["hall"],
        "node_capacity": 1,
        "nodes": {"far": {"capacity": None}},
        "docks": {"hall": 6},
        "battery": {"full": 0.4, "low": 0.1},
        "stranded": 20,
        "tasks": {"Look": {"at": ["far"], "seconds": 5, "again_after": 5}},
    }
    assert build(tmp_path, RING, tasks, 4, "--deadlock-free", "--seconds", "3") == 0
    told = capsys.readouterr().out
    assert "added group lane_1: at most 3 in n0, n1, n2, n3" in told
    assert "without it: robots can get stuck after Go_hall_n0" in told
    assert "tasks per hour: " in told
    run = Scenario(read_plan(str(tmp_path / "made")), functions=True, drawn=True)
    run.advance(1800.0)
    assert len(run.fired) > 500


def test_what_no_group_helps_against_is_an_error_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Robots never leave the ring again, so that those in the hall never get in."""
    tasks = {
        "start": ["hall"],
        "node_capacity": 1,
        "nodes": {"hall": {"capacity": None}},
        "tasks": {"Look": {"at": ["n0", "n2"], "seconds": 5}},
    }
    assert build(tmp_path, RING, tasks, 5, "--deadlock-free") == 2
    error = capsys.readouterr().err
    assert "robots can get stuck after Go_hall_n0" in error and "At_hall: " in error
    assert "even with at most 1 in n0, n1, n2, n3" in error
    assert not (tmp_path / "made").exists()
    tasks["start"] = ["n0", "n1", "n2", "n3"]
    assert build(tmp_path, RING, tasks, 4, "--deadlock-free") == 2
    assert "4 robots start in n0, n1, n2, n3, where 3 may be" in capsys.readouterr().err
    assert not (tmp_path / "made").exists()


def test_a_folder_that_exists_is_named_before_anything_is_computed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "made").mkdir()
    assert build(tmp_path, "no map", {}, 2, "--deadlock-free") == 2
    assert "the folder exists already" in capsys.readouterr().err


# -- where robots can wait for each other

Nodes = List[int]
MOST_ROBOTS = 5


@st.composite
def sites(draw: Any) -> Tuple[List[MapGroup], List[Tuple[str, str]], List[str]]:
    """Limits of nodes and of groups, and the ways between nodes."""
    nodes = ["abcde"[k] for k in range(draw(st.integers(2, 5)))]
    pairs = [(a, b) for a in nodes for b in nodes if a != b]
    moves = draw(st.lists(st.sampled_from(pairs), min_size=1, max_size=8, unique=True))
    limits = [
        MapGroup([node], (), capacity)
        for node in nodes
        for capacity in [draw(st.sampled_from([1, 1, 2, None]))]
        if capacity is not None
    ]
    for _ in range(draw(st.integers(0, 2))):
        inside = draw(st.lists(st.sampled_from(nodes), max_size=3, unique=True))
        lanes = draw(st.lists(st.sampled_from(moves), max_size=2, unique=True))
        limits.append(MapGroup(inside, lanes, draw(st.integers(1, 2))))
    return limits, moves, nodes


def positions(
    limits: Sequence[MapGroup], nodes: Sequence[str], robots: int
) -> List[Dict[str, int]]:
    """All ways in which so many robots can rest within the limits."""
    found: List[Dict[str, int]] = [{}]
    for node in nodes:
        found = [
            {**before, node: count}
            for before in found
            for count in range(robots + 1 - sum(before.values()))
        ]
    return [
        here
        for here in found
        if all(sum(here[node] for node in limit.nodes) <= limit.capacity for limit in limits)
    ]


def blocked(
    here: Mapping[str, int], limits: Sequence[MapGroup], moves: Sequence[Tuple[str, str]]
) -> Set[str]:
    """The nodes of robots that wait for each other, if each wants to go where it cannot."""
    left = {node for node, count in here.items() if count}
    full = [limit for limit in limits if sum(here[node] for node in limit.nodes) == limit.capacity]

    def waits(a: str, b: str) -> bool:
        return any(
            a not in limit.nodes
            and (b in limit.nodes or (a, b) in limit.edges or (b, a) in limit.edges)
            and all(node in left for node in limit.nodes if here[node])
            for limit in full
        )

    while True:
        free = {node for node in left if not any(a == node and waits(a, b) for a, b in moves)}
        if not free:
            return left
        left -= free


@given(sites())
def test_within_the_groups_no_robots_wait_for_each_other(
    site: Tuple[List[MapGroup], List[Tuple[str, str]], List[str]],
) -> None:
    limits, moves, nodes = site
    circles = waiting_circles(limits, moves)
    closed = [*limits, *(circle.group(circle.robots - 1) for circle in circles)]
    for here in positions(closed, nodes, MOST_ROBOTS):
        assert not blocked(here, closed, moves), (here, circles)
    # and where only nodes have limits, there is no group without a reason
    if circles and all(len(limit.nodes) == 1 and not limit.edges for limit in limits):
        least = min(circle.robots for circle in circles)
        some = positions(limits, nodes, max(MOST_ROBOTS, least))
        assert any(blocked(here, limits, moves) for here in some), circles


@pytest.mark.parametrize(
    "limits, moves, expected",
    [
        # a lane in both directions, and a node behind it that anybody may be in
        ("a1 b1 c1", "ab ba bc cb cd dc", {("abc", 2)}),
        # around in one direction
        ("a1 b1 c2", "ab bc ca", {("abc", 4)}),
        # two lanes beside a ring
        ("a1 b1 c1 d1", "ab bd da ac ca", {("ac", 2), ("abcd", 3)}),
        # where one robot may be anyway
        ("a1 b1 ab1", "ab ba", set()),
        ("a1 b1", "ab", set()),
    ],
)
def test_where_robots_can_wait_for_each_other(
    limits: str, moves: str, expected: Set[Tuple[str, int]]
) -> None:
    groups = [MapGroup(list(word[:-1]), (), int(word[-1])) for word in limits.split()]
    found = waiting_circles(groups, [(a, b) for a, b in moves.split()])
    assert {("".join(circle.nodes), circle.robots) for circle in found} == expected
