"""What fails after an answer was found does not lose the answer, and the exit code says so."""

from pathlib import Path

import pytest

from benchmarks.nets import kanban
from gspn_framework_package.analysis.decisions import optimise as optimising
from gspn_framework_package.analysis.decisions.optimise import _Exactly
from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import write_net
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import LimitError, RefusedError

PLANS = Path(__file__).resolve().parents[2] / "plans"
OPTIMISE = ["optimise", str(PLANS / "patrol"), "--robots", "1", "--reward", "*:Temperature_*=1"]


def failing(error):
    def fail(*_, **__):
        raise error

    return fail


@pytest.fixture
def log(tmp_path, capsys):
    path = str(tmp_path / "run.jsonl")
    assert main(["simulate", str(PLANS / "rendezvous"), "--time", "40", "--log", path]) == 0
    capsys.readouterr()
    return path


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (["analyse", "plans/measure", "--no-structure", "--csv"], "steady state ("),
        (["simulate", "plans/measure", "--time", "5", "--replications", "3", "--csv"], "3 runs"),
        ([*OPTIMISE, "--simulate", "0", "-o"], "best policy: "),
        (
            ["sweep", "plans/measure", "--vary", "rate:T1=1,2", "--time", "5"]
            + ["--replications", "3", "--plot"],
            "2 points",
        ),
    ],
)
def test_what_cannot_be_written_is_printed(words, answer, tmp_path, capsys):
    ending = "json" if words[-1] == "-o" else "svg"
    assert main([*words, str(tmp_path / "missing" / ("new." + ending))]) == 2
    told = capsys.readouterr()
    assert answer in told.out
    assert "missing" in told.err


def test_what_was_learned_is_printed_if_it_cannot_be_written(tmp_path, log, capsys):
    target = str(tmp_path / "missing" / "new.json")
    assert main(["fit", str(PLANS / "rendezvous"), log, "-o", target]) == 2
    told = capsys.readouterr()
    assert "attempts in 1 log of 1 run" in told.out
    assert "missing" in told.err


def test_a_policy_stays_although_its_simulation_fails(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(optimising, "compare_plans", failing(RefusedError("it never ends")))
    target = str(tmp_path / "new.json")
    assert main([*OPTIMISE, "-o", target]) == 1
    told = capsys.readouterr().out
    assert "best policy: 0.571428571" in told
    assert "not decided: the simulation of both plans: it never ends" in told
    assert read_plan(target).policy.rows


@pytest.mark.parametrize(
    "part", ["_add_price_of_never", "_add_present", "_add_choices", "_add_sensitivities"]
)
def test_a_policy_stays_although_there_is_no_time_for_what_is_beside_it(part, monkeypatch, capsys):
    monkeypatch.setattr(_Exactly, part, failing(LimitError("not decided within 1 s")))
    assert main([*OPTIMISE, "--simulate", "0"]) == 1
    told = capsys.readouterr().out
    assert "best policy: 0.571428571" in told
    assert "not decided within 1 s" in told


@pytest.mark.parametrize(
    "words",
    [
        ["--reach", "nowhere >= 1"],
        ["--cover", "nowhere=1"],
        ["--mean-time-to", "nowhere >= 1"],
        ["--reward", "nowhere=1"],
        ["--time-to-steady-state", "2"],
    ],
)
def test_a_wrong_question_is_refused_before_anything_is_computed(
    words, tmp_path, monkeypatch, capsys
):
    path = str(tmp_path / "kanban.pnpro")
    write_net(kanban(1), path)
    nothing = "gspn_framework_package.cli.analyse.working"
    monkeypatch.setattr(nothing, failing(AssertionError("it computes")))
    assert main(["analyse", path, *words]) == 2
    assert "it computes" not in capsys.readouterr().err
