"""The nets that the check asks about: the plan's, with the losses of robots, or without what would
follow the end of a run."""

from __future__ import annotations

from typing import List, Tuple

from gspn_framework_package.model.net import Arc, Net, Place, Transition
from gspn_framework_package.model.plan import Plan


def with_end(net: Net, plan: Plan) -> Net:
    """The net without the firings after ``until``, so that the counts of a finished run are not
    explored.

    For each count that alone satisfies ``until``, every transition gets an inhibitor arc.
    """
    ends = counts_that_end(net, plan)
    if not ends:
        return net
    arcs = [Arc(place, t.name, count, True) for place, count in ends for t in net.transitions]
    return Net(net.places, net.transitions, net.arcs + tuple(arcs), net.name)


def counts_that_end(net: Net, plan: Plan) -> List[Tuple[str, int]]:
    """The places of ``net``, each with a count from which on it alone satisfies ``until``."""
    if plan.ending is None:
        return []
    enough = plan.ending.enough()
    return [(place, count) for place, count in enough if place in net.place_index and count >= 1]


def with_losses(net: Net, plan: Plan, left_out: set[str]) -> Net:
    """The net with one more transition for every action place in which a robot can be lost."""
    places: List[Place] = list(net.places)
    transitions: List[Transition] = list(net.transitions)
    arcs: List[Arc] = list(net.arcs)
    taken = set(net.place_index) | set(net.transition_index)
    for place in plan.action_places:
        name = "(robot lost in %s)" % place
        while name in taken:
            name += "'"
        transitions.append(Transition(name))
        arcs.append(Arc(place, name))
        for resource, count in plan.on_evict.get(place, {}).items():
            if resource not in left_out and count > 0:
                arcs.append(Arc(name, resource, count))
    return Net(places, transitions, arcs, net.name)
