"""Arrivals: whether they change over the day, when, what comes, and the plan with a clock."""

from __future__ import annotations

import json
from typing import Any, Dict, Sequence

import numpy as np
import pytest

from benchmarks.waiting_places import HOUR, NORTH, SOUTH, day, warehouse
from gspn_framework_package.analysis.fitting import fit_plan
from gspn_framework_package.analysis.fitting.arrivals import fit_arrivals, with_day
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_to_short_json
from gspn_framework_package.model.attempt import EventCount
from gspn_framework_package.model.builder import NetBuilder

ENDS = (
    NetBuilder("ends")
    .place("a")
    .exponential("north", outputs="a")
    .exponential("south", outputs="a")
    .exponential("served", inputs="a")
    .build()
)


def recorded(draw: Any, days: int, **hourly: Sequence[float]) -> Dict[str, EventCount]:
    """What logs of so many days count, if so many come in each hour."""
    counts = {}
    for name, rates in hourly.items():
        hours = {h: (int(draw.poisson(days * rate)), HOUR * days) for h, rate in enumerate(rates)}
        counts[name] = EventCount(
            sum(n for n, _ in hours.values()), HOUR * days * len(rates), hours
        )
    return counts


def test_constant_rates_are_called_changing_in_one_case_of_twenty() -> None:
    draw = np.random.default_rng(1)
    days = [recorded(draw, 2, north=[4] * 8, south=[1] * 8) for _ in range(600)]
    found = [fit_arrivals(ENDS, one) for one in days]
    assert all(one.arrivals["south"].parts < one.arrivals["north"].parts for one in found)
    assert 15 <= sum(bool(one.day) for one in found) <= 45


def test_the_hours_and_the_rates_of_changing_arrivals_are_recovered() -> None:
    draw = np.random.default_rng(2)
    inside = {end: [0, 0] for end in ("north", "south")}
    for _ in range(60):
        found = fit_arrivals(ENDS, recorded(draw, 10, north=NORTH, south=SOUTH))
        assert [period.span for period in found.day] == [(0, 2), (2, 4), (4, 6), (6, 8)]
        for period in found.day:
            for end, rates in (("north", NORTH), ("south", SOUTH)):
                low, high = period.rates[end].interval
                truth = sum(rates[slice(*period.span)]) / period.hours / HOUR
                inside[end][low <= truth <= high] += 1
    for _, held in inside.values():
        assert 0.9 * 240 <= held <= 239
    (note,) = found.notes
    assert "16 of 24 hours of the day (UTC): 8 to 24" in note


def test_a_period_may_go_past_midnight_and_its_arrivals_may_be_none() -> None:
    rates = [0] * 6 + [9] * 16 + [0] * 2
    draw = np.random.default_rng(3)
    found = fit_arrivals(ENDS, recorded(draw, 5, north=rates, south=[1] * 24))
    assert [period.span for period in found.day] == [(6, 22), (22, 6)] and not found.notes
    assert list(found.day[0].rates) == ["north"]
    assert found.day[1].rates["north"].rate == 0 and found.day[1].rates["north"].interval[1] > 0


def test_the_variation_that_a_test_shows_is_shown_in_four_of_five_cases() -> None:
    draw = np.random.default_rng(4)
    rates = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0])
    even = EventCount(400, 80 * HOUR, dict.fromkeys(range(8), (50, 10 * HOUR)))
    some = fit_arrivals(ENDS, {"north": even}).arrivals["north"]
    assert some.shows is not None and some.p == pytest.approx(1.0)
    days = [recorded(draw, 10, north=5 * (1 + some.shows * rates)) for _ in range(400)]
    shown = sum(fit_arrivals(ENDS, one).arrivals["north"].changes for one in days)
    assert 0.74 * 400 <= shown <= 0.86 * 400


def test_what_the_logs_are_too_short_for_is_said() -> None:
    plan = warehouse()
    few = {"order_north": EventCount(9, HOUR, {0: (9, HOUR / 2), 1: (0, HOUR / 2)})}
    found = fit_plan(plan, [], few)
    assert found.arrivals.arrivals["order_north"].p is None and not found.arrivals.day
    (need,) = [need for need in found.needs() if need.what == "change over the day"]
    assert (need.of, need.seen, need.needed) == ("order_north", 9, 10)
    kinds = {"order_north": few["order_north"]._replace(data={"id": {"a": 1, "b": 1, "c": 2}})}
    assert any("the 3 values of id; about 15" in note for note in fit_plan(plan, [], kinds).notes)


