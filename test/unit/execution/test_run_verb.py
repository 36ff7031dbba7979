"""``gspn run``: whatever ends a run ends the command."""

import json
import os
import subprocess
import sys

import pytest
from full_disk import fill_the_disk

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.token_game import TokenGame

PLAN = "plans/tokens/instant.json"


def test_a_full_log_ends_a_run_without_a_limit(tmp_path, monkeypatch, capsys):
    fill_the_disk(monkeypatch, after=20_000)
    assert main(["run", PLAN, "--log", str(tmp_path / "log.jsonl"), "--json"]) == 1
    out, err = capsys.readouterr()
    end = json.loads(out.splitlines()[-1])
    assert (
        end["event"] == "end"
        and end["fault"]
        and "No space left" in end["reason"]
        and end["firings"] > 5
    )
    assert err.startswith("gspn: error: ") and "No space left" in err and "Traceback" not in err


def test_a_fault_of_the_executor_ends_a_run_without_a_limit(monkeypatch, capsys):
    def broken(*_):
        raise ZeroDivisionError("a fault of this program")

    monkeypatch.setattr(TokenGame, "reduce", broken)
    assert main(["run", PLAN]) == 1
    out, err = capsys.readouterr()
    assert "ended: the run failed" in out and "ZeroDivisionError" in err and "Traceback" not in err


@pytest.mark.long
@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_reader_that_leaves_ends_the_run(options):
    command = [sys.executable, "-m", "gspn_framework_package", "run", PLAN, *options]
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as process:
        process.stdout.readline()
        process.stdout.close()
        try:
            assert process.wait(60) == 141
            assert process.stderr.read() == b""
        finally:
            process.kill()


def write_chain(folder, actions, on_failure=None):
    """A plan of one agent whose transitions T1, T2, ... lead from place to place, with these
    actions."""
    places = ["Ask_operator", "P2", "P3", "the limit of P4"]
    arcs = []
    for number, (source, target) in enumerate(zip(places, places[1:]), 1):
        arcs += [{"from": source, "to": "T%d" % number}, {"from": "T%d" % number, "to": target}]
    net = {
        "places": [{"name": name, "tokens": int(name == places[0])} for name in places],
        "transitions": [{"name": "T%d" % number, "timed": True} for number in (1, 2, 3)],
        "arcs": arcs,
    }
    bound = {name: actions.get(name) for name in places}
    plan = {
        "net": net,
        "actions": bound,
        "robots": {"the limit of 1": places[0]},
        "on_failure": on_failure or {},
    }
    (folder / "plan.json").write_text(json.dumps(plan))
    (folder / "actions.py").write_text("def fails():\n    raise ValueError('broken')\n")
    return str(folder)


@pytest.mark.parametrize("limit", [1, 5, 300])
def test_a_run_fires_as_often_as_it_was_asked(limit, capsys):
    assert main(["run", PLAN, "--agents", "2", "--firings", str(limit), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert sum(line["event"] == "firing" for line in lines) == lines[-1]["firings"] == limit
    assert lines[-1]["reason"] == "the limit of %d firings" % limit and not lines[-1]["fault"]


def test_firings_that_one_event_sets_off_stay_together_and_that_is_said(tmp_path, capsys):
    plan = write_chain(tmp_path, {"the limit of P4": "actions.fails"})
    assert main(["run", plan, "--firings", "1"]) == 0
    out, err = capsys.readouterr()
    assert (
        "ended: the limit of 1 firings (3 fired, because an event may cause several); 3 firings"
        in out
    )
    assert "fault" not in err, "the action after the last firing is not begun"


def test_the_exit_code_looks_at_no_text(tmp_path, capsys):
    """The action of an agent that is called "the limit of 1" fails."""
    plan = write_chain(tmp_path, {"the limit of P4": "actions.fails"}, {"the limit of P4": "stop"})
    assert main(["run", plan, "--json"]) == 1
    end = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert end["fault"] and "the action of the limit of P4 failed" in end["reason"]
