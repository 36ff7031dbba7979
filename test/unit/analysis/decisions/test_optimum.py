"""Optimal policies: all policies enumerated, textbook problems, and what is refused."""

import dataclasses
import math
import os

import numpy as np
import pytest
from generated_automata import automata, automaton_of, best_of, rewarded, value_of
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from benchmarks.decisions import automaton_of as automaton_of_net
from benchmarks.literature.chains import tandem
from gspn_framework_package.analysis.chain import Chain
from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.analysis.decisions.automaton import Rewards
from gspn_framework_package.analysis.decisions.solving import (
    evaluate_policy,
    fixed_point,
    optimum,
)
from gspn_framework_package.analysis.solution.steady_state import steady_state
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError

EXAMPLES = int(os.environ.get("GSPN_DECISION_EXAMPLES", "40"))
relaxed = settings(
    max_examples=EXAMPLES, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck)
)
DISCOUNT = 0.3


def close(value, wanted):
    return abs(value - wanted) <= 1e-7 * max(1.0, abs(wanted))


@pytest.mark.long
@relaxed
@given(automata(), st.sampled_from(list(Aim)), st.booleans())
def test_the_bounds_hold_the_best_of_all_policies(problem, aim, maximise):
    automaton, rewards, goal = problem
    assume(np.prod(np.diff(automaton.rows)) <= 500)
    wanted = best_of(automaton, rewards, goal, DISCOUNT, aim, maximise)
    try:
        solved = optimum(
            automaton,
            aim,
            rewards,
            goal=goal,
            discount=DISCOUNT,
            maximise=maximise,
            width=1e-9,
        )
    except LimitError:
        raise
    except RefusedError as refused:
        known = ("cycle of immediate", "negative") if aim not in (Aim.REACH, Aim.TIME_TO) else ()
        assert wanted is None or math.isinf(wanted) or any(k in str(refused) for k in known)
        return
    assert wanted is not None
    assert solved.lower - 1e-8 <= wanted <= solved.upper + 1e-8
    assert close(solved.lower, wanted)
    assert close(solved.upper, wanted)
    begins_in_goal = goal[0] and aim not in (Aim.LONG_RUN, Aim.DISCOUNTED)
    policy = np.where(solved.row_of >= 0, solved.row_of, automaton.rows[:-1])
    if not begins_in_goal:
        assert close(value_of(automaton, rewards, goal, DISCOUNT, aim, policy), wanted)


@pytest.mark.long
@relaxed
@given(automata(), st.sampled_from(list(Aim)), st.randoms(use_true_random=False))
def test_evaluate_gives_the_value_of_a_policy_and_its_flows(problem, aim, random):
    automaton, rewards, goal = problem
    policy = [random.randrange(int(a), int(b)) for a, b in zip(automaton.rows, automaton.rows[1:])]
    weights = np.zeros(len(automaton.choices))
    weights[policy] = 1.0
    wanted = value_of(automaton, rewards, goal, DISCOUNT, aim, policy)
    try:
        found = evaluate_policy(automaton, aim, rewards, weights, goal=goal, discount=DISCOUNT)
    except RefusedError as refused:
        assert wanted is None or math.isinf(wanted) or "cycle of immediate" in str(refused)
        return
    assert close(found.value, wanted)
    assert found.lower <= found.value <= found.upper
    # what flows adds up to the value
    exits = automaton.exit_rates[automaton.arc_rows]
    arcs = found.flow[automaton.arc_rows] * automaton.values / np.where(exits > 0, exits, 1.0)
    if aim is Aim.TIME_TO:
        total = found.sojourn.sum()
    elif aim is Aim.REACH:
        total = arcs @ goal[automaton.targets] + float(goal[0])
    else:
        total = found.sojourn @ rewards.rate + arcs @ rewards.impulse
    assert close(total, wanted)