def test_kinds_and_places_of_tasks_have_shares_with_intervals() -> None:
    hours = {0: (60, 10 * HOUR), 1: (60, 10 * HOUR)}
    data = {"kind": {"urgent": 30, "normal": 90}, "id": {str(n): 1 for n in range(120)}}
    events = {
        "order_north": EventCount(120, 20 * HOUR, hours, data),
        "order_south": EventCount(40, 20 * HOUR, {0: (40, 20 * HOUR)}),
    }
    found = fit_plan(warehouse(), [], events)
    north = found.arrivals.arrivals["order_north"]
    assert (north.share.probability, north.share.total) == (0.75, 160)
    assert list(north.data) == ["kind"] and list(north.data["kind"]) == ["normal", "urgent"]
    urgent = north.data["kind"]["urgent"]
    assert urgent.probability == 0.25 and urgent.interval[0] < 0.25 < urgent.interval[1]
    (need,) = [need for need in found.needs(0.05) if need.what == "shares"]
    assert need.of == "kind of order_north" and need.needed > 120


@pytest.mark.long
def test_fit_finds_the_day_in_logs_and_gives_the_plan_a_clock(tmp_path: Any, capsys: Any) -> None:
    plan = warehouse()
    old, new = tmp_path / "plan.json", tmp_path / "new.json"
    old.write_text(json.dumps(plan_to_short_json(plan)))
    logs = [str(tmp_path / ("%d.jsonl" % n)) for n in range(4)]
    for number, log in enumerate(logs):
        day(plan, number, log)
    assert main(["fit", str(old), *logs, "-o", str(new), "--day"]) == 0
    out = capsys.readouterr().out
    assert "order_north changes over the day" in out and "an hour" in out
    assert main(["fit", str(old), *logs, "-o", str(new), "--day", "--json", "--force"]) == 0
    told = json.loads(capsys.readouterr().out)
    spans = [(part["from_hour"], part["hours"]) for part in told["day"]]
    assert spans == [(0, 2), (2, 2), (4, 2), (6, 2)]
    assert told["arrivals"]["order_north"]["changes"]
    learned = read_plan(str(new))
    assert {"hours_0_2", "hours_6_8"} <= learned.resource_places
    busy = learned.net.transition("order_north_2_4")
    evidence = learned.evidence["rates", busy.name]
    assert evidence.interval is not None
    assert evidence.interval[0] <= busy.number <= evidence.interval[1]
    # in virtual time, the clock keeps the hours, and in the third and fourth come the orders that
    # were learned, those of the rest of the day among them
    run = VirtualRun(learned, seed=5).run(time=40 * 24 * HOUR)
    assert run.firings["after_hours_2_4"] == 40
    assert run.mean_tokens["hours_2_4"] == pytest.approx(2 / 24)
    ordered = run.firings["order_north_2_4"] / (80 * HOUR)
    assert ordered == pytest.approx(busy.number, rel=0.1)
    most = learned.net.transition("order_north").number + busy.number
    assert most == pytest.approx(told["day"][1]["rates"]["order_north"]["rate"])
    # the simulation takes the rates, also where nobody simulates the environment of a run
    told = json.loads(new.read_text())
    told["environment"] = "operator"
    new.write_text(json.dumps(told))
    assert main(["simulate", str(new), "--time", "1e6", "--seed", "1", "--json"]) == 0
    morning = json.loads(capsys.readouterr().out)["mean_tokens"]["hours_2_4"]
    assert morning["mean"] == pytest.approx(0.25, abs=0.1)
    assert main(["fit", str(old), *logs, "-o", str(new), "--force"]) == 0
    assert [t.name for t in read_plan(str(new)).net.transitions] == [
        t.name for t in plan.net.transitions
    ]


def test_a_plan_whose_arrivals_do_not_change_gets_no_clock() -> None:
    plan = warehouse()
    events = recorded(np.random.default_rng(6), 2, order_north=[10] * 8)
    found = fit_plan(plan, [], events)
    assert not found.arrivals.arrivals["order_north"].changes
    assert with_day(plan, found.arrivals, []).net.transition_index == plan.net.transition_index
