"""The offline simulator against its definition: enabled set, race, weights, probabilities."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.execution.enabled_set import EnabledSet
from gspn_framework_package.execution.simulator import Simulator
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import NetError, NotEnabledError
from gspn_framework_package.model.net import Arc, Net, Place, Transition


@st.composite
def nets(draw):
    places = [
        Place("p%d" % i, draw(st.integers(0, 3)), draw(st.sampled_from([None, None, 4])))
        for i in range(draw(st.integers(1, 5)))
    ]
    transitions = [
        Transition(
            "t%d" % i,
            draw(st.booleans()),
            draw(st.floats(0.1, 5)),
            priority=draw(st.integers(1, 2)),
        )
        for i in range(draw(st.integers(1, 6)))
    ]
    pairs = draw(
        st.lists(
            st.tuples(
                st.sampled_from(places),
                st.sampled_from(transitions),
                st.sampled_from("ioh"),
                st.integers(1, 2),
            ),
            max_size=16,
        )
    )
    arcs = [
        Arc(t.name, p.name, w) if kind == "o" else Arc(p.name, t.name, w, kind == "h")
        for p, t, kind, w in pairs
    ]
    return Net(places, transitions, arcs)


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(nets(), st.integers(0, 2**32), st.booleans())
def test_the_enabled_set_agrees_with_the_net_along_random_walks(net, seed, by_priority):
    source = random.Random(seed)
    kept = EnabledSet(net, net.initial_marking, by_priority=by_priority)
    for _ in range(12):
        assert sorted(kept.now) == list(net.enabled(kept.marking, by_priority=by_priority))
        if not kept.now or max(kept.marking) > 50:
            break
        before = kept.now
        change = kept.fire(source.choice(sorted(kept.now)))
        assert (before | set(change.added)) - set(change.removed) == kept.now
    kept.move_to(net.initial_marking)
    assert sorted(kept.now) == list(net.enabled(net.initial_marking, by_priority=by_priority))


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(nets(), st.integers(0, 2**32))
def test_every_step_is_a_firing_of_the_net(net, seed):
    simulator = Simulator(net, source=random.Random(seed))
    for _ in range(12):
        before, choices = simulator.marking, simulator.choices()
        firing = simulator.step()
        if firing is None:
            assert not choices
            break
        assert firing.transition in [c.transition for c in choices]
        assert sum(c.probability for c in choices) == pytest.approx(1)
        assert simulator.marking == net.fire(before, firing.transition)
        assert (firing.delay > 0) == net.transitions[firing.transition].timed


def race(**rates):
    builder = NetBuilder().place("p", 1)
    for name, rate in rates.items():
        builder.exponential(name, rate, inputs="p", outputs="p")
    return builder.build()


def shares(simulator, steps=4000):
    counts = [0] * len(simulator.net.transitions)
    for _ in range(steps):
        counts[simulator.step().transition] += 1
    return [c / steps for c in counts]


def test_exponential_transitions_race_by_their_rates():
    simulator = Simulator(race(slow=1, fast=3), source=random.Random(1))
    assert [c.probability for c in simulator.choices()] == pytest.approx([0.25, 0.75])
    assert shares(simulator) == pytest.approx([0.25, 0.75], abs=0.03)


def test_the_delay_has_the_mean_of_the_race():
    simulator = Simulator(race(slow=1, fast=3), source=random.Random(2))
    assert sum(simulator.step().delay for _ in range(8000)) / 8000 == pytest.approx(0.25, rel=0.05)


def test_probabilities_of_the_user_go_before_the_rates():
    simulator = Simulator(
        race(slow=1, fast=3), source=random.Random(3), probabilities={0: 0.9, 1: 0.1}
    )
    assert shares(simulator) == pytest.approx([0.9, 0.1], abs=0.03)


def test_nothing_fires_when_the_user_set_all_probabilities_to_zero():
    assert Simulator(race(a=1), probabilities={0: 0}).step() is None


@pytest.mark.parametrize("value", [-1, float("nan"), float("inf")])
def test_a_probability_that_is_none_is_refused(value):
    with pytest.raises(NetError, match="transition 'a'"):
        Simulator(race(a=1), probabilities={0: value})


def test_choices_left_to_a_policy_are_drawn_evenly():
    net = (
        NetBuilder()
        .place("p", 1)
        .immediate("a", weight=0, inputs="p")
        .immediate("b", weight=0, inputs="p")
        .build()
    )
    assert [c.probability for c in Simulator(net).choices()] == [0.5, 0.5]


def test_a_chosen_transition_fires_only_when_enabled():
    net = NetBuilder().place("p", 1).exponential("a", 2, inputs="p").build()
    simulator = Simulator(net)
    assert simulator.fire(0).delay > 0
    with pytest.raises(NotEnabledError, match="p has 0 of 1 token"):
        simulator.fire(0)
