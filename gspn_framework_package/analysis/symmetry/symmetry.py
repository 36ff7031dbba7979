"""The symmetry of a net: its exchangeable parts, and the least marking of each orbit.

Let G be a group of automorphisms of a net, with its rates, weights, priorities and initial marking
(:mod:`~gspn_framework_package.analysis.symmetry.automorphisms`). A marking m and its image g(m)
enable corresponding transitions at the same rates. Hence the orbits of markings under G are a
lumping of the Markov chain: the rate from m to an orbit is the same for all m of an orbit (strong
lumpability: J. G. Kemeny and J. L. Snell, *Finite Markov Chains*, Van Nostrand, 1960, section 6.3;
for symmetries of nets, G. Chiola, C. Dutheillet, G. Franceschinis and S. Haddad, *Stochastic
well-formed colored nets and symmetric modeling applications*, IEEE Transactions on Computers
42(11), 1993).

It is therefore sufficient to visit one marking of each orbit. Since g(m0) = m0 for the initial
marking m0,

- with m every g(m) is reachable, so the number of reachable markings is the sum of the sizes of the
  visited orbits;
- the distribution over markings is the same under every g at all times: this holds at the start,
  and the rates are the same under g. It therefore also holds in the steady state (the limit of the
  means over time), with one recurrent class or several. Hence the mean count of a place p equals
  that of g(p), and so the average of the lumped chain's values over the orbit of p: the sum over
  that orbit is the same in all markings of an orbit. The same holds for the distribution of the
  count, and for the throughput of a transition.
"""

from __future__ import annotations

import math
from typing import Dict, Hashable, List, Mapping, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.symmetry.asked import is_kept
from gspn_framework_package.analysis.symmetry.automorphisms import automorphisms, orbits
from gspn_framework_package.analysis.symmetry.factors import factors_of, ones
from gspn_framework_package.model.condition import Condition
from gspn_framework_package.model.net import Net

_ROWS = 1 << 15
"""Largest number of markings reduced at once."""


class Symmetry:
    """Exchangeable parts of a net.

    :param asked: conditions that no exchange may change.
    :param distinguished: see :func:`~.automorphisms.automorphisms`.
    :ivar factors: the factors of the group used.
    :ivar generators: its generators: int arrays over places and transitions.
    :ivar unused: the number of generators of the whole group that are not used because the form of
        the group is unknown.
    :ivar place_orbits: int array: the number of the orbit of each place.
    :ivar transition_orbits: int array: the number of the orbit of each transition.
    :raises UsageError: igraph is not installed.
    """

    def __init__(
        self,
        net: Net,
        asked: Sequence[Condition] = (),
        distinguished: Optional[Sequence[Hashable]] = None,
    ) -> None:
        found = automorphisms(net, asked, distinguished)
        places = len(net.places)
        self.net = net
        self.factors, used = factors_of([generator[:places] for generator in found])
        self.generators = [found[n] for n in used]
        self.unused = len(found) - len(used)
        of = orbits(self.generators, places + len(net.transitions))
        self.place_orbits: Indices = np.unique(of[:places], return_inverse=True)[1]
        self.transition_orbits: Indices = np.unique(of[places:], return_inverse=True)[1]

    @property
    def order(self) -> int:
        """The number of permutations of the group used."""
        return math.prod(factor.order for factor in self.factors)

    def keeps(self, condition: Condition) -> bool:
        """Whether a condition on the markings of the net is the same after every exchange."""
        return is_kept(condition, [generator.tolist() for generator in self.generators])

    @property
    def text(self) -> List[str]:
        """The exchangeable parts, in words: one phrase per factor."""
        return [factor.text for factor in self.factors]

    def reduce(self, markings: Indices) -> Indices:
        """Replace markings (int array, one row per marking) by the least of their orbits, in place.

        :return: the size of each orbit.
        """
        sizes = ones(len(markings), self.order)
        for begin in range(0, len(markings), _ROWS):
            part = slice(begin, begin + _ROWS)
            counts = np.ascontiguousarray(markings[part].T)
            for factor in self.factors:
                sizes[part] = sizes[part] * factor.reduce(counts)
            markings[part] = counts.T
        return sizes

    def over_places(self, values: Sequence[float]) -> List[float]:
        """For each place, the mean of ``values`` over all places that it can be exchanged with."""
        return _over(self.place_orbits, values)

    def over_transitions(self, values: Sequence[float]) -> List[float]:
        """For each transition, the mean of ``values`` over all that it can be exchanged with."""
        return _over(self.transition_orbits, values)

    def over_distributions(
        self, distributions: Sequence[Mapping[int, float]]
    ) -> List[Dict[int, float]]:
        """For each place the mean of these distributions of its count (count -> probability)."""
        sizes = np.bincount(self.place_orbits).tolist()
        totals: List[Dict[int, float]] = [{} for _ in sizes]
        for orbit, counts in zip(self.place_orbits.tolist(), distributions):
            for n, value in counts.items():
                totals[orbit][n] = totals[orbit].get(n, 0.0) + value / sizes[orbit]
        return [dict(sorted(totals[orbit].items())) for orbit in self.place_orbits.tolist()]


def _over(orbit: Indices, values: Sequence[float]) -> List[float]:
    """For each node, the mean of ``values`` over its orbit."""
    if not len(orbit):
        return []
    return (np.bincount(orbit, weights=values) / np.bincount(orbit))[orbit].tolist()
