"""Orders about tasks: cancelling, priorities, what the team then says of a task."""

from __future__ import annotations

import contextlib
import json
import math
import random
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from game_driver import Run, make_plan
from logged_runs import Story
from test_reacting import shop_net
from test_reacting_replica import ERRANDS, Team, restart

from agreement.plans import make_plan as agreement_plan
from gspn_framework_package.analysis.fitting.arrivals import ArrivalsFit, Period, with_day
from gspn_framework_package.cli.tasks import lines
from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.displayed_data import displayed_tasks
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.firing import CancelAction, Fault, TaskEnded
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import DataError, PlanError
from gspn_framework_package.model.event import Tasks
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy
from gspn_framework_package.team.order_fields import seconds_of
from gspn_framework_package.team.orders import ORDERS, SUBMITTED


def net_with_way_out() -> Net:
    """Orders come in, robots take and deliver them, or give up."""
    return (
        NetBuilder()
        .place("Idle")
        .place("Deliver")
        .place("Orders", capacity=3)
        .exponential("order", rate=1, outputs="Orders")
        .immediate("take", inputs=["Idle", "Orders"], outputs="Deliver")
        .exponential("delivered", rate=1, inputs="Deliver", outputs="Idle")
        .exponential("give_up", rate=1, inputs="Deliver", outputs="Idle")
        .build()
    )


def plan_of(net: Net, robots: int = 1, on_cancel: Any = None, idle: bool = True) -> Plan:
    return make_plan(
        net,
        ["Idle"] * robots,
        ["Orders"],
        idle=["Idle"] if idle else [],
        tasks=Tasks(("Orders",), ("delivered",), on_cancel or {}),
        on_evict={"Deliver": {"Orders": 1}},
    )


def shop(**fields: Any) -> Run:
    return Run(plan_of(net_with_way_out(), **fields), in_order=True)


def submit(task: str, priority: int = 0) -> log_entries.Submit:
    return log_entries.Submit("order", task, priority=priority)


def waiting(run: Run) -> Any:
    return [task.id for queue in run.state.queues.values() for task in queue]


def ended(run: Run) -> Any:
    return [tuple(e[:2]) for e in run.state.ended_tasks]


def test_a_task_that_waits_is_cancelled() -> None:
    run = shop(idle=False)
    run.feed(*(submit("o%d" % n) for n in range(1, 6)))
    assert waiting(run) == ["o1", "o2", "o3"]
    assert run.feed(log_entries.CancelTask("o2")) == ["order"]  # there is room for the next
    assert waiting(run) == ["o1", "o3", "o4"]
    run.feed(log_entries.CancelTask("o5"))  # outside
    assert run.state.submitted == []
    assert ended(run) == [("o2", "cancelled"), ("o5", "cancelled")]
    assert (
        run.feed(log_entries.CancelTask("o2"), submit("o2")) == []
    )  # it counts once, and comes once


def test_a_robot_goes_on_as_the_plan_says_when_its_task_is_cancelled() -> None:
    run = shop(on_cancel={"Deliver": "give_up"})
    run.feed(submit("o1"), submit("o2"))
    assert run.feed(log_entries.CancelTask("o1")) == ["give_up", "take"]
    assert CancelAction("a", 2) in run.commands
    assert run.state.robots["a"].task.id == "o2"
    assert ended(run) == [("o1", "cancelled")]
    # the action had ended at the same moment: too late
    assert run.feed(log_entries.Done("a", 0, 2, "delivered")) == []


def test_a_robot_may_go_on_with_its_action_without_its_task() -> None:
    run = shop(on_cancel={"Deliver": None})
    run.feed(submit("o1"))
    commands = len(run.commands)
    assert run.feed(log_entries.CancelTask("o1")) == []
    (told,) = run.commands[commands:]
    assert told == TaskEnded("o1", "cancelled", "with a in Deliver", "a", {}, 0, 1)
    assert run.state.robots["a"].task is None
    assert run.done("a", "delivered") == ["delivered"]
    assert ended(run) == [("o1", "cancelled")]


def test_where_the_plan_says_nothing_a_robot_waits_for_the_operator() -> None:
    run = shop()
    run.feed(submit("o1"))
    run.feed(log_entries.CancelTask("o1"))
    robot = run.state.robots["a"]
    assert robot.phase is Phase.FAILED and robot.why == "its task o1 was cancelled"
    assert any("for the operator" in c.message for c in run.commands if isinstance(c, Fault))
    run.feed(log_entries.SetPlace("a", "Idle"), submit("o2"))
    assert robot.task is not None and robot.task.id == "o2"


