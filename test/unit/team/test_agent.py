"""Robots without ROS agree on a run: whole hosts in this process, on a carrier in memory."""

import json
import queue
import time
from functools import partial
from pathlib import Path

import pytest
from waiting import PATIENCE

from gspn_framework_package.cli.status import order_lines
from gspn_framework_package.execution.event_log import LogFile, read_log
from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making import templates
from gspn_framework_package.model.errors import PlanError, RefusedError
from gspn_framework_package.team import host as host_module
from gspn_framework_package.team.agent import PrintedReporter, make_agent
from gspn_framework_package.team.carrier import Operator, OperatorRequest
from gspn_framework_package.team.commands import handlers_of
from gspn_framework_package.team.host import HostOptions
from gspn_framework_package.visualizer.recording import Recording

NET = {
    "places": [{"name": "Look", "tokens": 2}, {"name": "Wait"}, {"name": "Home"}],
    "transitions": [{"name": "seen"}, {"name": "missed"}, {"name": "meet"}],
    "arcs": [
        {"from": "Look", "to": "seen"},
        {"from": "seen", "to": "Wait"},
        {"from": "Look", "to": "missed"},
        {"from": "missed", "to": "Look"},
        {"from": "Wait", "to": "meet", "weight": 2},
        {"from": "meet", "to": "Home", "weight": 2},
    ],
}

WORK = """
import os

GATE = os.path.join(os.path.dirname(__file__), "open")


def look(robot, feedback, is_cancelled):
    feedback(3)
    if robot == "robot_2":
        while not os.path.exists(GATE):
            if is_cancelled.wait(0.01):
                return "missed"
    return "seen"


def broken():
    raise ValueError("no camera")


def forever(is_cancelled):
    is_cancelled.wait()
"""


@pytest.fixture
def write(tmp_path):
    def write(**more):
        fields = {
            "net": NET,
            "actions": {"Look": "work.look", "Wait": None, "Home": None},
            "robots": {"robot_1": "Look", "robot_2": "Look"},
            "until": "Home >= 2",
            **more,
        }
        (tmp_path / "plan.json").write_text(json.dumps(fields))
        (tmp_path / "work.py").write_text(WORK)
        return read_plan(str(tmp_path))

    return write


class Wire:
    """Carries messages between hosts of this process, as bytes would go."""

    def __init__(self):
        self.carriers = {}
        self.firings, self.activities, self.teams, self.refused = [], [], [], []
        self.tasks = []

    def carrier(self, host):
        self.carriers[host.robot] = carrier = InMemory(self, host)
        return carrier


class InMemory:
    def __init__(self, wire, host):
        self.wire, self.robot, self.handlers, self.sent = wire, host.robot, handlers_of(host), 0

    def send(self, sends):
        for to, message in sends:
            self.sent += 1
            for robot, other in list(self.wire.carriers.items()):
                if robot != self.robot and to in ("", robot):
                    other.handlers.received(json.loads(json.dumps(message)))

    def is_watched(self):
        return True

    def refusals(self):
        return self.wire.refused

    def publish_firings(self, firings):
        self.wire.firings += json.loads(json.dumps(firings))

    def publish_task(self, task):
        self.wire.tasks.append(json.loads(json.dumps(task)))

    def is_team_watched(self):
        return True

    def publish_team(self, marking, team):
        self.wire.teams.append((marking, team))

    def publish_activity(self, activity):
        self.wire.activities.append(json.loads(json.dumps(activity)))

    def close(self):
        self.wire.carriers.pop(self.robot, None)


