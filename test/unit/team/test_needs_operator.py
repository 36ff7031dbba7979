"""What needs the operator is seen by the state of a robot, not by what a text about it says."""

import re
from types import SimpleNamespace

import pytest

from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.rules import RUNS_ON
from gspn_framework_package.execution.team_state import RobotState, TeamState
from gspn_framework_package.team.self_report import SelfReport
from gspn_framework_package.team.status_reporter import level_of


def report(phase, halted=None, ended=None, why="", stuck=False):
    """What a host says whose robot is in that phase, in a place named Ask_operator."""
    state = TeamState(
        (1,), {"robot_1": RobotState("robot_1", 0, phase=phase, why=why)}, ended=ended
    )
    game = SimpleNamespace(why_waiting=lambda *_: "wants T_operator: needs a robot in Ask_operator")
    replica = SimpleNamespace(
        ledger=SimpleNamespace(state=state, game=game),
        halted=halted,
        waits_for=lambda: "waits for operator_2 to start",
        is_stuck=lambda: stuck,
    )
    actions = SimpleNamespace(doing=lambda: "waits for the action server /operator/alarm")
    return SelfReport("robot_1", "run", replica, actions, list)


@pytest.mark.parametrize("phase", [Phase.DOING, Phase.DONE, Phase.INACTIVE, Phase.LEFT])
def test_a_name_with_the_word_in_it_needs_nobody(phase):
    waiting = report(phase)
    assert "Ask_operator" in waiting.waits_for()
    assert not waiting.needs_operator()
    assert level_of(waiting.needs_operator(), bool(waiting.waits_for())) == 1


@pytest.mark.parametrize(
    "phase, halted", [(Phase.FAILED, None), (Phase.LOST, None), (Phase.DOING, "a lost log")]
)
def test_a_robot_that_does_not_go_on_by_itself_needs_the_operator(phase, halted):
    assert report(phase, halted).needs_operator()
    assert level_of(True, False) == 2


def test_a_pause_says_since_when_an_action_runs_on():
    paused = report(Phase.DOING)
    paused._replica.ledger.game.why_waiting = lambda *_: RUNS_ON
    assert paused.waits_for().endswith("; " + RUNS_ON)
    paused.note_start()
    assert re.search("; %s since [0-9:]{8}$" % RUNS_ON, paused.waits_for())


def test_a_team_that_lost_too_many_logs_needs_the_operator():
    assert report(Phase.DONE, stuck=True).needs_operator()


def test_after_the_end_nobody_is_needed():
    assert not report(Phase.FAILED, ended="stopped").needs_operator()
    assert level_of(False, False) == 0