def test_a_task_of_a_robot_that_is_gone_can_be_cancelled() -> None:
    plan = replace(plan_of(net_with_way_out(), robots=2), on_evict={})
    run = Run(plan, in_order=True)
    run.feed(submit("o1"))
    run.feed(log_entries.Evict("a", 0))
    assert displayed_tasks(run.state, run.game)["tasks"][0]["trouble"] == (
        "a is lost: submit the task again, or cancel it"
    )
    run.feed(log_entries.CancelTask("o1"))
    assert run.state.robots["a"].task is None and ended(run) == [("o1", "cancelled")]


def test_tasks_of_higher_priority_come_first() -> None:
    run = shop(idle=False)
    run.feed(submit("o1"), submit("o2", 1), submit("o3"), submit("o4"), submit("o5", 2))
    assert waiting(run) == ["o2", "o1", "o3"]
    assert [task.id for _, task in run.state.submitted] == ["o5", "o4"]
    run.feed(log_entries.PrioritiseTask("o3", 1), log_entries.PrioritiseTask("o4", 3))
    assert waiting(run) == ["o2", "o3", "o1"]  # behind those that had it before
    assert run.done("a") == ["take", "order"]
    assert run.state.robots["a"].task.id == "o2"
    assert waiting(run) == ["o4", "o3", "o1"]
    # a task that returns goes before others of its priority, and behind those of a higher one
    run.feed(log_entries.PrioritiseTask("o2", 1), log_entries.SetPlace("a", "Idle"))
    assert waiting(run) == ["o4", "o2", "o3", "o1"]


def stated(order: str) -> Run:
    """Two robots, of which one is paused, and a queue with this order."""
    plan = plan_of(net_with_way_out(), robots=2, on_cancel={"Deliver": "give_up"}, idle=False)
    tasks = plan.tasks._replace(order={"Orders": order})
    return Run(replace(plan, tasks=tasks).validate(), in_order=True)


@pytest.mark.parametrize(
    ("order", "first", "prioritised", "returned"),
    [
        ("arrival", ["o1", "o2", "o3"], ["o1", "o2", "o3"], ["o1", "o2", "o3"]),
        ("priority", ["o2", "o1", "o3"], ["o3", "o2", "o1"], ["o3", "o2", "o1"]),
        ("deadline", ["o3", "o2", "o1"], ["o3", "o2", "o1"], ["o3", "o2", "o1"]),
    ],
)
def test_the_plan_says_in_which_order_tasks_are_taken(
    order: str, first: Any, prioritised: Any, returned: Any
) -> None:
    run = stated(order)
    run.feed(submit("o1"), submit("o2", 1)._replace(until=900), submit("o3")._replace(until=500))
    assert waiting(run) == first
    run.feed(log_entries.PrioritiseTask("o3", 2))
    assert waiting(run) == prioritised
    assert run.done("a") == ["take"]
    assert run.state.robots["a"].task.id == prioritised[0]
    run.feed(log_entries.GiveBack(prioritised[0]), log_entries.Pause("a"))
    assert waiting(run) == returned


def steered(order: str, path: str) -> Any:
    """A run with orders about tasks, drawn alike for every order of the queue; returns its tasks
    as robots took them."""
    plan = plan_of(net_with_way_out(), robots=2, on_cancel={"Deliver": "give_up"})
    plan = replace(plan, tasks=plan.tasks._replace(order={"Orders": order})).validate()
    run = VirtualRun(plan, seed=3, environment=False)
    dice = random.Random(4)
    with contextlib.closing(run.record_in(path, "run", "1")):
        run.begin()
        for number in range(80):
            task = submit("o%d" % number, dice.choice([0, 0, 1, 5]))
            run.order(task._replace(until=dice.choice([0, 400, 600, 900])))
            one, chance = "o%d" % dice.randrange(80), dice.random()
            if chance < 0.1:
                run.order(log_entries.GiveBack(one))
            elif chance < 0.2:
                run.order(log_entries.CancelTask(one))
            elif chance < 0.5:
                run.order(log_entries.PrioritiseTask(one, dice.choice([0, 2])))
            if number % 3 == 2:
                run.step(math.inf)
    log = read_log(path)
    assert verify([log]).violation is None
    firings = [f for record in log.records for f in record.get("firings", ())]
    return tuple(move[0] for f in firings if f["transition"] == "take" for move in f["tasks"])


