"""The plans that come with the package do what their descriptions say."""

from __future__ import annotations

from pathlib import Path

import pytest

from gspn_framework_package.execution import log_entries
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.testing import Coverage, Scenario

PLANS = Path(__file__).resolve().parents[3] / "plans"


@pytest.mark.parametrize(("name", "robots"), [("tokens", 5), ("measure", 2), ("rendezvous", 4)])
def test_all_of_a_plan_is_reached(name: str, robots: int) -> None:
    coverage = Coverage(read_plan(str(PLANS / name)))
    for seed in range(5):
        run = Scenario(PLANS / name, robots=robots, drawn=True, seed=seed, coverage=coverage)
        run.advance(100.0)
        run.check_no_faults()
    coverage.check()


def test_a_fork_makes_two_agents_that_join_again() -> None:
    coverage = Coverage(read_plan(str(PLANS / "fork_join")))
    for seed in range(10):
        run = Scenario(PLANS / "fork_join", functions=True, seed=seed, coverage=coverage)
        assert run.to_end(within=1000.0).finished
        assert run.marking == {"End": 1}
        assert run.count("Fork") == run.count("Join") == run.count("Again") + 1
    coverage.check()


def test_a_picker_waits_for_a_carrier() -> None:
    run = Scenario(PLANS / "rendezvous")
    net = run.plan.net
    meeting = next(
        t.name
        for t, arcs in zip(net.transitions, net.inputs)
        if {net.places[p].name for p, _ in arcs} >= {"At_Dock", "Docked"}
    )
    run.action("Approach", seconds=50.0)
    run.advance(49.0)
    run.check_not_fired(meeting)
    assert run.place("picker_1") == run.place("picker_2") == "At_Dock"
    assert "needs a robot in Docked" in run.why("picker_1")
    run.until_fired(meeting)
    assert run.now > 50.0


def test_a_lost_carrier_leaves_the_other_to_do_the_work() -> None:
    run = Scenario(PLANS / "rendezvous", agents=False)
    run.action("Approach", robot="carrier_1", seconds=5.0)
    run.lose("carrier_1", at=1.0)
    run.advance(10.0)
    before = len(run.firings)
    run.advance(60.0)
    assert {m.robot for f in run.firings[before:] for m in f.moves} >= {"carrier_2", "picker_1"}
    assert run.phase("carrier_1") == "lost"


def test_a_paused_patrol_goes_on() -> None:
    run = Scenario(PLANS / "patrol")
    run.advance(5.0)
    run.order(log_entries.Pause())
    run.advance(0.0)
    before = len(run.firings)
    run.advance(30.0)
    assert len(run.firings) == before
    run.order(log_entries.Resume())
    run.advance(30.0)
    assert len(run.firings) > before
