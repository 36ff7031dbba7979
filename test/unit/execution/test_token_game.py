"""The rules of the token game, one by one (docs/semantics.md)."""

from __future__ import annotations

import copy
from collections import Counter
from typing import Any, List

import pytest
from game_driver import Run, make_plan
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.firing import (
    CancelAction,
    Ended,
    Fault,
    StartAction,
    firing_to_json,
)
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.execution.verifier.slot_check import BrokenRuleError, SlotCheck
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.failure import FailureEnd, FailureRule
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import LostKind, LostRule
from gspn_framework_package.model.policy import Policy


def line() -> Net:
    return (
        NetBuilder()
        .place("P1")
        .place("P2")
        .place("P3")
        .exponential("T1", inputs="P1", outputs="P2")
        .exponential("T2", inputs="P2", outputs="P3")
        .build()
    )


def meeting() -> Net:
    return (
        NetBuilder()
        .place("P1")
        .place("P2")
        .place("P3")
        .place("P4")
        .exponential("meet", inputs=["P1", "P2"], outputs=["P3", "P4"])
        .exponential("back3", inputs="P3", outputs="P1")
        .exponential("back4", inputs="P4", outputs="P2")
        .exponential("alone", inputs="P1", outputs="P3")
        .build()
    )


def choice(**fields: Any) -> Net:
    return (
        NetBuilder()
        .place("P1")
        .place("A")
        .place("B")
        .immediate("a", inputs="P1", outputs="A")
        .immediate("b", inputs="P1", outputs="B")
        .exponential("ra", inputs="A", outputs="P1")
        .exponential("rb", inputs="B", outputs="P1")
        .build()
    )


def test_a_named_transition_fires_at_once_and_the_next_action_starts() -> None:
    run = Run(make_plan(line(), ["P1"]))
    assert run.commands == [StartAction("a", "P1", 0, 1, 1)]
    assert run.done("a", "T1") == ["T1"]
    assert run.commands[-1] == StartAction("a", "P2", 0, 2, 1)
    assert run.marking() == {"P2": 1}


def test_no_answer_in_a_place_with_one_exponential_output_asks_for_it() -> None:
    run = Run(make_plan(line(), ["P1"]))
    assert run.done("a", "None") == ["T1"]


def test_a_stale_or_repeated_done_changes_nothing() -> None:
    run = Run(make_plan(line(), ["P1"]))
    entry = log_entries.Done("a", 0, 1, "T1")
    run.feed(entry)
    assert run.feed(entry) == []
    assert run.feed(log_entries.Done("a", 3, 2, "T2")) == []
    assert run.feed(log_entries.Done("nobody", 0, 1, "T1")) == []
    assert run.marking() == {"P2": 1}


def test_the_run_ends_when_every_robot_is_in_a_place_without_outputs() -> None:
    run = Run(make_plan(line(), ["P2", "P3"]))
    run.done("b")
    assert run.state.robots["b"].phase is Phase.INACTIVE
    assert run.state.ended is None
    run.done("a", "T2")
    run.done("a")
    assert run.commands[-1] == Ended("every robot is in a place without output arcs", True)


def test_robots_meet_only_when_both_are_done_and_ask_for_it() -> None:
    run = Run(make_plan(meeting(), ["P1", "P2", "P1"]))
    assert run.done("a", "meet") == []
    assert "needs a robot in P2" in run.why("a")
    assert run.done("c", "alone") == ["alone"]
    assert run.done("b", "meet") == ["meet"]
    assert (run.place("a"), run.place("b")) == ("P3", "P4")


@pytest.mark.long
def test_chance_selects_the_partner_and_who_takes_the_tool() -> None:
    """Whoever finished first, and whatever each asks for."""
    net = (
        NetBuilder()
        .place("P1")
        .place("P2")
        .place("P3")
        .place("P4")
        .place("tool")
        .immediate("meet", inputs=["P1", "P2"], outputs=["P3", "P4"])
        .exponential("take", inputs=["P3", "tool"], outputs="P1")
        .exponential("grab", inputs=["P4", "tool"], outputs="P2")
        .exponential("bring", inputs=[], outputs="tool")
        .build()
    )
    partners, takers = Counter(), Counter()
    for seed in range(400):
        run = Run(make_plan(net, ["P1", "P1", "P2"], ["tool"], seed=seed))
        run.done("b")
        run.done("a")
        assert run.done("c") == ["meet"]
        partner = "a" if run.place("a") == "P3" else "b"
        run.done(partner, "take")
        run.done("c", "grab")
        assert run.feed(log_entries.Fire("bring"))[0] == "bring"
        partners[partner] += 1
        takers[run.firings[-1].robot == "c"] += 1
    assert abs(partners["a"] - 200) < 50 and abs(takers[True] - 200) < 50


