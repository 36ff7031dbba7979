"""The automorphisms of a net: the permutations of its nodes that preserve the net.

The net becomes an undirected graph with colours: a vertex for each place, each transition and each
arc. The colour of a vertex encodes everything that matters for the behaviour, so a permutation
of equally coloured, equally linked vertices is an automorphism of the net with its rates, weights,
priorities, servers, capacities and initial marking. The library igraph finds generators of the
group, with the algorithm BLISS (T. Junttila and P. Kaski, ALENEX 2007).
"""

from __future__ import annotations

from typing import Any, Dict, Hashable, List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.graph import components
from gspn_framework_package.analysis.symmetry.asked import Terms, in_any_order
from gspn_framework_package.model.condition import Condition
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net


def automorphisms(
    net: Net,
    asked: Sequence[Condition] = (),
    distinguished: Optional[Sequence[Hashable]] = None,
) -> List[Indices]:
    """Generators of the group of the automorphisms of a net.

    :param asked: conditions to preserve.
    :param distinguished: a value for each transition; only transitions with equal values are
        exchanged.
    :return: each generator as an int array over the nodes (the places, then the transitions): the
        image of each node. Only generators that move a place are returned.
    :raises UsageError: igraph is not installed.
    """
    places = len(net.places)
    nodes = places + len(net.transitions)
    # a place that a rate or weight names is exchanged with no other
    named = net.named_by_functions()
    colours: List[Hashable] = [
        ("place", place.tokens, place.capacity, place.name if place.name in named else None)
        for place in net.places
    ]
    for t, transition in enumerate(net.transitions):
        behaviour: Tuple[Hashable, ...] = (
            ("timed", transition.rate, transition.servers)
            if transition.timed
            else ("immediate", transition.weight, transition.priority)
        )
        colours.append((*behaviour, distinguished[t] if distinguished else None))
    edges: List[Tuple[int, int]] = []
    for kind, rows in (("in", net.inputs), ("out", net.outputs), ("not", net.inhibitors)):
        for t, row in enumerate(rows):
            for p, weight in row:
                edges += [(p, len(colours)), (places + t, len(colours))]
                colours.append((kind, weight))
    _add_conditions(asked, edges, colours)
    number: Dict[Hashable, int] = {}
    graph = _igraph().Graph(n=len(colours), edges=edges)
    found = graph.automorphism_group(color=[number.setdefault(c, len(number)) for c in colours])
    moves = [np.array(generator[:nodes], dtype=np.int64) for generator in found]
    return [g for g in moves if (g[:places] != np.arange(places)).any()]


def _add_conditions(
    asked: Sequence[Condition], edges: List[Tuple[int, int]], colours: List[Hashable]
) -> None:
    """Add conditions to the graph of a net: a vertex for each of their terms (a place has one
    already), and one for each operand of a term.

    A term is coloured by its height, so no automorphism maps a term to one of its operands.
    """
    terms = Terms()
    roots = [terms.of(condition) for condition in asked]
    needed = set(roots)
    for number in range(len(terms.terms) - 1, -1, -1):
        if number in needed:  # except the inner part of a sum of three
            needed.update(terms.terms[number][1])
    vertices: Dict[int, int] = {}
    heights: Dict[int, int] = {}
    for number in sorted(needed):
        operation, parts = terms.terms[number]
        heights[number] = 1 + max((heights[part] for part in parts), default=0)
        if isinstance(operation, tuple) and operation[0] == "place":
            vertices[number] = operation[1]
            continue
        vertices[number] = len(colours)
        questions = tuple(i for i, root in enumerate(roots) if root == number)
        colours.append(("term", operation, heights[number], questions))
        for position, part in enumerate(parts):
            edges += [(vertices[number], len(colours)), (vertices[part], len(colours))]
            colours.append(("part", -1 if in_any_order(operation) else position))


def _igraph() -> Any:
    """:raises UsageError: igraph is not installed."""
    try:
        import igraph
    except ImportError as error:
        raise UsageError(
            "symmetries are found by igraph, which is not installed: %s" % error,
            hint="pip install igraph",
        ) from None
    return igraph


def orbits(generators: Sequence[Indices], nodes: int) -> Indices:
    """For each of ``nodes`` nodes, the number of the orbit that it belongs to."""
    numbers = np.arange(nodes, dtype=np.int64)
    sources = np.concatenate([numbers] * (len(generators) + 1))
    return components(nodes, sources, np.concatenate([numbers, *generators])).of
