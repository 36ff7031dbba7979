"""A pause that stops actions, and one that lets them go on."""

from __future__ import annotations

import pytest
from game_driver import Run
from logged_runs import ring
from test_reacting_replica import Team, restart

from agreement.plans import make_plan
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.firing import CancelAction, StartAction
from gspn_framework_package.execution.log_entries import Pause, Resume
from gspn_framework_package.execution.team_state import TeamState

TOUR = 0


def commands(run: Run) -> list:
    found = [c for c in run.commands if isinstance(c, (CancelAction, StartAction))]
    run.commands.clear()
    return [
        ("cancel", c.robot) if isinstance(c, CancelAction) else ("start", c.robot, c.attempt)
        for c in found
    ]


def test_a_pause_that_stops_cancels_actions_and_resume_starts_them_again() -> None:
    run = Run(ring())
    commands(run)
    run.feed(Pause(stop=True))
    assert commands(run) == [("cancel", "a"), ("cancel", "b")]
    run.feed(Pause("a", stop=True))  # stopped already, and then for two reasons
    run.feed(Resume())
    assert commands(run) == [("start", "b", 2)]
    run.feed(Resume("a"))
    assert commands(run) == [("start", "a", 2)]
    assert not run.state.stopped and not run.state.is_stopped(run.state.robots["a"])


def test_a_pause_lets_actions_go_on() -> None:
    run = Run(ring())
    commands(run)
    run.feed(Pause(), Resume())
    assert commands(run) == []
    run.feed(Pause())
    assert "its action continues" in run.game.why_waiting(run.state, run.state.robots["a"])
    run.feed(Pause(stop=True))
    assert commands(run) == [("cancel", "a"), ("cancel", "b")]
    assert "starts again on resume" in run.game.why_waiting(run.state, run.state.robots["a"])
    run.feed(Pause())  # which takes nothing up
    assert commands(run) == [] and run.state.stopped


def test_an_action_that_had_ended_before_the_pause_is_not_repeated() -> None:
    run = Run(ring())
    commands(run)
    run.feed(Pause(stop=True), log_entries.Done("a", 0, 1))
    run.feed(Resume())
    started = commands(run)
    assert ("start", "a", 1) in started and ("start", "b", 2) in started  # in B, and again in A


def test_what_an_operator_moves_or_lets_try_again_starts_on_resume() -> None:
    run = Run(ring())
    run.fail("b")
    commands(run)
    run.feed(Pause(stop=True))
    run.feed(log_entries.SetPlace("a", "B"), log_entries.Retry("b"))
    run.feed(log_entries.Join("b", 1))
    assert commands(run) == [("cancel", "a")]
    run.feed(Resume())
    assert [c[:2] for c in commands(run)] == [("start", "a"), ("start", "b")]


def test_a_stop_is_in_a_snapshot() -> None:
    run = Run(ring())
    run.feed(Pause(stop=True), Pause("a", stop=True))
    net = run.game.net
    again = TeamState.from_json(run.state.to_json(net), net, frozenset())
    assert again == run.state and again.stopped and again.robots["a"].stopped


@pytest.mark.parametrize("partial", [False, True])
def test_robots_stop_and_take_their_actions_up_again(partial: bool) -> None:
    world = Team(make_plan(TOUR, 2, partial, 0.0, 0.0, False))
    begun = len(world.started)
    world.give("r1", interface.Order("stop", Pause(stop=True)))
    first = world.started[0]
    assert first.robot == "r1"
    world.done("r1", "")  # too late: it was cancelled
    assert len(world.entries("done")) == 0
    restart(world.nodes["r2"])  # it does not act either
    assert len(world.started) == begun
    assert world.nodes["r1"].replica.state.running is None
    world.give("r2", interface.Order("go", Resume()))
    again = {goal.robot: goal for goal in world.started[begun:]}
    assert again["r1"].visit == first.visit and again["r1"].attempt == 2
    assert set(again) == {"r1", "r2"}
    world.done("r1", "ab")
    world.check()
