"""The generated maps have the size of real ones, and one piece."""

import pytest

from benchmarks.sites import SITES


@pytest.mark.parametrize("site", SITES)
def test_a_site_has_190_nodes_in_one_piece_and_with_its_one_way_edge_437_edges(site):
    nodes, edges = SITES[site]()
    assert len(nodes) == 190
    assert 2 * len({frozenset(edge) for edge in edges}) + 1 == 437
    reached = {next(iter(nodes))}
    for _ in nodes:
        reached |= {b for edge in edges for b in edge if reached.intersection(edge)}
    assert reached == set(nodes)
