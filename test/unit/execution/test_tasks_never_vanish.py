"""A task never goes away without a word: it waits, a robot has it, or the team says how it ended."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any, Dict, Optional, Set

import pytest
from game_driver import make_plan
from test_reacting_replica import Team, restart

from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.firing import Fault
from gspn_framework_package.execution.log_entries import Entry, Submit
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan, RobotSpec


def shop(robots: int = 2) -> Plan:
    """Orders come in, three at most; robots fetch and carry them. From *Carry* nothing returns."""
    net = (
        NetBuilder("shop")
        .place("Idle")
        .place("Fetch")
        .place("Carry")
        .place("Repair")
        .place("orders")
        .exponential("order", rate=5.0, inputs={}, outputs="orders", inhibitors={"orders": 3})
        .immediate("take", inputs=["Idle", "orders"], outputs="Fetch")
        .exponential("fetched", inputs="Fetch", outputs="Carry")
        .exponential("broke", inputs="Carry", outputs="Repair")
        .exponential("repaired", inputs="Repair", outputs="Idle")
        .exponential("delivered", inputs="Carry", outputs="Idle")
        .build()
    )
    plan = make_plan(
        net,
        ["Idle"] * robots,
        ["orders"],
        idle=["Idle"],
        events={"order": EventSource("/orders", "std_msgs/String")},
        tasks=Tasks(("orders",), ("delivered",)),
        on_evict={"Fetch": {"orders": 1}},
    )
    return plan.with_robots([RobotSpec("r%d" % (n + 1), "Idle") for n in range(robots)]).validate()


class Shop(Team):
    """A team of which two robots fetch t1 (``one`` does) and t2; t3 to t5 are in the queue, and t6
    is outside."""

    def __init__(self, plan: Optional[Plan] = None) -> None:
        super().__init__(plan or shop())
        self.given: Set[str] = set()
        for number in range(1, 7):
            self.submit("r1", number)
        self.one = self.started[0].robot
        self.other = self.started[1].robot

    def submit(self, name: str, number: int, transition: str = "order") -> None:
        self.given.add("t%d" % number)
        super().submit(name, number, transition)

    def order(self, entry: Entry) -> interface.OrderResult:
        """Give an order to the other robot."""
        self.give(self.other, interface.Order("asked", entry))
        return self.nodes[self.other].results.pop("asked")

    def fail(self, times: int = 1) -> None:
        """Let the action of the robot that has t1 fail so often."""
        for _ in range(times):
            last = [goal for goal in self.started if goal.robot == self.one][-1]
            key = (last.incarnation, last.visit, last.attempt)
            self.give(self.one, interface.AttemptFailed(*key, Outcome.ABORTED))

    def where(self) -> Dict[str, str]:
        """Every task that was given, and where it is or how it ended."""
        replica = self.nodes[self.other].replica
        assert replica is not None
        team, net = replica.ledger.state, replica.ledger.game.net
        found = {task: team.whereabouts(task, net) for task in sorted(self.given)}
        missing = [task for task, where in found.items() if "no longer has it" in where]
        assert not missing, missing
        return found

    def said(self, text: str) -> bool:
        """Whether a robot has said this."""
        return any(text in fault for node in self.nodes.values() for fault in node.faults)


def test_so_a_shop_begins() -> None:
    world = Shop()
    assert world.where() == {
        "t1": "it is with " + world.one,
        "t2": "it is with " + world.other,
        "t3": "it is in orders",
        "t4": "it is in orders",
        "t5": "it is in orders",
        "t6": "it is before order",
    }


@pytest.mark.parametrize("how", ["leave", "set_place"])
@pytest.mark.parametrize("carries", [False, True])
def test_a_robot_that_is_taken_from_its_task(how: str, carries: bool) -> None:
    world = Shop()
    if carries:
        world.done(world.one, "fetched")
    leaves = how == "leave"
    entry = log_entries.Leave(world.one) if leaves else log_entries.SetPlace(world.one, "Repair")
    result = world.order(entry)
    where = world.where()["t1"]
    if not carries:
        assert where == "it is in orders" and "returns task t1 to orders" in result.text
    else:
        assert where == "it is with " + world.one and "to no queue (on_evict)" in result.text
        assert world.said("task t1")
        if leaves:
            assert world.order(Submit("order", "t1")).ok  # it comes in again
            assert world.where()["t1"] == "it is before order"
    world.check()


@pytest.mark.parametrize("carries", [False, True])
def test_a_robot_that_dies_with_its_task(carries: bool) -> None:
    world = Shop()
    if carries:
        world.done(world.one, "fetched")
    world.nodes[world.one].crash()
    world.run(world.now + 2.0)
    world.give(world.other, interface.ForceEvict("off", world.one))
    where = world.where()["t1"]
    if not carries:
        assert where == "it is in orders" and world.said("returns task t1 to orders")
    else:
        assert where == "it is with " + world.one
        assert world.said("is gone with task t1, which Carry returns to no queue (on_evict)")
    world.check()


def failing(rule: FailureRule) -> Plan:
    return replace(shop(), on_failure={"*": rule}).validate()


def test_a_robot_whose_action_has_failed_for_good_keeps_its_task_and_says_so() -> None:
    world = Shop(failing(FailureRule.retry(1)))
    world.fail(2)
    assert world.where()["t1"] == "it is with " + world.one
    assert world.said("with task t1")
    result = world.order(log_entries.GiveBack("t1"))
    assert result.ok and world.where()["t1"] == "it is in orders"
    world.check()


def test_a_failure_that_leads_away_takes_the_task_along_until_another_pushes_it_out() -> None:
    world = Shop(failing(FailureRule.fire("broke")))
    world.done(world.one, "fetched")
    world.fail()
    assert world.where()["t1"] == "it is with " + world.one
    world.done(world.one, "repaired")
    assert world.where()["t1"] == "it was lost (dropped by %s)" % world.one
    assert world.said("drops task t1, which was not done")
    result = world.order(Submit("order", "t1"))
    assert not result.ok and "is not taken again: it was lost" in result.text
    world.check()


def test_a_failure_that_ends_the_run_names_all_tasks() -> None:
    world = Shop(failing(FailureRule.stop()))
    world.fail()
    world.where()
    assert world.said("the run ends with 6 unfinished tasks: ")
    assert not world.order(Submit("order", "t9")).ok
    world.check()


def test_the_end_of_the_run_names_all_tasks_also_those_that_the_team_does_not_have() -> None:
    world = Shop()
    world.blocked = {(world.one, world.other), (world.other, world.one)}
    world.submit(world.one, 7)
    world.blocked = set()
    world.given.remove("t7")
    result = world.order(log_entries.Stop("enough"))
    assert "the run ends with 6 unfinished tasks: " in result.text
    world.where()
    late = "the run ends before the team has 1 tasks: t7"
    assert world.nodes[world.one].faults.count(late) == 1
    restart(world.nodes[world.one])
    assert world.nodes[world.one].faults.count(late) == 2  # another process says so, too
    world.submit(world.one, 8)
    assert world.said("task t8 is refused: the run is over")
    world.check()


def test_a_robot_that_has_halted_refuses_tasks() -> None:
    world = Shop()
    node = world.nodes[world.one]
    assert node.replica is not None
    node.replica.state.halted = "its log is not its own"
    effects = node.replica.step(interface.TaskCame(Submit("order", "t7")), world.now)
    assert [e.message for e in effects if isinstance(e, Fault)] == [
        "task t7 is refused: its log is not its own"
    ]


# -- another plan ----------------------------------------------------------------------------------


def renamed() -> Plan:
    """The shop with other names."""
    return plan_from_json(
        json.loads(re.sub(r"\border\b", "sale", json.dumps(plan_to_json(shop()))))
    )


def without_tasks() -> Plan:
    """The shop, whose orders are tokens, and come in by another transition."""
    data = plan_to_json(replace(shop(), tasks=Tasks(), events={}, on_evict={}))
    return plan_from_json(json.loads(re.sub(r"\border\b", "sale", json.dumps(data))))


def adopt(world: Shop, plan: Plan, mapping: Any = log_entries.NOTHING) -> interface.OrderResult:
    """The answer to an order to continue under a plan."""
    assert world.order(plan_change.stage_of(plan, mapping)).ok
    return world.order(log_entries.Adopt(1))


def test_tasks_stay_where_they_are_under_another_plan() -> None:
    world = Shop()
    before = world.where()
    assert adopt(world, renamed(), {"order": "sale"}).ok
    assert world.where() == {**before, "t6": "it is before sale"}
    world.submit(world.one, 7)  # whoever sends it knows the old name
    assert world.where()["t7"] == "it is before sale"
    world.check()


def test_a_plan_is_refused_that_has_no_room_for_tasks_and_the_answer_names_them() -> None:
    world = Shop()
    before = world.where()
    result = adopt(world, without_tasks())
    assert not result.ok
    assert "3 tasks wait in 'orders'" in result.text and "t3, t4, t5" in result.text
    assert "1 tasks wait for 'order'" in result.text and "t6" in result.text
    assert world.where() == before
    for task in ("t3", "t4", "t5", "t6"):
        assert world.order(log_entries.CancelTask(task)).ok
    result = world.order(log_entries.Adopt(1))
    assert not result.ok and "has task t1" in result.text and "has task t2" in result.text
    world.check()


def test_a_task_that_comes_while_its_entrance_goes_is_refused_by_its_name() -> None:
    world = Shop(shop(robots=3))
    for number in range(1, 7):
        assert world.order(log_entries.CancelTask("t%d" % number)).ok
    assert world.order(plan_change.stage_of(without_tasks(), {})).ok
    others = set(world.nodes) - {world.one}
    world.blocked = {pair for name in others for pair in ((world.one, name), (name, world.one))}
    world.nodes[world.one].give(interface.TaskCame(Submit("order", "t7")))
    assert world.order(log_entries.Adopt(1)).ok
    world.blocked = set()
    world.run(world.now + 2.0)
    assert world.said("task t7 is refused: 'order' does not take tasks any more")
    world.check()
