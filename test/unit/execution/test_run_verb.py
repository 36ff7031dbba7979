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
    assert end["event"] == "end" and end["fault"] and "No space left" in end["reason"] and end["firings"] > 5
    assert err.startswith("gspn: error: ") and "No space left" in err and "Traceback" not in err


def test_a_fault_of_the_executor_ends_a_run_without_a_limit(monkeypatch, capsys):
    def broken(*_):
        raise ZeroDivisionError("a fault of this program")

    monkeypatch.setattr(TokenGame, "reduce", broken)
    assert main(["run", PLAN]) == 1
    out, err = capsys.readouterr()
    assert "ended: the run broke off" in out and "ZeroDivisionError" in err and "Traceback" not in err


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_reader_that_leaves_ends_the_run(options):
    command = [sys.executable, "-m", "gspn_framework_package", "run", PLAN, *options]
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
        process.stdout.readline()
        process.stdout.close()
        try:
            assert process.wait(60) == 141
            assert process.stderr.read() == b""
        finally:
            process.kill()
