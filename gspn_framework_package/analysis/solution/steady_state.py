"""The steady state of a Markov chain.

The recurrent classes are found first; each has its own stationary distribution, and a probability
that the chain ends up in it. Let ``q(i, j)`` be the rate from state i to state j, ``e(i)`` the sum
of the rates out of i, and ``p0`` the initial distribution. The stationary distribution ``pi`` of a
class C balances the flow into and out of each state::

    e(j) * pi(j) = sum over i in C of pi(i) * q(i, j)        for each j in C
    sum over j in C of pi(j) = 1

With several classes, let T be the transient states and ``tau(j)`` the mean total time in j. Then
the probability ``P(C)`` of ending up in C is given by::

    e(j) * tau(j) = p0(j) + sum over i in T of tau(i) * q(i, j)        for each j in T
    P(C) = sum over j in C of (p0(j) + sum over i in T of tau(i) * q(i, j))

and the long-run share of time in a state j of C is ``P(C) * pi(j)``. See W. J. Stewart,
*Introduction to the Numerical Solution of Markov Chains* (Princeton University Press, 1994), and
for the absorption J. G. Kemeny and J. L. Snell, *Finite Markov Chains* (Van Nostrand, 1960),
chapter 3. The chain of the tangible markings of a GSPN is defined as in M. Ajmone Marsan et al.,
*Modelling with Generalized Stochastic Petri Nets* (Wiley, 1995).
"""

from __future__ import annotations

import math
from typing import Iterator, List, NamedTuple, Optional, Tuple

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from gspn_framework_package.analysis.arrays import Floats, Indices, Matrix
from gspn_framework_package.analysis.chain.markov_chain import Chain, Component
from gspn_framework_package.analysis.graph import flat_ranges
from gspn_framework_package.analysis.solution.linear import (
    ACCEPTED,
    LinearSolution,
    polished,
    solve_linear,
)
from gspn_framework_package.analysis.solution.ordering import sweep_order
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch


class SteadyState(NamedTuple):
    """The long-run distribution of a chain.

    :ivar distribution: float array over its states: the long-run share of time in each.
    :ivar components: the recurrent classes, ordered by their first state, each with the probability
      of ending up in it.
    :ivar residual: the largest residual of the linear systems behind it, relative to the largest
      term of the system.
    :ivar errors: float array: the estimated absolute error of each entry of the distribution.
    :ivar method: the method that solved the largest of these systems.
    """

    chain: Chain
    distribution: Floats
    components: List[Component]
    residual: float
    errors: Floats
    method: str

    def likeliest(self, number: int) -> List[Component]:
        """The ``number`` recurrent classes in which the chain most probably ends up, the most
        probable first."""
        return sorted(self.components, key=lambda c: (-c.probability, int(c.states[0])))[:number]


BLOCK_SIZE = 2_000
"""If there are several recurrent classes, those of up to this many states are solved together."""


def steady_state(
    chain: Chain,
    *,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    seconds: float = math.inf,
) -> SteadyState:
    """The steady state of a chain.

    :param seconds: longest time (s) that the work may take.
    :raises LimitError: a linear system was not solved to an acceptable residual, or not in time.
    :raises CancelledError: ``cancel`` returned true.
    """
    watch = Watch(progress, cancel, seconds=seconds)
    classes = chain.bottom_components()
    reached, doubts = _absorption(chain, classes, watch)
    distribution, errors = np.zeros(len(chain)), np.zeros(len(chain))
    components, worst, method, largest = [], reached.residual, reached.method, 0
    for states, probability, doubt, (solution, relative) in zip(
        classes, reached.values, doubts, _stationary_in_each(chain, classes, watch)
    ):
        components.append(Component(states, float(probability), solution.values))
        distribution[states] = probability * solution.values
        errors[states] = distribution[states] * np.minimum(relative + doubt, 1.0)
        worst = max(worst, solution.residual)
        if len(states) > largest:
            largest, method = len(states), solution.method
    return SteadyState(chain, distribution, components, worst, errors, method)


def _stationary_in_each(
    chain: Chain, classes: List[Indices], watch: Watch
) -> Iterator[Tuple[LinearSolution, Floats]]:
    """The stationary distribution over each recurrent class, in their order, and the relative error
    of its entries."""
    several = [states for states in classes if 1 < len(states) <= BLOCK_SIZE]
    together = iter(_stationary_together(chain, several) if len(several) > 1 else [])
    for count, states in enumerate(classes):
        if count % 64 == 0:
            watch.step("recurrent classes", count)
        if len(states) == 1:
            yield LinearSolution(np.ones(1), 0.0, "LU"), np.zeros(1)
            continue
        solution = next(together, None) if len(states) <= BLOCK_SIZE else None
        if solution is None or not solution.residual <= ACCEPTED:
            yield stationary(chain, states, watch)
            continue
        # each imbalance may come from any entry
        terms = chain.exit_rates[states] * solution.values
        wrong = max(solution.residual, np.finfo(float).eps) * terms.max()
        with np.errstate(divide="ignore"):
            yield solution, np.minimum(np.where(terms > 0, wrong / terms, 0.0), 1.0)