def test_a_partner_that_chance_did_not_select_is_found() -> None:
    plan = make_plan(meeting(), ["P1", "P1", "P2"])
    for in_order, why in (False, "chance selects"), (True, "done earlier"):
        run, check = Run(plan, in_order=in_order), SlotCheck(plan)
        run.state = run.game.new_state()
        entries = [run.game.start_entry()._replace(draws_ties=not in_order)]
        entries += [log_entries.Done(robot, 0, 1, "meet") for robot in "abc"]
        for slot, entry in enumerate(entries[:-1]):
            check.slot({"slot": slot, "entries": [log_entries.to_json(entry)], "firings": []})
            run.feed(entry)
        run.feed(entries[-1])
        record = {
            "slot": 3,
            "entries": [log_entries.to_json(entries[-1])],
            "firings": [firing_to_json(f, run.game.net) for f in run.firings],
        }
        lie = copy.deepcopy(record)
        for move in lie["firings"][0]["moves"]:
            move[0] = {"a": "b", "b": "a"}.get(move[0], move[0])
        with pytest.raises(BrokenRuleError, match=why):
            copy.deepcopy(check).slot(lie)
        check.slot(record)
        assert check.robots["c"].place == "P4"


def test_in_a_run_of_an_earlier_version_the_first_to_finish_goes_first() -> None:
    plan = make_plan(meeting(), ["P1", "P1", "P2"])
    start = log_entries.to_json(TokenGame(plan).start_entry()._replace(draws_ties=False))
    assert "draws_ties" not in start  # as earlier versions wrote it
    for seed in range(10):
        run = Run(plan, in_order=True)
        run.state = run.game.new_state()
        run.feed(log_entries.from_json({**start, "seed": seed}))
        run.done("b", "meet")
        run.done("a", "meet")
        assert run.done("c", "meet") == ["meet"]
        assert (run.place("a"), run.place("b"), run.place("c")) == ("P1", "P3", "P4")


def test_routing_decides_where_each_robot_goes() -> None:
    run = Run(make_plan(meeting(), ["P1", "P2"], routing={"meet": {"P1": "P4"}}))
    run.done("a", "meet")
    run.done("b", "meet")
    assert (run.place("a"), run.place("b")) == ("P4", "P3")


def test_arc_weights_take_two_robots_and_add_three_tokens() -> None:
    net = (
        NetBuilder()
        .place("P")
        .place("Q")
        .place("count")
        .exponential("two", inputs={"P": 2}, outputs={"Q": 2, "count": 3})
        .exponential("back", inputs="Q", outputs="P")
        .build()
    )
    run = Run(make_plan(net, ["P", "P", "P"], resources=["count"]))
    assert run.done("a", "two") == []
    assert run.done("c", "two") == ["two"]
    assert run.marking() == {"P": 1, "Q": 2, "count": 3}
    assert run.place("b") == "P"


def test_a_shared_tool_is_acquired_and_released() -> None:
    net = (
        NetBuilder()
        .place("idle")
        .place("use")
        .place("tool", tokens=1)
        .exponential("take", inputs=["idle", "tool"], outputs="use")
        .exponential("give", inputs="use", outputs=["idle", "tool"])
        .build()
    )
    run = Run(make_plan(net, ["idle", "idle"], resources=["tool"]))
    assert run.done("a", "take") == ["take"]
    assert run.done("b", "take") == []
    assert "tool has 0 of 1" in run.why("b")
    assert run.done("a", "give") == ["give", "take"]
    assert run.marking() == {"idle": 1, "use": 1}


