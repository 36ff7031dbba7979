"""``gspn agent``: robots without ROS, each a process, and the operator who asks them."""

import json
import os
import subprocess
import sys

import pytest
from meeting import WORK, meeting_of
from waiting import wait_for

from gspn_framework_package.cli.main import main


@pytest.fixture
def plan(tmp_path):
    folder = tmp_path / "meeting"
    folder.mkdir()
    (folder / "plan.json").write_text(json.dumps(meeting_of(2)))
    (folder / "work.py").write_text(WORK)
    return folder


def test_processes_without_ros_are_a_team(plan, tmp_path, capsys):
    zenoh_team = pytest.importorskip("zenoh") and pytest.importorskip("zenoh_team")
    endpoint = "tcp/127.0.0.1:%d" % zenoh_team.free_port()
    way = {"robot_1": "--listen", "robot_2": "--connect"}
    environment = {**os.environ, "ROS_HOME": str(tmp_path / "home")}
    command = [sys.executable, "-m", "gspn_framework_package", "agent", str(plan)]
    agents = []

    def statuses():
        # None answers until both take part
        if main(["status", "--connect", endpoint, "--json"]) != 0:
            capsys.readouterr()
            return None
        told = json.loads(capsys.readouterr().out)
        return told if len(told) == 2 else None

    try:
        for robot, option in way.items():
            words = ["--robot", robot, option, endpoint, "--run", "monday"]
            agents.append(subprocess.Popen([*command, *words], env=environment))
            if option == "--listen":
                log = tmp_path / "home" / "gspn" / "monday" / "robot_1.jsonl"
                wait_for(log.exists, 60, "the first agent")
        told = wait_for(statuses, 60, "both agents")
        assert {status["robot"] for status in told.values()} == set(way) == set(told)
        assert main(["set-place", "robot_1", "Wait", "--connect", endpoint]) == 0
        assert capsys.readouterr().out.startswith("done")
        (plan / "open").touch()
        assert [agent.wait(60) for agent in agents] == [0, 0]
    finally:
        for agent in agents:
            agent.kill()
            agent.wait()
    logs = [str(log.with_name(robot + ".jsonl")) for robot in way]
    assert main(["verify", *logs]) == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--robot", "robot_9", "--connect", "tcp/x:1"], "the plan has no robot 'robot_9'"),
        (["--robot", "robot_1"], "how are the other robots reached?"),
        (["--robot", "robot_1", "--connect", "tcp/x:1", "--run", ".."], "the name of a run"),
        (["--robot", "robot_1", "--connect", "tcp/x:1", "--keys", "nowhere"], "nowhere"),
    ],
)
def test_what_an_agent_cannot_begin_with_is_said(plan, capsys, words, says):
    assert main(["agent", str(plan), *words]) == 2
    assert says in capsys.readouterr().err


def test_keys_without_a_router_are_a_mistake(capsys):
    assert main(["status", "--keys", "keys"]) == 2
    assert "--keys says nothing without --connect" in capsys.readouterr().err
