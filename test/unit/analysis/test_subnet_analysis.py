"""Plans with subnets, whose policies decide for their own places only, in every reading."""

import json
import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.policy import decision_net, random_policy
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.plan.reading import NET, RUN
from gspn_framework_package.analysis.plan.structure import PolicyCover
from gspn_framework_package.analysis.preflight.check_plan import check
from gspn_framework_package.analysis.report import report
from gspn_framework_package.analysis.report_rows import rows
from gspn_framework_package.analysis.simulation import kernel, simulate
from gspn_framework_package.analysis.simulation.plan_tables import PlanTables
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.plan_timing import PlanTiming
from gspn_framework_package.model.policy import Policy, PolicyScope

DOCK = {
    "net": {
        "places": [{"name": "Approach"}, {"name": "Choose"}, {"name": "Done"}],
        "transitions": [
            {"name": "arrive", "timed": True, "rate": 2},
            {"name": "finish", "weight": 3},
            {"name": "again", "weight": 1},
        ],
        "arcs": [
            {"from": "Approach", "to": "arrive"},
            {"from": "arrive", "to": "Choose"},
            {"from": "Choose", "to": "finish"},
            {"from": "finish", "to": "Done"},
            {"from": "Choose", "to": "again"},
            {"from": "again", "to": "Approach"},
        ],
    },
    "actions": {"Approach": "actions.approach", "Choose": None, "Done": None},
}
HOME = {
    "net": {
        "places": [{"name": "Work", "tokens": 2}, {"name": "Dock"}],
        "transitions": [
            {"name": "go", "timed": True, "rate": 1},
            {"name": "leave"},
            {"name": "stay", "weight": 9},
        ],
        "arcs": [
            {"from": "Work", "to": "go"},
            {"from": "go", "to": "Dock"},
            {"from": "Dock", "to": "leave"},
            {"from": "leave", "to": "Work"},
            {"from": "Dock", "to": "stay"},
            {"from": "stay", "to": "Dock"},
        ],
    },
    "policy": {"places": [], "rows": [{"marking": [], "choose": {"leave": 0.5, "stay": 0.5}}]},
    "actions": {
        "Work": "actions.work",
        "Dock": {"plan": "dock.json", "entry": "Approach", "exit": "Done"},
    },
}


@pytest.fixture
def plan(tmp_path):
    """Two robots work and dock; the row of the outer policy speaks of no place in the subnet, where
    the weights decide."""
    (tmp_path / "home.json").write_text(json.dumps(HOME))
    (tmp_path / "dock.json").write_text(json.dumps(DOCK))
    return read_plan(str(tmp_path / "home.json"))


@pytest.mark.parametrize("timing", [RUN, NET])
def test_measures_of_a_subnet(plan, timing):
    # a robot approaches 4/3 times on average to get through, and goes through twice: 8/3 * 0.5 s
    inside = 4 / 3
    found = report(Analysis(plan, timing=timing))
    assert found["subnet_robots"] == {"Dock": pytest.approx(2 * inside / (1 + inside))}
    assert found["subnet_entries"] == {"Dock": pytest.approx(2 * 2 / (1 + inside))}
    assert found["subnet_time"] == {"Dock": pytest.approx(inside / 2)}
    assert ("subnet_time", "Dock", found["subnet_time"]["Dock"], None, None) in {
        row for row in rows(found) if not isinstance(row[2], dict)
    }


def test_a_plan_without_subnets_has_no_such_measures(plan):
    found = report(Analysis(plan.net))
    assert not [key for key in found if key.startswith("subnet")]


@pytest.mark.long
def test_simulation_and_the_run_itself_go_through_the_subnet(plan):
    firings = VirtualRun(plan, seed=1).run(time=4000.0).firings
    expected = Analysis(plan).measures.throughput
    simulated = simulate(plan, time=200.0, replications=20, seed=1)
    for transition, rate in expected.items():
        assert rate > 0
        assert math.isclose(firings[transition] / 4000.0, rate, rel_tol=0.15)
        assert math.isclose(simulated.throughput[transition].mean, rate, rel_tol=0.15)


def test_check_looks_for_rows_only_where_there_is_a_policy(plan):
    items = [item for item in check(plan).items if item.check == "policy"]
    assert [str(item.severity.name) for item in items] == ["OK"]
    cover = PolicyCover(plan)
    assert cover.matches(plan.net.place_number("Dock.Done"))
    assert not cover.matches(plan.net.place_number("Dock.Choose"))
    assert not cover.never_speaks(plan.net.place_number("Dock.Choose"))


@given(st.data())
def test_the_simulation_finds_the_rows_of_a_scope(data):
    net = decision_net()
    source = random.Random(data.draw(st.integers(0, 10**6)))
    whole = random_policy(net, data.draw(st.sampled_from([4, 13, 30])), source)
    first = data.draw(st.integers(0, len(whole.rows)))
    last = data.draw(st.integers(first, len(whole.rows)))
    inside = data.draw(st.sampled_from(["decide", net.places[1].name]))
    policy = Policy(whole.places, whole.rows, [PolicyScope((inside,), first, last)])
    plan = Plan(net, policy=policy, robots=(RobotSpec("r", "decide"),)).validate()
    book = PlanTables(plan, PlanTiming(plan)).book
    table = policy.bind(net)
    rows = (
        policy.rows[first:last]
        if inside == "decide"
        else (policy.rows[:first] + policy.rows[last:])
    )
    for _ in range(20):
        row = source.choice(whole.rows)
        marking = [source.randrange(3) if c is None else c for c in row.counts]
        expected = table.distribution(marking, 0)
        matching = [
            row for row in rows if all(c is None or c == n for c, n in zip(row.counts, marking))
        ]
        assert table.matches(marking, 0) == bool(matching)
        for place, wanted in ((0, expected), (book.any_of[0], matching or None)):
            entry = kernel.find_entry(place, marking, book.rows)
            assert (entry < 0) == (wanted is None)
            if place == 0 and entry >= 0:
                assert book.rows.entry_row[entry] == expected.row
                assert policy.rows[expected.row] in rows


@pytest.mark.long
@pytest.mark.parametrize("timing", [RUN, NET])
def test_simulation_estimates_the_measures_that_the_analysis_gives(plan, timing):
    exact = report(Analysis(plan, timing=timing))
    found = simulate(plan, time=400.0, warmup=20.0, replications=40, seed=1, timing=timing)
    told = found.to_json()
    assert sorted(found.subnets) == [
        "subnet_entries",
        "subnet_exits",
        "subnet_robots",
        "subnet_time",
    ]
    for measure, values in found.subnets.items():
        assert math.isclose(values["Dock"].mean, exact[measure]["Dock"], rel_tol=0.05)
        assert 0 < values["Dock"].half_width < 0.05 * values["Dock"].mean
        assert told[measure]["Dock"]["mean"] == values["Dock"].mean


def test_a_subnet_that_nobody_enters_has_no_time_per_visit(plan):
    found = simulate(plan, time=1e-9, replications=3, seed=1)
    assert found.to_json()["subnet_time"] == {"Dock": {"mean": None, "half_width": None}}
    assert str(found.subnets["subnet_time"]["Dock"]) == "not known"
    assert str(found.subnets["subnet_robots"]["Dock"]) == "0 in every run"


def test_the_simulation_of_a_net_has_no_measures_of_subnets(plan):
    found = simulate(plan.net, time=1.0, replications=3, seed=1)
    assert not [key for key in found.to_json() if key.startswith("subnet")]