def test_immediate_transitions_of_resources_fire_by_themselves_by_priority() -> None:
    net = (
        NetBuilder()
        .place("P")
        .place("Q")
        .place("raw")
        .place("low")
        .place("high")
        .exponential("make", inputs="P", outputs=["Q", "raw"])
        .exponential("back", inputs="Q", outputs="P")
        .immediate("to_low", inputs="raw", outputs="low", priority=1)
        .immediate("to_high", inputs="raw", outputs="high", priority=2)
        .build()
    )
    run = Run(make_plan(net, ["P"], resources=["raw", "low", "high"]))
    assert run.done("a", "make") == ["make", "to_high"]


def test_the_environment_fires_when_told_and_only_if_enabled() -> None:
    net = (
        NetBuilder()
        .place("P")
        .place("Q")
        .place("order")
        .exponential("arrive", inputs={}, outputs="order")
        .exponential("work", inputs=["P", "order"], outputs="Q")
        .exponential("back", inputs="Q", outputs="P")
        .build()
    )
    run = Run(make_plan(net, ["P"], resources=["order"]))
    assert run.done("a", "work") == []
    assert run.feed(log_entries.Fire("back")) == []
    assert isinstance(run.commands[-1], Fault)
    assert run.feed(log_entries.Fire("arrive")) == ["arrive", "work"]


def test_the_policy_decides_and_counts_every_robot() -> None:
    policy = Policy.from_table(
        ["P1", "A", "B"],
        [((1, 0, "-"), {"a": 1}), ((1, 1, "-"), {"b": 1}), (("-", "-", "-"), {"a": 1})],
    )
    run = Run(make_plan(choice(), ["P1", "A"], policy=policy))
    assert run.done("a") == ["b"]


def test_a_row_that_does_not_speak_of_the_robot_makes_it_wait_until_the_marking_changes() -> None:
    net = (
        NetBuilder()
        .place("P1")
        .place("P2")
        .place("R")
        .immediate("t1", inputs="P1", outputs="R")
        .immediate("t2", inputs="P2", outputs="R")
        .exponential("r", inputs="R", outputs="P2")
        .build()
    )
    policy = Policy.from_table(["P1", "P2", "R"], [((1, 1, 0), {"t2": 1}), ((1, 0, 1), {"t1": 1})])
    run = Run(make_plan(net, ["P1", "P2"], policy=policy))
    assert run.done("a") == []
    assert "no policy row applies to P1" in run.why("a")
    assert run.done("b") == ["t2", "t1"]


def test_a_row_without_choices_makes_robots_wait_until_the_marking_changes() -> None:
    net = (
        NetBuilder()
        .place("P1")
        .place("P2")
        .place("R")
        .immediate("t1", weight=2.0, inputs="P1", outputs="R")
        .immediate("t2", inputs="P2", outputs="R")
        .exponential("r", inputs="R", outputs="P2")
        .build()
    )
    policy = Policy.from_table(["R"], [((0,), {}), (("-",), {"t1": 0.5, "t2": 0.5})])
    run = Run(make_plan(net, ["P1", "R", "P2"], policy=policy, strict=True))
    assert run.done("b", "r") == ["r"] and run.marking() == {"P1": 1, "P2": 2}
    assert run.done("a") == []
    assert run.why("a") == "the policy makes it wait in this marking"
    assert not any(isinstance(c, Fault) for c in run.commands)
    assert run.done("c", "t2") == ["t2", "t1"]  # the action decides, whatever the policy says


def test_without_a_matching_row_weights_decide_but_not_in_a_strict_plan() -> None:
    net = (
        NetBuilder()
        .place("P1")
        .place("A")
        .place("B")
        .immediate("a", weight=0.0, inputs="P1", outputs="A")
        .immediate("b", weight=2.0, inputs="P1", outputs="B")
        .exponential("ra", inputs="A", outputs="P1")
        .exponential("rb", inputs="B", outputs="P1")
        .build()
    )
    policy = Policy.from_table(["P1"], [((5,), {"a": 1})])
    assert Run(make_plan(net, ["P1"], policy=policy)).done("a") == ["b"]
    strict = Run(make_plan(net, ["P1"], policy=policy, strict=True))
    assert strict.done("a") == []
    assert "no row" in strict.why("a")
    assert any(isinstance(c, Fault) for c in strict.commands)


