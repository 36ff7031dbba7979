"""How the nets of two plans differ, in words."""

from __future__ import annotations

from typing import Dict

from gspn_framework_package.model.plan import Plan


def net_difference(plan: Plan, other: Plan) -> str:
    """How the nets of two plans differ, in words; "" if they agree. Rates, weights and tokens may
    differ: runs with different ones still observe the same actions."""
    for what, one, two in (
        ("place", _places(plan), _places(other)),
        ("transition", _transitions(plan), _transitions(other)),
    ):
        for name in one:
            if name not in two:
                return "it has no %s '%s'" % (what, name)
        for name in two:
            if name not in one:
                return "it has an additional %s '%s'" % (what, name)
        for name in one:
            if one[name] != two[name]:
                return "the %s '%s' is %s there, and %s here" % (what, name, two[name], one[name])
    arcs, others = ({arc.meaning for arc in p.net.arcs} for p in (plan, other))
    if arcs != others:
        arc = min(arcs ^ others, key=str)
        return "an arc differs: from '%s' to '%s'" % (arc[0], arc[1])
    return ""


def _places(plan: Plan) -> Dict[str, str]:
    return {
        place.name: (
            "a resource place" if place.name in plan.resource_places else "an action place"
        )
        + (" with capacity %d" % place.capacity if place.capacity is not None else "")
        for place in plan.net.places
    }


def _transitions(plan: Plan) -> Dict[str, str]:
    return {
        t.name: "exponential" if t.timed else "immediate with priority %d" % t.priority
        for t in plan.net.transitions
    }
