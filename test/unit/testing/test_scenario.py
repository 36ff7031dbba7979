"""Runs of plans in virtual time that a test directs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.actions import ActionFailed
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.model.action import FunctionAction, ServerAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import GspnError, UsageError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.testing import ActionAttempt, Coverage, Scenario


def shop(robots: int = 1, **fields: Any) -> Plan:
    """Clerks wait for orders and deliver them; a low battery sends them to the charger."""
    net = (
        NetBuilder()
        .place("Idle")
        .place("Deliver")
        .place("Charge")
        .place("Orders")
        .exponential("order", rate=1, outputs="Orders")
        .immediate("take", inputs=["Idle", "Orders"], outputs="Deliver")
        .exponential("delivered", rate=1, inputs="Deliver", outputs="Idle")
        .exponential("low", rate=0.1, inputs="Deliver", outputs="Charge")
        .exponential("full", rate=1, inputs="Charge", outputs="Deliver")
        .build()
    )
    given = {
        "events": {"low": EventSource(topic="battery", type="a/B", resume=True)},
        "durations": {"Deliver": Duration.deterministic(10), "Charge": Duration.deterministic(60)},
        "outcomes": {"Deliver": {"delivered": 1.0}},
        **fields,
    }
    plan = Plan(
        net,
        actions={
            "Idle": None,
            "Deliver": FunctionAction("acts.deliver", "deliver"),
            "Charge": FunctionAction("acts.charge", "charge"),
        },
        resource_places=frozenset(["Orders"]),
        tasks=Tasks(("Orders",), ("delivered",)),
        **given,
    )
    return plan.with_robots([RobotSpec("ab"[n], "Idle") for n in range(robots)]).validate()


def test_a_task_is_done_and_its_data_are_given_to_the_action() -> None:
    run = Scenario(shop())
    assert run.submit("order", {"pose": [1, 2]}, at=5.0) == "order-1"
    fired = run.until_fired("delivered")
    assert fired.at == 15.0
    assert run.fired == ["order", "take", "delivered"]
    assert run.tasks == {"order-1": "done"}
    assert run.tasks_done == ["order-1"]
    assert run.attempts_in("Deliver") == [
        ActionAttempt(5.0, "a", "Deliver", 2, 1, {"task.id": "order-1", "task.pose": [1, 2]}, 0)
    ]
    run.check_no_faults()


def test_an_event_interrupts_an_action_which_goes_on_later() -> None:
    run = Scenario(shop())
    run.submit("order")
    run.event("low", "a", cause={"percentage": 0.1}, at=4.0)
    run.until_fired("delivered")
    assert run.now == 4.0 + 60.0 + 10.0
    run.check_fired("take", "low", "full", "delivered")
    assert [f.cause for f in run.firings if f.transition == "low"] == [{"percentage": 0.1}]
    assert [a.resumed_from for a in run.attempts_in("Deliver")] == [0, 2]


@pytest.mark.parametrize(("edge", "first"), [(False, "low"), (True, "delivered")])
def test_a_condition_that_holds_counts_on_entry_unless_only_its_edge_does(
    edge: bool, first: str
) -> None:
    source = EventSource(topic="battery", type="a/B", when="x < 1", edge=edge)
    run = Scenario(shop(events={"low": source}))
    run.holds("low")
    run.advance(1.0)
    run.action("Deliver", seconds=0.0, result="", times=1)  # even if it takes no time
    run.submit("order")
    run.advance(50.0)
    assert run.fired == ["order", "take", first]
    assert run.firings[-1].at == 1.0
    run.holds("low", False)
    run.submit("order")
    run.holds("low", at=63.0 if first == "low" else 53.0)  # it rises during a visit
    run.advance(20.0)
    assert run.fired.count("low") == (1 if edge else 2)


def test_events_of_time_come_by_themselves() -> None:
    run = Scenario(shop(events={"low": EventSource(after=7.0)}))
    run.submit("order")
    assert run.until_fired("low").at == 7.0
    assert run.until_fired("low").at == 74.0


def test_the_test_says_what_actions_do() -> None:
    run = Scenario(shop(on_failure={"Deliver": FailureRule.retry(5, 1.0)}))
    run.action("Deliver", seconds=2.0, fails="aborted", times=2)
    run.action("Deliver", seconds=3.0, data={"team.seen": 4}, times=1)
    run.submit("order")
    assert run.until_fired("delivered").at == 2 + 1 + 2 + 1 + 3
    assert [a.attempt for a in run.attempts] == [1, 2, 3]
    assert len(run.faults) == 2
    assert run.data() == {"team.seen": 4}
    run.action("Deliver", act=lambda attempt: ("delivered", {"at": attempt.at}), times=1)
    run.submit("order")
    assert run.until_fired("delivered").at == 9.0 + 10.0
    assert run.data("a") == {"robot.at": 9.0, "team.seen": 4}


def test_what_is_said_later_for_all_attempts_replaces_what_was_said_before() -> None:
    run = Scenario(shop())
    run.action("Deliver", seconds=1000.0)
    run.action("Deliver", seconds=2.0, times=1)
    run.action("Deliver", seconds=3.0)
    for at in (2.0, 2.0 + 3.0):
        run.submit("order")
        assert run.until_fired("delivered").at == at


def test_an_action_of_the_test_may_fail_or_never_end() -> None:
    def act(attempt: ActionAttempt) -> None:
        raise ActionFailed("no way to %s" % attempt.data["task.id"])

    run = Scenario(shop())
    run.action("Deliver", act=act, times=1)
    run.submit("order")
    run.advance(30.0)
    assert (run.phase("a"), run.place("a")) == ("failed", "Deliver")
    assert "no way to order-1" in run.faults[0]
    run.action("Deliver", seconds=math.inf)
    run.order(log_entries.Retry("a"))
    with pytest.raises(AssertionError, match="delivered does not fire within 500 s"):
        run.until_fired("delivered", within=500.0)
    run = Scenario(shop(timeouts={"*": 25.0}))
    run.action("Deliver", seconds=math.inf)
    run.submit("order")
    run.until(lambda: bool(run.faults))
    assert run.now == 25.0


def test_robots_are_lost_and_join() -> None:
    run = Scenario(shop(2, on_evict={"Deliver": {"Orders": 1}}), agents=False)
    run.submit("order")
    run.advance(0.0)
    lost, other = sorted("ab", key=lambda robot: run.place(robot) != "Deliver")
    run.lose(lost, at=3.0)
    run.join("c", "Idle", at=8.0)
    run.until_fired("delivered")
    assert [(a.robot, a.at) for a in run.attempts_in("Deliver")] == [(lost, 0.0), (other, 3.0)]
    assert run.tasks_done == ["order-1"]
    assert run.marking == {"Idle": 2}
    run.join(lost, "Idle")
    run.advance()
    assert run.marking == {"Idle": 3}


@pytest.mark.parametrize("how", ["fails", "act"])
def test_an_outcome_that_the_plan_leads_to_a_transition_fires_it(how: str) -> None:
    plan = shop()
    deliver = ServerAction("a/BAction", "deliver", {}, {"aborted": "low", "rejected": ""})
    plan = replace(plan, actions={**plan.actions, "Deliver": deliver}).validate()

    def fail(attempt: ActionAttempt) -> None:
        raise ActionFailed("no way")

    run = Scenario(plan)
    if how == "fails":
        run.action("Deliver", seconds=2.0, fails="aborted", times=1)
    else:
        run.action("Deliver", seconds=2.0, act=fail, times=1)
    run.submit("order")
    run.advance(3.0)
    run.check_fired("take", "low")
    run.check_no_faults()
    assert run.place("a") == "Charge"
    run.action("Deliver", seconds=2.0, fails="preempted")  # the plan does not mention it
    run.advance(70.0)
    assert run.phase("a") == "failed"


def test_a_check_that_fails_shows_the_course_of_the_run() -> None:
    run = Scenario(shop())
    run.submit("order")
    run.advance(12.0)
    run.check_not_fired("low")
    with pytest.raises(AssertionError) as failed:
        run.check_fired("take", "low")
    text = str(failed.value)
    assert text.startswith("low did not fire after take\n")
    assert "    10.000 s  delivered  a: Deliver -> Idle, task order-1: robot a -> done" in text
    assert text.endswith("at 12 s: a is done in Idle")
    with pytest.raises(AssertionError, match="take fired"):
        run.check_not_fired("low", "take")
    with pytest.raises(AssertionError, match="the run does not end within 5 s"):
        run.to_end(within=5.0)
    with pytest.raises(AssertionError, match="Orders >= 2 does not become true"):
        run.until("Orders >= 2", within=5.0)


def test_mistakes_of_a_test_are_reported() -> None:
    run = Scenario(shop())
    with pytest.raises(UsageError, match="has not begun"):
        run.place("a")
    run.advance()
    for mistake in (
        lambda: run.action("Nowhere"),
        lambda: run.action("Deliver", fails="badly"),
        lambda: run.event("delivered"),
        lambda: run.submit("take"),
        lambda: run.place("z"),
        lambda: run.until_fired("no such"),
    ):
        with pytest.raises(GspnError):
            mistake()
    run.advance(10.0)
    with pytest.raises(UsageError, match="5 s is in the past"):
        run.submit("order", at=5.0)


def test_a_plan_without_time_is_found() -> None:
    run = Scenario(shop(durations={"Deliver": Duration.none()}))
    run.action("Deliver", act=lambda attempt: run.submit("order") and "delivered")
    run.submit("order")
    with pytest.raises(AssertionError, match="runs without time"):
        run.advance(1.0)


def test_the_functions_of_a_plan_run_in_virtual_time(tmp_path: Path) -> None:
    (tmp_path / "acts.py").write_text(
        "def deliver(data, is_cancelled):\n"
        "    for leg in range(3):\n        is_cancelled.wait(4)\n"
        "    if data['task.id'] == 'order-2':\n        raise ValueError('no such address')\n"
        "    return 'delivered', {'team.last': data['task.id']}\n"
        "def charge(is_cancelled):\n    while not is_cancelled():\n        is_cancelled.wait(1)\n"
    )
    plan = replace(shop(), folder=str(tmp_path))
    run = Scenario(plan, functions=True)
    run.submit("order")
    assert run.until_fired("delivered").at == 12.0
    assert run.data() == {"team.last": "order-1"}
    run.action("Deliver", seconds=math.inf, times=1)  # the test says something else
    run.submit("order")
    run.event("low", at=20.0)
    run.advance(7 * 24 * 3600.0)
    assert run.place("a") == "Charge"  # its function never ends
    with pytest.raises(GspnError, match="no 'deliver'"):
        (tmp_path / "other").mkdir()
        (tmp_path / "other" / "acts.py").write_text("x = 1\n")
        Scenario(replace(plan, folder=str(tmp_path / "other")), functions=True)
    run = Scenario(plan, functions=True)
    run.submit("order", task="order-2")
    run.advance(12.0)
    assert "(aborted: ValueError: no such address)" in run.faults[0]


def test_what_the_plan_draws_is_drawn_with_its_seed(tmp_path: Path) -> None:
    path = str(tmp_path / "run.jsonl")
    with Scenario(shop(2), drawn=True, seed=3, log=path) as run:
        run.advance(2000.0)
        assert min(map(run.count, ("order", "delivered", "low"))) > 10
    assert sum(len(step.firings) for step in replay(read_log(path))) == len(run.firings)
    again = Scenario(shop(2), drawn=True, seed=3)
    again.advance(2000.0)
    assert again.firings == run.firings


# -- coverage ----------------------------------------------------------------------------------


def choices() -> Plan:
    net = (
        NetBuilder()
        .place("Go", 1)
        .place("Left")
        .place("Right")
        .place("Key")
        .immediate("left", inputs="Go", outputs="Left")
        .immediate("right", inputs="Go", outputs="Right")
        .exponential("back", rate=1, inputs="Left", outputs="Go")
        .exponential("key", rate=1, outputs="Key")
        .build()
    )
    rows = [
        PolicyRow((0,), ()),
        PolicyRow((1,), (("left", 1.0),)),
        PolicyRow((2,), (("right", 1.0),)),
    ]
    act = FunctionAction("acts.act", "act")
    return Plan(
        net,
        policy=Policy(("Key",), rows),
        actions={"Go": None, "Left": act, "Right": None},
        resource_places=frozenset(["Key"]),
        robots=(RobotSpec("a", "Go"),),
    ).validate()


def test_coverage_is_counted_over_runs() -> None:
    plan = choices()
    coverage = Coverage(plan)
    run = Scenario(plan, coverage=coverage)
    run.advance(10.0)
    assert coverage.missing == {
        "places": ["Left", "Right", "Key"],
        "transitions": ["left", "right", "back", "key"],
        "rows": [2, 3],
    }
    run.order(log_entries.Fire("key"))
    run.until_fired("back")
    assert coverage.rows == {1, 2}
    with pytest.raises(AssertionError) as failed:
        coverage.check(without=["right"])
    assert str(failed.value).splitlines()[1:] == [
        "places: 3 of 4; not Right",
        "transitions: 3 of 4; not right",
        "rows: 2 of 3; not 3",
    ]
    run = Scenario(plan, coverage=coverage)
    run.order(log_entries.Fire("key"))
    run.action("Left", seconds=5.0, result="back")
    run.order(log_entries.Fire("key"), at=1.0)
    assert run.to_end().finished
    coverage.check()


def test_an_event_to_all_may_end_another_agent():
    net = (
        NetBuilder("two")
        .place("a", tokens=1)
        .place("b")
        .place("c", tokens=1)
        .place("rung")
        .exponential("bell", inputs="a", outputs=["b", "rung"])
        .immediate("end", inputs=["c", "rung"], outputs=[])
        .build()
    )
    plan = Plan(
        net,
        actions={"a": FunctionAction("actions.work", "work"), "b": None, "c": None},
        robots=(RobotSpec("r1", "a"), RobotSpec("r2", "c")),
        events={"bell": EventSource("bell", "std_msgs/Empty")},
        resource_places=frozenset(["rung"]),
    ).validate()
    with Scenario(plan) as scenario:
        scenario.action("a", seconds=math.inf)
        scenario.event("bell", at=1.0)
        scenario.advance(2.0)
        assert scenario.fired == ["bell", "end"]
        assert scenario.marking == {"b": 1}
