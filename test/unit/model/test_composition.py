"""Expanding a place by a net, and saying capacities by inhibitor arcs."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.capacity import capacities_as_inhibitors
from gspn_framework_package.model.composition import expand_place
from gspn_framework_package.model.errors import NetError
from gspn_framework_package.model.net import Arc, Net, Place, Transition


def outer_net():
    return (
        NetBuilder("patrol")
        .place("Idle", tokens=1)
        .place("Inspect", tokens=2, position=(100, 50))
        .place("Count")
        .immediate("start", inputs="Idle", outputs="Inspect")
        .exponential("done", inputs={"Inspect": 2}, outputs=["Idle", "Count"])
        .immediate("leave", inputs="Count", inhibitors="Inspect")
        .build()
    )


def inner_net():
    return (
        NetBuilder("procedure")
        .place("Approach", position=(0, 0))
        .place("Look", position=(40, 10))
        .place("camera", tokens=1, position=(20, 30))
        .exponential(
            "arrive", rate=2, inputs=["Approach", "camera"], outputs="Look", position=(20, 0)
        )
        .immediate("again", inputs="Look", outputs=["Approach", "camera"])
        .build()
    )


def test_what_it_becomes():
    net = expand_place(outer_net(), "Inspect", inner_net(), entry="Approach", exit="Look")
    assert net == (
        NetBuilder("patrol")
        .place("Idle", tokens=1)
        .place("Inspect.Approach", tokens=2, position=(100, 50))
        .place("Inspect.Look", position=(140, 60))
        .place("Inspect.camera", tokens=1, position=(120, 80))
        .place("Count")
        .immediate("start")
        .exponential("done")
        .immediate("leave")
        .exponential("Inspect.arrive", rate=2, position=(120, 50))
        .immediate("Inspect.again")
        .arc("Idle", "start")
        .arc("start", "Inspect.Approach")
        .arc("Inspect.Look", "done", 2)
        .arc("done", "Idle")
        .arc("done", "Count")
        .arc("Count", "leave")
        .inhibitor("Inspect.Approach", "leave")
        .inhibitor("Inspect.Look", "leave")  # the camera is a resource: it does not count
        .arc("Inspect.Approach", "Inspect.arrive")
        .arc("Inspect.camera", "Inspect.arrive")
        .arc("Inspect.arrive", "Inspect.Look")
        .arc("Inspect.Look", "Inspect.again")
        .arc("Inspect.again", "Inspect.Approach")
        .arc("Inspect.again", "Inspect.camera")
        .build()
    )


def test_expanding_twice_needs_two_prefixes():
    inner = NetBuilder().place("x").build()
    net = NetBuilder().place("a").place("b").immediate("t", inputs="a", outputs="b").build()
    once = expand_place(net, "a", inner, "x", "x", prefix="one ")
    assert [p.name for p in expand_place(once, "b", inner, "x", "x", prefix="two ").places] == [
        "one x",
        "two x",
    ]
    with pytest.raises(NetError, match="already taken"):
        expand_place(once, "b", inner, "x", "x", prefix="one ")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"place": "Nowhere"}, "there is no place 'Nowhere'"),
        ({"entry": "Nowhere"}, "has no place 'Nowhere'"),
        ({"exit": "arrive"}, "has no place 'arrive'"),
        ({"entry": "camera"}, "has tokens on its entry or exit"),
        ({"net": outer_net().with_place(Place("Inspect", 0, capacity=2))}, "it has a capacity"),
        (
            {"net": outer_net().with_arc(Arc("Inspect", "start", 3, inhibitor=True))},
            "its inhibitor arc to 'start' counts 3 tokens",
        ),
    ],
)
def test_what_is_refused(change, message):
    arguments = {
        "net": outer_net(),
        "place": "Inspect",
        "subnet": inner_net(),
        "entry": "Approach",
        "exit": "Look",
    }
    arguments.update(change)
    with pytest.raises(NetError) as raised:
        expand_place(**arguments)
    assert message in str(raised.value)


@st.composite
def small_nets(draw):
    """A net with inhibitor arcs of weight 1, and capacities on all places but the first."""
    names = ["p0", "p1", "p2"]
    places = [Place(n, draw(st.integers(0, 2)), draw(st.sampled_from([None, 4]))) for n in names]
    places[0] = places[0]._replace(capacity=None)
    transitions, arcs = [], []
    for number in range(draw(st.integers(1, 4))):
        name = "t%d" % number
        transitions.append(Transition(name, timed=draw(st.booleans())))
        for place in draw(st.lists(st.sampled_from(names), max_size=2, unique=True)):
            arcs.append(Arc(place, name, draw(st.integers(1, 2))))
        for place in draw(st.lists(st.sampled_from(names), max_size=2, unique=True)):
            arcs.append(Arc(name, place, draw(st.integers(1, 2))))
        for place in draw(st.lists(st.sampled_from(names), max_size=1)):
            arcs.append(Arc(place, name, 1, inhibitor=True))
    return Net(places, transitions, arcs)


@settings(deadline=None)
@given(net=small_nets(), seed=st.integers(0, 10**6))
def test_the_expanded_net_does_what_the_net_does(net, seed):
    """Every run of the expanded net, its inner steps left out, is a run of the net; the tokens of
    the subnet add up to those of the place."""
    inner = (
        NetBuilder()
        .place("in")
        .place("mid")
        .place("out")
        .place("tool", 1)
        .exponential("a", inputs=["in", "tool"], outputs="mid")
        .exponential("b", inputs="mid", outputs=["out", "tool"])
        .build()
    )
    expanded = expand_place(net, "p0", inner, "in", "out")
    dice = random.Random(seed)
    big, small = expanded.initial_marking, net.initial_marking
    for _ in range(60):
        counts = expanded.named(big)
        added_up = counts["p0.in"] + counts["p0.mid"] + counts["p0.out"]
        assert (added_up, counts["p1"], counts["p2"]) == small
        enabled = expanded.enabled(big, by_priority=False)
        if not enabled or added_up > 50:
            break
        t = dice.choice(enabled)
        if t < len(net.transitions):
            small = net.fire(small, t)  # raises when the net does not allow it
        big = expanded.fire(big, t)


@settings(deadline=None)
@given(net=small_nets(), marking=st.tuples(*[st.integers(0, 4)] * 3))
def test_inhibitor_arcs_say_what_capacities_say(net, marking):
    said = capacities_as_inhibitors(net)
    assert all(place.capacity is None for place in said.places)
    for t in range(len(net.transitions)):
        assert said.is_enabled(marking, t) == net.is_enabled(marking, t)
        assert said.enabling_degree(marking, t) == net.enabling_degree(marking, t)
        assert said.effect(t) == net.effect(t)


def test_a_net_without_capacities_stays_what_it_is():
    net = outer_net()
    assert capacities_as_inhibitors(net) is net


def test_a_transition_that_can_never_fire():
    net = NetBuilder().place("a", capacity=1).immediate("t", outputs={"a": 2}).build()
    with pytest.raises(NetError, match="it can never fire: it adds 2 tokens to 'a'"):
        capacities_as_inhibitors(net)
