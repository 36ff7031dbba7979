"""Paths in graphs, against a plain search; and the cost of long ones."""

from collections import deque

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.analysis.graph import ShortestWays, can_reach, reachable_from


@st.composite
def graphs(draw):
    """Nodes, and arcs that are sorted by their source."""
    nodes = draw(st.integers(1, 12))
    node = st.integers(0, nodes - 1)
    arcs = sorted(draw(st.lists(st.tuples(node, node), max_size=30)), key=lambda arc: arc[0])
    sources, targets = (np.array([arc[i] for arc in arcs], dtype=np.int64) for i in (0, 1))
    return nodes, sources, targets


def distances(nodes, arcs, starts):
    """The number of arcs from the nearest of the starts to each node that can be reached."""
    found = dict.fromkeys(starts, 0)
    waiting = deque(starts)
    while waiting:
        node = waiting.popleft()
        for source, target in arcs:
            if source == node and target not in found:
                found[target] = found[node] + 1
                waiting.append(target)
    return found


@settings(derandomize=True)
@given(graphs(), st.data())
def test_ways_are_shortest_and_use_the_first_arcs_that_are_allowed(graph, data):
    nodes, sources, targets = graph
    allowed = np.array(data.draw(st.lists(st.booleans(), min_size=30, max_size=30)), dtype=bool)
    allowed = allowed[: len(sources)]
    arcs = list(zip(sources[allowed].tolist(), targets[allowed].tolist()))
    ways = ShortestWays(nodes, sources, targets, allowed)
    expected = distances(nodes, arcs, [0])
    assert set(np.flatnonzero(ways.reached)) == set(expected)
    for node, length in expected.items():
        way, at = ways.way_to(node), 0
        assert len(way) == length
        for step, arc in enumerate(way, 1):
            assert allowed[arc] and sources[arc] == at
            at = int(targets[arc])
            into = np.flatnonzero(allowed & (targets == at))
            assert arc == next(i for i in into if expected.get(int(sources[i])) == step - 1)
        assert at == node


@settings(derandomize=True)
@given(graphs(), st.data())
def test_what_can_be_reached_from_several_nodes(graph, data):
    nodes, sources, targets = graph
    starts = data.draw(st.lists(st.integers(0, nodes - 1), unique=True))
    arcs = list(zip(sources.tolist(), targets.tolist()))
    boolean = np.zeros(nodes, dtype=bool)
    boolean[starts] = True
    for start in (np.array(starts, dtype=np.int64), boolean):
        seen = reachable_from(nodes, sources, targets, start)
        assert set(np.flatnonzero(seen)) == set(distances(nodes, arcs, starts))
        seen = can_reach(nodes, sources, targets, start)
        back = [(target, source) for source, target in arcs]
        assert set(np.flatnonzero(seen)) == set(distances(nodes, back, starts))
