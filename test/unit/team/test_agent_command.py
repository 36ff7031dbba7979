"""``gspn agent``: robots without ROS, each a process, and the operator who asks them."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading

import pytest
from meeting import WORK, meeting_of
from waiting import wait_for

from gspn_framework_package.cli.interrupts import EXIT_INTERRUPTED
from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.log_damage import BOOT_ID
from gspn_framework_package.team import host as host_module
from gspn_framework_package.team import log_file


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
    command = [sys.executable, "-m", "gspn_framework_package", "agent", str(plan), "--json"]
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
            with open(tmp_path / robot, "w") as out:
                agents.append(subprocess.Popen([*command, *words], env=environment, stdout=out))
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
    for robot, log in zip(way, logs):
        lines = [json.loads(line) for line in (tmp_path / robot).read_text().splitlines()]
        assert {line["robot"] for line in lines} == {robot}
        assert lines[-1] == {"event": "end", "robot": robot, "exit_code": 0, "log": log}
        assert "meet fires" in " ".join(line.get("text", "") for line in lines)
        told = [line for line in lines if line["event"] == "diagnosis"]
        assert told and told[-1]["values"]["run"] == "monday" and told[-1]["level"] in (0, 1, 2)


@pytest.fixture(name="secured")
def _secured(tmp_path, monkeypatch):
    """Agents of this process with keys, and how an operator reaches them."""
    zenoh_team = pytest.importorskip("zenoh") and pytest.importorskip("zenoh_team")
    monkeypatch.setattr(host_module, "FAREWELL", 0.3)
    hub = zenoh_team.Hub(zenoh_team.make_keys(tmp_path / "keys"))
    agents = zenoh_team.Agents(hub, tmp_path / "meeting", **QUEUE)
    yield agents
    agents.close()
    hub.close()


QUEUE = {
    "net": {
        "places": [{"name": "Look", "tokens": 2}, {"name": "Jobs"}, {"name": "Home"}],
        "transitions": [
            {"name": "order", "timed": True, "rate": 1.0},
            {"name": "serve"},
        ],
        "arcs": [
            {"from": "order", "to": "Jobs"},
            {"from": "Look", "to": "serve"},
            {"from": "Jobs", "to": "serve"},
            {"from": "serve", "to": "Home"},
        ],
    },
    "resource_places": ["Jobs"],
    "actions": {"Look": "work.look", "Home": None},
    "tasks": {"queues": ["Jobs"]},
}


@pytest.mark.long
def test_an_operator_with_keys_asks_orders_submits_and_deploys(secured, tmp_path, capsys):
    def gspn(verb, *words, by="ann", run="monday"):
        way = ["--connect", secured.hub.endpoint, "--keys", str(tmp_path / "keys" / by)]
        code = main([verb, *words, *way, "--run", run])
        return code, capsys.readouterr()

    def all_act():
        code, said = gspn("status", "--json", by="screen")
        told = json.loads(said.out) if said.out else {}
        return code == 0 and len(told) == 2

    secured.wait_for_team()
    wait_for(all_act, 60, "both robots")
    assert gspn("pause")[0] == 0
    assert gspn("resume")[0] == 0
    assert gspn("breakpoints", "Look")[0] == 0
    code, said = gspn("breakpoints")
    assert code == 0 and "Look" in said.out
    assert gspn("breakpoints", "--clear")[0] == 0
    assert gspn("submit", "order", "--id", "o1")[0] == 0
    wait_for(lambda: "o1" in gspn("status", "--data", by="screen")[1].out, 30, "the task")
    plan = json.loads((secured.folder / "plan.json").read_text())
    other = secured.folder.with_name("other")
    other.mkdir()
    (other / "plan.json").write_text(json.dumps({**plan, "seed": 7}))
    (other / "work.py").write_text(WORK)
    code, said = gspn("deploy", str(other), "--json")
    assert code == 0, said
    for by, run, says in (
        ("screen", "monday", "the keys of watcher 'screen' cannot give orders"),
        ("robot_1", "monday", "the keys of robot 'robot_1' cannot give orders"),
        ("ann", "tuesday", "no execution node answers of run 'tuesday'"),
    ):
        code, said = gspn("stop", by=by, run=run)
        assert code == 1 and says in said.err
    assert gspn("stop")[0] == 0


def test_an_operator_has_the_robot_that_is_here_go_on_after_a_loss_of_power(
    secured, tmp_path, capsys, monkeypatch
):
    def gspn(verb, *words):
        way = ["--connect", secured.hub.endpoint, "--keys", str(tmp_path / "keys" / "ann")]
        code = main([verb, *words, *way])
        return code, capsys.readouterr()

    secured.wait_for_team()
    assert gspn("submit", "order", "--id", "o1")[0] == 0
    secured.close()
    for robot in secured.hosts:
        log = secured.folder / "logs" / "monday" / (robot + ".jsonl")
        *kept, last = log.read_bytes().splitlines(keepends=True)
        assert json.loads(last)["kind"] == "closed"
        log.write_bytes(b"".join(kept))
    monkeypatch.setenv(BOOT_ID, "another")
    secured.start("robot_1")
    wait_for(lambda: "not heard: robot_2" in gspn("status")[1].out, 60, "what robot_1 waits for")
    code, said = gspn("resume")
    assert code == 1 and "gspn trust" in said.out
    code, said = gspn("trust")
    assert code == 2 and "--yes" in said.err
    assert "Given up: what only these robots know: robot_2." in said.out
    code, said = gspn("trust", "--yes")
    assert code == 0, said
    wait_for(lambda: gspn("status")[0] == 0, 60, "robot_1 to go on")
    assert "o1" in gspn("status", "--data")[1].out
    secured.start("robot_2")
    wait_for(lambda: "torn" not in gspn("status")[1].out, 60, "robot_2 to be let in")


@pytest.mark.long
def test_a_name_that_runs_already_is_refused_and_its_log_is_let_go(secured, tmp_path, capsys):
    log = str(tmp_path / "elsewhere" / "robot_1.jsonl")
    way = ["--connect", secured.hub.endpoint, "--keys", str(tmp_path / "keys" / "robot_1")]
    agent = ["agent", str(secured.folder), "--robot", "robot_1", "--run", "monday", "--log", log]
    assert main([*agent, *way]) == 1
    said = capsys.readouterr().err
    assert said.count("another process already runs robot 'robot_1' in run 'monday'") == 1
    assert "Traceback" not in said
    log_file.lock_log(log).close()


@pytest.mark.parametrize(
    ("keys", "says"),
    [("robot_2", "the keys of robot 'robot_2', not of robot 'robot_1'"), ("ann", "operator 'ann'")],
)
def test_an_agent_takes_no_keys_of_another_member(plan, tmp_path, capsys, keys, says):
    zenoh_team = pytest.importorskip("zenoh") and pytest.importorskip("zenoh_team")
    folder = zenoh_team.make_keys(tmp_path / "keys")
    words = ["--robot", "robot_1", "--connect", "tls/127.0.0.1:1", "--keys"]
    assert main(["agent", str(plan), *words, os.path.join(folder, keys)]) == 2
    assert says in capsys.readouterr().err


@pytest.fixture(name="stranger")
def _stranger():
    """The port of somebody who takes connections, and is no router."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()

        def hang_up():
            with contextlib.suppress(OSError):  # the test is over
                while True:
                    listening.accept()[0].close()

        threading.Thread(target=hang_up, daemon=True).start()
        yield listening.getsockname()[1]
        listening.shutdown(socket.SHUT_RDWR)