class Team:
    """Agents of this process; it stops those that are left."""

    def __init__(self, folder):
        self.folder, self.wire, self.hosts, self.over = folder, Wire(), {}, queue.Queue()

    def log(self, robot):
        return str(self.folder / "logs" / (robot + ".jsonl"))

    def start(self, plan, *robots):
        for robot in robots:
            options = HostOptions("monday", self.log(robot))
            host = make_agent(plan, robot, options, PrintedReporter(robot), self.wire.carrier)
            self.hosts[robot] = host
            host.start(self.over.put)

    def ask(self, robot, command, about="", argument="", run=""):
        request = OperatorRequest(command, about, argument, run)
        return handlers_of(self.hosts[robot]).command(request, Operator("ann"))

    def status(self, robot):
        return json.loads(self.ask(robot, "status").message)

    def wait_for_all(self):
        """Wait until every robot is in the team, and sees a quorum."""

        def all_are_in():
            statuses = [self.status(robot) for robot in self.hosts]
            return all(status["active"] and status["quorum"] for status in statuses)

        self.wait_for(all_are_in, "the team")

    def wait_for(self, condition, what):
        deadline = time.monotonic() + 30
        while not condition():
            assert time.monotonic() < deadline, what
            time.sleep(0.01)

    def close(self):
        for host in self.hosts.values():
            host.stop()
        for host in self.hosts.values():
            host.join(20)


@pytest.fixture
def team(tmp_path, monkeypatch):
    monkeypatch.setattr(host_module, "FAREWELL", 0.3)
    made = Team(tmp_path)
    yield made
    made.close()


def open_gate(plan):
    """Let robot_2 see what it looks for."""
    (Path(plan.folder) / "open").touch()


@pytest.mark.parametrize("synchronisation", ["full", "partial"])
def test_robots_without_ros_run_a_plan_together(write, team, capfd, synchronisation):
    plan = write(synchronisation=synchronisation)
    team.start(plan, "robot_1", "robot_2")
    told = team.wire.activities
    team.wait_for(lambda: [3] in [a["feedback"] for a in told], "feedback of an action")
    open_gate(plan)
    assert {team.over.get(timeout=30 * PATIENCE) for _ in range(2)} == {"robot_1", "robot_2"}
    assert [host.exit_code for host in team.hosts.values()] == [0, 0]
    logs = [read_log(team.log(robot)) for robot in ("robot_1", "robot_2")]
    assert verify(logs).violation is None
    agreed = [f["transition"] for f in team.wire.firings if not f["private_move"]]
    assert sorted(set(agreed)) == ["meet", "seen"]
    assert team.wire.activities[-1]["finished"] is True
    elsewhere = [a["feedback"] for a in told if a["place"] != "Look"]
    assert elsewhere and not any(elsewhere)
    marking, state = team.wire.teams[-1]
    assert dict(zip(marking["places"], marking["counts"]))["Home"] == 2
    assert [robot["place"] for robot in state["robots"]] == ["Home", "Home"]
    assert "robot_1: does Look (visit 1)" in capfd.readouterr().err


def test_a_robot_answers_an_operator(write, team):
    plan = write()
    team.start(plan, "robot_1", "robot_2")
    team.wait_for_all()
    assert team.ask("robot_1", "pause").success
    team.wait_for(lambda: team.status("robot_2")["paused"], "the pause")
    assert team.ask("robot_2", "dance").message.startswith("unknown command 'dance'")
    assert not team.ask("robot_2", "resume", run="tuesday").success
    assert not team.ask("robot_2", "submit", argument="[]").success
    assert "Look" in team.ask("robot_2", "breakpoints", argument='["Look"]').message
    assert team.ask("robot_2", "set_place", "robot_1", "Wait").success
    team.wait_for(lambda: team.status("robot_1")["marking"] == {"Look": 1, "Wait": 1}, "the order")
    assert team.ask("robot_1", "stop", argument="enough").success
    assert {team.over.get(timeout=30 * PATIENCE) for _ in range(2)} == {"robot_1", "robot_2"}
    assert [host.exit_code for host in team.hosts.values()] == [1, 1]


def notes_in(path):
    told = Recording(LogFile(path))
    (board, _) = list(told.read())[-1]
    return [event["text"] for event in told.events(0, board.n) if event["k"] == "note"]


