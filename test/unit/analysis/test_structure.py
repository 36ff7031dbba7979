"""Invariants, siphons, traps and classes against their definitions."""

import itertools

import pytest
from generated_nets import bounded_nets
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.large_nets import ring
from benchmarks.nets import kanban, philosophers
from gspn_framework_package.analysis.state_space import explore
from gspn_framework_package.analysis.structure.invariants import (
    invariant_bounds,
    place_invariants,
    transition_invariants,
)
from gspn_framework_package.analysis.structure.net_structure import (
    Structure,
    classify,
    conflict_sets,
)
from gspn_framework_package.analysis.structure.siphons import (
    largest_set,
    minimal_sets,
    unguarded_siphon,
)
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Arc, Net, Place, Transition

relaxed = settings(deadline=None, suppress_health_check=list(HealthCheck))


def is_minimal(supports):
    return all(
        not (a < b or b < a) and (a != b or i == j)
        for i, a in enumerate(supports)
        for j, b in enumerate(supports)
    )


@relaxed
@given(bounded_nets(max_places=5, max_transitions=6))
def test_place_invariants_by_definition(net):
    found = place_invariants(net)
    for invariant in found:
        assert all(w > 0 for w in invariant.weights.values())
        for t in range(len(net.transitions)):
            assert (
                sum(c * invariant.weights.get(net.places[p].name, 0) for p, c in net.effect(t)) == 0
            )
    assert is_minimal([set(i.weights) for i in found])
    for marking in explore(net).markings().tolist():
        for invariant in found:
            counts = dict(zip((p.name for p in net.places), marking))
            assert sum(w * counts[p] for p, w in invariant.weights.items()) == invariant.value
    # All minimal ones: in small weights there is none whose support holds no support that was
    # found.
    supports = [set(i.weights) for i in found]
    for weights in itertools.product(range(3), repeat=len(net.places)):
        named = {p.name: w for p, w in zip(net.places, weights) if w}
        if named and all(
            sum(c * named.get(net.places[p].name, 0) for p, c in net.effect(t)) == 0
            for t in range(len(net.transitions))
        ):
            assert any(s <= set(named) for s in supports)
    for largest in (1, 2, 3):
        small = place_invariants(net, largest=largest)
        assert all(invariant in found for invariant in small)
        assert all(i in small for i in found if len(i.weights) <= largest)


@relaxed
@given(bounded_nets(max_places=3, max_transitions=5))
def test_transition_invariants_by_definition(net):
    found = transition_invariants(net)
    for invariant in found:
        change = {}
        for name, times in invariant.weights.items():
            assert times > 0
            for p, c in net.effect(net.transition_number(name)):
                change[p] = change.get(p, 0) + times * c
        assert not any(change.values())
    supports = [set(i.weights) for i in found]
    assert is_minimal(supports)
    names = [t.name for t in net.transitions]
    for counts in itertools.product(range(3), repeat=len(names)):
        if not any(counts):
            continue
        change = [0] * len(net.places)
        for t, times in enumerate(counts):
            for p, c in net.effect(t):
                change[p] += times * c
        if not any(change):
            assert any(s <= {n for n, times in zip(names, counts) if times} for s in supports)


@relaxed
@given(bounded_nets())
def test_invariant_bounds_hold(net):
    space = explore(net)
    for p, bound in enumerate(invariant_bounds(net)):
        assert bound is None or space.column(p).max() <= bound


def subsets_by_definition(net, feeding, support):
    """All minimal non-empty sets of places that hold an item of ``support[t]`` for every ``t`` that
    feeds them."""
    places = range(len(net.places))
    sets = []
    for size in range(1, len(net.places) + 1):
        for chosen in itertools.combinations(places, size):
            inside = set(chosen)
            if all(
                {p for p, _ in support[t]} & inside for p in inside for t in feeding[p]
            ) and not any(smaller < inside for smaller in sets):
                sets.append(inside)
    return {frozenset(net.places[p].name for p in s) for s in sets}


@relaxed
@given(bounded_nets(max_places=5, max_transitions=7))
def test_siphons_and_traps_by_definition(net):
    siphons, traps = minimal_sets(net, kind="siphons"), minimal_sets(net, kind="traps")
    assert {frozenset(s.places) for s in siphons} == subsets_by_definition(
        net, net.producers, net.inputs
    )
    assert {frozenset(s.places) for s in traps} == subsets_by_definition(
        net, net.consumers, net.outputs
    )
    for found in siphons + traps:
        assert found.marked == any(net.place(p).tokens for p in found.places)


@relaxed
@given(bounded_nets(max_places=5, max_transitions=6), st.sets(st.integers(0, 4)))
def test_what_is_decided_without_a_list(net, numbers):
    names = [p.name for i, p in enumerate(net.places) if i in numbers]
    siphons = sets_by_definition(net, net.producers, net.inputs)
    inside = [s for s in siphons if s <= set(names)]
    assert set(largest_set(net, names, kind="siphons")) == set().union(*inside)
    traps = sets_by_definition(net, net.consumers, net.outputs)

    def is_guarded(siphon):
        return any(trap <= siphon and any(net.place(p).tokens for p in trap) for trap in traps)

    for found in (
        unguarded_siphon(net),
        unguarded_siphon(net, minimal=minimal_sets(net, kind="siphons")),
    ):
        if found is None:
            assert all(is_guarded(s) for s in siphons)
        else:
            assert frozenset(found.places) in siphons and not is_guarded(frozenset(found.places))


def sets_by_definition(net, feeding, support):
    """All non-empty sets of places that hold an item of ``support[t]`` for every ``t`` that feeds
    them."""
    places = range(len(net.places))
    return {
        frozenset(net.places[p].name for p in chosen)
        for size in range(1, len(net.places) + 1)
        for chosen in itertools.combinations(places, size)
        if all({p for p, _ in support[t]} & set(chosen) for p in chosen for t in feeding[p])
    }


