"""Another plan for a running team: what the token game and the second implementation make of it."""

from __future__ import annotations

import json
import random
from dataclasses import replace

import pytest

from agreement.plans import another_plan
from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.event_log import EventLog, header
from gspn_framework_package.execution.firing import Fault, StartAction
from gspn_framework_package.execution.ledger import Item, Ledger, Origin
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.event import Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import (
    Plan,
    RobotSpec,
    Synchronisation,
)
from gspn_framework_package.model.policy import Policy


def _plan(builder, resources=(), robots=("r1", "r2"), start="A", **fields):
    net = builder.build()
    plan = Plan(
        net=net,
        actions={
            p.name: FunctionAction("actions.act", p.name)
            for p in net.places
            if p.name not in resources
        },
        resource_places=frozenset(resources),
        **fields,
    )
    return plan.with_robots([RobotSpec(name, start) for name in robots]).validate()


def _round(*names):
    """Places in a ring, each left by one exponential transition "from_to"."""
    builder = NetBuilder("round")
    for name in names:
        builder = builder.place(name)
    for a, b in zip(names, names[1:] + names[:1]):
        builder = builder.exponential("%s_%s" % (a, b), inputs=a, outputs=b)
    return builder


def _choice():
    return (
        NetBuilder("choice")
        .place("A")
        .place("B")
        .place("C")
        .immediate("ab", inputs="A", outputs="B")
        .immediate("ac", inputs="A", outputs="C")
        .exponential("ba", inputs="B", outputs="A")
        .exponential("ca", inputs="C", outputs="A")
    )


class Run:
    """A ledger, as every robot keeps one; each call is a slot."""

    def __init__(self, plan, agents=False, draws_ties=True):
        self.plan, self.agents = plan, agents
        self.ledger = Ledger(TokenGame(plan, agents=agents))
        self.records, self.numbers = [], {}
        self.slot(self.ledger.game.start_entry()._replace(draws_ties=draws_ties))

    def slot(self, *entries):
        items = []
        for entry in entries:
            who = getattr(entry, "robot", "") or "operator"
            self.numbers[who] = self.numbers.get(who, 0) + 1
            items.append(Item(entry, Origin(who, 0, self.numbers[who], "log")))
        record, step = self.ledger.append(items)
        self.records.append(json.loads(json.dumps(record)))
        return step

    def done(self, robot, result=""):
        state = self.ledger.state.robots[robot]
        return self.slot(log_entries.Done(robot, state.incarnation, state.visit, result))

    def stage(self, plan, mapping=None, votes=None):
        self.slot(plan_change.stage_of(plan, mapping or {}))
        self.vote(votes or self.ledger.state.members())

    def vote(self, names, why=""):
        team = self.ledger.state
        for name in names:
            incarnation = team.robots[name].incarnation if name in team.robots else 0
            self.slot(log_entries.Staged(name, incarnation, team.stages, why))

    def adopt(self):
        return self.slot(log_entries.Adopt(self.ledger.state.stages))

    def faults(self, step):
        return "; ".join(c.message for c in step.commands if isinstance(c, Fault))

    @property
    def marking(self):
        return self.ledger.game.net.named(self.ledger.state.marking, zeros=False)

    def places(self):
        net = self.ledger.game.net
        return {r.name: net.places[r.place].name for r in self.ledger.state.robots.values()}

    def logs(self):
        first = json.loads(json.dumps(header(self.plan, "run", "", "log", agents=self.agents)))
        return EventLog("log.jsonl", first, self.records)

    def check(self):
        """The log can be replayed, verified and read back from a snapshot."""
        assert list(replay(self.logs()))[-1].state == self.ledger.state
        verdict = verify([self.logs()])
        assert verdict.violation is None, verdict.violation
        again = Ledger(TokenGame(self.plan, agents=self.agents))
        again.restore(json.loads(json.dumps(self.ledger.snapshot())))
        assert again.state == self.ledger.state
        assert again.game.plan.hash() == self.ledger.game.plan.hash()


