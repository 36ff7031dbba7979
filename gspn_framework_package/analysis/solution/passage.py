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
from typing import List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.graph import can_reach, reachable_from
from gspn_framework_package.analysis.solution.linear import LinearSolution, solve_linear
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


class Passing:
    """A chain until a condition first holds: the states in which it does are absorbing, and those
    that the chain must ``avoid`` on the way.

    :ivar chain: that chain.
    :ivar there: boolean array over its states: those in which the condition holds.
    :ivar possible: whether it may hold.
    :ivar lost: whether it may never hold.
    """

    def __init__(self, graph: RatedGraph, goal: Booleans, avoid: Optional[Booleans] = None) -> None:
        """:param goal: boolean array: the states of ``graph`` in which the condition holds.
        :param avoid: boolean array: those, without ``goal``, at which it is too late.
        :raises RefusedError: there is a timeless trap.
        """
        self.chain = chain = Chain(graph, absorbing=goal if avoid is None else goal | avoid)
        self.there = goal[chain.states]
        sources = np.repeat(np.arange(len(chain)), np.diff(chain.rates.indptr))
        targets = chain.rates.indices
        visited = reachable_from(len(chain), sources, targets, chain.initial > 0)
        hopeful = can_reach(len(chain), sources, targets, self.there)
        self.possible = bool((visited & hopeful).any())
        self.lost = bool((visited & ~hopeful).any())
        self._inside = np.flatnonzero(visited & hopeful & ~self.there)
        self._among = chain.rates[self._inside][:, self._inside]
        self._exits = chain.exit_rates[self._inside]
        self._order = sweep_order(chain, self._inside)

    def probability(self, watch: Watch) -> Tuple[float, float]:
        """The probability that the condition ever holds, and the residual of the solution."""
        if not self.lost:
            return 1.0, 0.0
        solution = self._solve(self._into(), watch)
        return self._from_start(solution.values, self._at_once()), solution.residual

    def mean_time(self, watch: Watch) -> Tuple[float, float]:
        """The mean time (s) until the condition holds, and the residual of the solution."""
        if self.lost:
            return math.inf, 0.0
        solution = self._solve(np.ones(len(self._inside)), watch)
        return self._from_start(solution.values), solution.residual

    def bounded_probability(self, watch: Watch) -> Tuple[float, float]:
        """The probability that the condition ever holds, and a bound on the error of its
        computation.

        A solution x of ``e * h = b + M h`` that leaves the imbalance ``r = b + M x - e * x`` is
        wrong by ``(e - M)**-1 r``. That inverse has no negative entry, so the error is at most
        ``max(|r| / e) * n``, with ``n`` the mean number of changes of state until the end, which
        solves ``e * n = e + M n``.
        """
        if not self.lost:
            return 1.0, 0.0
        if not len(self._inside):
            return self._at_once(), 0.0
        into, exits = self._into(), self._exits
        values = self._solve(into, watch).values
        changes = self._solve(exits, watch).values
        gained = into + self._among @ values
        rounding = (np.diff(self._among.indptr) + 3) * np.finfo(float).eps
        wrong = np.abs(gained - exits * values) + rounding * (gained + exits * values)
        share = 1.0 - rounding - np.abs(1.0 - (changes - (self._among @ changes) / exits))
        if not share.min() > 0:
            return self._from_start(values, self._at_once()), 1.0
        error = float((wrong / exits).max() / share.min()) * self._from_start(changes)
        error += len(exits) * float(np.finfo(float).eps)
        return self._from_start(values, self._at_once()), min(error, 1.0)

    def _solve(self, rhs: Floats, watch: Watch) -> LinearSolution:
        if not len(rhs):
            return LinearSolution(rhs, 0.0, "LU")
        return solve_linear(
            self._among, self._exits, rhs, backward=True, order=self._order, watch=watch
        )

    def _into(self) -> Floats:
        """The rate from each state inside to those in which the condition holds."""
        into = self.chain.rates[self._inside][:, self.there].sum(axis=1)
        return np.asarray(into).reshape(-1)

    def _at_once(self) -> float:
        return float(self.chain.initial[self.there].sum())

    def _from_start(self, values: Floats, more: float = 0.0) -> float:
        return more + float(self.chain.initial[self._inside] @ values)


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
    passing = Passing(graph, goal)
    probability, worst = passing.probability(watch)
    mean, residual = passing.mean_time(watch)
    evolution = (
        transient(passing.chain, times, progress=progress, cancel=cancel, seconds=seconds)
        if len(times)
        else []
    )
    within = [float(at.distribution[passing.there].sum()) for at in evolution]
    return Passage(min(probability, 1.0), mean, within, max(worst, residual))
