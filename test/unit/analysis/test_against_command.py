"""``gspn simulate PLAN --against OTHER_PLAN``, and the nominal rates of a plan."""

import json
from pathlib import Path

import pytest

from gspn_framework_package.cli.main import main

PLAN = {
    "plan": "two ways",
    "net": {
        "places": [
            {"name": "choose", "tokens": 1},
            {"name": "slow"},
            {"name": "quick"},
            {"name": "trips"},
        ],
        "transitions": [
            {"name": "take_slow"},
            {"name": "take_quick"},
            {"name": "slow_done", "timed": True, "rate": 0.5},
            {"name": "quick_done", "timed": True, "rate": 2},
        ],
        "arcs": [
            {"from": "choose", "to": "take_slow"},
            {"from": "take_slow", "to": "slow"},
            {"from": "choose", "to": "take_quick"},
            {"from": "take_quick", "to": "quick"},
            {"from": "slow", "to": "slow_done"},
            {"from": "quick", "to": "quick_done"},
            {"from": "slow_done", "to": "choose"},
            {"from": "quick_done", "to": "choose"},
            {"from": "slow_done", "to": "trips"},
            {"from": "quick_done", "to": "trips"},
        ],
    },
    "policy": {"places": [], "rows": [{"marking": [], "choose": {"take_slow": 1}}]},
    "actions": {"choose": None, "slow": "act.drive", "quick": "act.drive"},
    "resource_places": ["trips"],
    "durations": {
        "slow": {"mean": 1, "of": {"observations": 9}},
        "quick": {"mean": 4, "of": {"observations": 9}},
    },
}
TRIPS = ["--reward", "slow_done=1", "--reward", "quick_done=1"]


@pytest.fixture
def plans(tmp_path):
    old, new = tmp_path / "old.json", tmp_path / "new.json"
    old.write_text(json.dumps(PLAN))
    rows = [{"marking": [], "choose": {"take_quick": 1}}]
    new.write_text(json.dumps({**PLAN, "policy": {"places": [], "rows": rows}}))
    return str(old), str(new)


def compare(plans, *words):
    return main(["simulate", plans[0], "--against", plans[1], *words])


@pytest.mark.long
def test_the_learned_durations_decide_and_the_nominal_rates_differ(plans, capsys):
    assert compare(plans, *TRIPS, "--replications", "20", "--json") == 0
    fitted = json.loads(capsys.readouterr().out)
    assert fitted["significant"] and fitted["better"] is False
    assert fitted["old"]["mean"] == pytest.approx(1, rel=0.1)
    assert fitted["new"]["mean"] == pytest.approx(0.25, rel=0.2)
    assert compare(plans, *TRIPS, "--replications", "20", "--rates", "nominal", "--json") == 0
    nominal = json.loads(capsys.readouterr().out)
    assert nominal["significant"] and nominal["better"]
    assert nominal["old"]["mean"] == pytest.approx(0.5, rel=0.1)
    for key in ("difference", "text", "pairs", "time", "warmup", "confidence", "notes"):
        assert nominal[key]


def test_the_text_has_the_values_and_the_verdict(plans, capsys):
    assert compare(plans, "--until", "trips >= 2", "--seconds", "0.2", "--seed", "1") == 0
    out = capsys.readouterr().out
    assert "aim: the shortest mean time until trips >= 2" in out
    assert "the new plan is worse than the old one" in out and "seed 1" in out


def test_nominal_rates_of_an_ordinary_simulation(plans, capsys):
    words = ["simulate", plans[0], "--time", "400", "--replications", "5", "--json"]
    values = []
    for more in ([], ["--rates", "nominal"]):
        assert main([*words, *more]) == 0
        values.append(json.loads(capsys.readouterr().out)["throughput"]["slow_done"]["mean"])
    assert values == pytest.approx([1.0, 0.5], rel=0.2)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "no aim is given"),
        ([*TRIPS, "--timing", "net"], "as they run"),
        ([*TRIPS, "--batches", "5"], "--batches and --against exclude each other"),
        ([*TRIPS, "--until", "trips >= 2"], "another aim is given"),
        (["--reward", "nowhere=1"], "'nowhere'"),
        (["--mean-time-to", "trips >"], "trips >"),
    ],
)
def test_what_makes_no_sense_is_refused(plans, capsys, words, message):
    assert compare(plans, *words) == 2
    assert message in capsys.readouterr().err


def test_what_is_no_comparison_is_refused(plans, tmp_path, capsys):
    assert main(["simulate", plans[0], "--time", "5", "--reward", "slow=1"]) == 2
    assert "--reward applies only to comparisons of two plans" in capsys.readouterr().err
    assert compare((plans[0], str(tmp_path / "none.json")), *TRIPS) == 2
    assert "none.json" in capsys.readouterr().err
    net = Path(__file__).parents[3] / "plans" / "patrol" / "patrol.pnml"
    if not net.exists():
        net = next((Path(__file__).parents[3] / "plans").rglob("*.xml"))
    assert main(["simulate", str(net), "--rates", "nominal", "--time", "5"]) == 2
    assert "are for plans" in capsys.readouterr().err
    assert compare((str(net), plans[1]), *TRIPS) == 2
    assert "this is a net" in capsys.readouterr().err
