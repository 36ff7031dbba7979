"""All engines find what the firing rule of the model finds, in any number of words, without a
silent overflow."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from generated_nets import bounded_nets, reference_space
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from waiting import PATIENCE

from benchmarks.large_nets import ring, star
from benchmarks.nets import kanban, philosophers
from gspn_framework_package.analysis.compiling import compiled, numba_is_there
from gspn_framework_package.analysis.state_space import numpy_engine, sparse_engine
from gspn_framework_package.analysis.state_space.packing import PackedNet, starting_widths
from gspn_framework_package.analysis.state_space.space import explore
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, LimitError, UsageError
from gspn_framework_package.model.net import MAX_COUNT, Arc, Net, Place, Transition

ENGINES = [
    "numpy",
    "sparse",
    pytest.param(
        "numba", marks=pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
    ),
]
relaxed = settings(deadline=None, suppress_health_check=list(HealthCheck))


def check_against_reference(space, untimed=False):
    expected = reference_space(space.net, untimed=untimed)
    markings = [tuple(m) for m in space.markings().tolist()]
    assert len(set(markings)) == len(markings)
    found = {}
    for state, marking in enumerate(markings):
        part = slice(space.offsets[state], space.offsets[state + 1])
        found[marking] = {
            int(t): markings[s]
            for t, s in zip(space.transitions[part].tolist(), space.targets[part].tolist())
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
    bounds = data.draw(
        st.lists(st.integers(0, 1), min_size=len(net.places), max_size=len(net.places))
    )
    check_against_reference(explore(net, engine=engine, bounds=bounds))


@pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
@pytest.mark.parametrize(
    "net", [kanban(2), philosophers(5), philosophers(12)], ids=lambda net: net.name
)
def test_engines_number_the_states_alike(net):
    one, other = explore(net, engine="numpy"), explore(net, engine="numba")
    assert np.array_equal(one.markings(), other.markings())
    for array in ("offsets", "targets", "transitions"):
        assert np.array_equal(getattr(one, array), getattr(other, array))


@pytest.mark.parametrize(("whole", "many"), [(10**6, 64), (0, 64), (0, 1)])
@relaxed
@given(net=bounded_nets(), data=st.data())
def test_sparse_markings_answer_as_packed_ones(whole, many, net, data):
    packed = explore(net, engine="numpy")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sparse_engine, "_MANY", many)  # transitions that fire together, or one by one
        # shown as they are, or as what differs from the initial one
        patch.setattr(sparse_engine, "_WHOLE", whole)
        sparse = explore(net, engine="sparse")
    assert np.array_equal(packed.markings(), sparse.markings())
    for array in ("offsets", "targets", "transitions"):
        assert np.array_equal(getattr(packed, array), getattr(sparse, array))
    chosen = np.array(sorted(data.draw(st.sets(st.integers(0, len(packed) - 1), min_size=1))))
    assert np.array_equal(packed.markings(chosen), sparse.markings(chosen))
    for p in range(len(net.places)):
        assert np.array_equal(packed.column(p), sparse.column(p))
        assert np.array_equal(packed.column(p, chosen), sparse.column(p, chosen))
    assert packed.store.largest() == sparse.store.largest()
    for state in chosen.tolist():
        assert sparse.find(packed.marking(state)) == state
    assert sparse.find([99] * len(net.places)) is None
    weights = np.array(
        data.draw(
            st.lists(st.sampled_from([0.0, 0.25, 1.0]), min_size=len(chosen), max_size=len(chosen))
        )
    )
    assert sparse.store.means(chosen, weights) == pytest.approx(packed.store.means(chosen, weights))
    for one, other in zip(
        packed.store.distributions(chosen, weights), sparse.store.distributions(chosen, weights)
    ):
        assert one == pytest.approx(other)
    assert np.array_equal(packed.holds("p0 > p1 or deadlock"), sparse.holds("p0 > p1 or deadlock"))


@pytest.mark.parametrize("engine", ENGINES)
def test_too_little_memory_or_time_ends_it_and_is_said(engine):
    space = explore(philosophers(12), engine=engine, memory=100_000)
    assert (
        not space.complete
        and space.shortage[0] == "--limit-memory"
        and "--limit-memory" in space.hint
    )
    space = explore(philosophers(12), engine=engine, seconds=0.0)
    assert not space.complete and space.shortage[0] == "--limit-time" and "0 s" in space.extent


def test_nets_of_thousands_of_places_are_explored_by_what_changes():
    space = explore(ring(3_000))
    assert (space.engine, len(space), space.complete) == ("sparse", 3_000, True)
    assert space.path_to(2) == ["t0", "t1"] and space.named(2_999) == {"p2999": 1}


def test_a_place_with_thousands_of_transitions(monkeypatch):
    looked_at = []
    is_enabled = sparse_engine._Rules._is_enabled
    monkeypatch.setattr(
        sparse_engine._Rules, "_is_enabled", lambda *args: looked_at.append(1) or is_enabled(*args)
    )
    space = explore(star(2_000), engine="sparse")
    assert (len(space), space.arcs, space.complete) == (2_001, 4_000, True)
    assert len(looked_at) < 20_000  # not all of them in every marking


# more than 2**62 tokens, and more than a machine word holds
@pytest.mark.parametrize("arcs", [600, 1_100])
def test_a_count_that_is_too_large_is_reported(arcs):
    # enough for their transitions to fire together
    places = [Place("p%d" % i, 1) for i in range(100)]
    transitions = [Transition("t%d" % i, timed=True) for i in range(100)]
    taking = [Arc("p%d" % i, "t%d" % i) for i in range(100)]
    net = Net([*places, Place("much")], transitions, taking + [Arc("t3", "much", MAX_COUNT)] * arcs)
    with pytest.raises(LimitError, match="a count of place 'much' exceeds"):
        explore(net, engine="sparse")


@pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
@relaxed
@given(net=bounded_nets(), cores=st.integers(2, 4), rounds=st.integers(0, 3))
def test_cores_and_engines_number_the_states_alike(net, cores, rounds):
    from gspn_framework_package.analysis.state_space import numba_engine

    packed = PackedNet(net, starting_widths(net, [8] * len(net.places)))
    new_buffers, fenced = numba_engine._new_buffers, []

    def between_fences(array):
        around = np.full(array.size + 200, 7, dtype=array.dtype)
        inside = around[100:-100].reshape(array.shape)
        inside[...] = array
        fenced.append(around)
        return inside

    with pytest.MonkeyPatch.context() as patch:
        one = numba_engine.explore(packed, 10**6, Watch(), cores=1)
        patch.setattr(numba_engine, "_SHARE", 3)
        patch.setattr(numba_engine, "_BLOCK", 1)
        patch.setattr(
            numba_engine,
            "_new_buffers",
            lambda *args: numba_engine._Buffers(*map(between_fences, new_buffers(*args))),
        )
        many = numba_engine.explore(packed, 10**6, Watch(), cores=cores)
        begun = numpy_engine.explore(packed, 10**6, Watch(), rounds=rounds)
        continued = numba_engine.explore(packed, 10**6, Watch(), cores=cores, begun=begun)
    for mine, theirs, and_theirs in zip(one, many, continued):
        assert np.array_equal(mine, theirs) and np.array_equal(mine, and_theirs)
    for around in fenced:
        outside = np.concatenate([around[:100], around[-100:]])
        assert np.all(outside == 7), "written outside of a buffer"


@pytest.mark.parametrize("engine", ENGINES)
def test_several_words(engine):
    builder = NetBuilder("wide")
    for i in range(5):
        builder.place("a%d" % i, tokens=2).place("b%d" % i, tokens=2**30)
        builder.exponential(
            "t%d" % i, inputs=["a%d" % i, "b%d" % i], outputs={"b%d" % ((i + 1) % 5): 3}
        )
    space = explore(builder.build(), engine=engine)
    assert engine == "sparse" or space.store.packing.words > 2
    check_against_reference(space)


@pytest.mark.parametrize("engine", ENGINES)
def test_counts_beyond_the_first_field_widths(engine):
    net = (
        NetBuilder()
        .place("a")
        .exponential("more", outputs={"a": 1000}, inhibitors={"a": 3_000_000})
        .build()
    )
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
    net = (
        NetBuilder()
        .place("a")
        .exponential("up", outputs="a", inhibitors={"a": 20_000})
        .exponential("down", inputs="a")
        .build()
    )
    space = explore(net)  # numpy, which would take a round for every state, gives up
    assert (space.engine, space.complete, len(space), space.arcs) == ("numba", True, 20_001, 40_000)
    assert space.column(0).tolist() == list(range(20_001))


@pytest.mark.parametrize("engine", ENGINES)
def test_cancel(engine):
    with pytest.raises(CancelledError):
        explore(kanban(3), engine=engine, cancel=lambda: True)


def test_progress_is_reported():
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
    net = (
        NetBuilder()
        .place("a", tokens=9)
        .place("b")
        .exponential("t", inputs={"a": 3}, outputs={"b": 70})
        .build()
    )
    assert starting_widths(net, [0, 0]) == (4, 7)


@pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
def test_compiles_where_no_machine_code_can_be_kept(monkeypatch):
    from numba.core import caching

    # as in a read-only install without a home
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert compiled(lambda a: a + 1)(2) == 3


@pytest.mark.skipif(not numba_is_there(), reason="numba is missing")
def test_kept_machine_code_runs_without_numba_until_its_source_changes(tmp_path, monkeypatch):
    program = (
        "import sys\n"
        "import numpy as np\n"
        "from doubling import doubled\n"
        "values = np.arange(3.0)\n"
        "print(doubled((values, 1), True), values.tolist(), 'numba' in sys.modules)\n"
    )
    code = (
        "from gspn_framework_package.analysis.machine_code import KeptCode\n"
        "@KeptCode\n"
        "def twice(x):\n    return 2 * x\n"
        "@KeptCode\n"
        "def doubled(work, yes):\n"
        "    values, first = work\n"
        "    for i in range(first, len(values)):\n        values[i] = twice(values[i])\n"
        "    return len(values), first, yes\n"
    )
    source = tmp_path / "doubling.py"

    def run(text):
        source.write_text(text, encoding="utf-8")
        path = os.pathsep.join([str(tmp_path), *sys.path])
        environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
        return subprocess.run(
            [sys.executable, "-c", program],
            check=True,
            timeout=300 * PATIENCE,
            env=environment,
            stdout=subprocess.PIPE,
        ).stdout.decode()

    assert run(code) == "(3, 1, 1) [0.0, 2.0, 4.0] True\n"
    assert run(code) == "(3, 1, 1) [0.0, 2.0, 4.0] False\n"
    (kept,) = tmp_path.glob("__pycache__/*.o")
    kept.write_bytes(kept.read_bytes()[:-1])
    assert run(code) == "(3, 1, 1) [0.0, 2.0, 4.0] True\n", "a damaged file is not run"
    other = code.replace("2 * x", "3 * x")
    assert run(other) == "(3, 1, 1) [0.0, 3.0, 6.0] True\n"
    # as in a read-only installation without a home
    shutil.rmtree(str(kept.parent))
    kept.parent.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(kept.parent))
    assert run(other) == "(3, 1, 1) [0.0, 3.0, 6.0] True\n"


@pytest.mark.long
def test_numba_is_not_loaded_for_what_numpy_does_sooner():
    program = (
        "import sys\n"
        "from gspn_framework_package.analysis.analyse import Analysis\n"
        "from benchmarks.nets import kanban\n"
        "analysis = Analysis(kanban(2))\n"
        "assert analysis.steady.method == 'Gauss-Seidel' and analysis.space.engine == 'numpy'\n"
        "assert 'numba' not in sys.modules\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(
        [sys.executable, "-c", program], check=True, timeout=300 * PATIENCE, env=environment
    )
