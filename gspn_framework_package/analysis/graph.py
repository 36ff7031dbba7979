"""Graph algorithms on state spaces: components, reachability, shortest paths.

SciPy is imported by the functions that use it: exploring a state space does not need it, and its
import takes as long as exploring 60,000 states."""

from __future__ import annotations

from bisect import bisect_left
from typing import List, NamedTuple, Optional, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices, Matrix


class Components(NamedTuple):
    """Strongly connected components: their ``number``; ``of`` (int array: the component of each
    node); ``bottom`` (boolean array over the components: no arc leaves it)."""

    number: int
    of: Indices
    bottom: Booleans


def adjacency(nodes: int, sources: Indices, targets: Indices) -> Matrix:
    """The sparse matrix with an entry for every arc."""
    from scipy import sparse

    ones = np.ones(len(targets), dtype=np.int8)
    return sparse.csr_matrix((ones, (sources, targets)), shape=(nodes, nodes))


def components(nodes: int, sources: Indices, targets: Indices) -> Components:
    """The strongly connected components of the graph with these arcs."""
    return components_of(adjacency(nodes, sources, targets))


def components_of(matrix: Matrix) -> Components:
    """The strongly connected components of the graph with an arc for every entry of a sparse
    matrix (CSR)."""
    from scipy.sparse import csgraph

    count, of = csgraph.connected_components(matrix, connection="strong")
    bottom = np.ones(count, dtype=bool)
    if count > 1:
        before = np.repeat(of, np.diff(matrix.indptr))
        bottom[before[before != of[matrix.indices]]] = False
    return Components(int(count), of, bottom)


def on_a_cycle(nodes: int, sources: Indices, targets: Indices) -> Booleans:
    """Boolean array: the nodes that are on a cycle of these arcs."""
    part = components(nodes, sources, targets).of
    found = np.bincount(part)[part] > 1
    found[sources[sources == targets]] = True
    return found


def reachable_from(
    nodes: int, sources: Indices, targets: Indices, start: Union[Indices, Booleans]
) -> Booleans:
    """Boolean array: the nodes that can be reached from ``start`` (numbers, or a boolean array),
    including ``start``."""
    begins = np.zeros(nodes, dtype=bool)
    begins[start] = True
    return search_from(adjacency(nodes, sources, targets), np.flatnonzero(begins))[0]


def search_from(matrix: Matrix, start: Indices) -> Tuple[Booleans, Indices]:
    """A search from ``start`` (numbers) along the entries of a sparse matrix (CSR).

    :return: boolean array: the nodes that it reaches, including ``start``; int array: the node
        before each of them on a shortest path; the number of nodes for ``start``.
    """
    from scipy import sparse
    from scipy.sparse import csgraph

    nodes = matrix.shape[0]
    # an additional node with an arc to each of them, since compiled code starts a search from a
    # single node
    indices = np.concatenate([matrix.indices, start])
    offsets = np.concatenate([matrix.indptr, [len(indices)]])
    ones = np.ones(len(indices), dtype=bool)
    whole = sparse.csr_matrix((ones, indices, offsets), shape=(nodes + 1, nodes + 1))
    order, before = csgraph.breadth_first_order(whole, nodes)
    seen = np.zeros(nodes + 1, dtype=bool)
    seen[order] = True
    return seen[:nodes], before[:nodes]


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
        self._sources = sources
        before, after = sources[arcs], targets[arcs]
        self.depth = depth = _depths(adjacency(nodes, before, after))
        """Int array: the number of arcs on a shortest path to each node; -1 where there is none."""
        self.reached = depth >= 0
        """Boolean array: the nodes that have a path from node 0."""
        self._parent = np.full(nodes, -1, dtype=np.int64)
        nearer = np.flatnonzero(self.reached[before] & (depth[after] == depth[before] + 1))[::-1]
        self._parent[after[nearer]] = arcs[nearer]  # of several arcs, the first: it is written last

    def way_to(self, node: int) -> List[int]:
        """The arcs of a shortest path to ``node``, which must be reachable."""
        arcs = []
        while node:
            arc = int(self._parent[node])
            arcs.append(arc)
            node = int(self._sources[arc])
        return arcs[::-1]


def _depths(matrix: Matrix) -> Indices:
    """The number of arcs on a shortest path from node 0 to each node; -1 where there is none."""
    from scipy.sparse import csgraph

    order, parents = csgraph.breadth_first_order(matrix, 0)
    place = np.empty(matrix.shape[0], dtype=np.int64)
    place[order] = np.arange(len(order))
    # Nodes in the order of their discovery have parents in the same order: a level ends where the
    # parents are no longer in the previous level.
    parent_places = place[parents[order[1:]]].tolist()
    ends = [0, 1]
    while ends[-1] < len(order):
        ends.append(1 + bisect_left(parent_places, ends[-1], lo=ends[-1] - 1))
    depth = np.full(matrix.shape[0], -1, dtype=np.int64)
    depth[order] = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    return depth


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
    from scipy import sparse

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