def test_the_verifier_knows_the_order_of_a_queue(tmp_path: Path) -> None:
    orders = ("arrival", "priority", "deadline")
    taken = {steered(order, str(tmp_path / order)) for order in orders}
    assert len(taken) == 3 and all(len(tasks) > 20 for tasks in taken)


def test_an_order_of_a_queue_has_to_be_one() -> None:
    for stated_order in ({"Orders": "size"}, {"Deliver": "arrival"}):
        tasks = Tasks(("Orders",), order=stated_order)
        with pytest.raises(PlanError, match="tasks.order"):
            replace(plan_of(net_with_way_out()), tasks=tasks).validate()


def test_a_task_in_a_robots_hands_is_given_back() -> None:
    run = shop(on_cancel={"Deliver": "give_up"}, robots=2)
    run.feed(submit("o1"), submit("o2"), submit("o3"))
    run.feed(log_entries.Pause("a"))
    assert run.feed(log_entries.GiveBack("o1")) == []  # it is paused, and asks for give_up
    assert waiting(run) == ["o1", "o3"]
    assert run.feed(log_entries.Resume("a")) == ["give_up", "take"]
    assert run.state.robots["a"].task.id == "o1" and run.state.robots["a"].task.attempts == 2
    before = len(run.commands)
    run.feed(log_entries.GiveBack("o3"))  # nobody has it
    said = [c.message for c in run.commands[before:] if isinstance(c, Fault)]
    assert said == ["task o3 was not given back: no robot has it; it is in Orders"]


def test_a_task_is_replaced() -> None:
    run = shop(on_cancel={"Deliver": "give_up"})
    run.feed(submit("o1"), submit("o2"))
    other = submit("o3")._replace(replaces="o1")
    assert run.feed(other, other) == ["give_up", "take", "order"]
    assert ended(run) == [("o1", "cancelled")]
    assert run.state.ended_tasks[0].why == "replaced by o3; with a in Deliver"
    # what it replaces has ended: it is not taken
    assert run.feed(submit("o4")._replace(replaces="o1")) == []
    assert waiting(run) == ["o3"] and ended(run)[-1] == ("o4", "cancelled")


def test_a_task_comes_in_at_its_time_and_again() -> None:
    run = shop(idle=False)
    assert run.feed(submit("once")._replace(at=100), submit("all")._replace(at=50, every=20)) == []
    where = [(t["id"], t["at"], t["every"]) for t in displayed_tasks(run.state, run.game)["tasks"]]
    assert where == [("once", 100, None), ("all", 50, 20)]
    due = log_entries.TaskDue("once", 100, 101)
    assert run.feed(due, due) == ["order"]
    due = log_entries.TaskDue("all", 50, 95)  # two were missed
    assert run.feed(due, due) == ["order"]
    assert waiting(run) == ["once", "all-1"]
    assert run.feed(log_entries.TaskDue("all", 110, 110)) == ["order"]
    assert waiting(run) == ["once", "all-1", "all-2"]
    run.feed(log_entries.CancelTask("all"), log_entries.TaskDue("all", 130, 130))
    assert waiting(run) == ["once", "all-1", "all-2"] and run.state.submitted == []
    net = run.game.net
    assert TeamState.from_json(run.state.to_json(net), net, run.game.queues) == run.state


def test_a_task_that_still_waits_when_its_time_is_over_is_late() -> None:
    run = shop(idle=False)
    run.feed(submit("o1"), submit("o2"))
    run.done("a")
    late = [log_entries.CancelTask(task, late=True) for task in ("o1", "o2")]
    run.feed(*late, *late)  # a robot has o1 in hand: it was begun in time
    assert ended(run) == [("o2", "late")] and run.state.robots["a"].task.id == "o1"