@pytest.mark.long
def test_a_draw_is_held_while_the_partner_is_busy() -> None:
    net = (
        NetBuilder()
        .place("P1")
        .place("P2")
        .place("M")
        .place("A")
        .immediate("meet", inputs=["P1", "P2"], outputs={"M": 2})
        .immediate("alone", inputs="P1", outputs="A")
        .exponential("rm", inputs="M", outputs="P1")
        .exponential("ra", inputs="A", outputs="P1")
        .build()
    )
    policy = Policy.from_table(["P1", "P2"], [((1, 1), {"meet": 0.9, "alone": 0.1})])
    outcomes = Counter()
    for seed in range(400):
        run = Run(make_plan(net, ["P1", "P2"], policy=policy, seed=seed))
        fired = run.done("a")
        for _ in range(3):
            fired += run.feed(log_entries.Pause("b"), log_entries.Resume("b"))
        fired += run.done("b") if not fired else []
        outcomes[fired[0]] += 1
    assert 340 <= outcomes["meet"] <= 380, outcomes


@pytest.mark.long
def test_draws_follow_the_distribution_and_the_seed() -> None:
    policy = Policy.from_table(["P1"], [((1,), {"a": 0.25, "b": 0.75})])
    fired = [
        Run(make_plan(choice(), ["P1"], policy=policy, seed=seed)).done("a")[0]
        for seed in range(1000)
    ]
    assert 210 <= fired.count("a") <= 290
    again = [
        Run(make_plan(choice(), ["P1"], policy=policy, seed=seed)).done("a")[0]
        for seed in range(20)
    ]
    assert again == fired[:20]


def test_the_higher_priority_goes_first_among_what_is_enabled() -> None:
    net = (
        NetBuilder()
        .place("P")
        .place("key")
        .place("A")
        .place("B")
        .immediate("low", inputs="P", outputs="A", weight=100)
        .immediate("high", inputs=["P", "key"], outputs="B", priority=3)
        .exponential("ra", inputs="A", outputs="P")
        .exponential("rb", inputs="B", outputs="P")
        .build()
    )
    assert Run(make_plan(net.with_marking({"key": 1}), ["P"], resources=["key"])).done("a") == [
        "high"
    ]
    assert Run(make_plan(net, ["P"], resources=["key"])).done("a") == ["low"]


def test_inhibitor_arcs_and_capacities_count_busy_robots_too() -> None:
    net = (
        NetBuilder()
        .place("P")
        .place("Q", capacity=1)
        .place("R")
        .exponential("in", inputs="P", outputs="Q")
        .exponential("out", inputs="Q", outputs="R")
        .exponential("back", inputs="R", outputs="P", inhibitors="Q")
        .build()
    )
    run = Run(make_plan(net, ["P", "Q", "R"]), in_order=True)
    assert run.done("a", "in") == []
    assert "Q is full" in run.why("a")
    assert run.done("c", "back") == []
    assert "inhibits" in run.why("c")
    assert run.done("b", "out") == ["out", "in"]
    assert run.place("c") == "R"


@pytest.mark.parametrize("result", ["T2", "nonsense", "P2"])
def test_a_result_that_names_no_possible_transition_is_a_fault(result: str) -> None:
    run = Run(make_plan(line(), ["P1"]))
    assert run.done("a", result) == []
    assert run.state.robots["a"].phase is Phase.FAILED
    assert result in run.why("a")
    run.feed(log_entries.Retry("a"))
    assert run.commands[-1] == StartAction("a", "P1", 0, 1, 2)
    assert run.done("a", "T1") == ["T1"]


def test_on_failure_retry_then_wait() -> None:
    rule = FailureRule.retry(2, 0.5)
    run = Run(make_plan(line(), ["P1"], on_failure={"P1": rule}))
    run.fail("a")
    assert run.commands[-1] == StartAction("a", "P1", 0, 1, 2, 0.5)
    stale = log_entries.Failed("a", 0, 1, 1, "aborted")
    run.feed(stale)
    assert run.state.robots["a"].attempt == 2
    run.fail("a", "timeout")
    run.fail("a", "timeout")
    assert run.state.robots["a"].phase is Phase.FAILED
    assert "timeout" in run.why("a")


