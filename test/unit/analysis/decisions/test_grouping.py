"""From solutions to decisions by marking: what is exported is worth what the solution says."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

sys.path.append(str(Path(__file__).parents[1]))

from generated_plans import small_plans
from running_plans import running_plans

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.decisions.aims import Objective
from gspn_framework_package.analysis.decisions.export import policy_of
from gspn_framework_package.analysis.decisions.grouping import Grouping
from gspn_framework_package.analysis.decisions.problem import DecisionProblem
from gspn_framework_package.analysis.decisions.solving.evaluation import evaluate_policy
from gspn_framework_package.analysis.decisions.solving.optima import optimum
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.markings import PlanMarkings
from gspn_framework_package.analysis.plan.reading import NET, RUN
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import LimitError, RefusedError

some = settings(max_examples=15, derandomize=True, suppress_health_check=list(HealthCheck))


def solved(decisions, objective, team=None, width=1e-9):
    """The team's rewards, allowed rows, goal and solution."""
    team = team or decisions.teams[0]
    rewards = decisions.rewards(team, objective)
    goal = decisions.goal(team, objective.goal) if objective.goal else None
    allowed = decisions.allowed(team)
    found = optimum(
        team.automaton,
        objective.aim,
        rewards,
        goal=goal,
        discount=objective.discount,
        maximise=objective.maximise,
        width=width,
        allowed=allowed,
    )
    return found, (rewards, objective, goal, allowed)


def patrol():
    plan = read_plan("plans/patrol/plan.json")
    names = [p.name for p in plan.net.places]
    never = ['"%s" + "%s" > 1' % (names[i], names[i + 1]) for i in range(0, 16, 4)]
    decide = [name for name in names if "Decide" in name]
    checks = {t.name: 1.0 for t in plan.net.transitions if "Temperature" in t.name}
    return plan, never, decide, Objective.long_run(checks)


@pytest.mark.parametrize(
    ("reading", "waits", "value"),
    [(NET, False, 1.194798945367), (NET, True, 1.325220304), (RUN, True, 1.325220304)],
)
def test_the_patrol_gets_its_published_value(reading, waits, value):
    plan, never, decide, objective = patrol()
    decisions = DecisionProblem(
        plan, reading=reading, never=never, may_wait=decide if waits else (), team_sizes=[4]
    )
    found, asked = solved(decisions, objective, width=1e-6)
    grouped = Grouping(decisions.teams[0], *asked).closest(found)
    assert grouped.evaluated.value == pytest.approx(value, abs=1e-9)
    assert found.lower - 1e-9 <= grouped.evaluated.value <= found.upper + 1e-9
    policy = policy_of(plan, grouped.decided)
    if reading == NET:
        measures = Analysis(plan.with_policy(policy), timing=reading).measures
        checks = sum(measures.throughput[name] for name in objective.rewards)
        assert checks == pytest.approx(grouped.evaluated.value, abs=1e-9)
    if not waits:
        present = evaluate_policy(
            decisions.teams[0].automaton,
            objective.aim,
            asked[0],
            decisions.weights_of(decisions.teams[0], plan.policy),
        )
        assert present.value == pytest.approx(value, abs=1e-9)  # the shipped policy is optimal
        assert grouped.silent == 0


@pytest.mark.long
def test_a_policy_for_all_teams_leaves_no_gap():
    plan, never, decide, objective = patrol()
    plan = replace(plan, strict=True)
    decisions = DecisionProblem(plan, reading=NET, never=never, may_wait=decide)
    markings, choices = [], []
    for team in decisions.teams:
        found, asked = solved(decisions, objective, team, width=1e-6)
        decided = Grouping(team, *asked).closest(found).decided
        markings.append(decided.markings)
        choices += decided.choices
    decided = decided._replace(markings=np.concatenate(markings), choices=tuple(choices))
    better = plan.with_policy(policy_of(plan, decided))
    visited = PlanMarkings(better, 10_000, losses=True)
    assert not list(visited.policy_gaps())
    for condition in never:
        assert not (visited.space.holds(condition) & visited._ways_with_losses.reached).any()


