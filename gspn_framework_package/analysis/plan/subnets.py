"""The flow of robots into and out of the subnets of a plan."""

from __future__ import annotations

from typing import Dict, Mapping, NamedTuple, Sequence, Set, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Floats
from gspn_framework_package.model.net import Net, WeightedPlaces
from gspn_framework_package.model.plan import Plan

TITLES: Mapping[str, str] = {
    "subnet_robots": "Robots in each subnet",
    "subnet_entries": "Entries of each subnet (1/s)",
    "subnet_exits": "Exits of each subnet (1/s)",
    "subnet_time": "Mean time in each subnet (s)",
}
"""The measures of subnets, by their keys in every report."""


class SubnetFlow(NamedTuple):
    """The robots of one subnet.

    :ivar places: its places, without those of resources.
    :ivar entries: transition -> robots that enter when it fires.
    :ivar exits: transition -> robots that leave when it fires.
    """

    places: Tuple[str, ...]
    entries: Mapping[str, int]
    exits: Mapping[str, int]


class SubnetCounts(NamedTuple):
    """Observations of one subnet in some runs, as arrays with one value per run.

    :ivar inside: robots inside times seconds.
    :ivar entries: number of robots that entered.
    :ivar exits: number that left through a transition.
    """

    inside: Floats
    entries: Floats
    exits: Floats


def subnet_flows(plan: Plan) -> Dict[str, SubnetFlow]:
    """Subnet -> the flow of its robots. A transition of the surrounding plan that moves a robot
    from inside to inside ends a visit and begins another."""
    net, found = plan.net, {}
    for name, subnet in plan.subnets.items():
        places = tuple(p for p in subnet.places if p not in plan.resource_places)
        inside = {net.place_number(p) for p in places}
        inner = set(subnet.transitions)
        around = [t for t, one in enumerate(net.transitions) if one.name not in inner]
        found[name] = SubnetFlow(
            places,
            _robots(net, around, net.outputs, inside),
            _robots(net, around, net.inputs, inside),
        )
    return found


def _robots(
    net: Net, transitions: Sequence[int], arcs: Sequence[WeightedPlaces], places: Set[int]
) -> Dict[str, int]:
    """Transition -> robots that it moves along ``arcs`` into or out of ``places``, if any."""
    counts = {
        net.transitions[t].name: sum(weight for p, weight in arcs[t] if p in places)
        for t in transitions
    }
    return {name: count for name, count in counts.items() if count}


def subnet_counts(plan: Plan, net: Net, firings: Floats, tokens: Floats) -> Dict[str, SubnetCounts]:
    """Subnet -> its observations in some runs.

    :param net: the net whose transitions and places are the columns of ``firings`` and ``tokens``
        (tokens times seconds), which have a row for each run.
    """

    def total(values: Floats, index: Mapping[str, int], weights: Mapping[str, int]) -> Floats:
        columns = [index[name] for name in weights]
        return np.asarray(values[:, columns] @ np.array(list(weights.values()), dtype=np.float64))

    return {
        name: SubnetCounts(
            total(tokens, net.place_index, dict.fromkeys(flow.places, 1)),
            total(firings, net.transition_index, flow.entries),
            total(firings, net.transition_index, flow.exits),
        )
        for name, flow in subnet_flows(plan).items()
    }
