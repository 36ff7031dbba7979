"""Both engines find what the firing rule of the model finds, in any number of words, without a silent overflow."""

import numpy as np
import pytest
from generated_nets import bounded_nets, reference_space
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gspn_framework_package.analysis.exploration import Watch
from gspn_framework_package.analysis.packing import PackedNet, starting_widths
from gspn_framework_package.analysis.state_space import explore, numba_is_there
from gspn_framework_package.benchmark.nets import kanban, philosophers
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, UsageError

ENGINES = ["numpy", pytest.param("numba", marks=pytest.mark.skipif(not numba_is_there(), reason="numba is missing"))]
relaxed = settings(deadline=None, suppress_health_check=list(HealthCheck))


def check_against_reference(space, untimed=False):
    expected = reference_space(space.net, untimed=untimed)
    markings = [tuple(m) for m in space.markings().tolist()]
    assert len(set(markings)) == len(markings)
    found = {}
    for state, marking in enumerate(markings):
        part = slice(space.offsets[state], space.offsets[state + 1])
        found[marking] = {
            int(t): markings[s] for t, s in zip(space.transitions[part].tolist(), space.targets[part].tolist())
        }
    assert found == expected


@pytest.mark.parametrize("engine", ENGINES)
@relaxed
@given(net=bounded_nets(), untimed=st.booleans())
def test_finds_what_the_firing_rule_finds(engine, net, untimed):
    check_against_reference(explore(net, engine=engine, untimed=untimed), untimed)


@pytest.mark.parametrize("engine", ENGINES)
@relaxed
@given(net=bounded_nets(), data=st.data())
def test_bounds_that_are_too_low_change_nothing(engine, net, data):
    bounds = data.draw(st.lists(st.integers(0, 1), min_size=len(net.places), max_size=len(net.places)))
    check_against_reference(explore(net, engine=engine, bounds=bounds))


@pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
@pytest.mark.parametrize("net", [kanban(2), philosophers(5), philosophers(12)], ids=lambda net: net.name)
def test_engines_number_the_states_alike(net):
    one, other = explore(net, engine="numpy"), explore(net, engine="numba")
    assert np.array_equal(one.markings(), other.markings())
    for array in ("offsets", "targets", "transitions"):
        assert np.array_equal(getattr(one, array), getattr(other, array))


@pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
@relaxed
@given(net=bounded_nets(), cores=st.integers(2, 4))
def test_cores_number_the_states_alike(net, cores):
    from gspn_framework_package.analysis import numba_engine

    packed = PackedNet(net, starting_widths(net, [8] * len(net.places)))
    with pytest.MonkeyPatch.context() as patch:
        one = numba_engine.explore(packed, 10**6, Watch(), cores=1)
        patch.setattr(numba_engine, "_SHARE", 3)
        patch.setattr(numba_engine, "_BLOCK", 1)
        many = numba_engine.explore(packed, 10**6, Watch(), cores=cores)
    for mine, theirs in zip(one, many):
        assert np.array_equal(mine, theirs)


@pytest.mark.parametrize("engine", ENGINES)
def test_several_words(engine):
    builder = NetBuilder("wide")
    for i in range(5):
        builder.place("a%d" % i, tokens=2).place("b%d" % i, tokens=2**30)
        builder.exponential("t%d" % i, inputs=["a%d" % i, "b%d" % i], outputs={"b%d" % ((i + 1) % 5): 3})
    space = explore(builder.build(), engine=engine)
    assert space.store.packing.words > 2
    check_against_reference(space)


@pytest.mark.parametrize("engine", ENGINES)
def test_counts_beyond_the_first_field_widths(engine):
    net = NetBuilder().place("a").exponential("more", outputs={"a": 1000}, inhibitors={"a": 3_000_000}).build()
    space = explore(net, engine=engine)
    assert space.column(0).max() == 3_000_000
    assert len(space) == 3001


@pytest.mark.parametrize("engine", ENGINES)
def test_the_limit_stops_an_unbounded_net(engine):
    net = NetBuilder().place("a").exponential("more", outputs="a").build()
    space = explore(net, engine=engine, limit=500)
    assert not space.complete
    assert 500 < len(space) < 5000
    assert not space.is_dead.any()
    assert space.path_to(3) == ["more"] * 3


@pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
def test_a_deep_and_narrow_graph():
    net = (NetBuilder().place("a").exponential("up", outputs="a", inhibitors={"a": 20_000})
           .exponential("down", inputs="a").build())  # fmt: skip
    space = explore(net)  # numpy, which would take a round for every state, gives up
    assert (space.engine, space.complete, len(space), space.arcs) == ("numba", True, 20_001, 40_000)
    assert space.column(0).tolist() == list(range(20_001))


@pytest.mark.parametrize("engine", ENGINES)
def test_cancel(engine):
    with pytest.raises(CancelledError):
        explore(kanban(3), engine=engine, cancel=lambda: True)


def test_progress_is_told():
    told = []
    watch = Watch(lambda what, count, seconds: told.append((what, count)), interval=0.0)
    watch.step("states", 7)
    assert told == [("states", 7)]


@pytest.mark.parametrize("engine", ENGINES)
def test_nets_without_places_or_transitions(engine):
    assert len(explore(NetBuilder().place("a", tokens=3).build(), engine=engine)) == 1
    assert len(explore(NetBuilder().build(), engine=engine)) == 1
    only = NetBuilder().exponential("t").build()
    space = explore(only, engine=engine)
    assert (len(space), space.arcs) == (1, 1)


def test_unknown_engine_and_limit():
    with pytest.raises(UsageError, match="no engine 'fast'"):
        explore(kanban(1), engine="fast")
    with pytest.raises(UsageError, match="limit of 0"):
        explore(kanban(1), limit=0)


@relaxed
@given(bounded_nets())
def test_shortest_ways_lead_there(net):
    space = explore(net)
    level = {0: 0}
    for state in range(len(space)):
        for _, target in space.successors(state):
            level.setdefault(target, level[state] + 1)
    for state in range(len(space)):
        marking = net.initial_marking
        way = space.path_to(state)
        for name in way:
            marking = net.fire(marking, net.transition_number(name))
        assert marking == space.marking(state)
        assert len(way) == level[state]
        assert space.find(marking) == state


@given(st.lists(st.tuples(st.integers(1, 62), st.integers(0, 2**62 - 1)), min_size=1, max_size=8))
def test_packing_keeps_every_count(fields):
    builder = NetBuilder()
    for i in range(len(fields)):
        builder.place("p%d" % i)
    net = builder.build()
    packed = PackedNet(net, [width for width, _ in fields])
    marking = tuple(count % (1 << width) for width, count in fields)
    states = packed.pack(marking)[None, :]
    assert tuple(packed.unpack(states)[0].tolist()) == marking
    assert np.array_equal(packed.pack_all(np.array([marking])), states)


def test_widths_hold_arc_weights_and_initial_tokens():
    net = NetBuilder().place("a", tokens=9).place("b").exponential("t", inputs={"a": 3}, outputs={"b": 70}).build()
    assert starting_widths(net, [0, 0]) == (4, 7)
