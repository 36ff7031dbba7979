"""``gspn compare --replay`` and ``gspn deploy --replay``: recorded runs on another plan."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any, Callable, Dict, List, Sequence, Tuple

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.history import RecordedRun, read_run
from gspn_framework_package.execution.history_run import HistoryRun, PlanNames, PlayedHistory
from gspn_framework_package.execution.log_parts import log_parts
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.testing import Scenario


def _arcs(*chains: str) -> List[Dict[str, Any]]:
    """``"a t b"``: from place a through transition t to place b."""
    found = []
    for chain in chains:
        place, transition, target = chain.split()
        found += [{"from": place, "to": transition}, {"from": transition, "to": target}]
    return found


ROADS: Dict[str, Any] = {
    "plan": "roads",
    "net": {
        "places": [
            {"name": "Choose", "tokens": 2},
            {"name": "Short"},
            {"name": "Long"},
            {"name": "Key", "tokens": 1},
        ],
        "transitions": [
            {"name": "short", "timed": False, "weight": 1},
            {"name": "long", "timed": False, "weight": 1},
            {"name": "was_short", "timed": True, "rate": 1},
            {"name": "was_long", "timed": True, "rate": 1},
        ],
        "arcs": _arcs(
            "Choose short Short",
            "Choose long Long",
            "Short was_short Choose",
            "Long was_long Choose",
        ),
    },
    "resource_places": ["Key"],
    "actions": {"Choose": None, "Short": "roads.drive", "Long": "roads.drive"},
    "robots": {"r1": "Choose", "r2": "Choose"},
    "durations": {
        "Short": {"mean": 1.0, "distribution": "gamma", "shape": 10},
        "Long": {"mean": 3.0, "distribution": "gamma", "shape": 10},
    },
    "failures": {"Long": {"probability": 0.1}},
    "on_failure": {"*": {"retry": 100, "delay": 0.5}},
}

SHOP: Dict[str, Any] = {
    "plan": "shop",
    "net": {
        "places": [{"name": "Idle", "tokens": 1}, {"name": "Serve"}, {"name": "Orders"}],
        "transitions": [
            {"name": "order", "timed": True, "rate": 0.2},
            {"name": "take", "timed": False},
            {"name": "served", "timed": True, "rate": 1},
        ],
        "arcs": [
            {"from": "order", "to": "Orders"},
            {"from": "Orders", "to": "take"},
            *_arcs("Idle take Serve", "Serve served Idle"),
        ],
    },
    "resource_places": ["Orders"],
    "tasks": {"queues": ["Orders"], "done": ["served"]},
    "actions": {"Idle": None, "Serve": "shop.serve"},
    "robots": {"r1": "Idle"},
    "durations": {"Serve": {"mean": 3.0, "distribution": "gamma", "shape": 10}},
}


def _always(transition: str) -> Dict[str, Any]:
    return {"policy": {"places": [], "rows": [{"marking": [], "choose": {transition: 1}}]}}


def _needs_key() -> Dict[str, Any]:
    """The plan in which a robot takes the key for the short road, and never gives it back."""
    plan = copy.deepcopy(ROADS)
    plan["net"]["arcs"].append({"from": "Key", "to": "short"})
    plan["policy"] = {
        "places": ["Key"],
        "rows": [
            {"marking": [1], "choose": {"short": 1}},
            {"marking": [0], "choose": {"short": 1}},
        ],
    }
    return plan


def _write(folder: Path, name: str, data: Dict[str, Any]) -> str:
    path = folder / (name + ".json")
    path.write_text(json.dumps(data))
    return str(path)


def _record(folder: Path, plan: str, seconds: float = 300.0, seed: int = 1) -> str:
    run = VirtualRun(read_plan(plan), seed=seed)
    path = folder / ("run_%d.jsonl" % seed)
    writer = run.record_in(str(path), "run %d" % seed, "log %d" % seed)
    run.run(time=seconds)
    writer.close()
    return str(path)


def _play(log: str, **names: str) -> Tuple[RecordedRun, PlayedHistory]:
    recorded = read_run(log_parts(log))
    plan = recorded.plan
    return recorded, HistoryRun(plan, recorded, PlanNames.between(plan, plan, names)).play(5)


Compare = Callable[..., Tuple[int, Dict[str, Any]]]


@pytest.fixture
def compare(capsys: pytest.CaptureFixture[str]) -> Compare:
    """Calls ``gspn compare --replay --json``."""

    def run(*words: str) -> Tuple[int, Dict[str, Any]]:
        code = main(["compare", *words, "--replay", "--json"])
        told = capsys.readouterr()
        assert code < 2, told.err
        return code, json.loads(told.out)

    return run


def _measure(found: Dict[str, Any], name: str) -> Dict[str, Any]:
    return next(m for m in found["measures"] if m["name"] == name)


@pytest.fixture
def roads(tmp_path: Path) -> Sequence[str]:
    """The plan, and the log of a run of it."""
    plan = _write(tmp_path, "roads", ROADS)
    return plan, _record(tmp_path, plan)


REWARD = ("--reward", "was_*=1")


def test_the_own_plan_meets_what_it_met(roads: Sequence[str]) -> None:
    recorded, played = _play(roads[1])
    names = [t.name for t in recorded.plan.net.transitions]
    assert dict(zip(names, played.firings[-1])) == recorded.firings
    assert played.drawn <= 2  # the end of the log cuts off one attempt of each robot
    assert any(action.failed for action in recorded.actions["r1", "Long"])


def test_a_better_plan(compare: Compare, roads: Sequence[str], tmp_path: Path) -> None:
    better = _write(tmp_path, "better", {**ROADS, **_always("short")})
    code, found = compare(better, roads[1], *REWARD)
    assert code == 0 and found["worse"] == []
    aim = found["aim"]
    assert aim["significant"] and aim["interval"][0] > 0
    # two robots, each 1 s for every road instead of 2.2 s on average
    assert aim["new"] == pytest.approx(2.0, rel=0.1)
    assert _measure(found, "throughput long")["new"] == 0
    assert found["attempts"]["recorded"] > 0 < found["attempts"]["drawn"]


def test_a_worse_plan(compare: Compare, roads: Sequence[str], tmp_path: Path) -> None:
    worse = _write(tmp_path, "worse", {**ROADS, **_always("long")})
    code, found = compare(worse, roads[1], *REWARD)
    assert code == 1
    assert "worse by more than 5 %" in found["worse"][0]
    assert compare(worse, roads[1], *REWARD, "--margin", "90")[0] == 0


def test_a_plan_that_deadlocks(compare: Compare, roads: Sequence[str], tmp_path: Path) -> None:
    code, found = compare(_write(tmp_path, "stuck", _needs_key()), roads[1])
    assert code == 1
    (stuck,) = found["stands_still"]
    assert stuck["where"] == "r1 waits in Choose, r2 waits in Choose"
    assert 0 < stuck["since"] < 10


def test_a_result_that_the_plan_does_not_know_is_refused(compare: Compare, tmp_path: Path) -> None:
    plan = copy.deepcopy(ROADS)
    plan["net"]["transitions"].append({"name": "lost", "timed": True, "rate": 1})
    plan["net"]["arcs"] += _arcs("Long lost Choose")
    plan["outcomes"] = {"Long": {"probabilities": {"was_long": 0.5, "lost": 0.5}}}
    log = _record(tmp_path, _write(tmp_path, "may_be_lost", plan))
    code, found = compare(_write(tmp_path, "roads", ROADS), log, *REWARD)
    assert code == 1
    (what,) = found["refused"]
    assert what == "Long names lost, which does not leave it"
    # the new plan has no 'lost', which is called 'was_long' there
    code, found = compare(_write(tmp_path, "roads", ROADS), log, *REWARD, "--map", "lost=was_long")
    assert found["refused"] == {}


def test_tasks_come_when_they_came_and_may_be_late(compare: Compare, tmp_path: Path) -> None:
    plan, log = _write(tmp_path, "shop", SHOP), str(tmp_path / "shop.jsonl")
    with Scenario(plan, log=log) as run:
        for number in range(20):
            order = log_entries.make_submit("order", "o%d" % number, {})
            run.order(order._replace(until=5 * number + 4), at=5.0 * number)
        run.advance(120)
    slow = copy.deepcopy(SHOP)
    slow["actions"]["Serve"] = "shop.serve_slowly"  # another action: its own durations
    slow["durations"]["Serve"] = {"mean": 9.5, "distribution": "deterministic"}
    code, found = compare(plan, log)
    assert (code, found["late"]) == (0, {"old": 0, "new": 0})
    seconds = 3600 * found["robot_hours"]  # of one robot
    assert _measure(found, "tasks done")["old"] == pytest.approx(20 / seconds)
    code, found = compare(_write(tmp_path, "slow", slow), log)
    assert code == 1
    # every second order waits until its time is over; the last one comes just before the end
    assert found["late"] == {"old": 0, "new": 9}
    assert _measure(found, "time of a task")["new"] > 9


def test_another_world_is_the_same_for_both(tmp_path: Path) -> None:
    """Events and the environment come again when they could have occurred for as long."""
    plan = copy.deepcopy(ROADS)
    plan["net"]["transitions"] += [
        {"name": "alarm", "timed": True, "rate": 0.2},
        {"name": "new_key", "timed": True, "rate": 0.1},
    ]
    plan["net"]["arcs"] += [*_arcs("Long alarm Choose"), {"from": "new_key", "to": "Key"}]
    plan["events"] = {"alarm": {"function": "roads.alarm"}}
    plan["environment"] = "simulate"
    plan["outcomes"] = {"Long": {"probabilities": {"was_long": 1}}}
    log = _record(tmp_path, _write(tmp_path, "alarms", plan), seconds=200.0)
    recorded, played = _play(log)
    assert recorded.firings["alarm"] > 5 < recorded.firings["new_key"]
    names = [t.name for t in recorded.plan.net.transitions]
    for name, count in zip(names, played.firings[-1]):
        assert count == pytest.approx(recorded.firings[name], abs=1), name
    exposures = [e for e, _ in recorded.events["r1", "alarm"]]
    assert all(e > 0 for e in exposures) and math.isfinite(sum(exposures))


def test_deploy_refuses_a_worse_plan_unless_forced(
    capsys: pytest.CaptureFixture[str],
    roads: Sequence[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # no runs of others
    worse = _write(tmp_path, "worse", {**ROADS, **_always("long")})
    words = ["deploy", worse, "--standalone", "--replay", roads[1], *REWARD]
    assert main([*words, "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert not told["done"] and "--force deploys it anyway" in told["message"]
    assert told["replay"]["worse"]
    assert main([*words, "--force"]) != 0  # goes on: there is no run
    assert "no run" in capsys.readouterr().err.lower()
    assert main(["deploy", worse, "--standalone", "--replay", roads[1]]) == 2
    assert "what counts" in capsys.readouterr().err


def test_a_store_of_the_history(
    roads: Sequence[str], tmp_path: Path, compare: Compare, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("duckdb")
    store = str(tmp_path / "fleet")
    assert main(["history", "ingest", roads[1], "--store", store, "--json"]) == 0
    capsys.readouterr()
    code, found = compare(roads[0], store, *REWARD)
    assert (code, found["runs"]) == (0, 1)


def test_workers_find_the_same(compare: Compare, tmp_path: Path) -> None:
    plan, logs = _write(tmp_path, "shop", SHOP), []
    for seed in (1, 2):
        logs.append(_record(tmp_path, plan, seconds=100.0, seed=seed))
    local = compare(plan, *logs)
    assert compare(plan, *logs, "--on", "processes:2") == local
    assert local[1]["runs"] == 2