def test_a_policy_that_draws_is_evaluated():
    # from 0 go to 1 (1 s, worth 4) or to 2 (0.5 s, worth 1), each half of the times
    automaton = automaton_of(
        [False, True, True], [[[(1, 1.0)], [(2, 1.0)]], [[(0, 1.0)]], [[(0, 2.0)]]]
    )
    rewards = rewarded(automaton, impulse=[4.0, 1.0, 0.0, 0.0])
    found = evaluate_policy(automaton, Aim.LONG_RUN, rewards, np.array([1.0, 1.0, 1.0, 1.0]))
    assert found.value == pytest.approx(2.5 / 0.75, rel=1e-12)
    assert found.flow[:2] == pytest.approx([1 / 1.5, 1 / 1.5])
    assert found.sojourn == pytest.approx([0, 2 / 3, 1 / 3])


def test_a_policy_that_says_nothing_where_a_run_comes_is_refused():
    automaton = automaton_of([True, False], [[[(1, 1.0)]], [[(0, 1.0)], [(1, 1.0)]]])
    with pytest.raises(RefusedError, match="is undefined"):
        evaluate_policy(automaton, Aim.LONG_RUN, rewarded(automaton), np.array([1.0, 0.0, 0.0]))


# -- textbooks -------------------------------------------------------------------------------------


def discrete(actions):
    """An automaton of a process in discrete time, one second per step: ``actions[s]`` are the
    choices in state ``s``, each a pair of probabilities and reward."""
    states = len(actions)
    tangible, rows, rate = [False] * states, [], [0.0] * states
    begins = []
    for choices in actions:
        listed = []
        for probabilities, reward in choices:
            begins.append(probabilities)
            rate.append(reward)
            listed.append([(states + len(begins) - 1, 1.0)])
        rows.append(listed)
    for probabilities in begins:
        tangible.append(True)
        rows.append([[(s, p) for s, p in enumerate(probabilities) if p]])
    automaton = automaton_of(tangible, rows)
    return automaton, rewarded(automaton, rate)


def test_howards_taxi():
    """R. A. Howard, Dynamic Programming and Markov Processes (MIT Press 1960): three towns; cruise,
    go to the stand, or wait for a call."""

    def mean(probabilities, fares):
        return probabilities, float(np.dot(probabilities, fares))

    half, quarter, eighth, sixteenth = 1 / 2, 1 / 4, 1 / 8, 1 / 16
    taxi, rewards = discrete(
        [
            [
                mean([half, quarter, quarter], [10, 4, 8]),
                mean([sixteenth, 3 * quarter, 3 * sixteenth], [8, 2, 4]),
                mean([quarter, eighth, 5 * eighth], [4, 6, 4]),
            ],
            [mean([half, 0, half], [14, 0, 18]), mean([sixteenth, 14 / 16, sixteenth], [8, 16, 8])],
            [
                mean([quarter, quarter, half], [10, 2, 8]),
                mean([eighth, 3 * quarter, eighth], [6, 4, 2]),
                mean([3 * quarter, sixteenth, 3 * sixteenth], [4, 0, 8]),
            ],
        ]
    )
    cruising = np.array([1, 0, 0, 1, 0, 1, 0, 0] + [1] * 8, dtype=float)
    assert evaluate_policy(taxi, Aim.LONG_RUN, rewards, cruising).value == pytest.approx(
        9.2, abs=1e-9
    )
    best = optimum(taxi, Aim.LONG_RUN, rewards, width=1e-9)
    assert best.lower == pytest.approx(13.3445378, abs=1e-6)
    assert best.upper - best.lower <= 1e-9 * best.upper
    assert best.row_of[:3].tolist() == [1, 4, 6]  # the stand, in each town


@pytest.mark.parametrize("sweeps", [24, 20_000])
def test_a_long_run_that_hardly_ever_comes_back_to_its_start(monkeypatch, sweeps):
    """Full queues: the empty one, where the run begins, has a share of time of 1e-60. Few sweeps
    leave the rest to policies, which are too large for LU here."""
    net = tandem(31)
    space = explore(net)
    first, second = (net.place_index[name] for name in ("first", "second"))
    customers = (space.store.column(first) + space.store.column(second)).astype(float)
    automaton = automaton_of_net(space)
    for name, value in (("_SMALL", 0), ("_DIRECT", 0), ("_MOST", sweeps)):
        monkeypatch.setattr(fixed_point, name, value)
    rewards = Rewards(customers, np.zeros(len(automaton.targets)))
    found = optimum(automaton, Aim.LONG_RUN, rewards)
    chain = Chain.of(space)
    value = float(steady_state(chain).distribution @ customers[chain.states])
    assert found.lower <= value * (1 + 1e-12) and value * (1 - 1e-12) <= found.upper
    assert found.upper - found.lower <= 1e-6 * value


