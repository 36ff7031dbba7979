"""The value of a given policy, which may be randomised, and the time that its runs spend in each
state.

Under a policy, every state has one row, in which randomised rows are mixed. That automaton has only
one policy, so its optimum is the value, with the same certificate.
"""

from __future__ import annotations

from typing import NamedTuple, Optional, Tuple

import numpy as np
from scipy import sparse

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices, Matrix
from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.analysis.decisions.automaton import CHANCE, Automaton, Rewards
from gspn_framework_package.analysis.decisions.solving import layers
from gspn_framework_package.analysis.decisions.solving.graphs import any_of_row, forward
from gspn_framework_package.analysis.decisions.solving.optima import optimum
from gspn_framework_package.analysis.graph import components_of
from gspn_framework_package.analysis.solution.linear import solve_linear as solve_linear
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import RefusedError

VALUE_WIDTH = 1e-9
"""Default width of the interval, relative to the value."""


_DIRECT_SIZE = 10_000
"""Up to this many states, flows in the long run are found by LU."""


class Evaluated(NamedTuple):
    """The value of a policy.

    :ivar value: the value from the automaton's initial states.
    :ivar lower: certified lower bound of the value.
    :ivar upper: certified upper bound.
    :ivar values: float array: the value from each state, or, in the long run, the bias. NaN where
        the policy is undefined.
    :ivar row_values: float array: the value of the state of each row if it takes this row now and
      follows the policy later.
    :ivar gains: float array: the gain per second from each state; only for the long run, otherwise
        None.
    :ivar flow: float array: the frequency of each row: per second in the long run; otherwise in the
        whole run (for DISCOUNTED: discounted).
    :ivar sojourn: float array: the time in each state. In the long run: its share; otherwise in
      seconds of the whole run (for DISCOUNTED: discounted). 0 in vanishing states.
    :ivar method: the method used.
    """

    value: float
    lower: float
    upper: float
    values: Floats
    row_values: Floats
    gains: Optional[Floats]
    flow: Floats
    sojourn: Floats
    method: str


def evaluate_policy(
    automaton: Automaton,
    aim: Aim,
    rewards: Optional[Rewards],
    weights: Floats,
    *,
    goal: Optional[Booleans] = None,
    discount: Optional[float] = None,
    width: float = VALUE_WIDTH,
    watch: Optional[Watch] = None,
) -> Evaluated:
    """The value of a policy.

    :param weights: float array over the rows: the probability with which each state takes it. The
      row of a tangible state counts as 1. States whose rows have no weight have no policy; a run
      must not reach them.
    :param goal: see :func:`~.optima.optimum`, as for the other arguments.
    :raises RefusedError: a run reaches a state without a policy, or the value is infinite.
    :raises LimitError: the bounds did not come close enough.
    """
    if aim in (Aim.LONG_RUN, Aim.DISCOUNTED):
        goal = None
    followed = follow_policy(automaton, rewards, weights, goal)
    try:
        solved = optimum(
            followed.automaton,
            aim,
            followed.rewards,
            goal=goal,
            discount=discount,
            maximise=True,
            width=width,
            allowed=followed.speaks,
            watch=watch,
        )
    except RefusedError as error:
        if not followed.speaks.all() and "allowed" in error.message:
            raise RefusedError("the policy is undefined in a state that a run reaches") from error
        raise
    sojourn, flow = flows(automaton, aim, weights, goal=goal, discount=discount, watch=watch)
    row_values = _row_values(automaton, aim, rewards, goal, solved.values)
    values, gains = solved.values, solved.gains
    bounds = 0.5 * (solved.lower + solved.upper), solved.lower, solved.upper
    return Evaluated(*bounds, values, row_values, gains, flow, sojourn, solved.method)


class Followed(NamedTuple):
    """A decision problem restricted to a policy.

    :ivar automaton: with one row per state, in which randomised rows are mixed.
    :ivar rewards: what its runs earn; None: nothing.
    :ivar arcs: int array: the original arc of each of its arcs.
    :ivar speaks: boolean array over the states: whether the policy is defined there.
    """

    automaton: Automaton
    rewards: Optional[Rewards]
    arcs: Indices
    speaks: Booleans


def follow_policy(
    automaton: Automaton, rewards: Optional[Rewards], weights: Floats, goal: Optional[Booleans]
) -> Followed:
    """The decision problem under a policy; see :func:`evaluate_policy` for the arguments."""
    rows = np.where(automaton.tangible[automaton.row_states], 1.0, np.asarray(weights, float))
    mixed, arcs = _mixed(automaton, rows)
    own = None
    if rewards is not None:
        own = Rewards(rewards.rate, np.asarray(rewards.impulse, dtype=np.float64)[arcs])
    speaks = np.bincount(automaton.row_states, weights=rows, minlength=len(automaton)) > 0
    if goal is not None:
        speaks |= goal
    return Followed(mixed, own, arcs, speaks)


def _mixed(automaton: Automaton, weights: Floats) -> Tuple[Automaton, Indices]:
    """The automaton with one row per state, and the original arc of each of its arcs."""
    total = np.bincount(automaton.row_states, weights=weights, minlength=len(automaton))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(weights > 0, weights / total[automaton.row_states], 0.0)
    kept = np.flatnonzero(share[automaton.arc_rows] > 0)
    states = automaton.row_states[automaton.arc_rows[kept]]
    arcs = np.searchsorted(states, np.arange(len(automaton) + 1))
    mixed = Automaton(
        automaton.tangible,
        np.arange(len(automaton) + 1, dtype=np.int64),
        arcs.astype(np.int64),
        automaton.targets[kept],
        automaton.values[kept] * share[automaton.arc_rows[kept]],
        automaton.fired[kept],
        np.full(len(automaton), CHANCE, dtype=np.int32),
        automaton.initial,
    )
    return mixed, kept