def test_a_rule_may_have_a_delay_for_each_attempt_and_then_any_end() -> None:
    rule = FailureRule("growing", 3, (0.5, 2.0), FailureEnd.FIRE, "T1")
    run = Run(make_plan(line(), ["P1"], on_failure={"P1": rule}))
    for attempt, delay in ((2, 0.5), (3, 2.0), (4, 2.0)):
        assert run.fail("a") == []
        assert run.commands[-1] == StartAction("a", "P1", 0, 1, attempt, delay)
    assert run.fail("a") == ["T1"]


def test_on_failure_fire_and_stop() -> None:
    run = Run(make_plan(line(), ["P1"], on_failure={"*": FailureRule.fire("T1")}))
    assert run.fail("a") == ["T1"]
    run = Run(make_plan(line(), ["P1", "P2"], on_failure={"P1": FailureRule.stop()}))
    run.fail("a", "lost")
    assert run.state.ended is not None
    assert CancelAction("b", 1) in run.commands
    assert run.done("b", "T2") == []


@pytest.mark.long
def test_a_cycle_without_time_is_cut_off() -> None:
    net = (
        NetBuilder()
        .place("P")
        .place("Q")
        .immediate("pq", inputs="P", outputs="Q")
        .immediate("qp", inputs="Q", outputs="P")
        .build()
    )
    run = Run(make_plan(net, ["P"], idle=["P", "Q"]))
    assert run.state.ended == "a cycle of immediate transitions"
    assert any(isinstance(c, Fault) for c in run.commands)


def test_pause_and_resume_of_team_and_robot() -> None:
    run = Run(make_plan(line(), ["P1", "P1"]))
    run.feed(log_entries.Pause())
    assert run.done("a", "T1") == []
    assert run.why("a") == "paused"
    assert run.feed(log_entries.Resume()) == ["T1"]
    run.feed(log_entries.Pause("b"))
    assert run.done("b", "T1") == []
    assert run.feed(log_entries.Resume("b")) == ["T1"]


def test_eviction_return_leave_and_set_place() -> None:
    run = Run(make_plan(meeting(), ["P1", "P2"]))
    run.done("a", "meet")
    run.done("b", "back4")
    run.feed(log_entries.Evict("b", 0))
    assert run.marking() == {"P1": 1}
    assert run.state.members() == ["a"]
    assert "needs a robot in P2" in run.why("a")
    run.feed(log_entries.Evict("b", 0), log_entries.Evict("nobody", 0))
    run.feed(log_entries.Join("b", 1))
    assert run.commands[-1] == StartAction("b", "P2", 1, 2, 1)
    assert run.done("b", "meet") == ["meet"]
    run.feed(log_entries.SetPlace("a", "P2"))
    assert run.place("a") == "P2"
    assert CancelAction("a", 2) in run.commands
    run.feed(log_entries.Leave("a"))
    assert run.marking() == {"P4": 1}
    run.feed(
        log_entries.Evict("b", 1), log_entries.Leave("b")
    )  # somebody has to let the others in again
    assert run.marking() == {"P4": 1}
    assert run.state.members() == ["b"]


def test_a_restarted_member_keeps_its_visit_and_starts_the_action_again() -> None:
    run = Run(make_plan(line(), ["P1"]))
    run.feed(log_entries.Join("a", 1))
    assert run.commands[-1] == StartAction("a", "P1", 1, 1, 2)
    assert run.feed(log_entries.Done("a", 0, 1, "T1")) == []
    assert run.done("a", "T1") == ["T1"]


def test_on_lost_and_on_evict() -> None:
    net = meeting().with_place(meeting().places[0]._replace(name="tool"))
    run = Run(
        make_plan(
            net,
            ["P1", "P2"],
            resources=["tool"],
            on_lost=LostRule(LostKind.FIRE, "alone"),
            on_evict={"P2": {"tool": 1}},
        )
    )
    run.done("a", "meet")
    assert run.feed(log_entries.Evict("b", 0)) == ["alone"]
    assert run.marking() == {"P3": 1, "tool": 1}
    run = Run(make_plan(meeting(), ["P1", "P2"], on_lost=LostRule(LostKind.STOP)))
    run.done("a", "meet")
    run.feed(log_entries.Evict("b", 0))
    assert run.state.ended is not None and "waits for it" in run.state.ended