def _stationary_together(chain: Chain, classes: List[Indices]) -> List[LinearSolution]:
    """The stationary distributions over small recurrent classes, by one decomposition. No arc leads
    from one class to another, so each is a block of the matrix, solved relative to its first
    state."""
    order = np.concatenate(classes)
    ends = np.cumsum([len(states) for states in classes])
    begins = ends - [len(states) for states in classes]
    inflow = _part(chain.inflow, order, len(chain))
    exits = chain.exit_rates[order]
    given = np.zeros(len(order), dtype=bool)
    given[begins] = True
    unknown = np.flatnonzero(~given)
    system = (sparse.diags(exits) - inflow).tocsc()[:, unknown].tocsr()[unknown].tocsc()
    values = np.ones(len(order))
    try:
        factor = linalg.splu(system)
        values[unknown] = np.maximum(factor.solve(inflow[unknown] @ given.astype(np.float64)), 0.0)
    except (RuntimeError, MemoryError):  # singular, or out of memory
        return []
    values /= np.repeat(np.add.reduceat(values, begins), ends - begins)
    terms = exits * values
    imbalance = np.maximum.reduceat(np.abs(terms - inflow @ values), begins)
    scale = np.maximum.reduceat(terms, begins)
    return [
        LinearSolution(values[begin:end], float(wrong / size), "LU")
        for begin, end, wrong, size in zip(begins, ends, imbalance, scale)
    ]


def _part(matrix: Matrix, states: Indices, size: int) -> Matrix:
    """The rows and columns ``states`` of a square sparse matrix (CSR) in which these states are
    connected only to each other."""
    number = np.full(size, -1, dtype=matrix.indices.dtype)
    number[states] = np.arange(len(states))
    begin, end = matrix.indptr[states], matrix.indptr[states + 1]
    entries = flat_ranges(begin, end)
    columns = number[matrix.indices[entries]]
    inside = columns >= 0
    counts = np.concatenate([[0], np.cumsum(inside)])
    offsets = counts[np.concatenate([[0], np.cumsum(end - begin)])]
    return sparse.csr_matrix(
        (matrix.data[entries][inside], columns[inside], offsets), shape=(len(states), len(states))
    )


def stationary(
    chain: Chain, states: Indices, watch: Optional[Watch] = None
) -> Tuple[LinearSolution, Floats]:
    """The stationary distribution over a recurrent class, with the relative error of each entry."""
    if len(states) == 1:
        return LinearSolution(np.ones(1), 0.0, "LU"), np.zeros(1)
    whole = len(states) == len(chain)
    inflow = chain.inflow if whole else _part(chain.inflow, states, len(chain))
    exits = chain.exit_rates if whole else chain.exit_rates[states]
    order = sweep_order(chain, states)
    found = solve_linear(inflow, exits, None, order=order, watch=watch)
    return polished(inflow, exits, None, found, order, watch)


def _absorption(
    chain: Chain, classes: List[Indices], watch: Watch
) -> Tuple[LinearSolution, Floats]:
    """The probability of ending up in each class, and its relative error."""
    if len(classes) == 1:
        return LinearSolution(np.ones(1), 0.0, "LU"), np.zeros(1)
    transient = np.ones(len(chain), dtype=bool)
    transient[np.concatenate(classes)] = False
    inside = np.flatnonzero(transient)
    inflow = chain.initial.copy()
    doubt = np.zeros(len(chain))
    worst, method = 0.0, "LU"
    if len(inside) and chain.initial[inside].any():
        among = _part(chain.inflow, inside, len(chain))
        order = sweep_order(chain, inside)
        times = solve_linear(
            among, chain.exit_rates[inside], chain.initial[inside], order=order, watch=watch
        )
        times, relative = polished(
            among, chain.exit_rates[inside], chain.initial[inside], times, order, watch
        )
        inflow = inflow + chain.rates[inside].T @ times.values
        doubt = chain.rates[inside].T @ (times.values * relative)
        worst, method = times.residual, times.method
    order = np.concatenate(classes)
    begins = np.cumsum([0] + [len(states) for states in classes[:-1]])
    values = np.add.reduceat(inflow[order], begins)
    errors = np.add.reduceat(doubt[order], begins)
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = np.where(values > 0, errors / values, 0.0)
    return LinearSolution(values / values.sum(), worst, method), errors