def test_a_task_may_be_for_one_robot() -> None:
    run = shop(robots=2)
    b = log_entries.Submit("order", "o1", to="b")
    assert run.feed(b) == ["order", "take"]
    assert run.state.robots["b"].task.id == "o1" and run.state.robots["a"].task is None
    run.feed(b._replace(id="o2"))
    assert run.state.robots["a"].why == "no immediate transition is enabled"  # for it
    assert run.feed(submit("o3")) == ["order", "take"]  # it passes the one that is not for it
    assert run.state.robots["a"].task.id == "o3" and waiting(run) == ["o2"]
    assert run.done("b", "delivered") == ["delivered", "take"]
    assert run.state.robots["b"].task.id == "o2"
    run.feed(b._replace(id="o4"), log_entries.Leave("b"))
    told = displayed_tasks(run.state, run.game)["tasks"]
    assert [t["trouble"] for t in told if t["id"] == "o4"] == [
        "only b may take it, which is gone: cancel it, or submit another"
    ]
    again = TeamState.from_json(run.state.to_json(run.game.net), run.game.net, run.game.queues)
    assert again == run.state


def able(plan: Plan, **capabilities: Any) -> Plan:
    """The plan, in which robots have these capabilities."""
    robots = [r._replace(capabilities=capabilities.get(r.name, ())) for r in plan.robots]
    return replace(plan, robots=tuple(robots)).validate()


def test_a_task_may_be_for_robots_that_can_something(tmp_path: Path) -> None:
    plan = able(plan_of(net_with_way_out(), robots=3), b=("fork", "arm"), c=("fork",))
    assert plan_from_json(plan_to_json(plan)).robots == plan.robots
    story = Story(plan)
    run = Run(plan, in_order=True)
    entries = [
        log_entries.Submit("order", "o1", to="arm"),
        log_entries.Submit("order", "o2", to="arm"),
        log_entries.Submit("order", "o3", to="fork"),
        log_entries.Submit("order", "o4", to="wings"),
        submit("o5"),
    ]
    run.feed(*entries)
    has = {name: robot.task and robot.task.id for name, robot in run.state.robots.items()}
    assert has == {"a": "o5", "b": "o1", "c": "o3"} and waiting(run) == ["o2", "o4"]
    troubles = {t["id"]: t["trouble"] for t in displayed_tasks(run.state, run.game)["tasks"]}
    assert [task for task, why in troubles.items() if why] == ["o4"]
    run.feed(log_entries.Leave("b"))
    said = [c.message for c in run.commands if isinstance(c, Fault)]
    assert "is gone, and task o2 waits for it in Orders" in said
    story.start().slot(1.0, *entries)
    story.slot(2.0, log_entries.Leave("b"))
    assert verify([read_log(story.save(tmp_path / "run.jsonl"))]).violation is None
    with pytest.raises(PlanError, match="is the name of a robot"):
        able(plan, b=("c",))


def test_a_row_of_the_policy_holds_a_robot_whose_tasks_are_for_others() -> None:
    plan = replace(
        plan_of(net_with_way_out(), robots=2),
        policy=Policy.from_table(["Orders"], [((1,), {"take": 1.0})]),
    ).validate()
    run = Run(plan, in_order=True)
    run.feed(log_entries.Pause("b"), log_entries.Submit("order", "o1", to="b"))
    why = run.game.why_waiting(run.state, run.state.robots["a"])
    assert why == "wants take: the tasks there are for others"
    assert run.feed(log_entries.Resume("b")) == ["take"]


def test_several_robots_cannot_take_a_task_for_one() -> None:
    net = (
        NetBuilder()
        .place("Idle")
        .place("Deliver")
        .place("Orders")
        .exponential("order", rate=1, outputs="Orders")
        .immediate("lift", inputs={"Idle": 2, "Orders": 1}, outputs={"Deliver": 2})
        .exponential("delivered", rate=1, inputs="Deliver", outputs="Idle")
        .build()
    )
    run = Run(plan_of(net, robots=2))
    assert run.game.why_not_to("order") == "'lift' takes tasks with several robots"
    run.feed(log_entries.Submit("order", "o1", to="a"))  # a plan from before: it waits
    assert run.feed(submit("o2")) == ["order", "lift"]
    assert waiting(run) == ["o1"]


