"""Performance measures: a distribution over markings expressed for places and transitions (thesis
2.4)."""

from __future__ import annotations

import math
from typing import Callable, Dict, Mapping, Optional, Sequence, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net


class Measures:
    """Measures of a net under a distribution, either stationary or at a given time.

    :param chain: the Markov chain.
    :param distribution: float array over its states.

    >>> from gspn_framework_package.model.builder import NetBuilder
    >>> from gspn_framework_package.analysis.state_space.space import explore
    >>> from gspn_framework_package.analysis.solution.steady_state import steady_state
    >>> net = (NetBuilder().place("up", tokens=1).place("down")
    ...        .exponential("fail", rate=1.0, inputs="up", outputs="down")
    ...        .exponential("repair", rate=3.0, inputs="down", outputs="up").build())
    >>> chain = Chain.of(explore(net))
    >>> measures = Measures(chain, steady_state(chain).distribution)
    >>> round(measures.mean_tokens["up"], 12), round(measures.throughput["fail"], 12)
    (0.75, 0.75)
    """

    def __init__(self, chain: Chain, distribution: Floats) -> None:
        self.chain = chain
        self.distribution = distribution
        self._flow: Optional[Floats] = None

    @property
    def graph(self) -> RatedGraph:
        """The graph behind the chain."""
        return self.chain.graph

    @property
    def mean_tokens(self) -> Dict[str, float]:
        """Mean number of tokens in each place."""
        found = self.graph.store.means(self.chain.states, self.distribution)
        if self.graph.exchanged is not None:
            found = self.graph.exchanged.over_places(found)
        return {place.name: mean for place, mean in zip(self.graph.net.places, found)}

    @property
    def token_distribution(self) -> Dict[str, Dict[int, float]]:
        """For each place: number of tokens -> probability."""
        found = self.graph.store.distributions(self.chain.states, self.distribution)
        if self.graph.exchanged is not None:
            found = self.graph.exchanged.over_distributions(found)
        return {place.name: counts for place, counts in zip(self.graph.net.places, found)}

    def probability(self, holds: Booleans) -> float:
        """Probability of a condition.

        :param holds: boolean array over the states of the graph.
        """
        return float(self.distribution[holds[self.chain.states]].sum())

    @property
    def flows(self) -> Floats:
        """How often (1/s) each arc of the graph is taken: float array."""
        if self._flow is None:
            graph, chain = self.graph, self.chain
            weight = np.zeros(len(graph))
            weight[chain.states] = self.distribution
            timed = ~graph.vanishing[graph.sources]
            flow = np.where(timed, weight[graph.sources] * graph.values, 0.0)
            if chain.elimination is not None:
                inflow = np.bincount(graph.targets, weights=flow, minlength=len(graph))
                visits = chain.elimination.visits(inflow.astype(np.float64, copy=False))
                flow[~timed] = (visits[graph.sources] * graph.values)[~timed]
            self._flow = flow
        return self._flow

    @property
    def throughput(self) -> Dict[str, float]:
        """How often (1/s) each transition fires, immediate ones included."""
        totals: Sequence[float] = np.bincount(
            self.graph.transitions, weights=self.flows, minlength=len(self.graph.net.transitions)
        ).tolist()
        if self.graph.exchanged is not None:
            totals = self.graph.exchanged.over_transitions(totals)
        return {t.name: v for t, v in zip(self.graph.net.transitions, totals)}

    @property
    def mean_waiting_time(self) -> Dict[str, float]:
        """Mean time (s) that a token stays in each place, by Little's law: mean tokens divided by
        their arrival rate. It is infinite if tokens stay and none arrive, and NaN if there never
        are any."""
        return waiting_times(self.graph.net, self.mean_tokens, self.throughput)

    @property
    def sojourn_times(self) -> Floats:
        """Mean time (s) of a stay in each state of the chain: float array, infinite for absorbing
        states."""
        with np.errstate(divide="ignore"):
            return 1.0 / self.chain.exit_rates

    def reward(
        self,
        rates: Union[Mapping[str, float], Callable[[Indices], Floats], None] = None,
        impulses: Optional[Mapping[str, float]] = None,
    ) -> float:
        """Reward per second.

        :param rates: place -> reward per token and second; or a function from markings (int array,
            one row a state) to rewards per second (float array).
        :param impulses: transition -> reward per firing.
        :raises UsageError: the net has no place or transition of that name.
        """
        total = 0.0
        net = self.graph.net
        if callable(rates):
            total += float(
                self.distribution @ np.asarray(rates(self.graph.markings(self.chain.states)))
            )
        elif rates:
            means = self.mean_tokens
            for name, value in rates.items():
                _known(name, means, "place", net.name)
                total += value * means[name]
        if impulses:
            throughput = self.throughput
            for name, value in impulses.items():
                _known(name, throughput, "transition", net.name)
                total += value * throughput[name]
        return total


def waiting_times(
    net: Net, mean_tokens: Mapping[str, float], throughput: Mapping[str, float]
) -> Dict[str, float]:
    """See :attr:`Measures.mean_waiting_time`."""
    arrivals = {place.name: 0.0 for place in net.places}
    for t, transition in enumerate(net.transitions):
        for p, weight in net.outputs[t]:
            arrivals[net.places[p].name] += weight * throughput[transition.name]
    return {
        name: mean_tokens[name] / rate
        if rate > 0
        else (math.inf if mean_tokens[name] > 0 else math.nan)
        for name, rate in arrivals.items()
    }


def _known(name: str, names: Mapping[str, float], kind: str, net: str) -> None:
    if name not in names:
        raise UsageError("there is no %s '%s'" % (kind, name), element=net or None)
