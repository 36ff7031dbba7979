"""Our answers to questions about a net, each with an interval that holds the value.

Averages in the long run, mean times and mean rewards until a condition come with the certificate of
:mod:`~gspn_framework_package.analysis.decisions.solving.optima`: a chain is a decision problem
without decisions. What is asked about a fixed time is computed by uniformisation, whose error has
the bound of :func:`~gspn_framework_package.analysis.solution.transient.truncation_and_rounding`.
"""

from __future__ import annotations

import contextlib
from functools import cached_property
from typing import Dict, Mapping, NamedTuple, Optional

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.analysis.decisions.automaton import CHANCE, Automaton, Rewards
from gspn_framework_package.analysis.decisions.solving.optima import optimum
from gspn_framework_package.analysis.solution.passage import Passing
from gspn_framework_package.analysis.solution.steady_state import SteadyState, steady_state
from gspn_framework_package.analysis.solution.transient import (
    TRUNCATION_ERROR,
    Evolution,
    poisson,
    truncation_and_rounding,
)
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph, rate
from gspn_framework_package.analysis.state_space.space import StateSpace, explore
from gspn_framework_package.analysis.symbolic.markings import MarkingCounts, count_markings
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Net

WIDTH = 1e-9
"""Largest width of an interval that is computed iteratively, relative to its value."""


CERTIFIED = 100_000
"""Averages in the long run are certified in chains of up to this many states. In larger ones, the
interval comes from the estimated errors of the stationary distribution."""


class Between(NamedTuple):
    """An interval that holds the value; both ends are the same if it is exact.

    :ivar certified: whether it surely does; otherwise, the width is an estimate.
    """

    lower: float
    upper: float
    certified: bool = True

    @classmethod
    def around(cls, value: float, error: float) -> Between:
        """The interval of all that differs from ``value`` by at most ``error``."""
        return cls(value - error, value + error)


class Subject:
    """A net about which questions are asked; what several of them need is computed once.

    :param certified: see :data:`CERTIFIED`.
    """

    def __init__(self, net: Net, certified: int = CERTIFIED) -> None:
        self.net = net
        self._certified = certified
        self.watch = Watch()
        self._occupied: Dict[float, Floats] = {}

    @cached_property
    def space(self) -> StateSpace:
        """The reachable markings."""
        return explore(self.net, limit=10**9)

    @cached_property
    def graph(self) -> RatedGraph:
        """The markings, with the rates between them."""
        return rate(self.space)

    @cached_property
    def chain(self) -> Chain:
        """The Markov chain of the tangible markings."""
        return Chain(self.graph)

    @cached_property
    def counts(self) -> MarkingCounts:
        """The numbers of markings and arcs, without visiting the markings."""
        return count_markings(self.net, watch=self.watch)

    @cached_property
    def steady(self) -> SteadyState:
        """The stationary distribution."""
        return steady_state(self.chain)

    @cached_property
    def automaton(self) -> Automaton:
        """The chain as a decision problem without decisions."""
        return automaton_of_chain(self.chain)

    # -- what is asked -----------------------------------------------------------------------------

    def holds(self, condition: str) -> Booleans:
        """In which states of the graph a condition holds."""
        found: Booleans = self.space.holds(condition)
        return found

    def pairs(self) -> int:
        """The number of pairs of different or equal states between which an arc leads."""
        graph = self.graph
        keys = graph.sources.astype(np.int64) * len(graph) + graph.targets
        return len(np.unique(keys))

    def reward(self, earned: Mapping[str, float]) -> Floats:
        """The reward per second in each state of the chain: of places for each token, of
        exponential transitions for each firing, of conditions while they hold."""
        graph, chain, net = self.graph, self.chain, self.net
        total = np.zeros(len(chain))
        impulses = np.zeros(len(net.transitions))
        for name, value in earned.items():
            if name in net.place_index:
                total += value * chain.column(net.place_index[name])
            elif name in net.transition_index:
                impulses[net.transition_index[name]] = value
            else:
                total += value * self.holds(name)[chain.states]
        if impulses.any():
            flow = graph.values * impulses[graph.transitions] * ~graph.vanishing[graph.sources]
            total += np.bincount(graph.sources, weights=flow, minlength=len(graph))[chain.states]
        return total

    def long_run(self, earned: Mapping[str, float]) -> Between:
        """The average reward per second in the long run."""
        reward = self.reward(earned)
        if len(self.chain) <= self._certified:
            rewards = Rewards(reward, np.zeros(self.chain.rates.nnz))
            with contextlib.suppress(LimitError):
                found = optimum(
                    self.automaton, Aim.LONG_RUN, rewards, width=WIDTH, watch=self.watch
                )
                return Between(found.lower, found.upper)
        value = float(self.steady.distribution @ reward)
        error = float(self.steady.errors @ np.abs(reward))
        return Between(value - error, value + error, certified=False)

    def until(self, condition: str, earned: Optional[Mapping[str, float]] = None) -> Between:
        """The mean time until a condition first holds, or the mean reward until then."""
        goal = self.holds(condition)
        passing = Passing(self.graph, goal)
        automaton = automaton_of_chain(passing.chain)
        reward = np.ones(len(automaton)) if earned is None else self.reward(earned)
        rewards = Rewards(reward, np.zeros(len(automaton.targets)))
        found = optimum(
            automaton,
            Aim.COST_TO,
            rewards,
            goal=passing.there,
            maximise=False,
            width=WIDTH,
            watch=self.watch,
        )
        return Between(found.lower, found.upper)

    def ever(self, condition: str, avoid: Optional[str] = None) -> Between:
        """The probability that a condition ever holds, before another one does."""
        passing = self._passing(condition, avoid)
        return Between.around(*passing.bounded_probability(self.watch))

    def within(self, time: float, condition: str, avoid: Optional[str] = None) -> Between:
        """The probability that a condition holds within a time, before another one does."""
        passing = self._passing(condition, avoid)
        distribution = Evolution(passing.chain, watch=self.watch).advance(time)
        value = float(distribution[passing.there].sum())
        return Between.around(value, uniformisation_error(passing.chain, time, value, 1.0))

    def at(self, time: float, earned: Mapping[str, float]) -> Between:
        """The mean reward per second at a time. Rewards are not negative."""
        reward = self.reward(earned)
        value = float(Evolution(self.chain, watch=self.watch).advance(time) @ reward)
        most = float(reward.max(initial=0.0))
        return Between.around(value, uniformisation_error(self.chain, time, value, most))

    def during(self, time: float, earned: Mapping[str, float]) -> Between:
        """The mean reward that is earned from the beginning until a time. Rewards are not
        negative."""
        reward = self.reward(earned)
        if time not in self._occupied:
            self._occupied[time] = occupation(self.chain, time, self.watch)
        value = float(self._occupied[time] @ reward)
        most = time * float(reward.max(initial=0.0))
        return Between.around(value, uniformisation_error(self.chain, time, value, most))

    def _passing(self, condition: str, avoid: Optional[str]) -> Passing:
        goal = self.holds(condition)
        return Passing(self.graph, goal, None if avoid is None else self.holds(avoid) & ~goal)