def test_a_team_says_where_its_tasks_are() -> None:
    run = shop(robots=2)
    run.feed(submit("o1")._replace(since=5), submit("o2"), submit("o3"))
    run.done("a", "delivered")
    told = displayed_tasks(run.state, run.game)
    assert [(t["id"], t["where"], t["attempts"]) for t in told["tasks"]] == [
        ("o3", "with a", 1),
        ("o2", "with b", 1),
    ]
    assert told["ended"] == [{"id": "o1", "outcome": "done", "why": "delivered with a"}]
    assert lines(told)[1].split() == ["o3", "with", "a", "in", "Deliver", "0", "1"]
    assert lines(told)[-1] == "o1: done (delivered with a)"
    run.feed(log_entries.CancelTask("o2"), log_entries.CancelTask("o3"))
    assert "the team has no task" in lines(displayed_tasks(run.state, run.game))
    again = TeamState.from_json(run.state.to_json(run.game.net), run.game.net, run.game.queues)
    assert again == run.state


def test_a_plan_says_only_what_a_robot_can_do() -> None:
    for on_cancel, why in (
        ({"Orders": None}, "holds no robots"),
        ({"Deliver": "take"}, "'take' does not leave 'Deliver'"),
        ({"Deliver": "refused"}, "puts a token into the queue 'Orders'"),
        ({"Nowhere": None}, "Nowhere"),
    ):
        with pytest.raises(PlanError, match=why):
            plan_of(shop_net(), on_cancel=on_cancel)


def test_the_hash_of_a_plan_has_what_it_says() -> None:
    one, other = (plan_of(net_with_way_out(), on_cancel=c) for c in ({}, {"Deliver": None}))
    assert one.hash() != other.hash()


@pytest.mark.parametrize("priority", [10**7, -(10**7)])
def test_a_priority_has_bounds(priority: int) -> None:
    with pytest.raises(DataError, match="between"):
        log_entries.make_submit("order", "o1", {}, priority)
    with pytest.raises(DataError, match="between"):
        log_entries.make_prioritise("o1", priority)


def test_who_listens_hears_once_how_each_task_ended() -> None:
    run = shop(on_cancel={"Deliver": "give_up"}, idle=False)
    run.feed(log_entries.Submit("order", "o1", {"pose": 1}, since=100), submit("o2"), submit("o3"))
    run.done("a")
    run.done("a", "delivered", {"task.weight": 7})
    run.feed(log_entries.CancelTask("o2"), log_entries.CancelTask("o3", late=True))
    told = [c for c in run.commands if isinstance(c, TaskEnded)]
    assert [(t.id, t.outcome, t.robot) for t in told] == [
        ("o1", "done", "a"),
        ("o2", "cancelled", ""),
        ("o3", "late", ""),
    ]
    assert told[0].data == {"pose": 1, "weight": 7} and told[0].seconds(130.5) == 30.5
    assert told[1].seconds(130.5) is None  # nobody knows since when


# -- in a team -------------------------------------------------------------------------------------


def errands(partial: bool = False) -> Team:
    return Team(agreement_plan(ERRANDS, 2, partial, 0.0, 0.0, False))


def result(world: Team, robot: str, entry: log_entries.Entry) -> interface.OrderResult:
    world.give(robot, interface.Order("asked", entry))
    return world.nodes[robot].results.pop("asked")


@pytest.mark.parametrize("partial", [False, True])
def test_an_operator_hears_what_became_of_a_task(partial: bool) -> None:
    world = errands(partial)
    for number in (1, 2):
        world.submit("r1", number)
    assert (
        result(world, "r2", log_entries.PrioritiseTask("t2", 4)).text
        == "priority 4: it is in orders"
    )
    world.done("r1", "look")
    world.done("r1", "home")
    given = result(world, "r2", log_entries.CancelTask("t2"))
    assert given.ok and given.text == "it was cancelled (with r1 in Deliver)"
    given = result(world, "r1", log_entries.CancelTask("t2"))
    assert not given.ok
    assert given.text == "the team no longer has task 't2': it was cancelled (with r1 in Deliver)"
    assert result(world, "r1", log_entries.CancelTask("t9")).text == "the team has no task 't9'"
    given = result(world, "r1", log_entries.Submit("order", "t2"))
    assert not given.ok
    assert given.text.endswith("is not taken again: it was cancelled (with r1 in Deliver)")
    restart(world.nodes["r1"])
    assert len(world.entries("cancel")) == 1
    world.check()


