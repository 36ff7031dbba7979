"""Small automata, solved densely: what the tests of decision problems compare with."""

import numpy as np

from gspn_framework_package.analysis.graph import reachable_from


def long_run(automaton, weights):
    """How often (1/s) each arc is taken in the long run, and the share of time in each state."""
    sources = automaton.row_states[automaton.arc_rows]
    chance = automaton.values * weights[automaton.arc_rows]
    begins = [state for state, _ in automaton.initial]
    taken = chance > 0
    reached = reachable_from(len(automaton), sources[taken], automaton.targets[taken], begins)
    number = np.cumsum(reached) - 1
    count = int(reached.sum())
    inside = reached[sources] & reached[automaton.targets]
    steps = np.zeros((count, count))
    at = number[sources[inside]], number[automaton.targets[inside]]
    np.add.at(steps, at, chance[inside])
    tangible = automaton.tangible[reached]
    vanishing = ~tangible
    inner = np.eye(vanishing.sum()) - steps[np.ix_(vanishing, vanishing)]
    through = np.linalg.solve(inner, steps[np.ix_(vanishing, tangible)])
    rates = steps[np.ix_(tangible, tangible)] + steps[np.ix_(tangible, vanishing)] @ through
    start = np.zeros(count)
    for state, v in automaton.initial:
        start[number[state]] += v
    begin = start[tangible] + start[vanishing] @ through
    exits = rates.sum(axis=1)
    fastest = 1.1 * max(exits.max(), 1e-9)
    chain = rates / fastest + np.diag(1 - exits / fastest)
    for _ in range(60):
        chain = chain @ chain
        chain /= chain.sum(axis=1, keepdims=True)
    mine = begin @ chain
    inflow = mine @ steps[np.ix_(tangible, vanishing)]
    visits = np.zeros(count)
    visits[tangible] = mine
    visits[vanishing] = np.linalg.solve(inner.T, inflow)
    often = np.zeros(len(automaton))
    often[reached] = visits
    return often[sources] * chance, np.where(automaton.tangible, often, 0.0)


def best_gain(automaton, rewards, allowed, *, maximise=True, rounds=200_000, width=1e-12):
    """The best long-run reward per second from the first state, by policy iteration on the dense
    evaluation of a unichain problem, and the rows chosen."""
    sign = 1.0 if maximise else -1.0
    count, rows = len(automaton), len(automaton.choices)
    row_states = automaton.row_states
    chosen = np.full(count, -1)
    for row in range(rows - 1, -1, -1):
        if allowed[row]:
            chosen[row_states[row]] = row
    chosen = np.where(chosen < 0, automaton.rows[:-1], chosen)
    while True:
        gain, values = _evaluated(automaton, rewards, chosen)
        worth = np.zeros(rows)
        np.add.at(
            worth,
            automaton.arc_rows,
            np.where(automaton.tangible[row_states[automaton.arc_rows]], 0, automaton.values)
            * (values[automaton.targets] + rewards.impulse),
        )
        better = chosen.copy()
        for row in range(rows):
            state = row_states[row]
            gain_of = sign * (worth[row] - worth[better[state]])
            if allowed[row] and not automaton.tangible[state] and gain_of > 1e-10:
                better[state] = row
        if (better == chosen).all():
            return gain, chosen, worth, values
        chosen = better


def _evaluated(automaton, rewards, chosen):
    """The gain and the bias of a policy, from the states that it reaches."""
    count = len(automaton)
    matrix = np.zeros((count + 1, count + 1))
    right = np.zeros(count + 1)
    for state in range(count):
        row = chosen[state]
        for arc in range(automaton.arcs[row], automaton.arcs[row + 1]):
            v = automaton.values[arc]
            matrix[state, state] += v
            matrix[state, automaton.targets[arc]] -= v
            right[state] += v * rewards.impulse[arc]
        if automaton.tangible[state]:
            right[state] += rewards.rate[state]
            matrix[state, count] = 1.0  # the gain
    matrix[count, automaton.initial[0][0]] = 1.0
    found = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return found[count], found[:count]