def automaton_of_chain(chain: Chain) -> Automaton:
    """A Markov chain as a decision problem without decisions."""
    rates, states = chain.rates, len(chain)
    starts = np.flatnonzero(chain.initial)
    return Automaton(
        np.ones(states, dtype=bool),
        np.arange(states + 1),
        rates.indptr.astype(np.int64),
        rates.indices.astype(np.int32),
        rates.data,
        np.full(rates.nnz, -1, dtype=np.int32),
        np.full(states, CHANCE, dtype=np.int32),
        tuple((int(s), float(chain.initial[s])) for s in starts),
    )


def occupation(chain: Chain, time: float, watch: Watch) -> Floats:
    """The mean time that is spent in each state until a time.

    With the ticks of :mod:`~gspn_framework_package.analysis.solution.transient` at rate c, the mean
    time after exactly k of them, within ``time``, is 1/c times the probability of more than k.
    """
    clock = float(chain.exit_rates.max(initial=0.0)) * 1.02
    first, weights = poisson(clock * time)
    more = np.concatenate([np.ones(first), np.cumsum(weights[::-1])[::-1][1:], [0.0]])
    moves, stays = chain.inflow / clock, 1.0 - chain.exit_rates / clock
    vector = chain.initial
    total = np.zeros(len(chain))
    for k, share in enumerate(more.tolist()):
        total += share * vector
        vector = stays * vector + moves @ vector
        if k % 64 == 63:
            watch.step("ticks", k)
    spent: Floats = total / clock
    return spent


def uniformisation_error(chain: Chain, time: float, value: float, most: float) -> float:
    """A bound of the error of a sum that uniformisation found.

    :param value: the sum. Nothing in it is negative, so rounding is relative to it; it may be three
      times that of a tick's sums, since ``1 - e / c`` is at least 0.02 and thus exact to 51 ulps.
    :param most: the largest possible value, of which the truncation omits a part.
    """
    truncation = 2 * TRUNCATION_ERROR
    rounding = truncation_and_rounding(chain, time) - truncation
    return 3 * rounding * abs(value) + truncation * most
