"""What a robot refused, and of whom, is in its status, its activity and its diagnosis."""

import json
from types import SimpleNamespace

import pytest

from benchmarks.plans import INSTANT, ring_plan
from gspn_framework_package.cli.status import refusal_lines
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.messages import PROTOCOL_VERSION
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.team.carrier import NotTaken
from gspn_framework_package.team.self_report import MOST_REFUSALS, SelfReport

NONSENSE = {"from": "robot_2", "kind": "dance", "version": PROTOCOL_VERSION}


@pytest.fixture
def robot():
    replica = Replica(ring_plan(3, 2, INSTANT), "robot_1", "run", "log", [])
    replica.start(0.0)
    return SimpleNamespace(
        replica=replica,
        refused=[],
        hear=lambda message: replica.step(interface.Received(message), 1.0),
    )


def report_of(robot):
    actions = SimpleNamespace(doing=lambda: "")
    return SelfReport("robot_1", "run", robot.replica, actions, lambda: robot.refused)


def test_nothing_is_refused_at_first(robot):
    report = report_of(robot)
    assert report.status()["refused"] == report.activity("", 1, [])["refused"] == []
    level, message, values = report.diagnosis()
    assert "refuses" not in message and values["refused messages"] == 0


def test_what_carrier_and_replica_refuse_is_counted_and_named(robot):
    report = report_of(robot)
    robot.refused.append(NotTaken("robot_3", "too large", 2))
    for _ in range(3):
        robot.hear(NONSENSE)
    told = [
        {"robot": "robot_2", "why": "unknown kind of message 'dance'", "times": 3},
        {"robot": "robot_3", "why": "too large", "times": 2},
    ]
    status = json.loads(json.dumps(report.status()))
    assert status["refused"] == report.activity("", 1, [])["refused"] == told
    assert refusal_lines([status]) == [
        "robot_1 refused 3 of robot_2: unknown kind of message 'dance'",
        "robot_1 refused 2 of robot_3: too large",
    ]


def test_a_diagnosis_warns_while_more_is_refused(robot):
    report = report_of(robot)
    robot.hear(NONSENSE)
    level, message, values = report.diagnosis()
    assert level >= 1 and message.endswith("refuses messages of robot_2")
    assert values["refused messages"] == 1
    assert values["refused from robot_2: unknown kind of message 'dance'"] == 1
    assert "refuses" not in report.diagnosis()[1]
    robot.hear(NONSENSE)
    assert "refuses" in report.diagnosis()[1]


def test_the_list_is_bounded_and_the_count_is_not(robot):
    report = report_of(robot)
    for number in range(500):
        robot.hear({**NONSENSE, "from": "robot %d" % number})
    assert len(report.status()["refused"]) == MOST_REFUSALS
    assert report.diagnosis()[2]["refused messages"] == 500
    assert len(robot.replica.complaints) <= 101
