"""Where robots on a map can wait for each other in a circle, and groups that prevent it.

A robot that rests in a node holds the limits of that node, and waits for those of the next one. So
robots can wait for each other for ever only if limits that are all full wait for each other in a
circle. It takes a number of robots to fill a circle of limits, and none forms where fewer are
allowed.

Limits of one robot each that wait for each other both ways, as the nodes of a lane do, become one
limit of a single robot: it is full as soon as a robot is in any of its nodes, so that it counts as
a single node from then on. The remaining circles, such as those of one-way lanes, get a group that
holds one robot less than the smallest of them needs.
"""

from __future__ import annotations

from typing import Dict, FrozenSet, Iterable, List, Mapping, NamedTuple, Sequence, Set, Tuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from gspn_framework_package.making.site_elements import MapGroup


class WaitingCircle(NamedTuple):
    """Nodes in which robots can wait for each other in a circle.

    :ivar robots: the least number of robots that such a circle needs.
    """

    nodes: Tuple[str, ...]
    robots: int

    def group(self, capacity: int) -> MapGroup:
        """The group of these nodes, with its capacity."""
        return MapGroup(self.nodes, (), capacity)


class _Part(NamedTuple):
    """Nodes and edges that together hold a limited number of robots."""

    nodes: FrozenSet[str]
    edges: FrozenSet[Tuple[str, str]]
    capacity: int
    joined: bool = False


def waiting_circles(
    limits: Iterable[MapGroup], moves: Sequence[Tuple[str, str]]
) -> List[WaitingCircle]:
    """Return where robots can wait for each other in a circle.

    :param limits: how many robots may be in which nodes and on which edges.
    :param moves: the pairs of nodes between which robots drive.
    """
    parts = _largest(
        _Part(
            frozenset(limit.nodes),
            frozenset(pair for edge in limit.edges for pair in (edge, edge[::-1])),
            limit.capacity,
        )
        for limit in limits
        if limit.nodes
    )
    while True:
        follow = _follow(parts, moves)
        pairs = [
            (h, z)
            for h in range(len(parts))
            for z in follow[h]
            if h < z and h in follow[z] and _robots_of((parts[h], parts[z])) == 2
        ]
        if not pairs:
            break
        parts = _largest(_joined(parts, pairs))
    found = [part for part in parts if part.joined]
    circles: List[WaitingCircle] = []
    for members in _strong(follow):
        needs = _smallest_circle(parts, members, follow)
        if needs == 2:
            found = [part for part in found if part not in [parts[m] for m in members]]
        circles.append(_circle([parts[m] for m in members], needs))
    return [*(_circle([part], 2) for part in found), *circles]


def _circle(parts: Sequence[_Part], robots: int) -> WaitingCircle:
    return WaitingCircle(tuple(sorted(set().union(*(part.nodes for part in parts)))), robots)


def _largest(parts: Iterable[_Part]) -> List[_Part]:
    """The parts except those inside another one that has room for a single robot."""
    found: List[_Part] = []
    for part in sorted(parts, key=lambda part: (part.capacity, -len(part.nodes))):
        if not any(
            o.capacity == 1 and part.nodes <= o.nodes and part.edges <= o.edges for o in found
        ):
            found.append(part)
    return found


def _follow(parts: Sequence[_Part], moves: Sequence[Tuple[str, str]]) -> List[Set[int]]:
    """Number of a part -> those for which robots that rest there can wait."""
    holding: Dict[str, Set[int]] = {}
    of_edge: Dict[Tuple[str, str], Set[int]] = {}
    for number, part in enumerate(parts):
        for node in part.nodes:
            holding.setdefault(node, set()).add(number)
        for edge in part.edges:
            of_edge.setdefault(edge, set()).add(number)
    follow: List[Set[int]] = [set() for _ in parts]
    nothing: Set[int] = set()
    for a, b in moves:
        held = holding.get(a, nothing)
        wanted = (holding.get(b, nothing) | of_edge.get((a, b), nothing)) - held
        for number in held:
            follow[number] |= wanted
    return follow


def _robots_of(parts: Sequence[_Part]) -> int:
    """The least number of robots that fill parts whose robots wait for each other."""
    nodes = sum(len(part.nodes) for part in parts)
    apart = len(frozenset().union(*(part.nodes for part in parts))) == nodes
    return sum(part.capacity for part in parts) if apart else 2


def _joined(parts: Sequence[_Part], pairs: Sequence[Tuple[int, int]]) -> List[_Part]:
    """The parts, with the two of each pair joined to one that holds a single robot."""
    sources, targets = zip(*pairs)
    ones = np.ones(len(pairs), dtype=np.int8)
    matrix = sparse.coo_matrix((ones, (sources, targets)), shape=(len(parts), len(parts)))
    count, of = csgraph.connected_components(matrix, directed=False)
    together: List[List[_Part]] = [[] for _ in range(count)]
    for number, part in zip(of, parts):
        together[number].append(part)
    return [
        group[0]
        if len(group) == 1
        else _Part(
            frozenset().union(*(part.nodes for part in group)),
            frozenset().union(*(part.edges for part in group)),
            1,
            joined=True,
        )
        for group in together
    ]


def _arcs(follow: Sequence[Set[int]], weights: Mapping[int, int]) -> sparse.csr_matrix:
    """The arcs between some parts; each has the weight of the part it leads to."""
    index = {number: k for k, number in enumerate(weights)}
    arcs = [(index[h], index[z], weights[z]) for h in weights for z in follow[h] if z in weights]
    sources, targets, values = zip(*arcs) if arcs else ((), (), ())
    return sparse.csr_matrix((values, (sources, targets)), shape=(len(index), len(index)))


def _strong(follow: Sequence[Set[int]]) -> List[List[int]]:
    """The sets of parts in which each can wait for every other one, perhaps through others."""
    count, of = csgraph.connected_components(
        _arcs(follow, dict.fromkeys(range(len(follow)), 1)), connection="strong"
    )
    found: List[List[int]] = [[] for _ in range(count)]
    for number, component in enumerate(of):
        found[component].append(number)
    return [members for members in found if len(members) > 1]


def _smallest_circle(
    parts: Sequence[_Part], members: Sequence[int], follow: Sequence[Set[int]]
) -> int:
    """The least number of robots that fill a circle of some of the parts."""
    if _robots_of([parts[m] for m in members]) == 2:
        return 2
    arcs = _arcs(follow, {m: parts[m].capacity for m in members})
    away = csgraph.dijkstra(arcs)
    there = arcs.tocoo()
    return int(min(away[there.col, there.row] + there.data))
