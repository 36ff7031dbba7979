"""``gspn compare`` as one calls it, on logs of runs in virtual time."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Tuple

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.attempts import AttemptFollower
from gspn_framework_package.execution.event_log import LogFile
from gspn_framework_package.execution.observation import RunObserver
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan

PLAN: Dict[str, Any] = {
    "plan": "two workers",
    "net": {
        "places": [{"name": "Work", "tokens": 2}, {"name": "Rest"}, {"name": "Tool", "tokens": 1}],
        "transitions": [
            {"name": "good", "timed": True, "rate": 1},
            {"name": "bad", "timed": True, "rate": 1},
            {"name": "left", "timed": False, "weight": 1},
            {"name": "right", "timed": False, "weight": 1},
        ],
        "arcs": [
            {"from": "Work", "to": "good"},
            {"from": "good", "to": "Rest"},
            {"from": "Work", "to": "bad"},
            {"from": "bad", "to": "Rest"},
            {"from": "Rest", "to": "left"},
            {"from": "left", "to": "Work"},
            {"from": "Rest", "to": "right"},
            {"from": "right", "to": "Work"},
        ],
    },
    "resource_places": ["Tool"],
    "actions": {"Work": "work.go", "Rest": "work.go"},
    "robots": {"r1": "Work", "r2": "Work"},
    "durations": {
        "Work": {
            "mean": 1.0,
            "distribution": "gamma",
            "shape": 20,
            "of": {"observations": 400, "logs": ["a"], "interval": [0.97, 1.03]},
        },
        "Rest": {"mean": 0.5, "distribution": "deterministic"},
    },
    "outcomes": {"Work": {"probabilities": {"good": 0.8, "bad": 0.2}}},
}


DOCK: Dict[str, Any] = {
    "net": {
        "places": [{"name": "Approach"}, {"name": "Docked"}],
        "transitions": [{"name": "arrive", "timed": True, "rate": 2}],
        "arcs": [{"from": "Approach", "to": "arrive"}, {"from": "arrive", "to": "Docked"}],
    },
    "actions": {"Approach": "dock.approach", "Docked": None},
    "durations": {"Approach": {"mean": 0.5, "distribution": "gamma", "shape": 4}},
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    return tmp_path


def _log(
    folder: Path, name: str = "run", seconds: float = 200.0, seed: int = 1, longer: float = 1.0
) -> Path:
    """Write the log of a virtual run, in which ``r2`` becomes slower in the middle."""
    plan = read_plan(str(folder))
    run = VirtualRun(
        plan,
        seed=seed,
        slowness=lambda robot, place, now: (
            longer if robot == "r2" and place == "Work" and now > seconds / 2 else 1.0
        ),
    )
    path = folder / (name + ".jsonl")
    writer = run.record_in(str(path), name, name)
    run.run(time=seconds)
    writer.close()
    return path


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*words: Any) -> Tuple[int, str, str]:
        code = main(["compare", *map(str, words)])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


FEW = ("--replications", "100")


def test_a_run_as_planned(folder: Path, call: Any) -> None:
    code, out, err = call(folder, _log(folder), "--json", *FEW)
    data = json.loads(out)
    assert code == 0, (data["alarms"], data["unusual"], data["farthest"])
    assert data["departs"] is False and data["alarms"] == []
    assert data["false_alarm_every"] == 30 * 86_400
    names = {m["name"]: m for m in data["measures"]}
    assert {"throughput good", "mean tokens Work", "mean tokens Tool", "visits Rest"} <= set(names)
    good = names["throughput good"]
    assert good["interval"][0] <= good["observed"] <= good["interval"][1] and good["inside"]
    assert good["predicted"] == pytest.approx(0.8 * 2 / 1.5, rel=0.05)
    assert names["mean tokens Tool"]["observed"] == 1.0 and names["mean tokens Tool"]["inside"]
    kinds = {(s["kind"], s["place"], s["robot"]) for s in data["streams"]}
    assert {("place", "Work", ""), ("robot", "", "r2"), ("team", "", "")} <= kinds
    assert all(s["cusum"] < s["threshold"] and s["alarm_at"] is None for s in data["streams"])


def test_a_slower_robot_is_named_and_the_exit_code_is_1(folder: Path, call: Any) -> None:
    path = _log(folder, longer=1.4)
    code, out, err = call(folder, path, "--json", *FEW)
    data = json.loads(out)
    assert code == 1 and data["departs"] is True
    stream = next(s for s in data["streams"] if s["robot"] == "r2")
    assert 100 < stream["alarm_at"] < 190 and stream["direction"] == "slower"
    alarm = data["alarms"][0]
    assert alarm["place"] == "Work" and alarm["robot"] == "r2"
    assert alarm["change"] == pytest.approx(0.4, abs=0.15)
    code, out, err = call(folder, path, *FEW)
    assert code == 1 and "Work, r2: slower than planned" in out
    assert "the run deviates from the plan" in out


def test_several_runs_are_compared_together(folder: Path, call: Any) -> None:
    logs = folder / "logs"
    logs.mkdir()
    (logs / "plan.json").write_text(json.dumps(PLAN))
    for seed in (1, 2):
        _log(logs, "run_%d" % seed, 60.0, seed)
    code, out, err = call(folder, logs, "--alarm-every", "12h", "--json", *FEW)
    data = json.loads(out)
    assert code == 0
    assert [run["name"] for run in data["runs"]] == ["run_1", "run_2"]
    assert [run["seconds"] for run in data["runs"]] == pytest.approx([60.0, 60.0])
    assert data["false_alarm_every"] == 43_200
    visits = next(m for m in data["measures"] if m["name"] == "visits Rest")
    assert visits["observed"] == pytest.approx(2 * 2 * 60 / 1.5, rel=0.1)


def test_the_time_to_the_condition(folder: Path, call: Any) -> None:
    plan = json.loads(json.dumps(PLAN))
    plan["until"] = "Tool >= 30"
    plan["net"]["arcs"].append({"from": "good", "to": "Tool"})
    (folder / "plan.json").write_text(json.dumps(plan))
    code, out, err = call(folder, _log(folder), "--json", *FEW)
    measure = json.loads(out)["measures"][-1]
    assert measure["kind"] == "time to condition" and measure["of"] == "Tool >= 30"
    assert measure["inside"] and 15 < measure["interval"][0] < measure["observed"] < 45


def test_another_policy_than_planned_is_noticed(folder: Path, call: Any) -> None:
    path = _log(folder, seconds=600.0)
    plan = json.loads(json.dumps(PLAN))
    plan["policy"] = {
        "places": ["Tool"],
        "rows": [{"marking": ["-"], "choose": {"left": 0.9, "right": 0.1}}],
    }
    (folder / "plan.json").write_text(json.dumps(plan))
    code, out, err = call(folder, path, "--json", *FEW)
    assert code == 1
    alarm = next(a for a in json.loads(out)["alarms"] if a["kind"] == "choice")
    assert alarm["place"] == "Rest" and alarm["observed"] == pytest.approx(0.5, abs=0.1)


def test_what_the_observer_adds_up_is_what_the_run_did(folder: Path) -> None:
    plan = replace(read_plan(str(folder)), seed=3)
    run = VirtualRun(plan)
    path = folder / "run.jsonl"
    writer = run.record_in(str(path), "run", "id")
    result = run.run(time=50.0)
    writer.close()
    file = LogFile(str(path))
    follower, observer = AttemptFollower(file.plan, agents=True), RunObserver(plan, file.plan)
    for record in file.checked_records():
        follower.take(record)
        if follower.step is not None:
            observer.take(follower.step, follower.now)
    assert observer.firings == result.firings
    assert observer.seconds == pytest.approx(50.0) and observer.robots == ["r1", "r2"]
    for place, mean in result.mean_tokens.items():
        assert observer.tokens[place] / 50.0 == pytest.approx(mean, abs=1e-6)
    assert len(observer.choices) == result.firings["left"] + result.firings["right"]
    start = observer.start_of(plan)
    assert start.net.initial_marking == plan.net.initial_marking
    assert start.robots == plan.robots


@pytest.mark.parametrize(
    "words, message",
    [
        (["plan", "nothing.jsonl"], "nothing.jsonl"),
        (["plan", "plan/plan.json"], "is not an event log"),
        (["plan", "log", "--alarm-every", "never"], "is not a time"),
        (["plan", "log", "--alarm-every", "0d"], "is not a time"),
        (["plan", "log", "--alarm-every", "nan"], "is not a time"),
        (["plan", "empty.jsonl"], "is empty"),
        (["plan", "head.jsonl"], "contains no run"),
        (["other", "log"], "its net differs"),
        (["log", "log"], "plan"),
    ],
)
def test_wrong_input(
    folder: Path, call: Any, monkeypatch: pytest.MonkeyPatch, words: Any, message: str
) -> None:
    monkeypatch.chdir(folder)
    log = _log(folder, seconds=5.0)
    (folder / "empty.jsonl").write_text("")
    (folder / "head.jsonl").write_text(log.read_text().splitlines(keepends=True)[0])
    other = json.loads(json.dumps(PLAN))
    other["net"]["places"].append({"name": "More"})
    other["actions"]["More"] = None
    (folder / "other.json").write_text(json.dumps(other))
    names = {"plan": folder, "log": log, "other": folder / "other.json"}
    names["plan/plan.json"] = folder / "plan.json"
    code, out, err = call(*[names.get(word, word) for word in words], *FEW)
    assert code == 2 and out == ""
    assert message in err and "Traceback" not in err


@pytest.mark.parametrize(("longer", "departs"), [(1.04, False), (1.2, True)])
def test_what_slows_all_actions_a_little_is_no_departure(
    tmp_path: Path, call: Any, longer: float, departs: bool
) -> None:
    """Fixed times predict a count exactly: 400 visits, of which the run loses 2, or 9."""
    fixed = {place: {"mean": 0.5, "distribution": "deterministic"} for place in ("Work", "Rest")}
    (tmp_path / "plan.json").write_text(json.dumps({**PLAN, "durations": fixed}))
    log = _log(tmp_path, longer=longer)
    _, out, _ = call(tmp_path, log, "--json", *FEW)
    visits = next(m for m in json.loads(out)["measures"] if m["name"] == "visits Rest")
    assert visits["observed"] < 400
    assert visits["inside"] is not departs


def test_subnets_are_compared_by_robots_entries_exits_and_time(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    plan = {
        **PLAN,
        "actions": {
            "Work": "work.go",
            "Rest": {"plan": "dock.json", "entry": "Approach", "exit": "Docked"},
        },
        "durations": {"Work": {"mean": 1.0, "distribution": "gamma", "shape": 20}},
    }
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    (tmp_path / "dock.json").write_text(json.dumps(DOCK))
    path = _log(tmp_path)
    assert main(["compare", str(tmp_path), str(path), "--json", "--replications", "200"]) == 0
    measures = {m["name"]: m for m in json.loads(capsys.readouterr().out)["measures"]}
    robots, entries, exits, stay = (
        measures["%s %s" % (kind, "Rest")]
        for kind in ("robots in subnet", "entries of subnet", "exits of subnet", "time in subnet")
    )
    assert all(m["inside"] for m in (robots, entries, exits, stay))
    # two robots, each a third of its time inside, for half a second a visit
    assert abs(robots["observed"] - 2 / 3) < 0.05 and abs(robots["predicted"] - 2 / 3) < 0.02
    assert abs(stay["observed"] - 0.5) < 0.05 and abs(stay["predicted"] - 0.5) < 0.02
    assert abs(entries["observed"] - exits["observed"]) <= 2 / 200
    assert abs(entries["observed"] - 4 / 3) < 0.1