def test_an_order_that_parts_a_robot_from_its_task_says_what_becomes_of_it() -> None:
    world = errands()
    world.submit("r1", 1)
    world.done("r1", "look")
    world.done("r1", "home")
    given = result(world, "r2", log_entries.SetPlace("r1", "Charge"))
    assert given.ok and "task" not in given.text  # it still has it there
    given = result(world, "r2", log_entries.SetPlace("r1", "Roam"))
    assert given.ok and given.text.endswith("; returns task t1 to orders")
    given = result(world, "r2", log_entries.GiveBack("t1"))
    assert not given.ok and given.text == "no robot has it; it is in orders"
    given = result(world, "r2", log_entries.Stop("enough"))
    assert given.ok and given.text.endswith("the run ends with 1 unfinished tasks: t1 in orders")


def test_the_first_running_robot_cancels_what_waits_too_long() -> None:
    world = errands()
    world.give("r2", interface.TaskCame(submit("t1")._replace(until=100)))
    for name in ("r2", "r1"):
        world.nodes[name].give(interface.TimeOfDay(99))
    world.run(world.now + 1.0)
    assert world.entries("cancel") == []
    for name in ("r2", "r1", "r1"):
        world.nodes[name].give(interface.TimeOfDay(100))
    world.run(world.now + 1.0)
    assert [e["late"] for e in world.entries("cancel")] == [True]
    given = result(world, "r1", log_entries.Submit("order", "t1"))
    assert given.text.endswith("it was late (it waited too long; in orders)")
    world.check()


def test_the_team_fires_the_clock_of_a_plan_by_the_hours_of_the_day() -> None:
    periods = (Period(8, 4, {}), Period(12, 8, {}), Period(20, 12, {}))
    plan = with_day(
        agreement_plan(ERRANDS, 2, False, 0.0, 0.0, False), ArrivalsFit({}, periods), []
    )
    assert plan_from_json(plan_to_json(plan)).events == plan.events
    assert "after_hours_8_12" not in plan.submissions
    world = Team(plan)

    def fired_at(hour: float, times: int = 1) -> Any:
        before = len(world.entries("fire"))
        for _ in range(times):
            for name in ("r2", "r1", "r1"):
                world.nodes[name].give(interface.TimeOfDay(86_400 + int(3_600 * hour)))
            world.run(world.now + 0.5)
        return [e["transition"] for e in world.entries("fire")[before:]]

    assert fired_at(11.99, 2) == []
    assert fired_at(12, 2) == ["after_hours_8_12"]
    assert result(world, "r1", log_entries.Pause()).ok
    assert fired_at(21) == []
    restart(world.nodes["r1"])
    assert result(world, "r2", log_entries.Resume()).ok
    assert fired_at(21, 2) == ["after_hours_12_20"]  # it is late, since the team was paused
    restart(world.nodes["r2"])
    assert fired_at(26) == []
    # a team that was off goes through the day until the clock is right
    assert fired_at(24 + 13, 4) == ["after_hours_20_8", "after_hours_8_12"]
    world.check()


def test_the_first_running_robot_says_that_it_is_time() -> None:
    world = errands()
    given = result(world, "r2", log_entries.Submit("order", "t1", at=100, every=50))
    assert given.text == "the team has the task; it waits until its time comes"
    for seconds in (99, 100, 100, 120, 151, 152):
        for name in ("r2", "r1"):
            world.nodes[name].give(interface.TimeOfDay(seconds))
        world.run(world.now + 0.5)
    assert [e["at"] for e in world.entries("task_due")] == [100, 150]
    team = world.nodes["r1"].replica.ledger.state
    assert [found.task.id for found in team.tasks() if found.place] == ["t1-1", "t1-2"]
    assert result(world, "r1", log_entries.Submit("order", "t1-1")).text.endswith("in orders")
    world.check()


@pytest.mark.parametrize("partial", [False, True])
def test_one_robot_tells_how_a_task_ended(partial: bool) -> None:
    world = errands(partial)
    for number in (1, 2):
        world.submit("r1", number)
    world.done("r1", "look")
    world.done("r1", "home")
    world.done("r1", "delivered", {"task.weight": 7})
    result(world, "r2", log_entries.CancelTask("t2"))
    told = sorted(t for node in world.nodes.values() for t in node.told)
    assert [(t.id, t.outcome, t.robot) for t in told] == [
        ("t1", "done", "r1"),
        ("t2", "cancelled", "r1"),
    ]
    assert told[0].data == {"weight": 7}
    restart(world.nodes["r1"])
    restart(world.nodes["r2"])
    assert sum(len(node.told) for node in world.nodes.values()) == 2
    world.check()


