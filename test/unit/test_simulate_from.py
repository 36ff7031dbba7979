"""``gspn simulate RUN.jsonl@SLOT`` goes on from the middle of a recorded run."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan

PLAN = Path(__file__).resolve().parents[2] / "plans" / "rendezvous"


@pytest.fixture
def recorded(tmp_path: Path) -> str:
    path = str(tmp_path / "run.jsonl")
    run = VirtualRun(read_plan(str(PLAN)), seed=1, agents=False)
    with contextlib.closing(run.record_in(path, "run", "1")):
        run.run(firings=40)
    return path


def test_a_slot_goes_on_in_simulation(recorded: str, tmp_path: Path, capsys: Any) -> None:
    words = ["simulate", recorded + "@17", "--time", "0.000001", "--json"]
    assert main([*words, "--replications", "3"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["replications"] == 3
    assert "after slot 17" in result["notes"][0]
    state = next(s.state for s in replay(read_log(recorded)) if s.slot == 17)
    plan = read_log(recorded).plan
    there = {p: e["mean"] for p, e in result["mean_tokens"].items() if e["mean"]}
    assert there == pytest.approx(plan.net.named(state.marking, zeros=False))


def test_what_follows_is_recorded_as_a_log_of_its_own(recorded: str, tmp_path: Path) -> None:
    log = str(tmp_path / "more.jsonl")
    assert main(["simulate", recorded + "@17", "--time", "50", "--log", log]) == 0
    steps = list(replay(read_log(log)))
    assert steps[0].snapshot
    assert steps[1].slot == 18
    assert sum(len(s.firings) for s in steps) > 10
    assert main(["verify", log]) == 0


@pytest.mark.parametrize(
    ("slot", "options", "text"),
    [
        ("@9999", ["--time", "5"], "the run has no slot 9999"),
        ("@17", [], "the length of a run"),
        ("@17", ["--time", "5", "--robots", "3"], "--robots does not apply to a recorded run"),
    ],
)
def test_what_cannot_go_on_is_reported(
    recorded: str, capsys: Any, slot: str, options: Any, text: str
) -> None:
    assert main(["simulate", recorded + slot, *options]) == 2
    assert text in capsys.readouterr().err
