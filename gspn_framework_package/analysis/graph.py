"""Graph algorithms on state spaces: components, reachability, shortest paths."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Tuple, Union

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from gspn_framework_package.analysis.arrays import Booleans, Indices, Matrix


class Components(NamedTuple):
    """Strongly connected components: their ``number``; ``of`` (int array: the component of each
    node); ``bottom`` (boolean array over the components: no arc leaves it)."""

    number: int
    of: Indices
    bottom: Booleans


def adjacency(nodes: int, sources: Indices, targets: Indices) -> Matrix:
    """The sparse matrix with an entry for every arc."""
    ones = np.ones(len(targets), dtype=np.int8)
    return sparse.csr_matrix((ones, (sources, targets)), shape=(nodes, nodes))


def components(nodes: int, sources: Indices, targets: Indices) -> Components:
    """The strongly connected components of the graph with these arcs."""
    return components_of(adjacency(nodes, sources, targets))


def components_of(matrix: Matrix) -> Components:
    """The strongly connected components of the graph with an arc for every entry of a sparse
    matrix (CSR)."""
    count, of = csgraph.connected_components(matrix, connection="strong")
    bottom = np.ones(count, dtype=bool)
    if count > 1:
        before = np.repeat(of, np.diff(matrix.indptr))
        bottom[before[before != of[matrix.indices]]] = False
    return Components(int(count), of, bottom)


def reachable_from(
    nodes: int, sources: Indices, targets: Indices, start: Union[Indices, Booleans]
) -> Booleans:
    """Boolean array: the nodes that can be reached from ``start`` (numbers, or a boolean array),
    including ``start``."""
    seen = np.zeros(nodes, dtype=bool)
    seen[start] = True
    frontier = np.flatnonzero(seen)
    if not len(frontier):
        return seen
    matrix = sparse.csr_matrix(
        (np.ones(len(targets), dtype=bool), (sources, targets)), shape=(nodes, nodes)
    )
    while len(frontier):
        reached = matrix.indices[flat_ranges(matrix.indptr[frontier], matrix.indptr[frontier + 1])]
        reached = np.unique(reached[~seen[reached]])
        seen[reached] = True
        frontier = reached
    return seen


def can_reach(
    nodes: int, sources: Indices, targets: Indices, goal: Union[Indices, Booleans]
) -> Booleans:
    """Boolean array: the nodes from which ``goal`` (numbers, or a boolean array) can be reached,
    including ``goal``."""
    return reachable_from(nodes, targets, sources, goal)


class ShortestWays:
    """Shortest paths from node 0 along the ``allowed`` arcs; arcs are sorted by source."""

    def __init__(
        self, nodes: int, sources: Indices, targets: Indices, allowed: Optional[Booleans] = None
    ) -> None:
        arcs = np.arange(len(targets)) if allowed is None else np.flatnonzero(allowed)
        self._sources, self._targets = sources, targets
        self._parent = np.full(nodes, -1, dtype=np.int64)
        self.reached = np.zeros(nodes, dtype=bool)
        """Boolean array: the nodes that have a path from node 0."""
        self.reached[0] = True
        offsets = np.searchsorted(sources[arcs], np.arange(nodes + 1))
        frontier = np.zeros(1, dtype=np.int64)
        while len(frontier):
            leaving = arcs[flat_ranges(offsets[frontier], offsets[frontier + 1])]
            leaving = leaving[~self.reached[targets[leaving]]]
            reached, first = np.unique(targets[leaving], return_index=True)
            self._parent[reached] = leaving[first]
            self.reached[reached] = True
            frontier = reached

    def way_to(self, node: int) -> List[int]:
        """The arcs of a shortest path to ``node``, which must be reachable."""
        arcs = []
        while node:
            arc = int(self._parent[node])
            arcs.append(arc)
            node = int(self._sources[arc])
        return arcs[::-1]


def flat_ranges(begins: Indices, ends: Indices) -> Indices:
    """The numbers of all ranges ``begins[i]:ends[i]``, concatenated."""
    lengths = ends - begins
    total = int(lengths.sum())
    if not total:
        return np.zeros(0, dtype=np.int64)
    filled = lengths > 0
    begins, lengths = begins[filled], lengths[filled]
    steps = np.ones(total, dtype=np.int64)
    steps[0] = begins[0]
    at = np.cumsum(lengths)[:-1]
    steps[at] = begins[1:] - begins[:-1] - lengths[:-1] + 1
    return np.cumsum(steps)


def longest_levels(nodes: int, sources: Indices, targets: Indices) -> Tuple[Indices, bool]:
    """For an acyclic graph, the length of the longest path from each node, and True. If there is a
    cycle, the second value is False."""
    waiting = np.bincount(sources, minlength=nodes)
    level = np.zeros(nodes, dtype=np.int64)
    backward = sparse.csr_matrix(
        (np.ones(len(sources), np.int8), (targets, np.arange(len(sources)))),
        shape=(nodes, max(len(sources), 1)),
    )
    frontier = np.flatnonzero(waiting == 0)
    done = len(frontier)
    depth = 0
    while len(frontier):
        depth += 1
        arcs = backward.indices[
            flat_ranges(backward.indptr[frontier], backward.indptr[frontier + 1])
        ]
        before = sources[arcs]
        np.subtract.at(waiting, before, 1)
        frontier = np.unique(before[waiting[before] == 0])
        level[frontier] = depth
        done += len(frontier)
    return level, done == nodes