def test_a_discounted_machine_is_replaced_in_time():
    """A machine ages from new to worn to broken, at 0.1 per second. It earns 10, 6 and 0 per
    second; an overhaul costs 20 and makes it new at once."""
    automaton = automaton_of(
        [True, False, True, False, True],
        [
            [[(1, 0.1)]],
            [[(2, 1.0)], [(0, 1.0)]],
            [[(3, 0.1)]],
            [[(4, 1.0)], [(0, 1.0)]],
            [[]],
        ],
    )
    rewards = rewarded(automaton, [10, 0, 6, 0, 0], [0, 0, -20, 0, 0, -20])
    best = optimum(automaton, Aim.DISCOUNTED, rewards, discount=0.05, width=1e-9)
    # overhauled only when broken: V = 10/0.15 + 2/3 W, W = 6/0.15 + 2/3 (V - 20)
    broken = (10 / 0.15 + 2 / 3 * (6 / 0.15 - 2 / 3 * 20)) / (1 - 4 / 9)
    # overhauled when worn: V = 10/0.15 + 2/3 (V - 20)
    worn = (10 / 0.15 - 2 / 3 * 20) * 3
    assert best.lower == pytest.approx(max(broken, worn), rel=1e-9)
    assert best.row_of[1] == (2 if worn > broken else 1)


def test_the_spider_and_the_fly():
    """D. P. Bertsekas, Dynamic Programming and Optimal Control: on a line, the fly goes left or
    right with probability p = 0.3 each; the spider goes towards it, and next to it it either jumps
    or waits. From distance 1: jumping is best as p <= 1/3, and takes 1 / (1 - 2p)."""
    p = 0.3
    line, rewards = discrete(
        [
            [([1, 0, 0, 0], 0)],
            [([1 - 2 * p, 2 * p, 0, 0], 0), ([p, 1 - 2 * p, p, 0], 0)],
            [([p, 1 - 2 * p, p, 0], 0)],
            [([0, p, 1 - 2 * p, p], 0)],
        ]
    )
    goal = np.zeros(len(line), dtype=bool)
    goal[0] = True
    begins = dataclasses.replace(line, initial=((1, 1.0),))
    solved = optimum(begins, Aim.TIME_TO, None, goal=goal, maximise=False, width=1e-9)
    assert solved.upper == pytest.approx(1 / (1 - 2 * p), rel=1e-9)
    # distance 2: p V0 + (1 - 2p) V1 + p V2 + 1 = V2
    assert solved.values[2] == pytest.approx((1 + (1 - 2 * p) / (1 - 2 * p)) / (1 - p), rel=1e-9)


# -- rows, ties, masks -----------------------------------------------------------------------------


def choice(rewards_of_rows, allowed=None, **options):
    """A state that chooses among loops of one second each."""
    count = len(rewards_of_rows)
    automaton = automaton_of(
        [False] + [True] * count,
        [[[(k + 1, 1.0)] for k in range(count)]] + [[[(0, 1.0)]]] * count,
    )
    rewards = rewarded(automaton, impulse=list(rewards_of_rows) + [0.0] * count)
    return optimum(automaton, Aim.LONG_RUN, rewards, allowed=allowed, **options)


def test_ties_go_to_the_first_row():
    assert choice([1.0, 2.0, 2.0 + 1e-11, 2.0]).row_of[0] == 1
    assert choice([3.0, 2.0, 2.0 - 1e-11], maximise=False).row_of[0] == 1


def test_rows_that_are_not_allowed_are_not_taken():
    allowed = np.array([True, True, False, True, True, True])
    solved = choice([1.0, 2.0, 3.0], allowed)
    assert solved.row_of[0] == 1
    assert solved.upper == pytest.approx(2.0)
    assert math.isnan(solved.row_values[2])
    assert solved.row_values[1] - solved.row_values[0] == pytest.approx(1.0)
    with pytest.raises(RefusedError, match="no choice is allowed"):
        choice([1.0], np.array([False, True]))


