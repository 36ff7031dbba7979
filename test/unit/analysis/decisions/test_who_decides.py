"""Who chooses in a place, and the reason that is given."""

from dataclasses import replace

import pytest

from gspn_framework_package.analysis.decisions.automaton import CHANCE
from gspn_framework_package.analysis.decisions.problem import DecisionProblem
from gspn_framework_package.analysis.decisions.who_decides import who_decides
from gspn_framework_package.analysis.plan.reading import NET, RUN
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import RefusedError, UsageError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow

WORK = FunctionAction("actions.work", "work")


def plan_of(*, weights=(1.0, 3.0), action=WORK, **more):
    """A robot works in ``work``; in ``choose`` it goes left or right, and both lead back."""
    net = (
        NetBuilder("fork")
        .place("work", tokens=1)
        .place("choose")
        .place("left")
        .place("right")
        .exponential("done", rate=1.0, inputs="work", outputs="choose")
        .immediate("go_left", weight=weights[0], inputs="choose", outputs="left")
        .immediate("go_right", weight=weights[1], inputs="choose", outputs="right")
        .exponential("from_left", rate=2.0, inputs="left", outputs="work")
        .exponential("from_right", rate=4.0, inputs="right", outputs="work")
        .build()
    )
    return Plan(
        net,
        actions={"work": WORK, "choose": action, "left": WORK, "right": WORK},
        robots=(RobotSpec("r", "work"),),
        **more,
    ).validate()


def decider(plan, reading=NET, may_wait=()):
    return who_decides(plan, reading, frozenset(may_wait))["choose"]


def test_weights_decide_where_nothing_else_is_said():
    found = decider(plan_of())
    assert not found.policy
    assert [v for _, v in found.chances] == [1.0, 3.0]


@pytest.mark.parametrize(
    "more",
    [
        {"action": None},
        {"weights": (0.0, 1.0)},
        {"policy": Policy([], [PolicyRow((), (("go_left", 1.0),))])},
        {"outcomes": {"choose": {"": 1.0}}},
    ],
)
def test_the_policy_decides(more):
    found = decider(plan_of(**more))
    assert found.policy and found.reason


def test_the_action_decides_if_its_outcomes_say_so():
    plan = plan_of(outcomes={"choose": {"go_left": 0.9, "go_right": 0.1}}, action=None)
    found = decider(plan)
    assert not found.policy
    assert [v for _, v in found.chances] == [0.9, 0.1]


def test_the_key_chance_has_the_last_word():
    plan = plan_of(action=None, chance=frozenset(["choose"]))
    assert not decider(plan).policy
    assert "chance" in decider(plan).reason


def test_chance_without_weights_is_refused():
    plan = plan_of(weights=(0.0, 0.0), chance=frozenset(["choose"]))
    with pytest.raises(RefusedError, match="no transition has a weight"):
        decider(plan)


def test_robots_wait_only_where_the_policy_decides():
    assert decider(plan_of(), may_wait=["choose"]).policy
    with pytest.raises(UsageError, match="cannot wait by choice"):
        decider(plan_of(chance=frozenset(["choose"])), may_wait=["choose"])
    with pytest.raises(UsageError, match="there is no choice in 'work'"):
        decider(plan_of(), may_wait=["work"])


def test_a_place_that_both_kinds_leave_is_refused():
    net = (
        NetBuilder("both")
        .place("a", tokens=1)
        .place("b")
        .exponential("slow", rate=1.0, inputs="a", outputs="b")
        .immediate("fast", inputs="a", outputs="b")
        .exponential("back", rate=1.0, inputs="b", outputs="a")
        .build()
    )
    plan = Plan(net, actions={"a": WORK, "b": WORK}, robots=(RobotSpec("r", "a"),)).validate()
    for reading in (NET, RUN):
        with pytest.raises(RefusedError, match="ambiguous who decides"):
            who_decides(plan, reading, frozenset())
    named = replace(plan, outcomes={"a": {"slow": 0.5, "": 0.5}}).validate()
    assert who_decides(named, RUN, frozenset())["a"].policy


@pytest.mark.parametrize("reading", [NET, RUN])
def test_no_weights_decide_in_a_strict_plan(reading):
    strict = replace(plan_of(), strict=True).validate()
    decider = who_decides(strict, reading, frozenset())["choose"]
    assert decider.policy and "strict" in decider.reason


@pytest.mark.parametrize("reading", [NET, RUN])
def test_assumptions_name_the_place_and_the_reason(reading):
    decisions = DecisionProblem(plan_of(), reading=reading)
    assert decisions.chance == {"choose": "only the weights decide there"}
    assert any(s.startswith("chance decides in choose: ") for s in decisions.assumptions)
    team = decisions.teams[0]
    free = decisions.allowed(team)
    assert set(team.automaton.choices[free].tolist()) == {CHANCE}


def test_outcomes_give_the_chances_of_a_row():
    plan = plan_of(outcomes={"choose": {"go_left": 0.9, "go_right": 0.1}}, action=None)
    for reading in (NET, RUN):
        automaton = DecisionProblem(plan, reading=reading).teams[0].automaton
        vanishing = [s for s in range(len(automaton)) if not automaton.tangible[s]]
        found = set()
        for state in vanishing:
            row = automaton.rows[state]
            arcs = slice(automaton.arcs[row], automaton.arcs[row + 1])
            found.add(tuple(sorted(automaton.values[arcs].round(12).tolist())))
        assert (0.1, 0.9) in found