@pytest.mark.parametrize(
    ("on_evict", "place"), [({}, "P1"), ({"P1": {}}, "P1"), ({"P1": {"tool": 1}}, "P2")]
)
def test_only_a_robot_that_gave_something_back_returns_elsewhere(on_evict: Any, place: str) -> None:
    net = line().with_place(line().places[0]._replace(name="tool"))
    plan = make_plan(net, ["P1", "P1"], resources=["tool"], on_evict=on_evict)
    run, check = Run(plan), SlotCheck(plan)
    entries = [log_entries.Evict("b", 0), log_entries.Join("b", 1, "P2")]
    for entry in entries:
        run.feed(entry)
    for entry in [run.game.start_entry(), *entries]:
        check._apply(entry)
    assert run.place("b") == check.robots["b"].place == place
    assert run.marking() == {p: n for p, n in check.marking.items() if n}


def test_until_ends_the_run() -> None:
    run = Run(make_plan(line(), ["P1", "P1"], until="P2 >= 2"))
    run.done("a", "T1")
    run.done("b", "T1")
    assert run.commands[-1] == Ended("until: P2 >= 2", True)


def test_agents_are_forked_and_destroyed() -> None:
    net = (
        NetBuilder()
        .place("P1")
        .place("A")
        .place("B")
        .exponential("fork", inputs="P1", outputs=["A", "B"])
        .exponential("join", inputs=["A", "B"], outputs="P1")
        .build()
    )
    run = Run(make_plan(net, ["P1"]), agents=True)
    run.done("a", "fork")
    assert sorted(run.state.robots) == ["2", "a"]
    run.done("a", "join")
    run.done("2", "join")
    assert len(run.state.robots) == 1
    assert [m.target for m in run.firings[-1].moves].count(None) == 1


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_order_of_results_keeps_the_invariants_and_replays_exactly(data: Any) -> None:
    net = (
        NetBuilder()
        .place("P1")
        .place("P2")
        .place("P3")
        .place("count")
        .place("tool", tokens=1)
        .exponential("work", inputs=["P1", "tool"], outputs=["P2", "tool", "count"])
        .immediate("pair", inputs={"P2": 2}, outputs=["P1", "P3"])
        .immediate("solo", inputs="P2", outputs="P3")
        .exponential("home", inputs="P3", outputs="P1")
        .build()
    )
    policy = Policy.from_table(["P2"], [((2,), {"pair": 0.5, "solo": 0.5})])
    plan = make_plan(
        net,
        ["P1", "P1", "P2", "P3"],
        resources=["count", "tool"],
        policy=policy,
        seed=data.draw(st.integers(0, 9)),
    )
    run = Run(plan)
    entries: List[Any] = [run.game.start_entry()]
    for _ in range(data.draw(st.integers(1, 25))):
        name = data.draw(st.sampled_from("abcd"))
        robot = run.state.robots[name]
        entry = data.draw(
            st.sampled_from(
                [
                    log_entries.Done(
                        name,
                        robot.incarnation,
                        robot.visit,
                        data.draw(st.sampled_from(["", "work", "pair", "home"])),
                    ),
                    log_entries.Failed(
                        name, robot.incarnation, robot.visit, robot.attempt, "aborted"
                    ),
                    log_entries.Retry(name),
                    log_entries.Evict(name, robot.incarnation),
                    log_entries.Join(name, robot.incarnation + 1),
                    log_entries.Pause(name),
                    log_entries.Resume(name),
                    log_entries.SetPlace(name, "P1"),
                    log_entries.Pause(),
                    log_entries.Resume(),
                ]
            )
        )
        entries.append(entry)
        run.feed(entry)
    game = TokenGame(plan)
    state = game.new_state()
    firings = []
    for slot, entry in enumerate(entries):
        again = log_entries.from_json(log_entries.to_json(entry))
        assert again == entry
        state = game.state_from_json(state.to_json(net))
        firings += game.reduce(state, slot, [again]).firings
    assert (state, firings) == (run.state, run.firings)