def test_a_policy_changes_while_a_robot_waits_for_it() -> None:
    waits = Policy.from_table(["A"], [((2,), {}), ((1,), {"ab": 1.0})])
    run = Run(_plan(_choice(), policy=waits))
    run.done("r1")
    assert run.ledger.state.robots["r1"].phase is Phase.DONE
    run.stage(_plan(_choice(), policy=Policy.from_table(["A"], [(("-",), {"ac": 1.0})])))
    step = run.adopt()
    assert [f.transition for f in step.firings] == ["ac"]
    assert run.places() == {"r1": "C", "r2": "A"}
    run.done("r2")
    assert run.places() == {"r1": "C", "r2": "C"}
    run.check()


def test_a_fifth_location_comes_and_a_robot_goes_there() -> None:
    run = Run(_plan(_round("A", "B", "C", "D")))
    run.done("r1")
    run.stage(_plan(_round("A", "B", "C", "D", "E")))
    step = run.adopt()
    assert not run.faults(step) and not step.firings
    assert not any(isinstance(c, StartAction) for c in step.commands)  # what runs goes on
    for result in ("B_C", "C_D", "D_E", ""):
        run.done("r1", result)
    assert run.places() == {"r1": "A", "r2": "A"} and run.marking == {"A": 2}
    run.check()


def test_names_that_change_are_mapped_even_in_results_of_running_actions() -> None:
    run = Run(_plan(_round("A", "B")))
    run.stage(_plan(_round("X", "B"), start="X"), {"A": "X", "A_B": "X_B", "B_A": "B_X"})
    run.adopt()
    assert run.places() == {"r1": "X", "r2": "X"}
    run.done("r1", "A_B")  # the action began under the old plan
    assert run.places()["r1"] == "B"
    run.slot(log_entries.SetPlace("r2", "A"))  # an order that was on its way
    assert run.places()["r2"] == "X"
    # once more, with names of both plans under way
    run.stage(_plan(_round("Z", "B"), start="Z"), {"X": "Z", "X_B": "Z_B", "B_X": "B_Z"})
    run.adopt()
    run.done("r2", "A_B")
    assert run.places() == {"r1": "B", "r2": "B"}
    run.check()


def test_a_result_that_names_no_transition_of_the_new_plan_is_a_failure() -> None:
    run = Run(_plan(_round("A", "B")))
    run.stage(_plan(_round("A", "C"), on_failure={"A": FailureRule.retry(1, 0.0)}))
    run.adopt()
    step = run.done("r1", "A_B")
    assert "'A_B' does not leave A" in run.faults(step)
    (again,) = [c for c in step.commands if isinstance(c, StartAction)]
    assert (again.robot, again.attempt) == ("r1", 2)
    run.done("r1", "A_C")
    assert run.places()["r1"] == "C"
    run.check()


def test_robots_that_are_done_ask_again_in_their_order() -> None:
    def shared(gate):
        return (
            NetBuilder("gate")
            .place("A")
            .place("B")
            .place("gate", tokens=gate)
            .exponential("go", inputs=["A", "gate"], outputs="B")
            .exponential("back", inputs="B", outputs=["A", "gate"])
        )

    run = Run(_plan(shared(0), ["gate"]), draws_ties=False)
    run.done("r2")
    run.done("r1")
    plan = _plan(
        shared(0).place("key", tokens=1).exponential("open", inputs="key", outputs="gate"),
        ["gate", "key"],
    )
    run.stage(plan)
    run.adopt()
    assert run.marking == {"A": 2, "key": 1}
    step = run.slot(log_entries.Fire("open"))
    assert [f.robot for f in step.firings] == ["", "r2"]
    run.check()


