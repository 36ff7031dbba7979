"""Actions that are programs: what they are given, what they leave, and how they end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.actions import (
    ActionContext,
    ActionFailed,
    Cancellation,
    no_feedback,
)
from gspn_framework_package.execution.commands import Command
from gspn_framework_package.execution.local_kinds import LOCAL_KINDS
from gspn_framework_package.model.action import (
    ACTION_KINDS,
    ROS_KINDS,
    CommandAction,
    FunctionAction,
)
from gspn_framework_package.model.errors import DataError

PYTHON = sys.executable


def wait_for(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def context(cancellation=None, **data):
    return ActionContext("P", "robot_1", no_feedback, cancellation or Cancellation(), 3, 2, data)


def do(*command, folder=None, cancellation=None, grace=10.0, data=None, **more):
    action = CommandAction(command, **more)
    return Command(action, folder, grace)(context(cancellation, **(data or {})))


def is_alive(pid: int) -> bool:
    try:
        with open("/proc/%d/stat" % pid) as file:
            return file.read().rsplit(")", 1)[1].split()[0] not in "ZX"
    except OSError:
        return False


def test_the_exit_code_is_the_outcome():
    assert do("true") == ("", {})
    assert do("true", outcomes={"succeeded": "T"}) == ("T", {})
    assert do("false", outcomes={"aborted": "T_no"}) == ("T_no", {})
    with pytest.raises(ActionFailed, match="^'false': exit code 1$"):
        do("false", outcomes={"succeeded": "T"})
    with pytest.raises(ActionFailed, match="^'sh': exit code 3: the arm is stuck$"):
        do("sh", "-c", "echo noise; echo 'the arm is stuck' >&2; exit 3")
    with pytest.raises(ActionFailed, match="^'sh': signal 9$"):
        do("sh", "-c", "kill -9 $$")


def test_what_cannot_be_started_is_named(tmp_path):
    with pytest.raises(ActionFailed, match="'no_such_program' cannot be started: No such file"):
        do("no_such_program")
    with pytest.raises(ActionFailed, match="cannot be started"):
        do("true", "a\0b")
    (tmp_path / "script").write_text("no program")
    with pytest.raises(ActionFailed, match="'./script' cannot be started: Permission denied"):
        do("./script", folder=str(tmp_path))


def test_data_goes_in_as_arguments_and_out_as_the_last_line(tmp_path):
    script = "import json, os, sys; print('noise'); print(json.dumps(sys.argv[1:] + [os.getcwd()]))"
    result = do(
        PYTHON,
        "-c",
        script,
        {"from": "task.pose"},
        {"from": "name"},
        keep="team.answer",
        folder=str(tmp_path),
        data={"task.pose": {"x": [1, None]}, "robot.name": "Küche; rm -rf"},
    )
    assert result.data == {"team.answer": ['{"x": [1, null]}', "Küche; rm -rf", str(tmp_path)]}
    with pytest.raises(DataError, match="no data 'task.pose'"):
        do("true", {"from": "task.pose"})


def test_the_last_line_need_not_end_and_may_follow_very_many():
    assert do("printf", "1\n\n[2]", keep="x").data == {"x": [2]}
    assert do("sh", "-c", "yes | head -c 3000000; echo; echo 7; echo", keep="x").data == {"x": 7}
    with pytest.raises(DataError, match="not JSON, so 'x' is not written: 'hello'"):
        do("echo", "hello", keep="x")
    with pytest.raises(DataError, match="not JSON.*: ''$"):
        do("true", keep="x")
    with pytest.raises(DataError, match="64002 characters"):
        do(PYTHON, "-c", "print('\"' + 'x' * 64000 + '\"')", keep="x")


def test_the_environment_says_who_and_where_and_there_is_no_input():
    line = 'cat; echo "\\"$GSPN_ROBOT $GSPN_PLACE $GSPN_VISIT $GSPN_ATTEMPT\\""'
    assert do("sh", "-c", line, keep="x").data == {"x": "robot_1 P 3 2"}


def test_children_that_stay_do_not_keep_it_waiting(tmp_path):
    pid_file = tmp_path / "pid"
    try:
        # which does not end when nobody reads what it writes any more
        talks_on = "(trap '' PIPE; while :; do echo y; done) 2>/dev/null"
        result = do("sh", "-c", "%s & echo $! > %s; echo 5 >&2; exit 0" % (talks_on, pid_file))
        assert result == ("", {})
        assert is_alive(int(pid_file.read_text()))
    finally:
        os.kill(int(pid_file.read_text()), 9)


@pytest.mark.parametrize("deaf", [False, True])
def test_a_cancelled_command_ends_with_its_whole_group(tmp_path, deaf):
    cancellation, caught = Cancellation(), []
    file = tmp_path / "pids"
    script = "%s sleep 600 & echo $$ $! > %s.new; mv %s.new %s; wait; sleep 600" % (
        "trap '' TERM;" if deaf else "",
        file,
        file,
        file,
    )

    def run():
        try:
            do("sh", "-c", script, cancellation=cancellation, grace=0.3 if deaf else 600.0)
        except ActionFailed as error:
            caught.append(str(error))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    wait_for(file.exists)
    pids = [int(pid) for pid in file.read_text().split()]
    assert all(map(is_alive, pids))
    cancellation.cancel()
    wait_for(lambda: not any(map(is_alive, pids)))
    thread.join(20)
    assert caught == ["'sh' was cancelled"]


def test_a_command_that_is_cancelled_before_it_begins_ends_at_once():
    cancellation = Cancellation()
    cancellation.cancel()
    with pytest.raises(ActionFailed, match="cancelled"):
        do("sleep", "600", cancellation=cancellation)


# -- in a standalone run


def test_every_kind_of_action_runs_on_ros_or_without():
    assert {*ACTION_KINDS.values()} == {FunctionAction, *LOCAL_KINDS, *ROS_KINDS}


def write_plan(folder: Path, command, **more) -> str:
    plan = {
        "net": {
            "places": [{"name": "Ask", "tokens": 1}, {"name": "Tell"}, {"name": "End"}],
            "transitions": [{"name": "T1", "timed": True}, {"name": "T2", "timed": True}],
            "arcs": [
                {"from": "Ask", "to": "T1"},
                {"from": "T1", "to": "Tell"},
                {"from": "Tell", "to": "T2"},
                {"from": "T2", "to": "End"},
            ],
        },
        "actions": {
            "Ask": {"command": ["sh", "ask.sh"], "keep": "answer"},
            "Tell": {"command": command},
            "End": None,
        },
        "robots": {"robot_1": "Ask"},
        **more,
    }
    (folder / "plan.json").write_text(json.dumps(plan))
    (folder / "ask.sh").write_text("echo '{\"n\": 41}'\n")
    return str(folder)


def test_a_run_passes_data_from_command_to_command(tmp_path, capsys):
    tell = ["sh", "-c", 'echo "$0" > told', {"from": "answer"}]
    assert main(["run", write_plan(tmp_path, tell), "--allow-commands"]) == 0
    assert json.loads((tmp_path / "told").read_text()) == {"n": 41}


def test_without_leave_no_command_runs(tmp_path, capsys):
    plan = write_plan(tmp_path, ["touch", "ran"])
    assert main(["run", plan, "--log", str(tmp_path / "run.jsonl")]) == 1
    error = capsys.readouterr().err
    assert "place 'Ask': its action 'run sh' is a command, and commands are not allowed" in error
    assert "--allow-commands" in error
    assert sorted(os.listdir(tmp_path)) == ["ask.sh", "plan.json"]


@pytest.mark.long
def test_an_interrupted_run_leaves_no_command_behind(tmp_path):
    deaf = "trap '' TERM; echo $$ > new; mv new pid; sleep 600; sleep 600"
    plan = write_plan(tmp_path, ["sh", "-c", deaf], cancel_grace=0.2)
    run = subprocess.Popen(
        [PYTHON, "-m", "gspn_framework_package", "run", plan, "--allow-commands", "--quiet"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wait_for((tmp_path / "pid").exists)
    pid = int((tmp_path / "pid").read_text())
    assert is_alive(pid)
    run.send_signal(signal.SIGINT)
    assert run.wait(20) == 130
    assert not is_alive(pid)
