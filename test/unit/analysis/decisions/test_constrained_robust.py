"""Constraints, uncertain rates and sensitivities: against enumeration, a linear program over
occupation measures, and finite differences."""

import dataclasses
import itertools
import os

import numpy as np
import pytest
from generated_automata import automata, automaton_of, policies, rewarded, value_of
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy import optimize

from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.analysis.decisions.solving import (
    constrained,
    evaluate_policy,
    optimum,
    robust,
    sensitivities,
)
from gspn_framework_package.model.errors import RefusedError, UsageError

relaxed = settings(
    derandomize=True,
    max_examples=int(os.environ.get("GSPN_DECISION_EXAMPLES", "12")),
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
DISCOUNT = 0.3


@st.composite
def rings(draw):
    """A hub that chooses among loops of two phases; in one of the loops there is a further choice.
    Each arc has its own transition."""
    count = draw(st.integers(2, 4))
    rate = st.sampled_from([0.3, 0.7, 1.0, 2.5])
    tangible, rows, number = [False], [[]], 0
    for loop in range(count):
        first = len(tangible)
        rows[0].append([(first, 1.0)])
        back = draw(st.booleans())
        arcs = [(first + 1, draw(rate), number)]
        if back:
            arcs.append((0, draw(rate), number + 1))
        number += 2
        tangible += [True, True]
        rows += [[arcs], [[(0, draw(rate), number)]]]
        number += 1
        if loop == 0:  # the second phase ends in a further choice
            rows[-1] = [[(first + 2, draw(rate), number - 1)]]
            tangible.append(False)
            rows.append([[(0, 1.0)], [(first, 0.5), (0, 0.5)]])
    automaton = automaton_of(tangible, rows)
    earned = draw(st.lists(st.integers(0, 5), min_size=len(tangible), max_size=len(tangible)))
    return automaton, rewarded(automaton, earned), number


# -- constraints -----------------------------------------------------------------------------------


def occupation(automaton, rewards, asked):
    """The best value by a linear program over how often each row is taken."""
    size, rows = len(automaton), len(automaton.choices)
    balance = np.zeros((size, rows))
    for row in range(rows):
        arcs = slice(automaton.arcs[row], automaton.arcs[row + 1])
        own = automaton.row_states[row]
        values = automaton.values[arcs]
        balance[own, row] += values.sum()
        np.add.at(balance[:, row], automaton.targets[arcs], -values)
    timed = automaton.tangible[automaton.row_states].astype(float)

    def earned(part):
        found = np.where(timed, part.rate[automaton.row_states], 0.0)
        np.add.at(found, automaton.arc_rows, automaton.values * part.impulse)
        return found

    return optimize.linprog(
        -earned(rewards),
        A_ub=np.array([-earned(part) for part, _ in asked]),
        b_ub=np.array([-bound for _, bound in asked]),
        A_eq=np.vstack([balance, timed]),
        b_eq=np.append(np.zeros(size), 1.0),
        method="highs" if hasattr(optimize, "milp") else "revised simplex",
    )


@pytest.mark.long
@relaxed
@given(rings(), st.data())
def test_constraints_equal_the_program_over_occupation_measures(problem, data):
    automaton, rewards, _ = problem
    asked = []
    for _ in range(data.draw(st.integers(1, 2))):
        state = data.draw(st.sampled_from(np.flatnonzero(automaton.tangible).tolist()))
        marked = rewarded(automaton, np.arange(len(automaton)) == state)
        asked.append((marked, data.draw(st.sampled_from([0.05, 0.2, 0.4]))))
    whole = occupation(automaton, rewards, asked)
    if whole.status == 2:
        with pytest.raises(RefusedError, match="cannot be"):
            constrained(automaton, rewards, asked)
        return
    found = constrained(automaton, rewards, asked)
    scale = max(1e-9, abs(whole.fun))
    assert found.lower <= -whole.fun + 1e-6 * scale
    assert found.upper >= -whole.fun - 1e-6 * scale
    assert found.upper - found.lower <= 2e-6 * scale
    for value, (_, bound) in zip(found.values, asked):
        assert value >= bound - 1e-8
    # the policy is one: the value is that of its weights
    assert evaluate_policy(automaton, Aim.LONG_RUN, rewards, found.weights).value == pytest.approx(
        0.5 * (found.lower + found.upper), rel=2e-6, abs=1e-9
    )


def two_loops():
    """Loop 1 takes 1 s and earns 3; loop 2 takes 1 s and earns 1."""
    automaton = automaton_of(
        [False, True, True], [[[(1, 1.0)], [(2, 1.0)]], [[(0, 1.0)]], [[(0, 1.0)]]]
    )
    return automaton, rewarded(automaton, [0, 3, 1]), rewarded(automaton, [0, 0, 1])


def test_a_constraint_has_a_price_and_the_policy_draws():
    automaton, rewards, second = two_loops()
    found = constrained(automaton, rewards, [(second, 0.25)], width=1e-9)
    assert found.lower == pytest.approx(2.5, abs=1e-8)
    assert found.weights[:2] == pytest.approx([0.75, 0.25], abs=1e-8)
    assert found.prices == pytest.approx([2.0])
    assert found.values[0] >= 0.25 - 1e-9
    free = constrained(automaton, rewards, [(second, -1.0)])
    assert (free.lower, free.prices) == (pytest.approx(3.0), [0.0])
    cheap = constrained(automaton, rewards, [(second, 0.25)], maximise=False)
    assert cheap.upper == pytest.approx(1.0)


def test_parts_that_never_meet_are_connected():
    # in 0 one may stay (worth 3 per second) or go to 2, and in 2 (worth 1) stay or go to 0: the
    # best mixture never goes, so no policy without memory is as good, but one comes close
    automaton = automaton_of(
        [False, True, False, True, True, True],
        [
            [[(1, 1.0)], [(4, 1.0)]],
            [[(0, 1.0)]],
            [[(3, 1.0)], [(5, 1.0)]],
            [[(2, 1.0)]],
            [[(2, 1.0)]],
            [[(0, 1.0)]],
        ],
    )
    rewards = rewarded(automaton, [0, 3, 0, 1, 0, 0])
    second = rewarded(automaton, [0, 0, 0, 1, 0, 0])
    found = constrained(automaton, rewards, [(second, 0.25)])
    assert found.lower == pytest.approx(2.5, rel=1e-6)
    assert found.upper == pytest.approx(2.5, rel=1e-6)
    assert found.values[0] >= 0.25 - 1e-8
    assert (found.weights > 0).all()  # it goes to and fro


def test_a_constraint_that_cannot_be_kept_is_named_with_the_best_that_can():
    automaton, rewards, second = two_loops()
    with pytest.raises(RefusedError, match="visits cannot be as high as 1.5: at most 1"):
        constrained(automaton, rewards, [(second, 1.5)], names=["visits"])
    first = rewarded(automaton, [0, 1, 0])
    with pytest.raises(RefusedError, match="together: .*one is .* two is"):
        constrained(automaton, rewards, [(first, 0.6), (second, 0.6)], names=["one", "two"])


# -- uncertain rates -------------------------------------------------------------------------------


def with_rates(automaton, factors):
    values = automaton.values * np.array([factors.get(int(t), 1.0) for t in automaton.fired])
    return dataclasses.replace(automaton, values=values)


@pytest.mark.long
@relaxed
@given(rings(), st.booleans(), st.data())
def test_the_robust_bounds_hold_the_best_worst_value(problem, maximise, data):
    automaton, rewards, number = problem
    named = data.draw(st.lists(st.integers(0, number - 1), min_size=1, max_size=2, unique=True))
    intervals = dict.fromkeys(named, (0.5, 1.5))
    found = robust(automaton, Aim.LONG_RUN, rewards, intervals, maximise=maximise)
    grid = [
        with_rates(automaton, dict(zip(named, factors)))
        for factors in itertools.product((0.5, 0.75, 1.0, 1.25, 1.5), repeat=len(named))
    ]
    worst, best = (min, max) if maximise else (max, min)
    wanted = best(
        worst(value_of(g, rewards, None, 0, Aim.LONG_RUN, p) for g in grid)
        for p in policies(automaton)
    )
    slack = 1e-6 * max(1.0, abs(wanted))
    # the grid misses the worst rates that are not on it, so only one side is tested by it
    own = [value_of(g, rewards, None, 0, Aim.LONG_RUN, found.row_of) for g in grid]
    if maximise:
        assert found.lower <= wanted + slack
        assert all(value >= found.lower - slack for value in own)
    else:
        assert found.upper >= wanted - slack
        assert all(value <= found.upper + slack for value in own)
    corner = optimum(with_rates(automaton, found.corner), Aim.LONG_RUN, rewards, maximise=maximise)
    assert found.lower <= corner.upper + slack
    assert found.upper >= corner.lower - slack


def test_one_uncertain_rate_in_one_place_is_solved():
    # loop 1 earns 3 per second at an uncertain rate, its way back takes 1 s; loop 2 earns 1
    automaton = automaton_of(
        [False, True, True, True],
        [[[(1, 1.0)], [(2, 1.0)]], [[(3, 1.0, 0)]], [[(0, 1.0, 1)]], [[(0, 1.0, 2)]]],
    )
    rewards = rewarded(automaton, [0, 3, 1, 0])
    # at 3 times the rate, loop 1 earns 1 in 4/3 s: less than loop 2
    found = robust(automaton, Aim.LONG_RUN, rewards, {0: (1.0, 3.0)})
    assert found.lower == pytest.approx(1.0)
    assert found.upper == pytest.approx(1.0)
    assert found.row_of[0] == 1
    assert found.corner == {0: 3.0}
    found = robust(automaton, Aim.LONG_RUN, rewards, {0: (1.0, 1.5)})
    assert found.lower == pytest.approx(2 / (2 / 3 + 1))
    assert found.row_of[0] == 0
    goal = np.array([False, False, False, True])
    time = robust(automaton, Aim.TIME_TO, None, {0: (0.5, 2.0)}, goal=goal, maximise=False)
    assert (time.lower, time.upper) == (pytest.approx(2.0), pytest.approx(2.0))


def test_an_interval_that_is_none_is_refused():
    automaton, rewards, _ = two_loops()
    with pytest.raises(UsageError, match="is not an interval"):
        robust(automaton, Aim.LONG_RUN, rewards, {0: (2.0, 1.0)})


# -- sensitivities ---------------------------------------------------------------------------------


@relaxed
@given(automata(deadlocks=False), st.sampled_from(list(Aim)))
def test_sensitivities_equal_finite_differences(problem, aim):
    automaton, rewards, goal = problem
    automaton = dataclasses.replace(automaton, fired=np.arange(len(automaton.targets)) % 3 - 1)
    weights = np.ones(len(automaton.choices))
    options = {"goal": goal, "discount": DISCOUNT, "width": 1e-11}
    try:
        base = evaluate_policy(automaton, aim, rewards, weights, **options)
    except RefusedError:
        assume(False)
    rates = np.array([2.0, 0.5])
    try:
        found = sensitivities(automaton, aim, rewards, base, rates)
    except RefusedError:
        assert np.ptp(base.gains[~np.isnan(base.gains)]) > 0
        return
    timed = automaton.tangible[automaton.row_states[automaton.arc_rows]]
    step = 1e-4
    for t, rate in enumerate(rates):
        sides = []
        for sign in (1, -1):
            scaled = np.where(timed & (automaton.fired == t), 1 + sign * step / rate, 1.0)
            other = dataclasses.replace(automaton, values=automaton.values * scaled)
            sides.append(evaluate_policy(other, aim, rewards, weights, **options).value)
        difference = (sides[0] - sides[1]) / (2 * step)
        assert found[t] == pytest.approx(difference, rel=1e-5, abs=1e-5 * max(1, abs(base.value)))