def check_generated(plan, reading, names):
    durations = {
        p: Duration.exponential(d.mean) if d.mean > 0 else d for p, d in plan.durations.items()
    }
    plan = replace(plan, durations=durations, failures={}, timeouts={})
    timed = [t.name for t in plan.net.transitions if t.timed]
    assume(timed)
    objective = Objective.long_run({timed[names % len(timed)]: 1.0})
    try:
        decisions = DecisionProblem(plan, reading=reading, limits=Limits(states=3000))
        team = decisions.teams[0]
        assume(decisions.deciders)
        found, asked = solved(decisions, objective)
        grouped = Grouping(team, *asked).closest(found)
        policy = plan.policy if grouped.kept else policy_of(plan, grouped.decided)
        measures = Analysis(plan.with_policy(policy), timing=reading).measures
    except (RefusedError, LimitError):
        assume(False)
    value = grouped.evaluated.value
    assert value <= found.upper + 1e-7 * max(1, abs(value))
    if reading == NET:
        assert value == pytest.approx(found.lower, rel=1e-7, abs=1e-7)
    # what is exported is worth what was computed, by the analysis and by the rows
    exported = sum(measures.throughput[name] for name in objective.rewards)
    assert exported == pytest.approx(value, rel=1e-7, abs=1e-8)
    try:
        weights = decisions.weights_of(team, policy)
    except RefusedError:
        return
    assert evaluate_policy(team.automaton, objective.aim, asked[0], weights).value == pytest.approx(
        value, rel=1e-7, abs=1e-8
    )


def check_passage(plan, reading, place, aim):
    """The way to a goal: the time, or the probability to get there."""
    durations = {
        p: Duration.exponential(d.mean) if d.mean > 0 else d for p, d in plan.durations.items()
    }
    plan = replace(plan, durations=durations, failures={}, timeouts={})
    places = [p.name for p in plan.net.places if p.name not in plan.resource_places]
    goal = "%s >= 2" % places[place % len(places)]
    objective = getattr(Objective, aim)(goal)
    try:
        decisions = DecisionProblem(
            plan, reading=reading, conditions=[goal], limits=Limits(states=3000)
        )
        team = decisions.teams[0]
        assume(decisions.deciders)
        found, asked = solved(decisions, objective)
        grouped = Grouping(team, *asked).closest(found)
        policy = plan.policy if grouped.kept else policy_of(plan, grouped.decided)
        passage = Analysis(plan.with_policy(policy), timing=reading).first_passage(goal)
    except (RefusedError, LimitError):
        assume(False)
    value = grouped.evaluated.value
    if reading == NET:
        assert value == pytest.approx(found.lower, rel=1e-7, abs=1e-7)
    exported = passage.mean_time if aim == "time_to" else passage.probability
    assert exported == pytest.approx(value, rel=1e-7, abs=1e-8)


@pytest.mark.long
@some
@given(running_plans(), st.integers(0, 3), st.sampled_from(["time_to", "reach"]))
def test_ways_to_a_goal_by_the_net(plan, place, aim):
    check_passage(plan, NET, place, aim)


@pytest.mark.long
@some
@given(running_plans(), st.integers(0, 3), st.sampled_from(["time_to", "reach"]))
def test_ways_to_a_goal_as_it_runs(plan, place, aim):
    check_passage(plan, RUN, place, aim)


@some
@given(running_plans(), st.integers(0, 20))
def test_generated_plans_by_their_nets(plan, names):
    check_generated(plan, NET, names)


@some
@given(running_plans(), st.integers(0, 20))
def test_generated_plans_as_they_run(plan, names):
    check_generated(plan, RUN, names)


@pytest.mark.long
@some
@given(small_plans(), st.integers(0, 20))
def test_generated_plans_with_everything(plan, names):
    check_generated(plan, NET, names)