def test_a_plan_without_queues_is_not_adopted_while_a_robot_has_a_task() -> None:
    run = shop()
    run.feed(submit("o1"))
    plan = run.game.plan
    new = replace(plan, tasks=Tasks(), on_evict={}).validate()
    (why,) = plan_change.tasks_in_hand(run.state, new)
    assert why.startswith("a has task o1, but the new plan has no queue")
    assert plan_change.tasks_in_hand(run.state, plan) == []


def test_a_task_for_a_robot_that_is_not_there_is_refused() -> None:
    world = errands()
    task = log_entries.Submit("order", "t1", to="r9")
    assert result(world, "r1", task).text == "there is no robot 'r9' in the team"
    plan = able(agreement_plan(ERRANDS, 2, False, 0.0, 0.0, False), r2=("lift",))
    other = Team(plan)
    assert result(other, "r1", task._replace(to="lift")).ok
    assert result(other, "r1", log_entries.Leave("r2")).ok
    given = result(other, "r1", task._replace(id="t2", to="lift"))
    assert not given.ok and given.text == "there is no robot that can 'lift' in the team"
    other.check()
    assert result(world, "r1", task._replace(to="r2")).ok
    world.done("r1", "look")
    world.done("r1", "home")
    assert world.started[-1].robot == "r1" and world.started[-1].place == "Roam"
    given = result(world, "r1", log_entries.Evict("r2", -1))
    assert given.text.endswith("is gone, and task t1 waits for it in orders")
    world.check()


def test_an_operator_replaces_a_task_once() -> None:
    world = errands()
    world.submit("r1", 1)
    other = log_entries.Submit("order", "t2", replaces="t1")
    assert result(world, "r1", other).text == "the team has the task; it is in orders"
    assert result(world, "r2", other).ok  # asked again
    given = result(world, "r2", other._replace(id="t3"))
    assert not given.ok and "t1" in given.text
    world.check()


# -- what an operator writes -----------------------------------------------------------------------


def test_times_are_read() -> None:
    now = time.mktime((2026, 11, 27, 12, 0, 0, 0, 0, -1))
    assert seconds_of("+90s", now) - now == 90 and seconds_of("+2h", now) - now == 7200
    assert seconds_of("12:30", now) - now == 1800
    assert seconds_of("11:30", now) - now == 23.5 * 3600  # tomorrow
    assert seconds_of("2026-11-27T12:01", now) - now == 60
    for text in ("", "soon", "+5", "+5y", "+xm", "25:00", "2026-13-01T00:00", "+" + "9" * 40 + "d"):
        with pytest.raises(DataError, match="is not a time"):
            seconds_of(text, now)


def test_what_is_not_given_does_not_travel() -> None:
    kind = ORDERS["submit"]
    values = kind.values({"transition": "order", "id": "o1", "priority": 2}, SUBMITTED)
    argument = kind.argument(values)
    assert json.loads(argument) == {"transition": "order", "id": "o1", "data": {}, "priority": 2}
    assert kind.read("", argument, "r1") == values
    assert [ORDERS["pause"].argument({"robot": "", "stop": stop}) for stop in (False, True)] == [
        "",
        "stop",
    ]
    assert ORDERS["pause"].read("", "stop", "r1") == {"robot": "", "stop": True}
    with pytest.raises(DataError, match="'stop' is not true or false"):
        ORDERS["pause"].read("", "slowly", "r1")


def test_the_command_of_a_task_has_all_fields() -> None:
    kind = ORDERS["submit"]
    order = {"transition": "order", "id": 7, "until": 1000, "replace": "6", "at": 5, "every": "2m"}
    argument = json.dumps(order)
    given = kind.entry(**kind.read("", argument, "r1"))
    assert given == log_entries.Submit("order", "7", {}, until=1000, replaces="6", at=5, every=120)
    assert log_entries.checked(given) == given
    with pytest.raises(DataError, match="needs the time of its first one"):
        kind.entry(**kind.read("", argument.replace('"at": 5', '"at": 0'), "r1"))
    with pytest.raises(DataError, match="cannot replace itself"):
        kind.entry(**kind.read("", argument.replace('"replace": "6"', '"replace": "7"'), "r1"))
