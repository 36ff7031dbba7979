"""``gspn deploy --standalone``: another plan for a ``gspn run`` in another process."""

import json
import os
import socket
import subprocess
import sys
import time

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.control_socket import (
    ControlSocket,
    DeployRequest,
    RunningPlan,
    ask_to_deploy,
    chosen_run,
    running_plans,
)
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError, RefusedError


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """The runs of this test alone."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "gspn_runs"


@pytest.fixture
def started(tmp_path):
    """Starts ``gspn run`` in a separate process."""
    processes = []

    def start(*words):
        with open(tmp_path / "out", "wb") as out:  # a pipe that nobody reads would halt it
            process = subprocess.Popen(
                [sys.executable, "-m", "gspn_framework_package", "run", "--json", *words],
                stdout=out,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONPATH": os.getcwd()},
            )
        processes.append(process)
        return process, Output(tmp_path / "out")

    yield start
    for process in processes:
        process.kill()
        process.wait()


class Output:
    """What a run prints, read from its beginning to its end."""

    def __init__(self, path):
        self._path, self._read = path, 0

    def wait_for(self, event, **fields):
        """Read until an event with these fields."""
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            lines = self._path.read_bytes().splitlines(keepends=True)[self._read :]
            for line in lines:
                if not line.endswith(b"\n"):
                    break
                self._read += 1
                found = json.loads(line)
                if found["event"] == event and fields.items() <= found.items():
                    return
            time.sleep(0.02)
        raise AssertionError("no %s %s" % (event, fields))


def patrol(folder, *places):
    """A plan to begin with, whose robots hurry."""
    assert main(["new", "patrol", str(folder), "--places", *places, "--robots", "2"]) == 0
    file = folder / "plan.json"
    text = file.read_text()
    for seconds in ("4.0", "2.0"):
        text = text.replace('"seconds": ' + seconds, '"seconds": 0.02')
    file.write_text(text)
    return str(folder)


def test_a_patrol_gets_a_computed_policy_and_then_a_fifth_location(tmp_path, started, capsys):
    four = patrol(tmp_path / "four", "door", "window", "gate", "yard")
    five = patrol(tmp_path / "five", "door", "window", "gate", "yard", "hall")
    better = os.path.join(four, "better.json")
    assert main(["optimise", four, "--reward", "Look_gate=1", "--simulate", "0", "-o", better]) == 0
    log = str(tmp_path / "run.jsonl")
    run, output = started(four, "--log", log)
    output.wait_for("firing", transition="arrived_gate")
    capsys.readouterr()
    assert main(["deploy", better, "--standalone", four, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["done"] and told["process"] == run.pid
    output.wait_for("plan")
    output.wait_for("firing", transition="arrived_gate")
    broken = tmp_path / "broken"
    patrol(broken, "door", "window", "gate", "yard", "hall")
    (broken / "actions.py").write_text("def other():\n    pass\n")
    assert main(["deploy", str(broken), "--standalone"]) == 1
    assert "there is no 'TakeTime'" in capsys.readouterr().out
    assert main(["deploy", five, "--standalone"]) == 0
    output.wait_for("plan", plan="five")
    output.wait_for("firing", transition="arrived_hall")
    run.send_signal(2)
    assert run.wait(30) == 130
    assert main(["deploy", five, "--standalone"]) == 1
    assert "no run found" in capsys.readouterr().err
    recorded = read_log(log)
    assert verify([recorded]).violation is None
    steps = (step.state.adopted for step in replay(recorded))
    assert {adopted.number for adopted in steps if adopted is not None} == {1, 2}
    assert main(["verify", log]) == 0
    out = capsys.readouterr().out
    assert "adopted the plan 'four'" in out and "adopted the plan 'five'" in out


def test_a_plan_that_ends_robots_does_not_follow_one_that_keeps_them(tmp_path, started, capsys):
    four = patrol(tmp_path / "four", "door", "window", "gate", "yard")
    run, output = started(four)
    output.wait_for("firing", transition="arrived_gate")
    data = json.loads((tmp_path / "four" / "plan.json").read_text())
    data["net"] = net_to_json(read_plan(four).net)
    data["net"]["transitions"].append({"name": "gone", "timed": True, "rate": 1})
    data["net"]["arcs"].append({"from": "Go_gate", "to": "gone"})
    new = tmp_path / "four" / "taking.json"
    new.write_text(json.dumps(data))
    capsys.readouterr()
    assert main(["deploy", str(new), "--standalone", four]) == 1
    assert "gone takes 1 robot(s) and puts 0" in capsys.readouterr().out
    output.wait_for("firing", transition="arrived_gate")


def test_a_run_is_found_and_answers(tmp_path, own_folder):
    asked = []

    def deploy(request):
        asked.append(request)
        if request.plan == "/bad":
            raise RefusedError("robot_1 is in 'A'", file="/bad")
        return "done so"

    request = DeployRequest("/new", {"A": "B"}, None, 1.0)
    with ControlSocket(lambda: {"plan": "p", "files": ["/a/plan.json", "/b/plan.json"]}, deploy):
        (run,) = running_plans()
        assert run[1:] == (os.getpid(), "p", ["/a/plan.json", "/b/plan.json"])
        assert chosen_run([run], "/b/plan.json", "") is run is chosen_run([run], "", "")
        assert ask_to_deploy(run, request) == {"done": True, "message": "done so"}
        refused = ask_to_deploy(run, request._replace(plan="/bad"))
        assert refused == {"done": False, "message": "/bad: robot_1 is in 'A'"}
        assert asked[0] == request
        for text in (b"[]\n", b"nonsense\n", b'{"ask": "else"}\n', b"[" * 100_000 + b"\n", b""):
            with socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(30)
                connection.connect(run.socket)
                connection.sendall(text)
                connection.shutdown(socket.SHUT_WR)
                assert json.loads(connection.makefile().read())["done"] is False
        assert [r.process for r in running_plans()] == [os.getpid()]
    assert running_plans() == [] == os.listdir(own_folder)
    with pytest.raises(ExecutionError, match="does not answer"):
        ask_to_deploy(run, request)


def test_which_run_is_meant():
    runs = [RunningPlan("", 1, "a", ["/a"]), RunningPlan("", 2, "a", ["/a", "/b"])]
    assert chosen_run(runs, "/b", "") is runs[1] is chosen_run(runs, "/a", "2")
    with pytest.raises(ExecutionError, match="several runs: process 1 runs /a; process 2 runs /b"):
        chosen_run(runs, "/a", "")
    with pytest.raises(ExecutionError, match="no run found of /c in process 2"):
        chosen_run(runs, "/c", "2")


def test_what_a_killed_run_left_is_removed(own_folder):
    own_folder.mkdir(0o700)
    left = socket.socket(socket.AF_UNIX)
    left.bind(str(own_folder / "1-dead.sock"))
    left.close()
    assert running_plans() == [] == os.listdir(own_folder)


def test_a_folder_that_others_may_enter_is_not_used(own_folder):
    own_folder.mkdir(0o700)
    own_folder.chmod(0o755)
    with pytest.raises(ExecutionError, match="only you may access"):
        ControlSocket(dict, lambda request: "")
    own_folder.rmdir()
    own_folder.symlink_to("/tmp")
    with pytest.raises(ExecutionError, match="only you may access"):
        running_plans()


def test_a_run_without_ros_is_not_staged_only(capsys):
    assert main(["deploy", "plans/fork_join", "--standalone", "--stage-only"]) == 2
    assert "--stage-only" in capsys.readouterr().err
