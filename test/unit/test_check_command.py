"""What ``gspn check`` says beyond the check itself: functions that are not there, and nets."""

import json
import re

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.actions import load_action
from gspn_framework_package.model.errors import PlanError

PLAN = {
    "net": {
        "places": [{"name": "P", "tokens": 1}, {"name": "Q"}],
        "transitions": [
            {"name": "T", "timed": True, "rate": 1},
            {"name": "U", "timed": True, "rate": 1},
        ],
        "arcs": [
            {"from": "P", "to": "T"},
            {"from": "T", "to": "Q"},
            {"from": "Q", "to": "U"},
            {"from": "U", "to": "P"},
        ],
    },
    "actions": {"P": "work.go", "Q": None},
}

SOURCES = {
    "def go():\n    pass\n": None,
    "class go:\n    def __call__(self):\n        pass\n": None,
    "from os import path as go\n": "the module 'os' is not in the plan's folder",
    "if True:\n    go = print\n": None,
    "from os import *\n": None,
    "def gone():\n    go = 1\n": "there is no 'go' in",
    "class Other:\n    def go(self):\n        pass\n": "there is no 'go' in",
    "def go(:\n": "line 1: cannot be read",
    "raise SystemExit(5)\ndef go():\n    pass\n": None,  # it is not run
}


@pytest.mark.parametrize("source", SOURCES)
def test_a_function_that_is_not_there_is_refused(tmp_path, capsys, source):
    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    (tmp_path / "work.py").write_text(source)
    message = SOURCES[source]
    assert main(["check", str(tmp_path)]) == (1 if message else 0)
    shown = capsys.readouterr().out
    assert ("refused  functions: work.go in P:" in shown) == bool(message)
    assert (message or "") in shown


