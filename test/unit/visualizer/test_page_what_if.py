"""What if robots were slower or more: the first look, and the simulation that follows."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import pytest
from page_client import PageClient

from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer import app, what_if
from gspn_framework_package.visualizer.analysis_worker import exact_paces
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.session import Session
from gspn_framework_package.visualizer.what_if import FirstLooks, action_means, what_if_in_form

ALL = "all transitions"


@pytest.fixture(autouse=True)
def _first_looks_of_their_whole_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine a first look is short, and its numbers are rough."""
    monkeypatch.setattr(what_if, "FIRST_LOOK", 60.0)


@pytest.fixture(name="plan", scope="module")
def _plan() -> Plan:
    return read_plan(plans_folder() + "/patrol")


@pytest.fixture(name="client")
def _client(plan: Plan) -> PageClient:
    project = Project()
    project.show(Session("plan", Document("patrol", plan.net, plan)))
    return PageClient(project)


def pace(plan: Plan, **changes: Any) -> float:
    return FirstLooks().at(what_if_in_form(changes, plan).apply(plan))["growth"][ALL][0]


def test_a_change_does_what_it_says_to_times_robots_and_rates(plan: Plan) -> None:
    place, other = list(action_means(plan))[:2]
    means = action_means(what_if_in_form({"slower": 2, "places": {place: 3}}, plan).apply(plan))
    assert means[place] == pytest.approx(6 * action_means(plan)[place])
    assert means[other] == pytest.approx(2 * action_means(plan)[other])
    stated = replace(plan, durations={place: Duration.exponential(7.0)})
    changed = what_if_in_form({"places": {place: 3}}, stated).apply(stated)
    assert changed.durations[place].mean == pytest.approx(21.0)
    assert len(what_if_in_form({"robots": 6}, plan).apply(plan).robots) == 6
    one = stated.robots[0].name
    alone = what_if_in_form({"slower": 2, "each": {one: 3}}, stated).apply(stated)
    assert alone.durations[place].mean == pytest.approx(14.0)
    assert alone.own_times[one].durations[place].mean == pytest.approx(42.0)
    assert what_if.adjustable(plan)["each"] == [] != what_if.adjustable(stated)["each"]
    inspection = read_plan(plans_folder() + "/inspection")
    event = next(iter(what_if.adjustable(inspection)["rates"]))
    rated = what_if_in_form({"rates": {event: 0.5}}, inspection).apply(inspection)
    before = inspection.net.transition(event).number
    assert rated.net.transition(event).number == pytest.approx(0.5 * before)


def test_slower_robots_do_less_in_a_first_look(plan: Plan) -> None:
    assert pace(plan, slower=4.0) < 0.5 * pace(plan)


@pytest.mark.parametrize(
    "fields",
    [
        {"robots": 0},
        {"robots": 10_000},
        {"slower": 0},
        {"slower": 11},
        {"slower": "2"},
        {"slower": True},
        {"places": {"nowhere": 2}},
        {"places": [1]},
        {"rates": {"t2:AlarmOff_L1": 2}},
        {"each": {"robot_1": 2}},  # its times are rates of the net
    ],
)
def test_what_makes_no_sense_is_refused(client: PageClient, fields: Any) -> None:
    assert client.post("/api/what_if?id=plan", fields).status_code == 400


@pytest.mark.long
def test_the_page_gets_a_first_look_and_then_a_simulation(
    client: PageClient, plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app, "EXACT_SECONDS", 60.0)  # however busy the machine is
    monkeypatch.setattr(app, "WHAT_IF_LIMIT", 120.0)
    known = client.get("/api/what_if?id=plan").get_json()
    assert known["robots"] == len(plan.robots) and known["places"] == action_means(plan)
    look = client.post("/api/what_if?id=plan", {"robots": 5}).get_json()
    assert set(look["growth"]) == {ALL, *(t.name for t in plan.net.transitions)}
    asked = {"robots": 5, "whole": True, "next": {"runs": 4, "time": 20}}
    job = client.post("/api/what_if?id=plan", asked).get_json()["job"]
    deadline = time.monotonic() + 120
    report = client.get("/api/analysis/" + job).get_json()
    while report["state"] == "running":
        assert time.monotonic() < deadline
        time.sleep(0.05)
        report = client.get("/api/analysis/" + job).get_json()
    found = report["result"]["prediction"]
    assert report["state"] == "done" and found["runs"] == 4
    assert found["growth"][ALL][0] == pytest.approx(look["growth"][ALL][0], rel=0.3)
    exact = report["result"]["exact"]
    assert exact["states"] > 1 and set(exact["throughput"]) == {
        t.name for t in plan.net.transitions
    }
    assert sum(exact["throughput"].values()) == pytest.approx(look["growth"][ALL][0], rel=0.3)


def test_where_there_is_no_exact_answer_it_says_why() -> None:
    plan = read_plan(plans_folder() + "/warehouse")
    robot = plan.robots[0].name
    changed = what_if_in_form({"each": {robot: 2}}, plan).apply(plan)
    assert pace(plan, each={robot: 8}) < pace(plan)
    assert not what_if_in_form({"slower": 2, "each": {robot: 1}}, plan).apply(plan).own_times
    assert "do not distinguish robots" in next(exact_paces(changed, 1.0, lambda *_: None))["why"]


def test_the_exact_answer_for_a_learned_plan_says_how_far_off_it_may_be() -> None:
    plan = read_plan(plans_folder() + "/patrol").for_robots(1)
    times = {place: Duration.exponential(mean) for place, mean in action_means(plan).items()}
    of = {("durations", place): Evidence(40, ("a.jsonl",)) for place in times}
    learned = replace(plan, durations=times, evidence=of)
    first, last = exact_paces(learned, 60.0, lambda *_: None)
    why = "the intervals take into account that the logs that values were learned from are short"
    assert "half_widths" not in first and first["notes"] == last["notes"] == [why]
    fired = {name: half for name, half in last["half_widths"].items() if first["throughput"][name]}
    assert fired and all(half > 0 for half in fired.values())
    known, same = exact_paces(plan, 60.0, lambda *_: None)
    assert known["notes"] == [] and set(same["half_widths"].values()) == {0.0}


def test_a_net_alone_has_no_runs_to_predict() -> None:
    client = PageClient()
    assert client.get("/api/what_if?id=small").status_code == 400
    assert client.post("/api/what_if?id=small", {}).status_code == 400
