"""The chain of a state space on disk, and its steady state: as in memory."""

import numpy as np
import pytest
from generated_nets import bounded_nets
from hypothesis import given, settings
from hypothesis import strategies as st
from steady_answers import assert_answers_of

from benchmarks.nets import FAMILIES
from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.on_disk import chain as chain_module
from gspn_framework_package.analysis.on_disk.chain import OnDiskChain
from gspn_framework_package.analysis.on_disk.scratch import Scratch
from gspn_framework_package.analysis.on_disk.search import search
from gspn_framework_package.analysis.on_disk.steady import steady_state_on_disk
from gspn_framework_package.analysis.solution import linear
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LimitError, RefusedError

MEMORY = 40_000.0


def chain_of(net, memory=MEMORY, scratch=None):
    """The chain of a net on disk."""
    return OnDiskChain(search(net, memory, scratch=scratch), memory, Watch())


def assert_as_in_memory(net, direct, memory=MEMORY):
    """Assert that chain and steady state on disk are those in memory."""
    analysis = Analysis(net)
    try:
        several = len(analysis.steady.components) > 1
    except RefusedError as refusal:
        with pytest.raises(RefusedError) as told:
            chain_of(net, memory)
        # the first state with the fault is another one
        assert told.value.message.split(" in (")[0].split(" from (")[0] in str(refusal)
        return
    chain = chain_of(net, memory)
    whole = analysis.chain
    words = chain.space.packed.pack_all(whole.graph.markings(whole.states))
    order = np.argsort(chain.space.code.encode(words), kind="stable")
    inflow = whole.inflow[order][:, order]
    for part, rates in chain.blocks():
        difference = (rates - inflow[part]).tocoo()
        rates.sum_duplicates()
        assert np.abs(difference.data).max(initial=0) <= 1e-9 * inflow.max()
    assert chain.exit_rates[0 : len(chain)] == pytest.approx(whole.exit_rates[order])
    assert np.flatnonzero(chain.initial).tolist() in ([], [int(whole.initial[order].argmax())])
    if several:
        with pytest.raises(RefusedError, match="several recurrent classes"):
            steady_state_on_disk(chain, Watch(), direct)
        return
    found = steady_state_on_disk(chain, Watch(), direct)
    assert_answers_of(analysis, found)


@pytest.mark.long
@settings(derandomize=True, deadline=None, max_examples=100)
@given(net=bounded_nets(), direct=st.sampled_from([0, 2000]))
def test_with_little_memory_the_steady_state_is_that_in_memory(net, direct):
    assert_as_in_memory(net, direct)


@pytest.mark.long
@settings(derandomize=True, deadline=None, max_examples=50)
@given(net=bounded_nets(dependent=True), direct=st.sampled_from([0, 2000]))
def test_rates_that_depend_on_the_marking_are_those_in_memory(net, direct):
    assert_as_in_memory(net, direct)


@pytest.mark.long
@pytest.mark.parametrize(
    ("family", "size", "memory"),
    [("kanban", 2, 1e6), ("fms", 2, 3e5), ("polling", 5, 3e5), ("courier", 1, 1e7)],
)
def test_nets_from_the_literature_are_as_in_memory(family, size, memory):
    assert_as_in_memory(FAMILIES[family](size), 0, memory)


def leading(*ways):
    """A net of one token in ``a``, with an exponential transition for each way (from, to)."""
    builder = NetBuilder("ways")
    for place in sorted({place for way in ways for place in way}):
        builder.place(place, tokens=place == "a")
    for number, (source, target) in enumerate(ways):
        builder.exponential("t%d" % number, rate=1.0 + number, inputs=source, outputs=target)
    return builder.build()


@pytest.mark.parametrize("direct", [0, 2000])
@pytest.mark.parametrize(
    "ways",
    [
        ["ab", "bc", "cb"],  # what comes first never returns
        ["ab", "bc"],  # a deadlock
        ["ab", "ac"],  # two of them
        ["ab", "bd", "db", "ac", "ce", "ec"],  # two classes
        ["ab", "bd", "db", "ac"],  # a class and a deadlock
        ["ab", "ba", "aa"],  # a firing that changes nothing
    ],
    ids="-".join,
)
def test_recurrent_classes_are_as_in_memory(ways, direct):
    assert_as_in_memory(leading(*ways), direct)


def choosing():
    """A net that begins with an immediate choice, which leads to the same recurrent class, and
    chooses again later."""
    builder = NetBuilder("choosing").place("start", tokens=1)
    for place in "abcd":
        builder.place(place)
    builder.immediate("left", weight=1.0, inputs="start", outputs="a")
    builder.immediate("right", weight=3.0, inputs="start", outputs="b")
    builder.exponential("onward", rate=2.0, inputs="a", outputs="c")
    builder.exponential("after", rate=0.5, inputs="b", outputs="c")
    builder.immediate("again", weight=2.0, inputs="c", outputs="d")
    builder.immediate("back", weight=1.0, inputs="c", outputs="b")
    builder.exponential("home", rate=5.0, inputs="d", outputs="b")
    return builder.build()


@pytest.mark.parametrize("direct", [0, 2000])
def test_vanishing_states_are_eliminated(direct):
    assert_as_in_memory(choosing(), direct)


def test_rows_too_long_for_the_memory_are_collected_in_pieces(monkeypatch):
    monkeypatch.setattr(chain_module, "_PER_COLLECTED", 1e4)
    assert_as_in_memory(choosing(), 0)


@pytest.mark.long
def test_without_numba_the_steady_state_is_the_same(monkeypatch):
    monkeypatch.setattr(linear, "_compiled_sweep", lambda: None)
    assert_as_in_memory(FAMILIES["kanban"](1), 0)


def test_a_vector_that_does_not_fit_is_refused():
    net = FAMILIES["kanban"](2)
    with pytest.raises(LimitError, match="raise --memory"):
        chain_of(net, 4600 * 8 * 1.5)


def test_a_disk_without_room_is_reported_before(monkeypatch, tmp_path):
    scratch = Scratch(tmp_path)
    space = search(FAMILIES["kanban"](2), 1e5, scratch=scratch)
    asked = []
    monkeypatch.setattr(scratch, "require", asked.append)
    chain = OnDiskChain(space, 1e5, Watch())
    assert scratch.peak <= asked[0] + space.code.dtype.itemsize * 2 * len(space)
    assert asked[0] >= 12 * chain.entries


def test_nothing_is_left_on_disk(tmp_path):
    scratch = Scratch(tmp_path)
    steady_state_on_disk(chain_of(choosing(), scratch=scratch), Watch(), 0)
    scratch.close()
    assert scratch.used == 0
    assert not list(tmp_path.iterdir())