def test_an_occupied_place_has_to_survive_or_be_mapped() -> None:
    run = Run(_plan(_round("A", "B")))
    run.stage(_plan(_round("X", "B"), start="X"))
    step = run.adopt()
    assert "r1, r2 are in 'A'" in run.faults(step) and run.marking == {"A": 2}
    assert run.ledger.state.staged is not None
    run.stage(_plan(_round("X", "B"), start="X"), {"A": "X"})
    assert not run.faults(run.adopt())
    run.check()


def test_tokens_of_resources_carry_over_and_are_dropped_only_where_that_is_said() -> None:
    def tools(name):
        return (
            _round("A", "B")
            .place(name, tokens=2)
            .exponential("use", inputs=["A", name], outputs="B")
        )

    run = Run(_plan(tools("tool"), ["tool"]))
    run.done("r1", "use")
    without = _plan(_round("A", "B"))
    run.stage(without)
    assert "'tool' holds 1 tokens" in run.faults(run.adopt())
    run.stage(_plan(tools("crane"), ["crane"]), {"tool": "crane"})
    assert not run.faults(run.adopt())
    assert run.marking == {"A": 1, "B": 1, "crane": 1}
    run.stage(without, {"crane": ""})
    assert not run.faults(run.adopt())
    run.stage(_plan(tools("tool"), ["tool"]))
    run.adopt()
    assert run.marking == {"A": 1, "B": 1, "tool": 2}  # as in the initial marking
    run.check()


def test_every_member_has_to_say_yes_and_earlier_lives_and_stages_do_not_count() -> None:
    run = Run(_plan(_round("A", "B"), robots=("r1", "r2", "r3")))
    plan = _plan(_round("A", "B", "C"))
    run.stage(plan, votes=["r1", "r2"])
    assert "r3 has not voted" in run.faults(run.adopt())
    run.vote(["r3"], "no such function")
    assert "r3 cannot follow the plan: no such function" in run.faults(run.adopt())
    run.slot(log_entries.Evict("r3", 0))
    run.slot(log_entries.Join("r2", 1, "A", "log2"))
    assert "r2 has not voted" in run.faults(run.adopt())
    run.slot(log_entries.Staged("r2", 0, 1))  # what its earlier life had on the way
    assert "r2 has not voted" in run.faults(run.adopt())
    run.slot(log_entries.Join("r4", 0, "A", "log4"))
    run.vote(["r2"])
    assert "r4 has not voted" in run.faults(run.adopt())
    run.vote(["r4"])
    run.stage(plan, votes=["r1"])  # a newer stage: all start anew
    run.slot(log_entries.Staged("r2", 1, 1))
    assert "r2 has not voted" in run.faults(run.adopt())
    assert "stage 1 is over" in run.faults(run.slot(log_entries.Adopt(1)))
    run.slot(log_entries.Unstage(2))
    assert "no plan is staged" in run.faults(run.adopt())
    run.check()
    assert run.ledger.state.adopted is None


def test_the_order_of_a_slot_decides_whose_rules_apply() -> None:
    """Before and after the adoption, in one slot: firings of two nets."""
    run = Run(_plan(_round("A", "B")))
    run.stage(_plan(_round("A", "C", "B")))
    step = run.slot(
        log_entries.Done("r1", 0, 1, "A_B"),
        log_entries.Adopt(1),
        log_entries.Done("r2", 0, 1, "A_C"),
    )
    assert [f.transition for f in step.firings] == ["A_B", "A_C"]
    assert len(step.firings[0].marking) == 2 and len(step.firings[1].marking) == 3
    run.check()


def test_lost_robots_come_back_under_the_new_plan() -> None:
    run = Run(_plan(_round("A", "B"), robots=("r1", "r2", "r3")))
    run.done("r3")
    run.slot(log_entries.Evict("r3", 0))
    new = _plan(_round("A", "C"), spawn=("C",))
    run.stage(new)
    assert not run.faults(run.adopt())
    assert run.places()["r3"] == "C"  # where a new robot starts: its place is no more
    run.slot(log_entries.Join("r3", 1, "A", "log"))
    assert run.marking == {"A": 2, "C": 1}
    run.check()


