"""The automorphisms of a net: the permutations of its nodes that leave the net as it is.

The net becomes an undirected graph with colours: a vertex for each place, each transition and each
arc. The colour of a vertex holds everything that matters for the behaviour, so that a permutation
of equally coloured, equally linked vertices is an automorphism of the net with its rates, weights,
priorities, servers, capacities and initial marking. The library igraph finds generators of the
group, with the algorithm BLISS (T. Junttila and P. Kaski, ALENEX 2007).
"""

from __future__ import annotations

from typing import Any, Collection, Dict, Hashable, List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.graph import components
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net


def automorphisms(
    net: Net,
    fixed: Collection[str] = (),
    told_apart: Optional[Sequence[Hashable]] = None,
) -> List[Indices]:
    """Generators of the group of the automorphisms of a net.

    :param fixed: names of places that stay where they are.
    :param told_apart: a value for each transition; those with different values are not exchanged.
    :return: each generator as an int array over the nodes (the places, then the transitions): the
        node that each becomes. Only those that move a place.
    :raises UsageError: igraph is not installed.
    """
    places = len(net.places)
    nodes = places + len(net.transitions)
    colours: List[Hashable] = [
        ("place", p if place.name in fixed else -1, place.tokens, place.capacity)
        for p, place in enumerate(net.places)
    ]
    for t, transition in enumerate(net.transitions):
        behaviour: Tuple[Hashable, ...] = (
            ("timed", transition.rate, transition.servers)
            if transition.timed
            else ("immediate", transition.weight, transition.priority)
        )
        colours.append((*behaviour, told_apart[t] if told_apart else None))
    edges: List[Tuple[int, int]] = []
    for kind, rows in (("in", net.inputs), ("out", net.outputs), ("not", net.inhibitors)):
        for t, row in enumerate(rows):
            for p, weight in row:
                edges += [(p, len(colours)), (places + t, len(colours))]
                colours.append((kind, weight))
    number: Dict[Hashable, int] = {}
    graph = _igraph().Graph(n=len(colours), edges=edges)
    found = graph.automorphism_group(color=[number.setdefault(c, len(number)) for c in colours])
    moves = [np.array(generator[:nodes], dtype=np.int64) for generator in found]
    return [g for g in moves if (g[:places] != np.arange(places)).any()]


def _igraph() -> Any:
    """:raises UsageError: igraph is not installed."""
    try:
        import igraph
    except ImportError as error:
        raise UsageError(
            "symmetries are found by igraph, which is not there: %s" % error,
            hint="pip install igraph",
        ) from None
    return igraph


def orbits(generators: Sequence[Indices], nodes: int) -> Indices:
    """For each of ``nodes`` nodes, the number of the orbit that it belongs to."""
    numbers = np.arange(nodes, dtype=np.int64)
    sources = np.concatenate([numbers] * (len(generators) + 1))
    return components(nodes, sources, np.concatenate([numbers, *generators])).of
