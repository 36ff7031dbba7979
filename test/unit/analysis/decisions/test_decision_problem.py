"""The decision problem of a plan: its states, who decides, and what policies do in it."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dense_automata import long_run
from hypothesis import HealthCheck, assume, given, settings

sys.path.append(str(Path(__file__).parents[1]))

from generated_plans import plain_event, small_plans, with_events
from hypothesis import strategies as st
from running_plans import running_plans

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.decisions.aims import Objective, Request
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.analysis.decisions.problem import DecisionProblem
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.reading import NET, RUN
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import LimitError, RefusedError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Plan, RobotSpec

PLANS = ["patrol", "rendezvous", "fork_join", "measure", "tokens"]

many = settings(max_examples=25, derandomize=True, suppress_health_check=list(HealthCheck))


def exponential(plan):
    """The plan with exponential durations of the same means, which nothing cuts off."""
    durations = {
        p: Duration.exponential(d.mean) if d.mean > 0 else d for p, d in plan.durations.items()
    }
    return replace(plan, durations=durations, timeouts={})


def assert_same(plan, decisions, policy, reading):
    """What the policy does on the rows is what the analysis of the plan finds."""
    team = decisions.teams[0]
    weights = decisions.weights_of(team, policy)
    sums = np.bincount(team.automaton.row_states, weights=weights, minlength=len(team.automaton))
    flow, time = long_run(team.automaton, weights)
    rows = team.automaton.arc_rows
    used = np.bincount(team.automaton.row_states[rows], weights=np.abs(flow)) > 1e-12
    assert sums[np.flatnonzero(used)] == pytest.approx(1.0, abs=1e-12)
    analysis = Analysis(plan.with_policy(policy), timing=reading)
    measures = analysis.measures
    for t, transition in enumerate(plan.net.transitions):
        assert flow[team.automaton.fired == t].sum() == pytest.approx(
            measures.throughput[transition.name], abs=1e-9
        ), transition.name
    for p, place in enumerate(plan.net.places):
        if place.name in measures.mean_tokens and place.name not in decisions.left_out:
            assert time @ team.markings[:, p] == pytest.approx(
                measures.mean_tokens[place.name], abs=1e-9
            ), place.name


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "reading"),
    # the patrol as it runs is large: test_grouping.py has its published value
    [("patrol", NET), *((name, reading) for name in PLANS[1:] for reading in (NET, RUN))],
)
def test_the_present_policy_does_what_the_analysis_says(name, reading):
    plan = exponential(read_plan("plans/%s/plan.json" % name))
    try:
        analysis = Analysis(plan, timing=reading)
        analysis.measures  # noqa: B018
    except RefusedError:
        pytest.skip("it has no steady state")
    assert_same(plan, DecisionProblem(plan, reading=reading), plan.policy, reading)


def check_generated(plan, reading):
    plan = exponential(plan)
    try:
        decisions = DecisionProblem(plan, reading=reading, limits=Limits(states=1500))
        team = decisions.teams[0]
        decisions.weights_of(team, plan.policy)
        Analysis(plan, timing=reading).measures  # noqa: B018
    except (RefusedError, LimitError):
        assume(False)
    assert_same(plan, decisions, plan.policy, reading)


@many
@given(running_plans())
def test_generated_plans_by_their_nets(plan):
    check_generated(plan, NET)


@many
@given(running_plans())
def test_generated_plans_as_they_run(plan):
    check_generated(plan, RUN)


@many
@given(small_plans())
def test_generated_plans_with_everything_by_their_nets(plan):
    check_generated(plan, NET)


@many
@given(small_plans())
def test_generated_plans_with_everything_as_they_run(plan):
    check_generated(plan, RUN)


@pytest.mark.parametrize("reading", [NET, RUN])
def test_a_smaller_team_that_is_never_seen_to_ask_has_its_states(reading):
    net = (
        NetBuilder("a tool is missing")
        .place("a", 2)
        .place("b")
        .place("tool")
        .immediate("go", inputs=["a", "tool"], outputs="b")
        .exponential("on", rate=1.0, inputs="b", outputs="a")
        .build()
    )
    plan = Plan(
        net,
        actions={"a": FunctionAction("actions.work", "a"), "b": None},
        robots=(RobotSpec("r", "a"), RobotSpec("s", "a")),
        resource_places=frozenset({"tool"}),
        outcomes={"a": {"go": 1.0}},
    )
    teams = DecisionProblem(plan, reading=reading).teams
    assert [team.robots for team in teams] == [2, 1]
    assert all(len(team.automaton) for team in teams)


@pytest.mark.parametrize("reading", [NET, RUN])
def test_rates_are_proportional_to_those_of_the_transitions_that_are_named(reading):
    plan = read_plan("plans/rendezvous/plan.json")
    decisions = DecisionProblem(plan, reading=reading)
    team = decisions.teams[0]
    labels = decisions.rate_labels(team)
    timed = team.automaton.tangible[team.automaton.row_states[team.automaton.arc_rows]]
    assert (labels[timed] >= 0).all() and (labels[~timed] < 0).all()
    for t in np.unique(labels[timed]).tolist():
        faster = plan.with_rates({plan.net.transitions[t].name: 2 * plan.net.transitions[t].rate})
        other = DecisionProblem(faster, reading=reading).teams[0].automaton
        changed = np.where(labels == t, 2.0, 1.0) * team.automaton.values
        assert other.values == pytest.approx(changed, rel=1e-12)


def test_given_durations_depend_on_no_rate():
    plan = read_plan("plans/rendezvous/plan.json")
    plan = replace(plan, durations={"Fetch": Duration.erlang(3, 2.0)})
    decisions = DecisionProblem(plan, reading=RUN)
    labels = decisions.rate_labels(decisions.teams[0])
    fetched = list(plan.net.consumers[plan.net.place_number("Fetch")])
    assert not np.isin(labels, fetched).any()


@settings(many, max_examples=20)
@given(with_events(running_plans(), plain_event()), st.sampled_from([NET, RUN]))
def test_generated_plans_with_events(plan, reading):
    check_generated(plan, reading)


def test_an_event_that_several_robots_share_a_resource_for_is_refused():
    net = (
        NetBuilder()
        .place("Work", 2)
        .place("Charge")
        .place("Dock", 1)
        .exponential("low", rate=0.3, inputs=["Work", "Dock"], outputs="Charge")
        .exponential("full", rate=1, inputs="Charge", outputs=["Work", "Dock"])
        .build()
    )
    act = FunctionAction("actions.work", "work")
    plan = Plan(
        net,
        actions={"Work": act, "Charge": act},
        resource_places=frozenset(["Dock"]),
        robots=(RobotSpec("a", "Work"), RobotSpec("b", "Work")),
        events={"low": EventSource("battery", "a/B")},
    ).validate()
    for reading in (NET, RUN):
        with pytest.raises(RefusedError, match="low: it is an event .* also takes from Dock"):
            DecisionProblem(plan, reading=reading)
        one = plan.for_robots(1)
        assert_same(one, DecisionProblem(one, reading=reading), one.policy, reading)
    held = replace(one, events={"low": EventSource("battery", "a/B", hold=True)}).validate()
    notes = DecisionProblem(held, reading=RUN).assumptions
    assert any("the simulation holds them" in note for note in notes)


@pytest.mark.parametrize(
    ("limit", "mean", "failure"), [(0.5, 0.5, 1.0), (1.5, 1.375, 0.5), (3.0, 1.5, 0.0)]
)
def test_an_attempt_that_a_timeout_cuts_off_is_a_failure_of_its_true_probability(
    limit, mean, failure
):
    plan = read_plan("plans/rendezvous/plan.json")
    plan = replace(plan, on_failure={"Fetch": FailureRule.retry(1, 0.7)})
    uniform = {"Fetch": Duration.uniform(1.0, 2.0)}
    one = DecisionProblem(replace(plan, durations=uniform, timeouts={"Fetch": limit}), reading=RUN)
    same = {"Fetch": Duration.exponential(mean)}
    other = DecisionProblem(replace(plan, durations=same, failures={"Fetch": failure}), reading=RUN)
    found, expected = one.teams[0].automaton, other.teams[0].automaton
    assert found.targets.tolist() == expected.targets.tolist()
    assert found.values == pytest.approx(expected.values, rel=1e-9)
    assert "durations are taken as exponential with their means (Fetch)" in one.assumptions


@pytest.mark.long
@pytest.mark.parametrize(
    ("rule", "then"),
    [
        (FailureRule.retry(2), "wait"),
        (FailureRule.fire("slip"), "fire"),
        (FailureRule.stop(), "stop"),
    ],
)
def test_the_best_policy_of_actions_that_fail_is_worth_what_analysis_and_simulation_say(rule, then):
    net = NetBuilder("fails").place("at", 1).place("good").place("poor").place("back")
    net.immediate("to_good", inputs="at", outputs="good")
    net.immediate("to_poor", inputs="at", outputs="poor")
    net.immediate("done_good", inputs="good", outputs="back")
    net.immediate("done_poor", inputs="poor", outputs="back")
    net.immediate("slip", inputs="good", outputs="back")
    net.exponential("again", rate=0.5, inputs="back", outputs="at")
    act = FunctionAction("actions.work", "work")
    plan = Plan(
        net.build(),
        actions={"at": None, "good": act, "poor": act, "back": act},
        robots=(RobotSpec("r", "at"),),
        durations={"good": Duration.exponential(1.0), "poor": Duration.exponential(2.0)},
        outcomes={"good": {"done_good": 1.0}, "poor": {"done_poor": 1.0}},
        failures={"good": 0.4},
        on_failure={"good": rule},
    ).validate()
    rewards = {"done_good": 1.0, "done_poor": 0.7}
    report = optimise(plan, Request(Objective.long_run(rewards)), simulated=0)
    fired = Analysis(report.plan).measures.throughput
    worth = sum(fired[t] * value for t, value in rewards.items())
    assert report.teams[0].value == pytest.approx(worth, abs=1e-9)
    # stuck, or stopped, sooner or later: then the poor way is the better one
    assert fired["done_poor"] == pytest.approx(0.0 if then == "fire" else 1 / 4, abs=1e-9)
    assert fired["done_good"] == pytest.approx(0.6 / 3 if then == "fire" else 0.0, abs=1e-9)
    found = simulate(report.plan, time=2000.0, replications=40, seed=3).throughput
    for t in rewards:
        assert abs(found[t].mean - fired[t]) <= 2 * found[t].half_width