def test_breakpoints_that_were_left_beside_the_plan_are_a_warning(tmp_path, capsys):
    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    (tmp_path / "work.py").write_text("def go():\n    pass\n")
    assert main(["check", str(tmp_path)]) == 0
    assert "breakpoints" not in capsys.readouterr().out
    (tmp_path / "breakpoints.json").write_text(json.dumps({"places": ["P"]}))
    assert main(["check", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "warning  breakpoints: robots stop at P in every run of this plan" in told
    (tmp_path / "breakpoints.json").write_text(json.dumps({"places": ["elsewhere"]}))
    assert main(["check", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "'elsewhere'" in told and "robots ignore it" in told


def test_a_module_that_is_not_there_is_refused(tmp_path, capsys):
    (tmp_path / "plan.json").write_text(
        json.dumps(dict(PLAN, actions={"P": "in_no_folder.go", "Q": None}))
    )
    assert main(["check", str(tmp_path)]) == 1
    assert "there is no in_no_folder.py beside the plan" in capsys.readouterr().out
    (tmp_path / "plan.json").write_text(
        json.dumps(dict(PLAN, actions={"P": "os.getcwd", "Q": None}))
    )
    assert main(["check", str(tmp_path)]) == 1
    assert main(["check", str(tmp_path), "--modules", "os"]) == 0


def test_a_function_of_an_event_that_is_not_there_is_refused(tmp_path, capsys):
    (tmp_path / "plan.json").write_text(
        json.dumps(
            dict(PLAN, actions={"P": None, "Q": None}, events={"T": {"function": "watch.low"}})
        )
    )
    (tmp_path / "watch.py").write_text("def high():\n    pass\n")
    assert main(["check", str(tmp_path)]) == 1
    shown = capsys.readouterr().out
    assert "refused  functions: watch.low for the event 'T': there is no 'low' in" in shown


def test_the_modules_of_another_plan_are_not_taken(tmp_path, capsys):
    for name in ("has", "lacks"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "plan.json").write_text(
            json.dumps(dict(PLAN, actions={"P": "only_here.go", "Q": None}))
        )
    (tmp_path / "has" / "only_here.py").write_text("def go():\n    pass\n")
    assert main(["run", str(tmp_path / "has"), "--seconds", "0.1", "--quiet"]) == 0
    capsys.readouterr()
    assert main(["check", str(tmp_path / "lacks")]) == 1
    assert "there is no only_here.py beside the plan" in capsys.readouterr().out
    assert main(["run", str(tmp_path / "lacks"), "--seconds", "0.1", "--quiet"]) == 1
    assert "there is no only_here.py beside the plan" in capsys.readouterr().err


def test_a_net_is_reported_as_a_net(tmp_path, capsys):
    assert main(["convert", _net(tmp_path), str(tmp_path / "net.pnml")]) == 0
    capsys.readouterr()
    assert main(["check", str(tmp_path / "net.pnml")]) == 2
    assert "this is a net, not a plan (use gspn analyse for a net)" in capsys.readouterr().err
    assert main(["run", str(tmp_path / "net.pnml")]) == 2
    assert "this is a net, not a plan" in capsys.readouterr().err
    (tmp_path / "broken.pnml").write_text("<pnml")
    assert main(["check", str(tmp_path / "broken.pnml")]) == 2
    assert "JSON" not in capsys.readouterr().err
    (tmp_path / "none.txt").write_text("hello")
    assert main(["check", str(tmp_path / "none.txt")]) == 2
    assert "not JSON" in capsys.readouterr().err


def _net(folder):
    (folder / "plan.json").write_text(json.dumps(PLAN))
    return str(folder / "plan.json")


@pytest.mark.parametrize(("mean", "said"), [(1.3, False), (5.0, True)])
def test_a_duration_that_contradicts_the_rates_is_a_warning(tmp_path, capsys, mean, said):
    (tmp_path / "plan.json").write_text(json.dumps({**PLAN, "durations": {"P": {"mean": mean}}}))
    (tmp_path / "work.py").write_text("def go():\n    pass\n")
    assert main(["check", str(tmp_path)]) == 0
    assert ("P takes 5 s on average, 1 s by the rates" in capsys.readouterr().out) == said


def test_a_simulated_log_is_valid_and_never_overwrites(tmp_path, capsys):
    (tmp_path / "plan.json").write_text(
        json.dumps({**PLAN, "durations": {"P": {"mean": 2, "distribution": "deterministic"}}})
    )
    log = str(tmp_path / "run.jsonl")
    command = ["simulate", str(tmp_path), "--log", log, "--seed", "4", "--json"]
    assert main(command) == 2
    assert "the length of the run is not given" in capsys.readouterr().err
    assert main([*command, "--time", "101"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["firings"] == {"T": 50, "U": 50}
    assert main(["verify", log]) == 0
    assert main([*command, "--time", "101"]) == 2
    assert "exists already" in capsys.readouterr().err
    net = tmp_path / "net.json"
    net.write_text(json.dumps(PLAN["net"]))
    assert main(["simulate", str(net), "--format", "json", "--log", log]) == 2


SETTINGS = {
    "def go(seconds=0.5):\n    pass\n": "its setting 'seconds' takes a number, not \"0.5\"",
    "def go(seconds: float):\n    pass\n": "its setting 'seconds' takes a number",
    "def go(seconds='0.5'):\n    pass\n": "",
    "def go(seconds=None):\n    pass\n": "",
    "def go(**more):\n    pass\n": "",
    "def go():\n    pass\n": "the function has no parameter for the setting 'seconds'",
    "def go(seconds, speed):\n    pass\n": "its parameter 'speed' is not one that an action can",
    "def go(place, seconds, *, speed=2):\n    pass\n": "",
    "class go:\n    def __init__(self, seconds=1):\n        pass\n    def __call__(self):\n"
    "        pass\n": "its setting 'seconds' takes a number",
    "class Base:\n    def __init__(self, seconds=[]):\n        pass\nclass go(Base):\n"
    "    def __call__(self):\n        pass\n": "its setting 'seconds' takes a list",
    "from other import Base\nclass go(Base):\n    pass\n": "",  # the source does not show it
    "import functools\n@functools.lru_cache\ndef go():\n    pass\n": "",
}


@pytest.mark.parametrize("source", SETTINGS)
def test_settings_that_a_function_cannot_take_are_refused(tmp_path, capsys, source):
    action = {"function": "work.go", "settings": {"seconds": "0.5"}}
    (tmp_path / "plan.json").write_text(json.dumps(dict(PLAN, actions={"P": action, "Q": None})))
    (tmp_path / "work.py").write_text(source)
    text = SETTINGS[source]
    assert main(["check", str(tmp_path)]) == (1 if text else 0)
    assert text in capsys.readouterr().out
    if text:  # as in a run
        assert main(["run", str(tmp_path), "--seconds", "1"]) == 1
        assert text in capsys.readouterr().err
        with pytest.raises(PlanError, match=re.escape(text)):
            load_action(str(tmp_path), "work.go", action["settings"])


def test_all_commands_refuse_a_plan_that_would_end_at_once(tmp_path, capsys):
    data = json.loads(json.dumps(PLAN))
    data["net"]["transitions"][0] = {"name": "T"}
    (tmp_path / "plan.json").write_text(json.dumps({**data, "actions": {"P": None, "Q": None}}))
    plan, log = str(tmp_path), str(tmp_path / "run.jsonl")
    assert main(["check", plan]) == 1
    assert "P, Q and pass at once: give one of these places an action" in capsys.readouterr().out
    assert main(["run", plan]) == 1
    assert main(["simulate", plan, "--time", "5"]) == 1
    assert main(["simulate", plan, "--time", "5", "--log", log]) == 1
    assert main(["deploy", plan]) == 1
    assert "the check refuses the plan: no place has an action" in capsys.readouterr().err


# -- questions about all markings ------------------------------------------------------------------


def test_questions_are_decided_and_their_proofs_checked(tmp_path, capsys):
    pytest.importorskip("scipy", minversion="1.7")
    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    (tmp_path / "work.py").write_text("def go():\n    pass\n")
    file = str(tmp_path / "proofs.json")
    words = ["check", str(tmp_path), "--never", "P + Q > 1", "--always", "P >= 1 or Q >= 1"]
    words += ["--apart", "*", "--certificate", file]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "proven       never P + Q > 1 (structure" in told
    assert told.count("\nproven ") == 5, "two of them are asked for the certificate's sake"
    assert main(["verify", file]) == 0
    assert "5 proofs" in capsys.readouterr().out

    assert main(["check", str(tmp_path), "--never", "Q >= 1", "--never-fires", "U", "--json"]) == 1
    answers = json.loads(capsys.readouterr().out)["answers"]
    assert [answer["verdict"] for answer in answers] == ["violated", "violated"]
    assert [answer["sequence"] for answer in answers] == [["T"], ["T"]]

    two = json.loads(json.dumps(PLAN))
    two["net"]["places"][0]["tokens"] = 2
    (tmp_path / "plan.json").write_text(json.dumps(two))
    assert main(["verify", file]) == 1, "the plan has changed"
    assert "REFUSED    never P + Q > 1" in capsys.readouterr().out
    assert main(["verify", file, "--json"]) == 1
    assert any(row["refused"] for row in json.loads(capsys.readouterr().out)["proofs"])


def test_a_net_can_be_asked_about_too(tmp_path, capsys):
    net = str(tmp_path / "net.pnml")
    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    assert main(["convert", str(tmp_path), net]) == 0
    capsys.readouterr()
    assert main(["check", net, "--never", "P + Q > 1"]) == 0
    assert "never P + Q > 1" in capsys.readouterr().out
    for asked in (net, str(tmp_path)):
        assert main(["check", asked, "--never", "nowhere > 1"]) == 2
        told = capsys.readouterr()
        assert "there is no place 'nowhere'" in told.err
        assert not told.out, "nothing is checked before the questions are read"


def test_an_answer_stays_although_its_proof_cannot_be_written(tmp_path, capsys):
    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    file = str(tmp_path / "nowhere" / "proofs.json")
    assert main(["check", str(tmp_path), "--never", "P + Q > 1", "--certificate", file]) == 2
    told = capsys.readouterr()
    assert "proven       never P + Q > 1" in told.out
    assert file in told.err


def test_files_that_only_begin_like_proofs_are_refused(tmp_path, capsys):
    file = tmp_path / "proofs.json"
    for text in ('{"format": "gspn_proofs"', '{"format": "gspn_proofs"}'):
        file.write_text(text)
        assert main(["verify", str(file)]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