@pytest.mark.long
def test_the_structure_of_a_large_ring():
    structure = Structure(ring(3_000), limit=200_000)
    assert [len(i.weights) for i in structure.place_invariants] == [3_000]
    assert [len(i.weights) for i in structure.transition_invariants] == [3_000]
    assert [len(s.places) for s in structure.siphons + structure.traps] == [3_000, 3_000]
    assert structure.unguarded_siphon is None and structure.conservative and structure.repetitive


@relaxed
@given(bounded_nets(max_places=5, max_transitions=6))
def test_what_shows_at_once_is_what_the_invariants_say(net):
    structure = Structure(net)
    limited = Structure(net, limit=0)
    for question in ("conservative", "consistent", "repetitive"):
        try:
            answer = getattr(limited, question)
        except LimitError:
            continue
        assert answer == getattr(structure, question)


def test_known_structures():
    structure = Structure(philosophers(4))
    assert len(structure.place_invariants) == 8
    assert len(structure.siphons) == 9
    assert structure.conservative and structure.consistent and structure.repetitive
    assert not structure.strictly_conservative
    assert not structure.classes.free_choice
    assert ["take_left1", "take_right4"] in [sorted(s) for s in structure.conflict_sets]
    assert Structure(kanban(3)).classes.free_choice


def test_classes():
    def cycle():
        return NetBuilder().place("a", tokens=1).place("b")

    ring = (
        cycle()
        .exponential("t", inputs="a", outputs="b")
        .exponential("u", inputs="b", outputs="a")
        .build()
    )
    classes = classify(ring)
    assert classes.state_machine and classes.marked_graph and classes.free_choice and classes.pure
    choice = (
        cycle()
        .exponential("t", inputs="a", outputs="b")
        .exponential("u", inputs=["a", "b"])
        .build()
    )
    classes = classify(choice)
    assert (
        not classes.free_choice and not classes.extended_free_choice and classes.asymmetric_choice
    )
    weighted = cycle().exponential("t", inputs={"a": 2}, outputs="b").build()
    assert not classify(weighted).ordinary
    loop = cycle().exponential("t", inputs="a", outputs="a").build()
    assert not classify(loop).pure


@relaxed
@given(net=bounded_nets(max_places=5, max_transitions=8))
def test_asymmetric_choice_by_definition(net):
    leaving = [set(ts) for ts in net.consumers]
    ordinary = all(w == 1 for arcs in net.inputs + net.outputs for _, w in arcs)
    pairs = [(leaving[p], leaving[q]) for arcs in net.inputs for p, _ in arcs for q, _ in arcs]
    assert classify(net).asymmetric_choice == (ordinary and all(a <= b or b <= a for a, b in pairs))


def test_conflicts_through_inhibitor_arcs_and_priorities():
    net = (
        NetBuilder()
        .place("a", tokens=1)
        .place("b", tokens=1)
        .place("c")
        .immediate("fills", inputs="a", outputs="c")
        .immediate("shy", inputs="b", inhibitors="c")
        .immediate("other", priority=2, inputs="a")
        .build()
    )
    assert conflict_sets(net) == [("fills", "shy")]


def test_repetitive_but_not_consistent():
    net = NetBuilder().place("a").exponential("source", outputs="a").build()
    structure = Structure(net)
    assert structure.repetitive and not structure.consistent and not structure.conservative


def test_limits_are_said():
    builder = NetBuilder()
    for layer in range(12):
        for i in range(3):
            builder.place("p%d_%d" % (layer, i))
    for layer in range(12):
        builder.exponential(
            "t%d" % layer,
            inputs=["p%d_%d" % (layer, i) for i in range(3)],
            outputs=["p%d_%d" % ((layer + 1) % 12, i) for i in range(3)],
        )
    net = builder.build()
    with pytest.raises(LimitError, match="too much work"):
        place_invariants(net, limit=1000)
    with pytest.raises(LimitError, match="too much work"):
        minimal_sets(net, limit=1000, kind="siphons")
    assert invariant_bounds(net, limit=1000) == (None,) * 36


@pytest.mark.long
def test_thousands_of_sources_are_as_many_siphons():
    places = [Place("p%d" % i) for i in range(6_000)]
    transitions = [Transition("t%d" % i, timed=True) for i in range(len(places))]
    net = Net(places, transitions, [Arc("p%d" % i, "t%d" % i) for i in range(len(places))])
    structure = Structure(net)
    assert len(structure.siphons) == len(places)
    assert structure.traps == []
    assert structure.unguarded_siphon == (("p0",), False)


@relaxed
@given(bounded_nets())
def test_conflict_sets_by_definition(net):
    def change(t, p):
        return dict(net.effect(t)).get(p, 0)

    def disturbs(t, u):
        """Whether a firing of t can disable u, directly."""
        return any(change(t, p) < 0 for p, _ in net.inputs[u]) or any(
            change(t, p) > 0 for p, _ in net.inhibitors[u]
        )

    def kind(t):
        transition = net.transitions[t]
        return (True, 0) if transition.timed else (False, transition.priority)

    numbers = range(len(net.transitions))
    together = {t: {t} for t in numbers}
    for t, u in itertools.product(numbers, numbers):
        if kind(t) == kind(u) and t != u and disturbs(t, u):
            merged = together[t] | together[u]
            together.update(dict.fromkeys(merged, merged))
    expected = {frozenset(s) for s in together.values() if len(s) > 1}
    found = conflict_sets(net)
    assert found == sorted(found, key=lambda names: net.transition_number(names[0]))
    assert {frozenset(map(net.transition_number, names)) for names in found} == expected
