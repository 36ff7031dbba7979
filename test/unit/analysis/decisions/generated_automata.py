"""Small Markov automata for Hypothesis, and their values by enumeration of all policies, written
with dense matrices and without the package's own solvers."""

import itertools
import math

import numpy as np
from hypothesis import strategies as st
from scipy.sparse import csgraph

from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.analysis.decisions.automaton import CHANCE, Automaton, Rewards


def automaton_of(tangible, rows, initial=((0, 1.0),)):
    """An automaton from nested lists: for each state its rows, for each row its arcs (target,
    value) or (target, value, number of the transition)."""
    offsets, arcs, targets, values, fired = [0], [0], [], [], []
    for state in rows:
        for row in state:
            for arc in row:
                targets.append(arc[0])
                values.append(arc[1])
                fired.append(arc[2] if len(arc) > 2 else -1)
            arcs.append(len(targets))
        offsets.append(len(arcs) - 1)
    return Automaton(
        np.array(tangible, dtype=bool),
        np.array(offsets, dtype=np.int64),
        np.array(arcs, dtype=np.int64),
        np.array(targets, dtype=np.int32),
        np.array(values, dtype=np.float64),
        np.array(fired, dtype=np.int32),
        np.full(len(arcs) - 1, CHANCE, dtype=np.int32),
        tuple(initial),
    )


def rewarded(automaton, rate=None, impulse=None):
    """Rewards; None: 0."""
    return Rewards(
        np.zeros(len(automaton)) if rate is None else np.array(rate, dtype=float),
        np.zeros(len(automaton.targets)) if impulse is None else np.array(impulse, dtype=float),
    )


@st.composite
def automata(draw, most=6, deadlocks=True):
    """An automaton with all kinds of cycles, and rewards that may be negative."""
    size = draw(st.integers(1, most))
    tangible = draw(st.lists(st.booleans(), min_size=size, max_size=size))
    rows = []
    for timed in tangible:
        state = []
        for _ in range(1 if timed else draw(st.integers(1, 3))):
            fewest = 0 if timed and deadlocks else 1
            targets = draw(st.lists(st.integers(0, size - 1), min_size=fewest, max_size=3))
            if timed:
                values = [draw(st.sampled_from([0.1, 1.0, 2.0, 5.0])) for _ in targets]
            else:
                parts = [draw(st.integers(1, 3)) for _ in targets]
                values = [part / sum(parts) for part in parts]
            state.append(list(zip(targets, values)))
        rows.append(state)
    automaton = automaton_of(tangible, rows)
    least = draw(st.sampled_from([0, 0, -2]))
    rate = draw(st.lists(st.integers(least, 4), min_size=size, max_size=size))
    arcs = len(automaton.targets)
    impulse = [0] * arcs
    if draw(st.booleans()):
        impulse = draw(st.lists(st.integers(min(least + 1, 0), 2), min_size=arcs, max_size=arcs))
    goal = draw(st.lists(st.booleans(), min_size=size, max_size=size))
    return automaton, rewarded(automaton, rate, impulse), np.array(goal, dtype=bool)


def policies(automaton):
    """All policies that do not draw."""
    return itertools.product(
        *(range(a, b) for a, b in zip(automaton.rows[:-1], automaton.rows[1:]))
    )


def value_of(automaton, rewards, goal, discount, aim, policy):
    """The value of a policy from state 0; None if it fires without end in zero time."""
    size = len(automaton)
    step, earned, time = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    for state in range(size):
        arcs = slice(automaton.arcs[policy[state]], automaton.arcs[policy[state] + 1])
        targets, values = automaton.targets[arcs], automaton.values[arcs].copy()
        if automaton.tangible[state]:
            leaving = values.sum() + (discount if aim is Aim.DISCOUNTED else 0.0)
            if leaving == 0:
                step[state, state] = time[state] = 1
                earned[state] = rewards.rate[state]
                continue
            values /= leaving
            time[state] = 1 / leaving
            earned[state] = rewards.rate[state] / leaving
        np.add.at(step[state], targets, values)
        earned[state] += values @ rewards.impulse[arcs]
    ends = goal if aim not in (Aim.LONG_RUN, Aim.DISCOUNTED) else np.zeros(size, dtype=bool)
    for state in np.flatnonzero(ends):
        step[state] = 0
        step[state, state] = 1
        earned[state] = time[state] = 0
    reached = np.linalg.matrix_power(np.eye(size) + (step > 0), size)[0] > 0
    _, of = csgraph.connected_components(step > 0, connection="strong")
    closed = [np.flatnonzero(of == c) for c in np.unique(of[reached])]
    closed = [c for c in closed if not (step[c][:, of != of[c[0]]] > 0).any()]
    if any(not automaton.tangible[c].any() and not ends[c].any() for c in closed):
        return None
    inner = np.zeros(size, dtype=bool)
    inner[np.concatenate(closed)] = True
    moving = np.flatnonzero(reached & ~inner)
    among = np.eye(len(moving)) - step[np.ix_(moving, moving)]
    if aim is Aim.DISCOUNTED:
        states = np.flatnonzero(reached)
        whole = np.eye(len(states)) - step[np.ix_(states, states)]
        return np.linalg.solve(whole, earned[states])[0]
    known = np.zeros(size)
    if aim in (Aim.LONG_RUN, Aim.REACH):
        for c in closed:
            if aim is Aim.REACH:
                known[c] = float(ends[c].any())
                continue
            system = np.vstack([step[np.ix_(c, c)].T - np.eye(len(c)), np.ones(len(c))])
            share = np.linalg.lstsq(system, np.append(np.zeros(len(c)), 1.0), rcond=None)[0]
            known[c] = (share @ earned[c]) / (share @ time[c])
        into = step[moving] @ known
    else:
        if any(not ends[c].any() for c in closed):
            return math.inf
        into = (time if aim is Aim.TIME_TO else earned)[moving]
    if not len(moving) or moving[0] != 0:
        return float(known[0])
    return float(np.linalg.solve(among, into)[0])


def best_of(automaton, rewards, goal, discount, aim, maximise):
    """The best value over all policies; None if each fires without end in zero time."""
    values = [value_of(automaton, rewards, goal, discount, aim, p) for p in policies(automaton)]
    values = [value for value in values if value is not None]
    return None if not values else max(values) if maximise else min(values)
