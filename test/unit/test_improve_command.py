"""``gspn improve``: from logs to a better plan and a report."""

from __future__ import annotations

import json

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan


@pytest.fixture
def logged(tmp_path, monkeypatch):
    """A plan of one robot that may look at a place nearby or far away, and a log of it."""
    monkeypatch.chdir(tmp_path)
    words = "new patrol round --places near far --robots 1"
    assert main(words.split()) == 0
    assert main(["simulate", "round", "--time", "400", "--log", "run.jsonl"]) == 0


def test_what_was_learned_is_improved_checked_and_written(logged, capsys):
    words = "improve round run.jsonl --reward Look_*=1 -o better.json --report r.html --simulate 0"
    assert main(words.split()) == 0
    out = capsys.readouterr().out
    assert "it would gain" in out.splitlines()[-1] or "the gain is not known" in out
    for title in (
        "Learned from",
        "The runs compared",
        "The computed policy",
        "Findings of the check",
    ):
        assert "== " + title in out
    plan, learned = read_plan("round"), read_plan("better.json")
    assert learned.net.places == plan.net.places and learned.durations != plan.durations
    with open("r.html", encoding="utf-8") as file:
        page = file.read()
    assert "Improving round" in page and "<script" not in page and "Look_near" in page

    assert main(words.split()) == 2, "no file is overwritten"
    assert "exists already" in capsys.readouterr().err
    assert main([*words.split(), "--force", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["policy"]["value"] >= data["policy"]["present_policy"]["value"] * (1 - 1e-9)
    assert data["new_doubts"] == [] and not data["comparison"]["departs"]


def test_wrong_input_writes_nothing(logged, tmp_path, capsys):
    before = sorted(path.name for path in tmp_path.iterdir())
    for words in (
        "improve round run.jsonl -o new.json",
        "improve round run.jsonl --reward nobody=1 -o new.json",
        "improve round no.jsonl --reward Look_*=1 -o new.json",
        "improve round round/plan.json --reward Look_*=1 -o new.json",
    ):
        assert main(words.split()) == 2, words
        assert "Traceback" not in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == before
