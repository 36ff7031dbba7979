"""First passage to a condition: the mean time, the probability that it ever holds, and the
probability that it holds within a given time.

The states in which the condition holds are made absorbing, vanishing ones included: a condition
that holds for zero time counts. Let G be these states, ``q(i, j)`` the rate from state i to state
j, ``e(i)`` the sum of the rates out of i, and ``p0`` the initial distribution. The probability
``h(i)`` of ever reaching G from i and, if G is certain to be reached, the mean time ``m(i)`` until
then, are the least non-negative solutions of::

    e(i) * h(i) = sum over j in G of q(i, j) + sum over j not in G of q(i, j) * h(j)
    e(i) * m(i) = 1 + sum over j not in G of q(i, j) * m(j)

for each i not in G, with ``h = 1`` and ``m = 0`` in G. The answers are the means of ``h`` and ``m``
over ``p0``; if G may be missed, the mean time is infinite. The probability of reaching G within a
time t is the probability of G at t in the chain with G absorbing (see
:mod:`~gspn_framework_package.analysis.solution.transient`). See J. R. Norris, *Markov Chains*
(Cambridge University Press, 1997), section 3.3.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.graph import can_reach, reachable_from
from gspn_framework_package.analysis.solution.linear import solve_linear
from gspn_framework_package.analysis.solution.ordering import sweep_order
from gspn_framework_package.analysis.solution.transient import transient
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch


class Passage(NamedTuple):
    """The first time that a condition holds.

    :ivar probability: the probability that it ever holds.
    :ivar mean_time: mean time (s) until then; infinite if it may never hold.
    :ivar within: the probability that it holds within each of the requested times.
    :ivar residual: the largest residual of the linear systems behind the answer.
    """

    probability: float
    mean_time: float
    within: List[float]
    residual: float


def first_passage(
    graph: RatedGraph,
    goal: Booleans,
    times: Sequence[float] = (),
    *,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    seconds: float = math.inf,
) -> Passage:
    """The first time that a condition holds, starting from the initial marking.

    :param graph: the graph with rates.
    :param goal: boolean array: the states of ``graph`` in which the condition holds.
    :param times: times (s) for which to compute the probability that the condition has held.
    :param seconds: longest time (s) that each part of the work may take.
    :raises LimitError: a linear system was not solved to an acceptable residual, or not in time.
    :raises RefusedError: there is a timeless trap.
    """
    if goal[0]:
        return Passage(1.0, 0.0, [1.0] * len(times), 0.0)
    if not goal.any():
        return Passage(0.0, math.inf, [0.0] * len(times), 0.0)
    watch = Watch(progress, cancel, seconds=seconds)
    chain = Chain(graph, absorbing=goal)
    there = goal[chain.states]
    sources = np.repeat(np.arange(len(chain)), np.diff(chain.rates.indptr))
    targets = chain.rates.indices
    visited = reachable_from(len(chain), sources, targets, chain.initial > 0)
    hopeful = can_reach(len(chain), sources, targets, there)
    lost = bool((visited & ~hopeful).any())
    inside = np.flatnonzero(visited & hopeful & ~there)
    among = chain.rates[inside][:, inside]
    exits, order = chain.exit_rates[inside], sweep_order(chain, inside)
    worst = 0.0
    if lost:
        into = np.asarray(chain.rates[inside][:, there].sum(axis=1)).reshape(-1)
        solution = solve_linear(among, exits, into, backward=True, order=order, watch=watch)
        probability = float(chain.initial[there].sum() + chain.initial[inside] @ solution.values)
        mean = math.inf
        worst = solution.residual
    else:
        probability, mean = 1.0, 0.0
        if len(inside):
            solution = solve_linear(
                among, exits, np.ones(len(inside)), backward=True, order=order, watch=watch
            )
            mean = float(chain.initial[inside] @ solution.values)
            worst = solution.residual
    evolution = (
        transient(chain, times, progress=progress, cancel=cancel, seconds=seconds)
        if len(times)
        else []
    )
    within = [float(at.distribution[there].sum()) for at in evolution]
    return Passage(min(probability, 1.0), mean, within, worst)
