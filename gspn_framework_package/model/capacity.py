"""Rewriting of place capacities, for formats and methods that do not have them."""

from __future__ import annotations

from typing import List

from gspn_framework_package.model.errors import NetError
from gspn_framework_package.model.net import Arc, Net


def capacities_as_inhibitors(net: Net) -> Net:
    """Replace every capacity with inhibitor arcs that forbid the same firings.

    A transition that adds ``d`` tokens to a place of capacity ``c`` may fire as long as the place
    holds at most ``c - d`` tokens, which an inhibitor arc of weight ``c - d + 1`` expresses.
    Markings, enabled transitions and rates do not change (a complementary place would slow down
    multi-server transitions).

    :raises NetError: a transition can never fire, because it adds more tokens to a place than the
        place can hold."""
    if all(place.capacity is None for place in net.places):
        return net
    arcs: List[Arc] = list(net.arcs)
    for t, transition in enumerate(net.transitions):
        for p, change in net.effect(t):
            place = net.places[p]
            if place.capacity is None or change <= 0:
                continue
            if change > place.capacity:
                raise NetError(
                    "it can never fire: it adds %d tokens to '%s', which holds %d at most"
                    % (change, place.name, place.capacity),
                    element="transition '%s'" % transition.name,
                    hint="delete it, or raise the capacity",
                )
            weight = place.capacity - change + 1
            arcs.append(Arc(place.name, transition.name, weight, inhibitor=True))
    places = [place._replace(capacity=None) for place in net.places]
    return Net(places, net.transitions, arcs, net.name)