def test_who_gave_an_order_is_in_every_log_and_shown(write, team):
    team.start(write(), "robot_1", "robot_2")
    team.wait_for_all()
    assert team.ask("robot_1", "pause").success
    assert team.ask("robot_1", "breakpoints", argument='["Look"]').success
    assert not team.ask("robot_1", "retry", "robot_2").success
    for question in ("status", "breakpoints", "plan"):
        team.ask("robot_1", question)
    status = team.status("robot_1")
    assert [order["operator"] for order in status["orders"]] == 3 * ["ann"]
    assert [line[10:] for line in order_lines([status])] == [
        "ann (not authenticated) orders: pause",
        'ann (not authenticated) orders: breakpoints ["Look"]',
        "ann (not authenticated) orders: retry robot_2",
    ]
    assert team.ask("robot_1", "stop").success
    assert {team.over.get(timeout=30 * PATIENCE) for _ in range(2)} == {"robot_1", "robot_2"}
    logs = [read_log(team.log(robot)) for robot in ("robot_1", "robot_2")]
    assert verify(logs).violation is None
    kept = [record for record in logs[0].records if record["kind"] == "order"]
    assert [(r["command"], r["robot"], r["argument"], r["operator"]) for r in kept] == [
        ("pause", "", "", "ann"),
        ("breakpoints", "", '["Look"]', "ann"),
        ("retry", "robot_2", "", "ann"),
        ("stop", "", "", "ann"),
    ]
    assert not any(record["kind"] == "order" for record in logs[1].records)
    for log in logs:
        slots = [record for record in log.records if record["kind"] == "slot"]
        entries = [entry for record in slots for entry in record["entries"]]
        ordered = [(entry["entry"], entry["by"]) for entry in entries if "by" in entry]
        assert ordered == [("pause", ["ann", ""]), ("stop", ["ann", ""])]
    orders = ["pause", 'breakpoints ["Look"]', "retry robot_2", "stop"]
    told = ["ann (not authenticated) orders: " + order for order in orders]
    assert notes_in(team.log("robot_1")) == told
    assert notes_in(team.log("robot_2")) == [
        "ann (not authenticated) orders: pause, asking robot_1",
        "ann (not authenticated) orders: stop, asking robot_1",
    ]
    logs[0].records = [record for record in logs[0].records if record["kind"] != "order"]
    violation = verify(logs).violation
    assert violation.rule == 4
    assert "names 'ann', who had not given robot_1 an order" in violation.text


def test_a_robot_that_is_started_again_goes_on(write, team):
    plan = write()
    team.start(plan, "robot_1", "robot_2")
    team.wait_for(lambda: team.status("robot_1")["marking"].get("Wait") == 1, "robot_1")
    team.hosts["robot_2"].stop()
    assert team.over.get(timeout=30 * PATIENCE) == "robot_2"
    open_gate(plan)
    team.start(plan, "robot_2")
    assert {team.over.get(timeout=30 * PATIENCE) for _ in range(2)} == {"robot_1", "robot_2"}
    assert [host.exit_code for host in team.hosts.values()] == [0, 0]


@pytest.mark.long
@pytest.mark.parametrize("line", [1, 3, 6])
def test_a_robot_whose_log_was_damaged_says_so_and_goes_on(write, team, capfd, line):
    plan = write()
    team.start(plan, "robot_1", "robot_2")
    team.wait_for(lambda: team.status("robot_1")["marking"].get("Wait") == 1, "robot_1")
    team.hosts["robot_2"].stop()
    assert team.over.get(timeout=30 * PATIENCE) == "robot_2"
    log = Path(team.log("robot_2"))
    damaged = log.read_bytes().splitlines(keepends=True)
    damaged[line - 1] = damaged[line - 1].replace(b'"', b"'", 1)
    log.write_bytes(b"".join(damaged))
    open_gate(plan)
    team.start(plan, "robot_2")
    assert {team.over.get(timeout=30 * PATIENCE) for _ in range(2)} == {"robot_1", "robot_2"}
    assert [host.exit_code for host in team.hosts.values()] == [0, 0]
    said = "line %d of %s is damaged; the whole file is kept as %s.damaged" % (line, log, log)
    assert said in capfd.readouterr().err
    assert Path(str(log) + ".damaged").read_bytes() == b"".join(damaged)
    verdict = verify([read_log(team.log(robot)) for robot in team.hosts])
    assert verdict.violation is None, verdict.violation
    assert any(str(log) + ".damaged" in note for note in verdict.notes)


