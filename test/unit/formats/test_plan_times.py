"""Durations, outcomes, failures and rates of a plan file: what is read, written and refused."""

import copy
import json

import pytest

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.model.errors import PlanError

PLAN = {
    "net": {
        "places": [{"name": "a.b", "tokens": 1}, {"name": "c"}, {"name": "tools", "tokens": 1}],
        "transitions": [
            {"name": "t", "timed": True, "rate": 2},
            {"name": "u", "timed": True, "rate": 3},
            {"name": "i"},
        ],
        "arcs": [
            {"from": "a.b", "to": "t"},
            {"from": "t", "to": "c"},
            {"from": "a.b", "to": "u"},
            {"from": "u", "to": "c"},
            {"from": "c", "to": "i"},
            {"from": "i", "to": "a.b"},
        ],
    },
    "actions": {"a.b": "actions.f", "c": "actions.f"},
    "resource_places": ["tools"],
    "durations": {
        "a.b": {
            "mean": 1.2,
            "distribution": "gamma",
            "shape": 59,
            "of": {"observations": 537, "logs": ["run.jsonl"], "interval": [1.1, 1.3]},
        },
        "c": {"mean": 0.5},
    },
    "outcomes": {"a.b": {"probabilities": {"t": 0.25, "u": 0.75}, "of": {"observations": 40}}},
    "failures": {"c": {"probability": 0.01}},
    "chance": ["c"],
    "rates": {"t": {"rate": 5}},
}


def test_what_is_written_is_read_again():
    plan = plan_from_json(PLAN)
    assert plan.durations == {"a.b": Duration.gamma(59, 1.2), "c": Duration.exponential(0.5)}
    assert plan.outcomes["a.b"]["u"] == 0.75
    assert plan.failures == {"c": 0.01}
    assert plan.net.transition("t").rate == 5
    assert plan.net.transition("u").rate == 3
    assert plan.evidence["durations", "a.b"] == Evidence(537, ("run.jsonl",), (1.1, 1.3))
    again = plan_from_json(json.loads(json.dumps(plan_to_json(plan))))
    for name in ("durations", "outcomes", "failures", "chance", "rates", "evidence"):
        assert getattr(again, name) == getattr(plan, name)
    assert again.hash() == plan.hash()


def test_only_what_a_run_reads_is_part_of_its_hash():
    without = {
        k: v for k, v in PLAN.items() if k not in ("durations", "outcomes", "failures", "chance")
    }
    assert plan_from_json(without).hash() == plan_from_json(PLAN).hash()
    assert plan_from_json({**without, "rates": {}}).hash() != plan_from_json(PLAN).hash()


def test_a_plan_remembers_the_rates_of_its_net():
    plan = plan_from_json(PLAN)
    for held in (plan, plan_from_json(json.loads(json.dumps(plan_to_json(plan))))):
        assert held.hash() == plan.hash()
        assert held.net.transition("t").rate == 5
        assert held.own_rates == {"t": 2}
        nominal = held.nominal()
        assert [nominal.net.transition(t).rate for t in "tu"] == [2, 3]
        assert not nominal.rates and not nominal.evidence
        # what has no evidence was written by a person
        assert nominal.durations == {"c": Duration.exponential(0.5)}
        assert nominal.outcomes == {} and nominal.failures == {"c": 0.01}


def test_a_rate_that_is_learned_twice_has_one_nominal_value():
    plan = plan_from_json(PLAN).with_rates({"t": 6.0, "u": 7.0}).with_rates({"t": 8.0})
    assert plan.rates == {"t": 8, "u": 7}
    assert [plan.net.transition(t).rate for t in "tu"] == [8, 7]
    assert [plan.nominal().net.transition(t).rate for t in "tu"] == [2, 3]


def test_a_plan_without_learned_values_is_nominal():
    plain = plan_from_json({k: v for k, v in PLAN.items() if k not in ("rates", "durations")})
    plain = plan_from_json({**plan_to_json(plain), "outcomes": {}})
    assert plain.nominal() == plain and plain.nominal().hash() == plain.hash()


@pytest.mark.parametrize(
    ("path", "value", "message", "line_has"),
    [
        (("durations", "a.b"), {"mean": -1}, "less than the minimum", '"mean"'),
        (("durations", "a.b"), {"mean": 0}, "0 is not a possible mean", '"a.b"'),
        (("durations", "a.b", "distribution"), "normal", "is not one of", '"normal"'),
        (("durations", "nowhere"), {"mean": 1}, "no place 'nowhere'", '"durations"'),
        (("durations", "tools"), {"mean": 1}, "has no action", '"tools"'),
        (("outcomes", "a.b", "probabilities"), {"t": 0.5}, "sum to 0.5", '"a.b"'),
        (("outcomes", "a.b", "probabilities"), {"i": 1}, "'i' does not leave", '"a.b"'),
        (("failures", "c", "probability"), 1, "1", '"probability"'),
        (("chance",), ["nowhere"], "no place 'nowhere'", '"chance"'),
        (("chance",), ["a.b"], "no immediate transition leaves 'a.b'", '"chance"'),
        (("rates", "i"), {"rate": 1}, "an immediate transition has no rate", '"i"'),
        (("rates", "x"), {"rate": 1}, "no transition 'x'", '"rates"'),
    ],
)
def test_what_is_wrong_is_refused_with_its_line(tmp_path, path, value, message, line_has):
    data = copy.deepcopy(PLAN)
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(data, indent=1))
    with pytest.raises(PlanError, match=message) as caught:
        read_plan(str(file))
    assert caught.value.line is not None
    assert line_has in file.read_text().splitlines()[caught.value.line - 1]