@pytest.mark.long
def test_agents_wait_for_their_router_and_end_when_asked(plan, tmp_path):
    zenoh_team = pytest.importorskip("zenoh") and pytest.importorskip("zenoh_team")
    hub = zenoh_team.Hub()
    hub.router.close()
    command = [sys.executable, "-m", "gspn_framework_package", "agent", str(plan)]
    command += ["--connect", hub.endpoint, "--quiet", "--robot"]
    agents, told = {}, {}
    try:
        for robot in ("robot_1", "robot_2"):
            told[robot] = tmp_path / (robot + ".txt")
            words = [robot, "--log", str(tmp_path / (robot + ".jsonl"))]
            with open(told[robot], "w") as out:
                agents[robot] = subprocess.Popen([*command, *words], stderr=out)
        for text in told.values():
            wait_for(lambda text=text: "waits for a router" in text.read_text(), 60, "the line")
        agents["robot_2"].send_signal(signal.SIGINT)
        assert agents["robot_2"].wait(60) == EXIT_INTERRUPTED
        assert not (tmp_path / "robot_2.jsonl").exists()
        hub.reopen()
        wait_for((tmp_path / "robot_1.jsonl").exists, 60, "the log of the other one")
        agents["robot_1"].send_signal(signal.SIGTERM)
        assert agents["robot_1"].wait(60) == EXIT_INTERRUPTED
    finally:
        for agent in agents.values():
            agent.kill()
            agent.wait()
        hub.close()
    for robot, text in told.items():
        assert text.read_text().count("%s: warning: waits for a router" % robot) == 1
        assert "Traceback" not in text.read_text()


