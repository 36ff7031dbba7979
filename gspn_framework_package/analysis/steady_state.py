"""The steady state of a Markov chain.

The recurrent classes are found first; each has its own stationary distribution, and a probability to end up in it.
"""

from __future__ import annotations

from typing import Any, List, NamedTuple, Optional

import numpy as np

from gspn_framework_package.analysis.chain import Chain, Component
from gspn_framework_package.analysis.exploration import Cancel, Progress, Watch
from gspn_framework_package.analysis.linear import Solution, solve
from gspn_framework_package.analysis.ordering import sweep_order


class SteadyState(NamedTuple):
    """Where the chain is in the long run.

    :ivar chain: the chain.
    :ivar distribution: float array over its states: the long-run share of time in each.
    :ivar components: the recurrent classes, each with the probability to end up in it.
    :ivar residual: of the worst of the linear systems behind it, relative to its largest term.
    :ivar method: how the largest of them was solved.
    """

    chain: Chain
    distribution: Any
    components: List[Component]
    residual: float
    method: str


def steady_state(chain: Chain, *, progress: Optional[Progress] = None, cancel: Optional[Cancel] = None) -> SteadyState:
    """The steady state.

    :raises LimitError: a linear system was not solved to an acceptable residual.
    :raises CancelledError: ``cancel`` said so.
    """
    watch = Watch(progress, cancel)
    classes = chain.bottom_components()
    reached = _absorption(chain, classes, watch)
    distribution = np.zeros(len(chain))
    components, worst, method, largest = [], reached.residual, reached.method, 0
    for states, probability in zip(classes, reached.values):
        solution = stationary(chain, states, watch)
        components.append(Component(states, float(probability), solution.values))
        distribution[states] = probability * solution.values
        worst = max(worst, solution.residual)
        if len(states) > largest:
            largest, method = len(states), solution.method
    return SteadyState(chain, distribution, components, worst, method)


def stationary(chain: Chain, states: Any, watch: Optional[Watch] = None) -> Solution:
    """The stationary distribution over a recurrent class."""
    if len(states) == 1:
        return Solution(np.ones(1), 0.0, "LU")
    whole = len(states) == len(chain)
    inflow = chain.inflow if whole else chain.inflow[states][:, states]
    exits = chain.exit_rates if whole else chain.exit_rates[states]
    return solve(inflow, exits, None, order=sweep_order(chain, states), watch=watch)


def _absorption(chain: Chain, classes: List[Any], watch: Watch) -> Solution:
    """The probability to end up in each class."""
    if len(classes) == 1:
        return Solution(np.ones(1), 0.0, "LU")
    transient = np.ones(len(chain), dtype=bool)
    for states in classes:
        transient[states] = False
    inside = np.flatnonzero(transient)
    inflow = chain.initial.copy()
    worst, method = 0.0, "LU"
    if len(inside) and chain.initial[inside].any():
        among = chain.inflow[inside][:, inside]
        order = sweep_order(chain, inside)
        times = solve(among, chain.exit_rates[inside], chain.initial[inside], order=order, watch=watch)
        flows = chain.rates[inside].T @ times.values
        inflow = inflow + flows
        worst, method = times.residual, times.method
    values = np.array([inflow[states].sum() for states in classes])
    return Solution(values / values.sum(), worst, method)
