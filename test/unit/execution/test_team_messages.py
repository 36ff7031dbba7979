"""What watchers read of a team: its robots, its end, the tasks that wait, a firing."""

from __future__ import annotations

import json
from typing import Any, Dict

from agreement.plans import make_plan
from gspn_framework_package.execution.agreement.interface import Fired
from gspn_framework_package.execution.firing import Firing, Move, TaskEnded, TaskMove
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_messages import (
    ROBOT_STATES,
    firing_fields,
    robot_fields,
    task_fields,
    team_fields,
)
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame

PLAN = make_plan(2, 3, False, 0.0, 0.0, False)
GAME = TokenGame(PLAN)


def started() -> TeamState:
    state = GAME.new_state()
    GAME.reduce(state, 0, [GAME.start_entry()])
    return state


def of_robot(state: TeamState, phase: Phase) -> Dict[str, Any]:
    robot = state.robots["r1"]
    robot.phase = phase
    return robot_fields(GAME, state, robot, "run", "plan")


def test_the_numbers_of_the_states_stay_as_programs_know_them() -> None:
    assert ROBOT_STATES[:6] == ("", "Doing", "Done", "Waiting", "Paused", "Failed")
    assert ROBOT_STATES[6:] == ("Inactive", "Lost", "Left")


def test_a_robot_that_is_gone_is_in_no_place_and_waits_for_nothing() -> None:
    state = started()
    place = GAME.net.places[state.robots["r1"].place].name
    here = of_robot(state, Phase.DONE)
    assert (here["place"], here["place_number"]) == (place, state.robots["r1"].place)
    assert here["waits_for"]
    gone = of_robot(state, Phase.LOST)
    assert (gone["place"], gone["place_number"], gone["waits_for"]) == ("", -1, "")
    assert gone["needs_operator"]


def test_who_acts_waits_for_nothing() -> None:
    assert of_robot(started(), Phase.DOING)["waits_for"] == ""


def test_after_the_end_nobody_waits_or_needs_the_operator() -> None:
    state = started()
    assert of_robot(state, Phase.FAILED)["needs_operator"]
    state.ended = "stopped"
    assert not of_robot(state, Phase.FAILED)["needs_operator"]
    assert of_robot(state, Phase.DONE)["waits_for"] == ""


def test_a_pause_is_reported_of_every_robot() -> None:
    state = started()
    state.paused = True
    assert of_robot(state, Phase.DOING)["state_name"] == "Paused"
    assert team_fields(GAME, state, "run", "plan")["paused"]


def test_the_end_of_a_team_says_why() -> None:
    state = started()
    running = team_fields(GAME, state, "run", "plan")
    assert (running["ended"], running["ended_why"]) == (False, "")
    state.ended = ""  # ended, and nobody said why
    assert team_fields(GAME, state, "run", "plan")["ended"]


def test_the_robots_of_a_team_are_in_the_order_of_their_names() -> None:
    state = started()
    state.robots = dict(reversed(list(state.robots.items())))
    names = [robot["robot"] for robot in team_fields(GAME, state, "run", "plan")["robots"]]
    assert names == sorted(state.robots)


def test_a_firing_says_what_caused_it_and_where_its_tasks_went() -> None:
    move, task = Move("r1", None, "p", 1), TaskMove("t", "", "robot r1")
    firing = Firing(3, 1, "t1", "r1", 2, 5, (move,), (0,) * len(PLAN.net.places))
    fields = firing_fields(Fired(firing, True, "abc", PLAN, private=True), "run")
    assert (fields["slot"], fields["index"], fields["private_move"]) == (3, 1, True)
    assert (fields["incarnation"], fields["visit"], fields["details"]) == (2, 5, "")
    told = Fired(firing._replace(tasks=(task,), cause={"n": 1}), True, "abc", PLAN)
    details = json.loads(firing_fields(told, "run")["details"])
    assert details == {"cause": {"n": 1}, "tasks": [["t", "", "robot r1"]]}


def test_how_long_a_task_took_is_told_only_if_it_is_known() -> None:
    ended = TaskEnded("t", "done", "", "r1", {"n": 1}, since=100, attempts=2)
    fields = task_fields(ended, "run", 130.0)
    assert (fields["seconds"], fields["attempts"], fields["data"]) == (30.0, 2, {"n": 1})
    assert task_fields(ended._replace(since=0), "run", 130.0)["seconds"] is None