def test_tasks_that_wait_carry_over_and_are_never_dropped() -> None:
    def shop(queue):
        return (
            NetBuilder("shop")
            .place("A")
            .place("B")
            .place(queue)
            .exponential("order", inputs={}, outputs=queue, inhibitors={queue: 1})
            .immediate("take", inputs=["A", queue], outputs="B")
            .exponential("back", inputs="B", outputs="A")
        )

    def tasks(queue):
        return {"tasks": Tasks((queue,), ("back",)), "resources": [queue]}

    run = Run(_plan(shop("orders"), **tasks("orders")))
    run.slot(log_entries.Submit("order", "t1", {"n": 1}))
    run.slot(log_entries.Submit("order", "t2"))
    assert run.marking == {"A": 2, "orders": 1} and len(run.ledger.state.submitted) == 1
    run.stage(_plan(_round("A", "B")), {"orders": ""})
    text = run.faults(run.adopt())
    assert "1 tasks wait in 'orders'" in text and "1 tasks wait for 'order'" in text
    run.stage(_plan(shop("inbox"), **tasks("inbox")), {"orders": "inbox"})
    assert not run.faults(run.adopt())
    run.slot(log_entries.Submit("order", "t1"))  # came before, under the old plan
    run.done("r1")
    assert run.ledger.state.robots["r1"].task.id == "t1"
    run.done("r2")
    assert run.ledger.state.robots["r2"].task.id == "t2"
    assert run.marking == {"B": 2}
    run.check()


@pytest.mark.parametrize(
    "change, text",
    [
        ({"synchronisation": Synchronisation.PARTIAL}, "synchronisation"),
        ({"witness": ("w",)}, "witnesses"),
        ({"fsync": True}, "fsync"),
    ],
)
def test_what_a_running_team_cannot_change(change, text) -> None:
    old = _plan(_round("A", "B"))
    (why,) = plan_change.why_never(old, replace(old, **change), {})
    assert text in why


@pytest.mark.parametrize(
    "mapping, text",
    [
        ({"Z": "A"}, "no such place"),
        ({"A": "Z"}, "is not a place of the new net"),
        ({"A": ""}, "cannot be dropped"),
        ({"A": "A_B"}, "is not a place of the new net"),
        ({"A_B": "A"}, "is not a transition of the new net"),
        ({"A_B": "B_A"}, "another 'A_B'"),
        ({"A": "tool"}, "is an action place"),
    ],
)
def test_mappings_that_make_no_sense(mapping, text) -> None:
    old = _plan(_round("A", "B"))
    new = _plan(_round("A", "B").place("tool"), ["tool"])
    assert text in "; ".join(plan_change.why_never(old, new, mapping))


def test_a_plan_that_was_altered_on_the_way_is_not_adopted() -> None:
    run = Run(_plan(_round("A", "B")))
    stage = plan_change.stage_of(_plan(_round("A", "B", "C")), {})
    run.slot(stage._replace(digest="0" * 32))
    run.vote(["r1", "r2"])
    assert "digest" in run.faults(run.adopt())
    run.check()


def test_in_a_standalone_run_the_executor_alone_looks_at_the_plan() -> None:
    run = Run(_plan(_round("A", "B")), agents=True)
    run.slot(plan_change.stage_of(_plan(_round("A", "B", "C")), {}))
    run.vote(["r1", "r2"])
    assert "the executor has not voted" in run.faults(run.adopt())
    run.vote([""])
    assert not run.faults(run.adopt())
    run.check()


def test_the_simulation_changes_a_plan_without_transitions_too():
    net = {"places": [{"name": "A", "tokens": 1}], "transitions": [], "arcs": []}
    plan = plan_from_json({"net": net, "actions": {"A": "os.getcwd"}, "robots": {"r1": "A"}})
    for seed in range(30):
        assert another_plan(plan, random.Random(seed))[0].action_places