@pytest.mark.long
def test_a_robot_ends_when_its_log_is_removed(write, team, capfd):
    plan = write()
    team.start(plan, "robot_1", "robot_2")
    team.wait_for_all()
    Path(team.log("robot_2")).unlink()
    assert team.over.get(timeout=30 * PATIENCE) == "robot_2"
    assert team.hosts["robot_2"].exit_code == 1
    text = capfd.readouterr().err
    assert "%s: was removed or replaced while" % team.log("robot_2") in text
    open_gate(plan)
    team.start(plan, "robot_2")
    assert {team.over.get(timeout=30 * PATIENCE) for _ in range(2)} == {"robot_1", "robot_2"}
    assert [host.exit_code for host in team.hosts.values()] == [0, 0]


@pytest.mark.parametrize(
    ("function", "more", "says"),
    [
        ("work.broken", {}, "ValueError: no camera"),
        (
            "work.forever",
            {"timeout": {"*": 0.1}},
            "the action took longer than 0.1 s (timeout in the plan)",
        ),
    ],
)
def test_a_function_that_fails_is_a_failed_attempt(write, team, function, more, says):
    plan = write(actions={"Look": function, "Wait": None, "Home": None}, **more)
    team.start(plan, "robot_1", "robot_2")
    team.wait_for(lambda: team.status("robot_1")["needs_operator"], "the failure")
    assert says in team.status("robot_1")["waits_for"]


@pytest.mark.long
def test_another_plan_is_followed_without_a_stop(write, team):
    team.start(write(), "robot_1", "robot_2")
    team.wait_for(lambda: team.status("robot_1")["marking"].get("Wait") == 1, "robot_1")
    new = write(actions={"Look": "work.look", "Wait": "work.broken", "Home": None})
    staged = stage_of(new, {})
    given = {"plan": staged.plan, "map": {}, "folder": new.folder}
    assert team.ask("robot_1", "stage", argument=json.dumps(given)).success
    adopted = partial(team.ask, "robot_1", "adopt")
    team.wait_for(lambda: adopted().success, "the votes of both")
    team.wait_for(lambda: team.status("robot_2")["plan"] == new.hash(), "the new plan")
    open_gate(new)
    team.wait_for(lambda: "no camera" in team.status("robot_2")["waits_for"], "the new action")


def test_a_plan_that_needs_ros_is_not_followed(write, team):
    team.start(write(), "robot_1", "robot_2")
    team.wait_for_all()
    service = {"service": "/x", "type": "std_srvs/Trigger"}
    new = write(actions={"Look": "work.look", "Wait": service, "Home": None})
    given = {"plan": stage_of(new, {}).plan, "map": {}, "folder": new.folder}
    assert team.ask("robot_1", "stage", argument=json.dumps(given)).success
    adopt = partial(team.ask, "robot_1", "adopt")
    team.wait_for(lambda: "needs ROS" in adopt().message, "the reason")


@pytest.mark.parametrize(
    ("action", "error", "says"),
    [
        ({"service": "/x", "type": "std_srvs/Trigger"}, PlanError, "needs ROS"),
        ({"command": ["true"]}, RefusedError, "commands are not allowed"),
        ("work.nothing", PlanError, "nothing"),
    ],
)
def test_an_action_that_a_robot_cannot_carry_out_is_refused(write, team, action, error, says):
    plan = write(actions={"Look": action, "Wait": None, "Home": None})
    with pytest.raises(error, match=says):
        team.start(plan, "robot_1")


def test_one_robot_tells_everybody_how_a_task_ended(tmp_path, team):
    templates.write("deliver", str(tmp_path / "post"), robots=2)
    plan = read_plan(str(tmp_path / "post"))
    team.start(plan, "robot_1", "robot_2")
    team.wait_for_all()
    order = json.dumps({"transition": "order", "id": "o1", "data": {"address": "door 7"}})
    assert team.ask("robot_1", "submit", argument=order).success
    assert team.ask("robot_2", "cancel", argument="o1").success
    told = team.wire.tasks
    team.wait_for(lambda: "o1" in [task["id"] for task in told], "how the task ended")
    (task,) = [task for task in told if task["id"] == "o1"]
    assert (task["run"], task["outcome"]) == ("monday", "cancelled")
    assert 0 <= task["seconds"] < 60 and task["data"] == {"address": "door 7"}
