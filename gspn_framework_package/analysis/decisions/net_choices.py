"""A net of decisions: the immediate transitions of weight 0 are the choices."""

from __future__ import annotations

from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan


def plan_of_choices(net: Net) -> Plan:
    """A plan without actions and without a policy whose choices are those of the net.

    A choice is made for the tokens of a place. So the fewest places are sought (largest first)
    that are inputs of all controllable transitions and that nothing else leaves; all other places
    are resources. In the classical reading (``net``), markings and rates are those of the net, and
    the policy chooses wherever a controllable transition is enabled and no other immediate one is.

    :raises RefusedError: nothing is controllable, or a controllable transition has no such place.
    """
    left = {t for t, it in enumerate(net.transitions) if it.is_controllable}
    if not left:
        raise RefusedError(
            "the net has no choice: no immediate transition has the weight 0",
            hint="give the transitions to choose from the weight 0, or (if the file gives no "
            "weights) use --controllable",
        )
    leaving = {p: set(takers) for p, takers in enumerate(net.consumers) if left.issuperset(takers)}
    chosen = set()
    while left:
        place = max(leaving, key=lambda p: (len(left & leaving[p]), -p), default=-1)
        if place < 0 or not left & leaving[place]:
            raise RefusedError(
                "something else takes tokens from each of its inputs, so it is not clear whose "
                "choice it is",
                element=net.transitions[min(left)].name,
                hint="give it an input that only transitions of weight 0 leave",
            )
        chosen.add(place)
        left -= leaving[place]
    resources = frozenset(p.name for n, p in enumerate(net.places) if n not in chosen)
    return Plan(net, resource_places=resources).validate()
