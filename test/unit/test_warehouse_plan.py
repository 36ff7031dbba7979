"""The warehouse does what its README says (plans/warehouse)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.actions import load_actions
from gspn_framework_package.testing import Coverage, Scenario

FOLDER = Path(__file__).resolve().parents[2] / "plans" / "warehouse"
POSE = {"position": {"x": 1.0, "y": 2.0}}


@pytest.fixture(scope="module", params=["plan.json", "room.json"])
def coverage(request: Any) -> Coverage:
    """The two plans have the same net, and do the same."""
    return Coverage(Scenario(FOLDER / request.param).plan)


def start(coverage: Coverage, **options: Any) -> Scenario:
    return Scenario(coverage.plan, coverage=coverage, **options)


def test_its_functions_are_allowed_without_a_word() -> None:
    pytest.importorskip("rospy")
    actions = load_actions(Scenario(FOLDER / "room.json").plan, "robot_1")
    assert set(actions) == {"Park", "Loaded", "Hand_Over", "Low"}


def test_orders_are_delivered_one_at_a_time_at_the_counter(coverage: Coverage) -> None:
    run = start(coverage)
    orders = [run.submit("order", {"pose": POSE}) for _ in range(6)]
    run.until("Delivered >= 6", within=9_000.0)
    assert sorted(run.tasks_done) == sorted(orders)
    assert run.attempts_in("Fetch")[0].data["task.pose"] == POSE
    # the net has one token of the counter, or a robot there
    assert run.count("bring") == run.count("at_counter") == 6
    run.until("Parked >= 4", within=9_000.0)
    run.check_no_faults()


def test_robots_stop_for_a_person_and_go_on(coverage: Coverage) -> None:
    run = start(coverage)
    for place in ("Fetch", "Deliver.Approach"):
        run.action(place, seconds=20.0)
    run.submit("order", {"pose": POSE})
    run.holds("person", at=5.0)
    run.holds("person", False, at=9.0)
    run.holds("clear", at=9.0)
    run.until_fired("bring")
    first, second = run.attempts_in("Fetch")
    assert second.resumed_from == first.visit and second.data == first.data
    run.event("Deliver.person")
    run.event("Deliver.clear", at=run.now + 2.0)
    run.until_fired("delivered")
    first, second = run.attempts_in("Deliver.Approach")
    assert second.resumed_from == first.visit
    assert run.tasks_done == ["order-1"]


def test_a_robot_whose_battery_is_low_gives_its_order_back_and_charges(
    coverage: Coverage,
) -> None:
    run = start(coverage)
    run.action("Fetch", seconds=20.0)
    run.submit("order", {"pose": POSE})
    run.until("Fetch >= 1")
    robot = run.attempts_in("Fetch")[0].robot
    run.event("low_on_the_way", robot, at=run.now + 1.0, cause={"percentage": 0.2})
    assert run.until_fired("low_on_the_way").tasks == (
        ("order-1", "robot " + robot, "place Orders"),
    )
    run.until_fired("delivered", within=9_000.0)
    assert run.tasks_done == ["order-1"]
    run.until(lambda: run.count("charged") == 1)
    run.event("low", next(r.name for r in run.plan.robots if run.place(r.name) == "Parked"))
    run.until_fired("charged")
    run.check_no_faults()


@pytest.mark.parametrize("place", ["Fetch", "Deliver.Approach", "Hand_Over"])
def test_the_order_of_a_lost_robot_is_done_once(coverage: Coverage, place: str) -> None:
    run = start(coverage)
    run.action(place, seconds=1e6, times=1)
    run.submit("order", {"pose": POSE})
    run.until("%s >= 1" % place, within=9_000.0)
    robot = next(r for r in ("robot_%d" % k for k in range(1, 5)) if run.place(r) == place)
    run.lose(robot)
    run.until_fired("delivered", within=9_000.0)
    run.join(robot, "Parked")
    run.submit("order", {"pose": POSE})
    run.until("Delivered >= 2", within=9_000.0)
    assert run.tasks_done == ["order-1", "order-2"]
    assert run.marking["Counter"] == 1


@pytest.mark.parametrize("place", ["Fetch", "Hand_Over"])
def test_a_robot_whose_action_fails_keeps_its_order_until_it_is_given_back(
    coverage: Coverage, place: str
) -> None:
    run = start(coverage)
    run.action(place, fails="aborted", times=1)
    run.submit("order", {"pose": POSE})
    run.until_fired("delivered", within=9_000.0)
    first, second = run.attempts_in(place)
    assert second.data["task.id"] == first.data["task.id"] == "order-1"
    tries = 1 + coverage.plan.failure_rule(place).times
    run.action(place, fails="aborted", times=tries)
    run.submit("order", {"pose": POSE})
    run.until(lambda: len(run.attempts_in(place)) == 2 + tries, within=9_000.0)
    robot = run.attempts_in(place)[-1].robot
    run.until(lambda: run.phase(robot) == "failed", within=9_000.0)
    run.order(log_entries.GiveBack("order-2"))
    run.until_fired("delivered", within=9_000.0)
    assert run.tasks_done == ["order-1", "order-2"]
    assert run.count("order") == 2


@pytest.mark.parametrize(
    ("place", "leaves"),
    [("Fetch", "called_off"), ("Deliver.Approach", "taken_back"), ("Hand_Over", "taken_back")],
)
def test_a_robot_whose_order_is_cancelled_takes_the_next(
    coverage: Coverage, place: str, leaves: str
) -> None:
    run = start(coverage)
    run.action(place, seconds=50.0, times=1)
    if place == "Deliver.Approach":
        run.action("Hand_Over", result="taken_back", times=1)  # which has no order
    run.submit("order", {"pose": POSE})
    run.until("%s >= 1" % place, within=9_000.0)
    run.order(log_entries.CancelTask("order-1"))
    run.until_fired(leaves, within=9_000.0)
    assert run.marking["Counter"] == 1
    run.submit("order", {"pose": POSE})
    run.until_fired("delivered", within=9_000.0)
    assert run.tasks_done == ["order-2"]
    run.check_no_faults()


def test_an_order_is_cancelled_while_its_robot_waits(coverage: Coverage) -> None:
    run = start(coverage)
    run.action("Fetch", seconds=20.0)
    run.submit("order", {"pose": POSE})
    run.until("Fetch >= 1")
    run.event("person", run.attempts_in("Fetch")[0].robot)
    run.until("Stopped >= 1")
    run.order(log_entries.CancelTask("order-1"))
    run.until_fired("called_off_there")
    run.action("Hand_Over", seconds=200.0, times=1)
    loaded = [run.submit("order", {"pose": POSE}), run.submit("order", {"pose": POSE})]
    run.until("Loaded >= 1 and Counter == 0", within=9_000.0)
    waits = next(r for r in ("robot_%d" % k for k in range(1, 5)) if run.place(r) == "Loaded")
    order = run.attempts_in("Fetch", waits)[-1].data["task.id"]
    run.order(log_entries.CancelTask(order))
    run.until_fired("put_back")
    run.until_fired("delivered", within=9_000.0)
    assert [*run.tasks_done, order] in (loaded, loaded[::-1])


def test_everything_in_the_plan_happens() -> None:
    plan = Scenario(FOLDER).plan
    coverage = Coverage(plan)
    run = Scenario(plan, drawn=True, coverage=coverage)
    run.until("Charge.Approach >= 1")
    run.event("Charge.person")
    run.until_fired("Charge.clear")
    run.advance(300.0)
    run.until_fired("taken_back")
    coverage.check()
