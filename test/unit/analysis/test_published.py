"""Numbers that others published: state counts, throughputs, mean times."""

import numpy as np
import pytest

from benchmarks.nets import (
    courier,
    flexible_manufacturing,
    kanban,
    manufacturing_with_pallets,
    philosophers,
    polling,
    readers_writers,
)
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.analysis.state_space.properties import Properties


@pytest.mark.parametrize(
    ("n", "states", "arcs"), [(1, 160, 616), (2, 4600, 28120), (3, 58400, 446400)]
)
@pytest.mark.parametrize("engine", ["numpy", "auto"])
def test_kanban_states(n, states, arcs, engine):
    space = explore(kanban(n), engine=engine)
    assert (len(space), space.arcs) == (states, arcs)


def test_kanban_of_five_cards():
    space = explore(kanban(5), limit=3_000_000)
    assert space.complete and len(space) == 2546432


def test_kanban_throughput():
    """Of one card in each cell: 0.0925846346 parts per hour leave."""
    throughput = Analysis(kanban(1)).measures.throughput
    assert throughput["leave"] == pytest.approx(0.0925846346, abs=5e-11)
    assert throughput["enter"] == pytest.approx(throughput["leave"], rel=1e-12)


@pytest.mark.parametrize(("n", "tangible"), [(1, 54), (2, 810), (3, 6520)])
def test_flexible_manufacturing_states(n, tangible):
    space = explore(flexible_manufacturing(n))
    assert len(space) - int(space.is_vanishing.sum()) == tangible
    assert len(Analysis(flexible_manufacturing(n)).chain) == tangible


@pytest.mark.parametrize(
    ("n", "tangible", "productivity"), [(1, 54, 13.85312833622229), (2, 810, 29.154698799657936)]
)
@pytest.mark.parametrize("engine", ["numpy", "numba", "sparse"])
def test_flexible_manufacturing_productivity(n, tangible, productivity, engine):
    """Parts of the four kinds are worth 400, 600, 100 and 1100; they count when they are carried to
    a machine."""
    analysis = Analysis(manufacturing_with_pallets(n), engine=engine)
    assert len(analysis.chain) == tangible
    carried = analysis.measures.throughput
    worth = {"carry1": 400, "carry2": 600, "carry3": 100, "carry12": 1100}
    assert sum(v * carried[t] for t, v in worth.items()) == pytest.approx(productivity, rel=1e-10)


@pytest.mark.parametrize(("n", "tangible"), [(4, 35910), (5, 152712), (6, 537768)])
def test_flexible_manufacturing_markings(n, tangible):
    """Too many for a chain in a quick test."""
    space = explore(flexible_manufacturing(n), limit=3_000_000)
    assert space.complete
    assert len(space) - int(space.is_vanishing.sum()) == tangible


def test_courier_states_of_window_1():
    space = explore(courier(1))
    assert (len(space), len(space) - int(space.is_vanishing.sum())) == (29010, 11700)


def test_courier_chain_of_window_3():
    """As in the case studies of the APNN toolbox (P. Buchholz)."""
    chain = Analysis(courier(3)).chain
    assert (len(chain), chain.rates.nnz) == (419400, 2281620)


def test_five_readers_and_writers_all_wait_after_263_seconds():
    """The value of the Quantitative Verification Benchmark Set, which an exact solver found."""
    waiting = "want_read + want_write + wait_network_read + wait_network_write"
    passage = Analysis(readers_writers(5)).first_passage(waiting + " == 5")
    assert passage.probability == 1.0
    assert passage.mean_time == pytest.approx(263.0295996778164, rel=1e-10)


@pytest.mark.parametrize(("n", "states"), [(4, 34), (12, 39202)])
def test_philosophers_states(n, states):
    space = explore(philosophers(n))
    assert len(space) == states
    assert len(space.deadlocks) == 1
    assert sorted(space.path_to(int(space.deadlocks[0]))) == sorted(
        "take_left%d" % i for i in range(1, n + 1)
    )


def test_philosophers_starve_in_550_over_101_seconds():
    passage = Analysis(philosophers(4)).first_passage("deadlock")
    assert passage.probability == 1.0
    assert passage.mean_time == pytest.approx(550 / 101, rel=1e-12)


@pytest.mark.parametrize("n", range(1, 9))
def test_polling_states(n):
    assert len(explore(polling(n))) == 3 * n * 2 ** (n - 1)


def test_kanban_is_live_reversible_and_bounded_by_its_cards():
    properties = Properties(explore(kanban(2)))
    assert properties.live and properties.reversible
    assert properties.k_safe == 2 and set(properties.bounds.values()) == {2}
    assert len(properties.home_states) == 4600
    assert properties.deadlocks == []
    assert np.array_equal(properties.home_states, np.arange(4600))
