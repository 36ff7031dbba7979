"""The plan of the site: its files are those that its sources give, and its policy and its net do
what its README says (plans/inspection)."""

from __future__ import annotations

import itertools
import runpy
from pathlib import Path
from typing import Dict, List

import networkx
import pytest
import yaml

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.plan import Plan

FOLDER = Path(__file__).resolve().parents[2] / "plans" / "inspection"
WRITTEN = ("net.xml", "plan.json", "policy.json")


@pytest.fixture(scope="module")
def plan() -> Plan:
    return read_plan(str(FOLDER))


@pytest.fixture(scope="module")
def tasks() -> dict:
    return yaml.safe_load((FOLDER / "tasks.yaml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def site() -> networkx.DiGraph:
    graph = networkx.DiGraph()
    nodes = yaml.safe_load((FOLDER / "site.tmap2").read_text(encoding="utf-8"))["nodes"]
    for node in (entry["node"] for entry in nodes):
        graph.add_edges_from((node["name"], edge["node"]) for edge in node["edges"])
    return graph


def test_the_files_are_those_that_the_script_writes(tmp_path: Path) -> None:
    runpy.run_path(str(FOLDER / "make_plan.py"))["write"](str(tmp_path))
    for name in WRITTEN:
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name


def test_the_net_has_the_edges_of_the_map(plan: Plan, site: networkx.DiGraph) -> None:
    assert len(site) == 9 and all(site.has_edge(b, a) for a, b in site.edges)
    driven = {t.name[len("Go_") :] for t in plan.net.transitions if t.name.startswith("Go_")}
    levels = ("full", "half", "low")
    assert driven == {"%s_%s_%s" % (a, b, level) for a, b in site.edges for level in levels}


def test_the_policy_goes_to_the_nearest_node_that_is_due(
    plan: Plan, site: networkx.DiGraph, tasks: dict
) -> None:
    net, table = plan.net, plan.policy.bind(plan.net)
    far = dict(networkx.all_pairs_shortest_path_length(site))
    inspected, dock = list(tasks["due_again_after"]), tasks["dock"]
    for number, level in itertools.product(range(2 ** len(inspected)), ("full", "half", "low")):
        due = [name for bit, name in enumerate(inspected) if number >> bit & 1]
        for node in site:
            place = "At_%s_%s" % (node, level)
            marking = [int(p.name in [place, *("Due_" + n for n in due)]) for p in net.places]
            choice = table.distribution(marking, net.place_index[place])
            names = [net.transitions[t].name for t, _ in choice.choices] if choice else []
            if node in due and level != "low":
                assert names == ["Start_%s_%s" % (node, level)]
            elif node == dock and (level == "low" or not due):
                assert names == ([] if level == "full" else ["Dock_" + level])
            else:
                there = [dock] if level == "low" or not due else due
                nearest = min(far[node][target] for target in there)
                (name,) = names
                _, here, towards, with_level = name.split("_")
                assert (here, with_level) == (node, level)
                assert nearest - 1 in [far[towards][t] for t in there if far[node][t] == nearest]


def test_one_robot_at_a_time_drives_on_a_narrow_edge_and_charges(plan: Plan, tasks: dict) -> None:
    """A token more in the places of an edge is always a token less in the one that says it is
    free."""
    net = plan.net
    taken: Dict[str, List[str]] = {"Free_dock": ["Charge_half", "Charge_low"]}
    for edge in tasks["narrow"]:
        a, b = edge.split("_")
        ways = ("Drive_%s_%s" % (a, b), "Drive_%s_%s" % (b, a))
        taken["Free_" + edge] = [p.name for p in net.places if p.name.startswith(ways)]
    for free, places in taken.items():
        group = {net.place_index[name] for name in (free, *places)}
        assert sum(net.initial_marking[p] for p in group) == 1
        for t in range(len(net.transitions)):
            assert sum(change for p, change in net.effect(t) if p in group) == 0


@pytest.mark.parametrize("robots", [1, 3])
def test_it_runs_with_one_to_three_robots(plan: Plan, tasks: dict, robots: int) -> None:
    result = VirtualRun(plan.for_robots(robots), seed=1).run(time=300.0)
    assert result.ended is None
    done = {name: count for name, count in result.firings.items() if "Inspected_" in name}
    for node in tasks["due_again_after"]:
        assert sum(count for name, count in done.items() if "_%s_" % node in name) > 10


def test_the_check_finds_nothing_but_what_the_policy_never_does(plan: Plan) -> None:
    report = check(plan.for_robots(1))
    assert report.exit_code == 0
    assert {item.check for item in report.items if item.severity.value != "ok"} <= {"never_fire"}