def test_an_agent_whose_key_others_can_read_or_that_is_not_let_in_does_not_begin(
    plan, tmp_path, stranger, capsys
):
    zenoh_team = pytest.importorskip("zenoh") and pytest.importorskip("zenoh_team")
    own = os.path.join(zenoh_team.make_keys(tmp_path / "keys"), "robot_1")
    port = stranger
    begin = ["agent", str(plan), "--robot", "robot_1", "--keys", own]

    def code(endpoint):
        log = str(
            tmp_path / ("%s.jsonl" % endpoint.replace("/", "_"))
        )  # each has a lock of its own
        return main([*begin, "--log", log, "--connect", "%s:%d" % (endpoint, port)])

    assert code("tls/127.0.0.1") == 1
    assert "cannot open a Zenoh session with tls/127.0.0.1:%d" % port in capsys.readouterr().err
    assert code("tcp/127.0.0.1") == 2
    assert "keys cannot protect" in capsys.readouterr().err
    os.chmod(os.path.join(own, "key.pem"), 0o644)
    assert code("tls/127.0.0.1") == 2
    assert "other users can read this private key" in capsys.readouterr().err


def test_a_router_prints_a_configuration_that_zenoh_reads(tmp_path, capsys):
    zenoh_team = pytest.importorskip("zenoh") and pytest.importorskip("zenoh_team")
    zenoh = pytest.importorskip("zenoh")
    own = os.path.join(zenoh_team.make_keys(tmp_path / "keys"), "hub")
    assert main(["router", "--keys", own, "--listen", "tls/127.0.0.1:7447", "--print-config"]) == 0
    text = capsys.readouterr().out
    zenoh.Config.from_json5(text)
    config = json.loads(text)
    assert config["mode"] == "router" and config["access_control"]["default_permission"] == "deny"
    full = config["transport"]["link"]["tx"]["queue"]["congestion_control"]
    assert full == {"drop": {"wait_before_drop": 0}}  # a router that sleeps passes nothing on
    assert main(["router", "--keys", own + "/../ann", "--print-config"]) == 2
    assert "not of a router" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--robot", "robot_9", "--connect", "tcp/x:1"], "the plan has no robot 'robot_9'"),
        (["--robot", "robot_1"], "how can the other robots be reached?"),
        (["--robot", "robot_1", "--connect", "tcp/x:1", "--run", ".."], "a valid name for a run"),
        (["--robot", "robot_1", "--connect", "tcp/x:1", "--keys", "nowhere"], "nowhere"),
    ],
)
def test_what_an_agent_cannot_begin_with_is_said(plan, capsys, words, says):
    assert main(["agent", str(plan), *words]) == 2
    assert says in capsys.readouterr().err


def test_keys_without_a_router_are_a_mistake(capsys):
    assert main(["status", "--keys", "keys"]) == 2
    assert "--keys requires --connect" in capsys.readouterr().err