def _row_values(
    automaton: Automaton,
    aim: Aim,
    rewards: Optional[Rewards],
    goal: Optional[Booleans],
    values: Floats,
) -> Floats:
    """The value of each row if the policy is followed afterwards."""
    earned = np.zeros(len(automaton.choices))
    if rewards is not None and aim in (Aim.LONG_RUN, Aim.COST_TO, Aim.DISCOUNTED):
        earned = layers.earnings(automaton, rewards)
    found = earned + np.bincount(
        automaton.arc_rows,
        weights=automaton.values * np.where(np.isnan(values), 0.0, values)[automaton.targets],
        minlength=len(automaton.choices),
    )
    unknown = any_of_row(layers.arrows_of(automaton), np.isnan(values)[automaton.targets])
    found[unknown] = np.nan
    fixed = automaton.tangible if goal is None else automaton.tangible | goal
    owners = automaton.row_states
    result: Floats = np.where(fixed[owners], values[owners], found)
    return result


def flows(
    automaton: Automaton,
    aim: Aim,
    weights: Floats,
    *,
    goal: Optional[Booleans] = None,
    discount: Optional[float] = None,
    watch: Optional[Watch] = None,
) -> Tuple[Floats, Floats]:
    """The time that a policy spends in each state, and how often it takes each row; see
    :class:`Evaluated`. The arguments are those of :func:`evaluate_policy`."""
    watch = watch or Watch()
    weights = np.where(automaton.tangible[automaton.row_states], 1.0, np.asarray(weights, float))
    mixed, _ = _mixed(automaton, weights)
    long_run = aim is Aim.LONG_RUN
    size = len(automaton)
    starts = np.zeros(size)
    for state, probability in automaton.initial:
        starts[state] += probability
    ends = np.zeros(size, dtype=bool) if goal is None else goal
    arrows = layers.arrows_of(mixed)
    open_rows = ~ends
    reached = forward(arrows, np.flatnonzero(starts > 0), open_rows)
    exits: Floats = np.where(mixed.tangible, mixed.exit_rates, 1.0)
    if aim is Aim.DISCOUNTED:
        exits = np.where(mixed.tangible, exits + (discount or 0.0), 1.0)
    sources = mixed.row_states[mixed.arc_rows]
    kept = reached[sources] & ~ends[sources] & (sources != mixed.targets)
    loops = ~ends[sources] & (sources == mixed.targets)
    exits = exits - np.bincount(sources[loops], weights=mixed.values[loops], minlength=size)
    inflow = sparse.csr_matrix(
        (mixed.values[kept], (mixed.targets[kept], sources[kept])), shape=(size, size)
    )
    amount = np.zeros(size)
    if long_run:
        amount = _in_the_long_run(inflow, exits, mixed.tangible, starts, reached, watch)
    else:
        moving = np.flatnonzero(reached & ~ends & _leading(inflow, ends, exits))
        if len(moving):
            part = inflow[moving][:, moving]
            amount[moving] = solve_linear(part, exits[moving], starts[moving], watch=watch).values
    sojourn = np.where(mixed.tangible & ~ends, amount, 0.0)
    total = np.bincount(automaton.row_states, weights=weights, minlength=size)
    visits = np.where(mixed.tangible, amount * mixed.exit_rates, amount)
    visits[ends] = 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(weights > 0, weights / total[automaton.row_states], 0.0)
    return sojourn, visits[automaton.row_states] * share


def _leading(inflow: Matrix, ends: Booleans, exits: Floats) -> Booleans:
    """The states from which the run ends with certainty or is discounted: those in no closed
    class."""
    _, of, bottom = components_of(inflow.T.tocsr())
    out = np.asarray(inflow.sum(axis=0)).reshape(-1)
    leaking = exits - out > 1e-12 * np.maximum(exits, 1e-300)
    bottom[of[leaking | ends]] = False
    result: Booleans = ~bottom[of]
    return result


def _in_the_long_run(
    inflow: Matrix,
    exits: Floats,
    tangible: Booleans,
    starts: Floats,
    reached: Booleans,
    watch: Watch,
) -> Floats:
    """Share of time in the tangible states, visits per second of the vanishing ones."""
    _, of, bottom = components_of(inflow.T.tocsr())
    bottom[of[~reached]] = False
    transient = np.flatnonzero(reached & ~bottom[of])
    entering = starts.copy()
    if len(transient):
        part = inflow[transient][:, transient]
        visits = solve_linear(part, exits[transient], starts[transient], watch=watch).values
        entering = entering + inflow[:, transient] @ visits
    amount = np.zeros(len(starts))
    for number in np.flatnonzero(bottom):
        states = np.flatnonzero((of == number) & reached)
        probability = float(entering[states].sum())
        if len(states) == 1:
            amount[states] = probability
            continue
        part = inflow[states][:, states]
        # a mixture of policies with few common states is too stiff for sweeps
        found = solve_linear(part, exits[states], None, watch=watch, direct=_DIRECT_SIZE).values
        amount[states] = probability * found / float(found[tangible[states]].sum())
    return amount
