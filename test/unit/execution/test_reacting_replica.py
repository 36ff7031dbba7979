"""Events, tasks and data at the replicas of a team, case by case."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, List

import pytest

from agreement.plans import make_plan
from agreement.world import SimulatedNode, World
from gspn_framework_package.execution import log_entries, plan_change, task_turn, team_state
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.net import Net, Place
from gspn_framework_package.model.plan import Plan, RobotSpec, Synchronisation

ERRANDS, ROUNDS = 4, 5


class Team(World):
    """A team in which only what the test does happens; it notes the actions that start."""

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan, 1)
        self.started: List[StartAction] = []
        self.robot_events = []  # no sources of its own
        for node in self.nodes.values():
            node.start()
        self.run(1.0)

    def start_action(self, node: SimulatedNode, goal: StartAction) -> None:
        self.started.append(goal)

    def give(self, name: str, given: interface.Input) -> None:
        self.nodes[name].give(given)
        self.run(self.now + 1.0)

    def done(self, name: str, result: str, data: Any = log_entries.NOTHING) -> None:
        last = [goal for goal in self.started if goal.robot == name][-1]
        key = (last.incarnation, last.visit, last.attempt)
        self.give(name, interface.ActionDone(*key, result, data))

    def submit(self, name: str, number: int, transition: str = "order") -> None:
        self.give(name, interface.TaskCame(log_entries.Submit(transition, "t%d" % number)))

    def entries(self, kind: str) -> List[Any]:
        disk = next(iter(self.nodes.values())).disk
        assert disk is not None
        slots = [r for r in disk.records() if r["kind"] == "slot"]
        return [e for r in slots for e in r["entries"] if e["entry"] == kind]

    def check(self) -> None:
        logs = [EventLog(d.header["log"], d.header, d.records(), self.plan) for d in self.logs()]
        verdict = verify(logs)
        assert verdict.violation is None, verdict.violation


def team(kind: int = ERRANDS, robots: int = 2, partial: bool = False) -> Team:
    return Team(make_plan(kind, robots, partial, 0.0, 0.0, False))


def deliver(world: Team) -> None:
    """Let r1 take a task."""
    world.submit("r1", 1)
    world.done("r1", "look")
    world.done("r1", "home")
    assert world.started[-1].place == "Deliver"


def delivering() -> Team:
    world = team(robots=1)
    deliver(world)
    return world


def restart(node: SimulatedNode) -> None:
    node.crash()
    node.start()
    node.world.run(node.world.now + 1.0)


def test_tasks_that_the_team_forgot_it_had_are_not_offered_again(monkeypatch: Any) -> None:
    monkeypatch.setattr(task_turn, "KNOWN_TASKS", 2)
    world = team()
    for number in range(6):
        world.submit("r1", number)
    restart(world.nodes["r1"])
    assert len(world.entries("submit")) == 6
    world.submit("r1", 6)
    assert len(world.entries("submit")) == 7


def test_a_robot_keeps_a_task_until_another_can_wait(monkeypatch: Any) -> None:
    monkeypatch.setattr(team_state, "OUTSIDE_LIMIT", 2)
    world = team()
    world.give("r1", interface.Order("pause", log_entries.Pause()))
    for number in range(1, 5):
        world.submit("r1", number)
    assert len(world.entries("submit")) == 2
    world.give("r1", interface.Order("full", log_entries.Submit("order", "one more")))
    result = world.nodes["r1"].results["full"]
    assert not result.ok
    assert result.text.endswith("tasks are already waiting for 'order'")
    world.give("r1", interface.Order("resume", log_entries.Resume()))
    assert [e["id"] for e in world.entries("submit")] == ["t1", "t2", "t3", "t4"]
    world.check()


def test_a_task_that_only_a_dead_robot_has_comes_in_when_it_is_back() -> None:
    world = team(robots=3)
    node = world.nodes["r3"]
    world.blocked = {("r3", "r1"), ("r3", "r2"), ("r1", "r3"), ("r2", "r3")}
    world.submit("r3", 1)
    node.crash()
    world.blocked = set()
    world.run(world.now + 1.0)
    assert world.entries("submit") == []
    node.start()
    world.run(world.now + 3.0)
    assert [e["id"] for e in world.entries("submit")] == ["t1"]
    world.check()


@pytest.mark.parametrize("ends", ["leave", "stop"])
def test_what_a_task_waits_for_does_not_wake_a_robot_all_the_time(ends: str) -> None:
    world = team(robots=3)
    entry = log_entries.Leave("r3") if ends == "leave" else log_entries.Stop()
    world.blocked = {("r3", "r1"), ("r3", "r2")}  # it hears the others, they do not hear it
    world.nodes["r3"].give(interface.TaskCame(log_entries.Submit("order", "t1")))
    world.operator(entry, world.nodes["r1"])
    world.run(world.now + 2.0)
    before = world.steps
    world.run(world.now + 1.0)
    assert world.steps - before < 300


def test_a_robot_that_leaves_hands_its_tasks_over_first() -> None:
    world = team(robots=3)
    world.operator(log_entries.Leave("r3"), world.nodes["r3"])
    world.nodes["r3"].give(interface.TaskCame(log_entries.Submit("order", "t1")))
    world.run(world.now + 3.0)
    assert [e["id"] for e in world.entries("submit")] == ["t1"]
    assert world.nodes["r3"].ended


def test_an_operator_hears_when_the_team_has_the_task() -> None:
    world = team()
    for number in range(1, 7):
        task = log_entries.Submit("order", "t%d" % number)
        world.give("r2", interface.Order("o%d" % number, task))
    results = world.nodes["r2"].results
    assert results["o1"].ok and results["o1"].text == "the team has the task; it is in orders"
    assert results["o6"].ok and "waits until 'order' is enabled" in results["o6"].text
    world.give("r2", interface.Order("again", log_entries.Submit("order", "t1")))
    assert results["again"].ok
    assert len(world.entries("submit")) == 6
    world.give("r2", interface.Order("bad", log_entries.Submit("full", "t1")))
    assert results["bad"].text == "'full' does not take tasks"


def test_an_event_that_comes_all_the_time_is_proposed_once() -> None:
    world = delivering()
    node = world.nodes["r1"]
    world.operator(log_entries.Pause("r1"), node)
    for number in range(50):
        node.give(interface.EventObserved("alarm", None, {"number": number}))
    assert [e["cause"]["number"] for e in world.entries("interrupt")] == [0]
    world.operator(log_entries.Resume("r1"), node)
    assert world.started[-1].place == "Shelter"
    world.check()


def test_an_event_that_cannot_fire_is_not_proposed() -> None:
    plan = make_plan(ERRANDS, 1, False, 0.0, 0.0, False)
    events = {**plan.events, "low": plan.events["low"]._replace(hold=False, when="")}
    world = Team(replace(plan, events=events, net=plan.net.with_marking({"Idle": 1})).validate())
    deliver(world)
    for _ in range(50):
        world.nodes["r1"].give(interface.EventObserved("low", None))
    assert world.entries("interrupt") == []


def test_data_that_nobody_could_read_is_a_failure_and_stops_nobody() -> None:
    world = team()
    goal = world.started[0]
    world.done(goal.robot, "", {"x": float("nan")})
    robot = world.nodes["r1"].replica.ledger.state.robots[goal.robot]
    assert robot.phase is Phase.FAILED and "bad result" in robot.why
    task = log_entries.Submit("order", "t1", {"x": object()})
    world.give("r2", interface.TaskCame(task))
    assert "not JSON" in world.nodes["r2"].faults[-1]
    world.submit("r1", 2)
    assert [e["id"] for e in world.entries("submit")] == ["t2"]


def test_a_cause_that_nobody_could_read_is_left_out() -> None:
    world = delivering()
    world.give("r1", interface.EventObserved("alarm", None, {"x": float("inf")}))
    assert "Shelter" in [goal.place for goal in world.started]
    assert "cause" not in world.entries("interrupt")[0]
    assert any("the cause of 'alarm'" in fault for fault in world.nodes["r1"].faults)


def test_a_visit_is_continued_once_also_ahead_of_the_log() -> None:
    world = team(ROUNDS, robots=2, partial=True)
    at_a = world.started[0].robot
    world.give(at_a, interface.EventObserved("jump", True))
    world.give(at_a, interface.EventObserved("jump", False))
    slots = world.length()
    for result in ("ca", "ab", "ba"):  # local transitions, which are not in the log yet
        last = [goal for goal in world.started if goal.robot == at_a][-1]
        key = (last.incarnation, last.visit, last.attempt)
        world.nodes[at_a].give(interface.ActionDone(*key, result))
    assert world.length() == slots
    mine = [(g.place, g.resumed_from) for g in world.started if g.robot == at_a]
    assert mine == [("A", 0), ("C", 0), ("A", 1), ("B", 0), ("A", 0)]


def test_a_robot_that_waits_for_an_event_costs_the_others_no_slots() -> None:
    builder = (
        NetBuilder()
        .place("A")
        .place("B")
        .place("Wait")
        .place("bell")
        .exponential("ab", inputs="A", outputs="B")
        .exponential("ba", inputs="B", outputs="A")
        .exponential("go", inputs=["Wait", "bell"], outputs="A")
    )
    plan = Plan(
        net=builder.build(),
        actions={p: FunctionAction("actions.f", "f") for p in ("A", "B", "Wait")},
        resource_places=frozenset(["bell"]),
        events={"go": EventSource("bell", "std_msgs/Empty")},
        synchronisation=Synchronisation.PARTIAL,
    )
    world = Team(plan.with_robots([RobotSpec("r1", "A"), RobotSpec("r2", "Wait")]).validate())
    world.done("r2", "")
    slots = world.length()
    for result in ("ab", "ba", "ab"):
        world.done("r1", result)
    assert world.length() == slots


def test_a_task_that_was_given_up_with_its_slot_is_not_missed() -> None:
    """r1 alone is a quorum and takes a task in. Then it stops, and the operator continues without
    what it knew."""
    world = team()
    world.given_up = True
    world.blocked |= {("r1", "r2"), ("r2", "r1")}
    world.submit("r1", 1)
    assert len(world.entries("submit")) == 1
    world.nodes["r1"].crash()
    world.nodes["r2"].give(interface.ForceEvict("off", "r1"))
    world.run(world.now + 1)
    world.blocked.clear()
    world.nodes["r1"].start()
    world.acting = False
    assert world.run(world.now + 6, world.has_settled)
    logs = [EventLog(d.header["log"], d.header, d.records(), world.plan) for d in world.logs()]
    assert verify(logs, settled=True).violation is None


def test_a_robot_that_adopts_another_plan_by_itself_looks_at_the_places_of_that_plan() -> None:
    world = delivering()
    old = world.plan
    spare = [Place("Spare_%d" % number) for number in range(len(old.net.places))]
    net = Net([*spare, *old.net.places], old.net.transitions, old.net.arcs)
    names = {place.name for place in spare}
    new = replace(old, net=net, resource_places=old.resource_places | names).validate()
    node = world.nodes["r1"]
    for order in (plan_change.stage_of(new, {}), log_entries.Adopt(-1)):
        world.operator(order, node)
        world.run(world.now + 1.0)
    assert node.replica is not None and node.replica.ledger.game.plan.net == net
    world.done("r1", "delivered")
    assert not world.entries("failed")


@pytest.mark.parametrize(
    "order",
    [
        log_entries.CancelTask("t1"),
        log_entries.GiveBack("t1"),
        log_entries.PrioritiseTask("t1", 7),
        log_entries.Pause(""),
        log_entries.SetPlace("r1", "Deliver"),
    ],
)
def test_an_order_after_the_end_in_the_same_slot_is_not_done(order: Any) -> None:
    world = delivering()
    node = world.nodes["r1"]
    assert node.replica is not None
    both = interface.Order("first", log_entries.Stop("enough")), interface.Order("second", order)
    node.carry_out(node.replica.step_all(both, world.now))
    world.run(world.now + 1.0)
    assert node.results["first"].ok
    assert node.results["second"][1:] == (False, "the run is over: enough")
