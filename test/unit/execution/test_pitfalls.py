"""Where the framework published with the thesis breaks: one test for each fault that shows without
ROS, by its number. Those that need ROS are in test/rostest/pitfalls, those of the page in
test/browser and test/unit/visualizer."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, List

import pytest
from game_driver import Run, make_plan

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import GspnError, PolicyError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.outcome import FAILURES
from gspn_framework_package.model.policy import Policy

ROOT = Path(__file__).resolve().parents[3]


def tool_net() -> Net:
    return (
        NetBuilder()
        .place("idle")
        .place("use")
        .place("tool", tokens=1)
        .exponential("take", inputs=["idle", "tool"], outputs="use")
        .exponential("give", inputs="use", outputs=["idle", "tool"])
        .build()
    )


def meeting(resource: bool = False) -> Net:
    inputs = ["P1", "P2"] + (["permit"] if resource else [])
    return (
        NetBuilder()
        .place("P1")
        .place("P2")
        .place("P3")
        .place("P4")
        .place("permit", tokens=1)
        .exponential("meet", inputs=inputs, outputs=["P3", "P4"])
        .exponential("other", inputs=["P1", "P2"], outputs=["P4", "P3"])
        .exponential("b3", inputs="P3", outputs="P1")
        .exponential("b4", inputs="P4", outputs="P2")
        .build()
    )


def test_01_the_robot_that_acquires_a_resource_moves() -> None:
    run = Run(make_plan(tool_net(), ["idle"], resources=["tool"]))
    assert run.done("a", "take") == ["take"]
    assert run.place("a") == "use"


def test_02_a_transition_that_is_not_enabled_does_not_fire() -> None:
    run = Run(make_plan(tool_net(), ["idle", "idle"], resources=["tool"]))
    run.feed(
        log_entries.Done("a", 0, 1, "take"),
        log_entries.Done("a", 0, 1, "take"),
        log_entries.Done("b", 0, 1, "take"),
    )
    assert run.marking() == {"idle": 1, "use": 1}


def test_03_of_two_robots_that_want_one_token_one_gets_it_and_the_other_later() -> None:
    run = Run(make_plan(tool_net(), ["idle", "idle"], resources=["tool"]))
    run.feed(log_entries.Done("b", 0, 1, "take"), log_entries.Done("a", 0, 1, "take"))
    assert (run.place("a"), run.place("b")) == ("idle", "use")
    run.done("b", "give")
    assert (run.place("a"), run.place("b")) == ("use", "idle")


def test_05_source_and_sink_transitions() -> None:
    net = (
        NetBuilder()
        .place("P")
        .place("Q")
        .place("order")
        .exponential("arrive", outputs="order")
        .exponential("drop", inputs="order")
        .exponential("work", inputs="P", outputs="Q")
        .exponential("back", inputs="Q", outputs="P")
        .build()
    )
    run = Run(make_plan(net, ["P"], resources=["order"]))
    assert run.feed(
        log_entries.Fire("arrive"), log_entries.Fire("arrive"), log_entries.Fire("drop")
    ) == [
        "arrive",
        "arrive",
        "drop",
    ]
    assert run.marking() == {"P": 1, "order": 1}


def test_06_a_bystander_sees_a_synchronisation() -> None:
    run = Run(make_plan(meeting(), ["P1", "P2", "P1"]))
    run.done("a", "meet")
    run.done("b", "meet")
    assert run.marking() == {"P1": 1, "P3": 1, "P4": 1}


def test_07_partners_that_finish_together_go_to_different_places_once() -> None:
    run = Run(make_plan(meeting(), ["P1", "P2"]))
    assert run.feed(log_entries.Done("b", 0, 1, "meet"), log_entries.Done("a", 0, 1, "meet")) == [
        "meet"
    ]
    assert (run.place("a"), run.place("b")) == ("P3", "P4")


def test_08_a_partner_is_matched_by_transition() -> None:
    run = Run(make_plan(meeting(), ["P1", "P2", "P2"]))
    run.done("a", "meet")
    assert run.done("b", "other") == []
    assert run.done("c", "meet") == ["meet"]
    assert run.place("b") == "P2"


def test_09_resource_inputs_are_no_robots_and_two_in_a_place_do_not_overshoot() -> None:
    run = Run(make_plan(meeting(resource=True), ["P1", "P1", "P2"], resources=["permit"]))
    run.done("a", "meet")
    run.done("b", "meet")
    assert run.done("c", "meet") == ["meet"]
    assert run.marking() == {"P1": 1, "P3": 1, "P4": 1}


def test_10_a_wait_blocks_nobody_and_is_asked_again() -> None:
    run = Run(make_plan(meeting(), ["P1", "P2", "P3"]))
    run.done("a", "meet")
    assert run.done("c", "b3") == ["b3"]
    assert run.why("a") == "wants meet: needs a robot in P2"
    assert run.done("b", "meet") == ["meet"]


@pytest.mark.parametrize("reason", FAILURES)
def test_11_an_action_that_fails_stalls_nobody_silently(reason: str) -> None:
    run = Run(make_plan(tool_net(), ["idle"], resources=["tool"]))
    run.fail("a", reason)
    assert reason in run.why("a")
    run.feed(log_entries.Retry("a"))
    assert run.commands[-1] == StartAction("a", "idle", 0, 1, 2)


def test_13_the_policy_is_asked_again_when_the_marking_changes() -> None:
    net = (
        NetBuilder()
        .place("D")
        .place("E")
        .place("F")
        .immediate("d", inputs="D", outputs="E")
        .exponential("e", inputs="E", outputs="F")
        .exponential("f", inputs="F", outputs="E")
        .build()
    )
    policy = Policy.from_table(["E", "F"], [((0, 1), {"d": 1})])
    run = Run(make_plan(net, ["D", "E"], policy=policy, strict=True))
    assert run.done("a") == []
    assert "no row" in run.why("a")
    assert run.done("b", "e") == ["e", "d"]


def test_14_policies_are_read_and_looked_up_with_care() -> None:
    net = (
        NetBuilder()
        .place("A")
        .place("B")
        .place("C")
        .immediate("x", inputs="A", outputs="B")
        .immediate("y", inputs="A", outputs="C")
        .exponential("z", inputs="B", outputs="A")
        .build()
    )
    rows: List[Any] = [(("-", "-"), {"x": 1}), ((1, "-"), {"y": 1})]
    run = Run(make_plan(net, ["A"], policy=Policy.from_table(["A", "C"], rows)))
    assert run.done("a") == [
        "y"
    ]  # not the first row that matches; B, which is left out, shifts nothing
    with pytest.raises(PolicyError, match="sum to 0.9"):
        Policy.from_table(["A"], [((1,), {"x": 0.4, "y": 0.5})])
    run = Run(make_plan(net, ["A"]))
    assert run.done("a", "no such transition") == []
    assert run.state.robots["a"].phase is Phase.FAILED


def test_16_results_from_many_threads_are_one_sequence(tmp_path: Path) -> None:
    (tmp_path / "work.py").write_text("def go(): pass\n")
    net = (
        NetBuilder()
        .place("P", 20)
        .place("Q")
        .exponential("t", inputs="P", outputs="Q")
        .exponential("u", inputs="Q", outputs="P")
        .build()
    )
    (tmp_path / "plan.json").write_text(
        json.dumps(
            {
                "net": {
                    "places": [{"name": p.name, "tokens": p.tokens} for p in net.places],
                    "transitions": [{"name": t.name, "timed": True} for t in net.transitions],
                    "arcs": [{"from": a.source, "to": a.target} for a in net.arcs],
                },
                "actions": {"P": "work.go", "Q": "work.go"},
            }
        )
    )
    seen: List[Any] = []
    enough = threading.Event()

    class Counting(Listener):
        def on_step(self, slot: int, entries: Any, firings: Any, state: Any) -> None:
            seen.extend((f.slot, f.index, f.marking) for f in firings)
            if len(seen) > 2000:
                enough.set()

    executor = StandaloneExecutor(read_plan(str(tmp_path)), Counting())
    executor.start()
    assert enough.wait(30)
    executor.stop()
    assert executor.wait(10) is not None
    assert all(sum(marking) == 20 for _, _, marking in seen)
    assert [s[:2] for s in seen] == sorted({s[:2] for s in seen})


def test_19_weights_count() -> None:
    net = (
        NetBuilder()
        .place("P")
        .place("Q")
        .place("count")
        .exponential("both", inputs={"P": 2}, outputs={"Q": 2, "count": 3})
        .exponential("back", inputs="Q", outputs="P")
        .build()
    )
    run = Run(make_plan(net, ["P", "P"], resources=["count"]))
    assert run.done("a", "both") == []
    assert run.done("b", "both") == ["both"]
    assert run.marking() == {"Q": 2, "count": 3}


def gspn(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gspn_framework_package", *words]
    return subprocess.run(command, cwd=str(ROOT), capture_output=True, text=True, timeout=120)


@pytest.mark.long
def test_20_a_plan_of_13_robots_is_checked_by_structure_and_a_refused_one_exits_with_1() -> None:
    report = check(read_plan(str(ROOT / "plans" / "tokens")).for_robots(13))
    assert not report.refused and report.states == 0
    refused = gspn("check", str(ROOT / "plans" / "fork_join"))
    assert refused.returncode == 1
    assert "conservative" in refused.stdout


def test_21_nothing_is_tied_to_one_machine() -> None:
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=str(ROOT), capture_output=True, text=True, timeout=30
    ).stdout.split()
    here = Path(__file__).name
    for name in tracked:
        path = ROOT / name
        if path.suffix in (".py", ".launch", ".test", ".sh", ".json", ".xml") and path.name != here:
            text = path.read_text(encoding="utf-8", errors="replace")
            assert "gnome-terminal" not in text, name
            if not name.startswith("test/"):
                assert "/home/" not in text, name


def test_24_initial_places_that_contradict_the_marking_are_refused(tmp_path: Path) -> None:
    plan = json.loads((ROOT / "plans" / "measure" / "plan.json").read_text())
    plan["robots"] = {"robot_1": "P1", "robot_2": "P1"}
    for name in ("net.xml", "actions.py"):
        (tmp_path / name).write_bytes((ROOT / "plans" / "measure" / name).read_bytes())
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    refused = gspn("check", str(tmp_path))
    assert refused.returncode == 1
    assert "initial" in refused.stdout


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cut.json", '{"net": "net.xml", "actions": {'),
        ("empty.json", ""),
        ("binary.json", "\x00\x01\x02"),
        ("list.json", "[]"),
    ],
)
def test_broken_plans_get_one_clear_message(
    tmp_path: Path, capsys: pytest.CaptureFixture, name: str, content: str
) -> None:
    path = tmp_path / name
    path.write_text(content)
    for verb in ("check", "run"):
        assert main([verb, str(path)]) == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1 and name in told
        assert "Traceback" not in told
    with pytest.raises(GspnError):
        read_plan(str(path))
