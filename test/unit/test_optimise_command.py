"""``gspn optimise``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan

PATROL = str(Path(__file__).resolve().parents[2] / "plans" / "patrol")
QUICK = ["--robots", "2", "--simulate", "0"]
CHECKS = ["--reward", "*:Temperature_*=1"]


def test_the_new_plan_is_written_and_reported(tmp_path, capsys):
    target = tmp_path / "new"
    words = ["--may-wait", "p*:Decide_*", "-o", str(target), "--json"]
    assert main(["optimise", PATROL, *QUICK, *CHECKS, *words]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["present_policy"]["value"] == pytest.approx(0.8987647482, rel=1e-9)
    assert data["lower"] <= data["value"] * (1 + 1e-9)
    assert data["gain"] > 0.02
    assert [team["robots"] for team in data["teams"]] == [2, 1]
    assert data["simulation"] is None
    plan = read_plan(str(target))
    assert len(plan.policy.rows) == data["rows"]
    assert len(plan.robots) == 2
    assert main(["check", str(target)]) == 0
    assert main(["optimise", PATROL, *QUICK, *CHECKS, "-o", str(target)]) == 2
    assert "the file exists already" in capsys.readouterr().err


def test_without_a_name_nothing_is_written(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--team-sizes", "own", "--simulate", "0.01"]
    assert main(["optimise", PATROL, "--robots", "1", *CHECKS, *words]) == 0
    text = capsys.readouterr().out
    assert "present policy: 0.571428571 1/s" in text
    assert "simulated as it runs: " in text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ([], 2, "no aim is given"),
        (["--reward", "nothing=1"], 2, "'nothing', which is neither a place nor a transition"),
        (["--reward", "x*=1"], 2, "nothing in the net matches 'x*'"),
        (["--mean-time-to", "p1 =="], 2, "p1"),
        ([*CHECKS, "--never", "p1:Check"], 2, "p1:Check"),
        ([*CHECKS, "--may-wait", "p1:Check_Temperature_L1"], 2, "there is no choice in"),
        ([*CHECKS, "--at-least", "t1"], 2, "NAME>=VALUE"),
        ([*CHECKS, "--uncertain", "t2:AlarmOff_L1=1"], 2, "TRANSITION=LOW..HIGH"),
        ([*CHECKS, "--team-sizes", "3"], 2, "--team-sizes '3'"),
        ([*CHECKS, "--width", "0"], 2, "--width"),
        ([*CHECKS, "--never", "true"], 1, "cannot be avoided"),
    ],
)
def test_wrong_input_gets_one_clear_line(words, code, message, capsys):
    assert main(["optimise", PATROL, *QUICK, *words]) == code
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
