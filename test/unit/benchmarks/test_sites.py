"""The generated maps have the size of real ones, and one piece."""

import pytest

from benchmarks.sites import SITES


@pytest.mark.parametrize("site", SITES)
def test_a_site_is_in_one_piece_and_has_its_size(site):
    nodes, edges = SITES[site]()
    size = len(nodes), 2 * len({frozenset(edge) for edge in edges}) + 1
    assert size == ((400, 1521) if site == "grid" else (190, 437))
    reached = {next(iter(nodes))}
    for _ in nodes:
        reached |= {b for edge in edges for b in edge if reached.intersection(edge)}
    assert reached == set(nodes)