def test_the_best_of_several_end_components_is_chosen():
    # 0 chooses between two rings that cannot be left: 1 (worth 1 per second) and 2 (3)
    automaton = automaton_of(
        [False, True, True], [[[(1, 1.0)], [(2, 1.0)]], [[(1, 1.0)]], [[(2, 1.0)]]]
    )
    rewards = rewarded(automaton, [0, 1, 3])
    best = optimum(automaton, Aim.LONG_RUN, rewards)
    assert (best.lower, best.upper) == (3.0, 3.0)
    assert best.row_of[0] == 1
    assert best.gains.tolist() == [3.0, 1.0, 3.0]
    assert best.row_values[0] == -math.inf
    assert optimum(automaton, Aim.LONG_RUN, rewards, maximise=False).lower == 1.0


# -- refused ---------------------------------------------------------------------------------------


def test_a_goal_that_is_not_reached_surely_has_no_mean_time():
    # from 0 the goal 1 or the trap 2
    automaton = automaton_of([True, True, True], [[[(1, 1.0), (2, 1.0)]], [[]], [[]]])
    goal = np.array([False, True, False])
    with pytest.raises(RefusedError, match="no policy reaches the goal with certainty"):
        optimum(automaton, Aim.TIME_TO, goal=goal, maximise=False)
    assert optimum(automaton, Aim.REACH, goal=goal).lower == pytest.approx(0.5)


def test_negative_costs_of_a_policy_that_stays_are_refused():
    # 0 may stay in 1 and earn there, or go to the goal 2
    automaton = automaton_of([False, True, True], [[[(1, 1.0)], [(2, 1.0)]], [[(0, 1.0)]], [[]]])
    goal = np.array([False, False, True])
    with pytest.raises(RefusedError, match="costs are negative"):
        optimum(automaton, Aim.COST_TO, rewarded(automaton, [0, -1, 0]), goal=goal, maximise=False)


def test_staying_for_ever_without_a_cost_does_not_reach_the_goal():
    # 0 may stay in 1 for nothing, or go to the goal for 5
    automaton = automaton_of([False, True, True], [[[(1, 1.0)], [(2, 1.0)]], [[(0, 1.0)]], [[]]])
    goal = np.array([False, False, True])
    costs = rewarded(automaton, impulse=[0, 5, 0])
    solved = optimum(automaton, Aim.COST_TO, costs, goal=goal, maximise=False)
    assert solved.lower == pytest.approx(5.0)
    assert solved.row_of[0] == 1


def test_a_reward_on_a_timeless_cycle_is_refused():
    automaton = automaton_of(
        [False, False, True], [[[(1, 1.0)], [(2, 1.0)]], [[(0, 1.0)]], [[(0, 1.0)]]]
    )
    with pytest.raises(RefusedError, match="cycle of immediate transitions earns"):
        optimum(automaton, Aim.LONG_RUN, rewarded(automaton, impulse=[1, 0, 0, 0]))
    solved = optimum(automaton, Aim.LONG_RUN, rewarded(automaton, [0, 0, 2]))
    assert solved.lower == pytest.approx(2.0)
    assert solved.row_of.tolist() == [1, 2, 3]


def test_a_timeless_trap_is_refused():
    automaton = automaton_of([False, False], [[[(1, 1.0)]], [[(0, 1.0)]]])
    with pytest.raises(RefusedError, match="timeless trap"):
        optimum(automaton, Aim.LONG_RUN, rewarded(automaton))


def test_arguments_that_make_no_sense():
    automaton = automaton_of([True], [[[]]])
    with pytest.raises(UsageError, match="width"):
        optimum(automaton, Aim.LONG_RUN, rewarded(automaton), width=1e-13)
    with pytest.raises(UsageError, match="goal"):
        optimum(automaton, Aim.REACH)
    with pytest.raises(UsageError, match="rate of discount"):
        optimum(automaton, Aim.DISCOUNTED, rewarded(automaton))
    with pytest.raises(UsageError, match="rewards"):
        optimum(automaton, Aim.LONG_RUN)
    with pytest.raises(UsageError, match="finite"):
        optimum(automaton, Aim.LONG_RUN, rewarded(automaton, [math.nan]))
