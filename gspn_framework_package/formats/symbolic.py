"""The firing rule of a net as formulas, shared by the JANI and PRISM writers."""

from __future__ import annotations

import re
from typing import Dict, List, Mapping, NamedTuple, Optional, Sequence, Set

from gspn_framework_package.model.net import Net

_KEYWORDS = """A bool C ceil clock const ctmc deadlock double dtmc E endinit endinvariant endmodule
    endobservables endrewards endsystem F false filter floor formula func G global I init int
    invariant label log ma max mdp min mod module nondeterministic not P Pmax Pmin pomdp popta pow
    probabilistic prob pta R rate rewards Rmax Rmin S smg stochastic system true U W X and or"""
_RESERVED = frozenset(_KEYWORDS.split())
"""Words that PRISM or Storm do not accept as the name of a variable."""


class PlaceComparison(NamedTuple):
    """Compares the tokens of place number ``place`` with a number by ``operator`` (``>=``, ``<`` or
    ``<=``)."""

    place: int
    operator: str
    bound: int


def identifiers(*groups: Sequence[str]) -> List[Dict[str, str]]:
    """Make unique identifiers for model checkers, of letters, digits and ``_``; returns a
    dictionary name -> identifier for each group of names."""
    used: Set[str] = set(_RESERVED)
    return [{name: _identifier(name, used) for name in group} for group in groups]


def _identifier(name: str, used: Set[str]) -> str:
    wanted = re.sub(r"[^A-Za-z0-9_]", "_", name)
    if not re.match(r"[A-Za-z_]", wanted):
        wanted = "_" + wanted
    found, number = wanted, 1
    while found in used:
        number += 1
        found = "%s_%d" % (wanted, number)
    used.add(found)
    return found


def concession(net: Net, t: int) -> List[PlaceComparison]:
    """Return the comparisons that hold if and only if transition number ``t`` has concession
    (``Net.is_enabled``)."""
    found = [PlaceComparison(p, ">=", weight) for p, weight in net.inputs[t]]
    found += [PlaceComparison(p, "<", weight) for p, weight in net.inhibitors[t]]
    for p, change in net.effect(t):
        capacity = net.places[p].capacity
        if change > 0 and capacity is not None:
            found.append(PlaceComparison(p, "<=", capacity - change))
    return found


def priority_levels(net: Net) -> List[List[int]]:
    """Group the numbers of the immediate transitions by priority, highest first."""
    levels: Dict[int, List[int]] = {}
    for t, transition in enumerate(net.transitions):
        if not transition.timed:
            levels.setdefault(transition.priority, []).append(t)
    return [levels[priority] for priority in sorted(levels, reverse=True)]


def upper_bounds(net: Net, bounds: Mapping[str, int]) -> List[Optional[int]]:
    """Return an upper bound for the variable of each place: the given bound, else the capacity,
    else None (not known).

    It is never below 1, because Storm computes wrong numbers if a variable has only one value.
    """
    known = [bounds.get(place.name, place.capacity) for place in net.places]
    return [
        None if bound is None else max(bound, place.tokens, 1)
        for bound, place in zip(known, net.places)
    ]
