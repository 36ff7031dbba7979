"""The net and its firing rule (thesis 2.1)."""

from __future__ import annotations

from typing import Any, List

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import NetError, NotEnabledError
from gspn_framework_package.model.net import Arc, Net, Place, Transition


def producer() -> Net:
    return (
        NetBuilder("producer")
        .place("idle", tokens=2)
        .place("busy")
        .place("store", capacity=3)
        .place("closed")
        .immediate("begin", inputs="idle", outputs="busy", inhibitors="closed", priority=2)
        .exponential("end", rate=0.5, servers=None, inputs="busy", outputs={"idle": 1, "store": 2})
        .build()
    )


def test_firing_moves_weights_and_respects_inhibitors_and_capacities() -> None:
    net = producer()
    begin, end = net.transition_number("begin"), net.transition_number("end")
    marking = net.fire(net.initial_marking, begin)
    assert net.named(marking, zeros=False) == {"idle": 1, "busy": 1}
    marking = net.fire(marking, end)
    assert net.named(marking, zeros=False) == {"idle": 2, "store": 2}
    full = net.fire(marking, begin)
    assert not net.is_enabled(full, end)
    assert net.why_disabled(full, end) == ["store has room for 1 of 2 more tokens (capacity 3)"]
    with pytest.raises(NotEnabledError, match="transition 'end'.*store has room for 1 of 2"):
        net.fire(full, end)
    closed = net.marking({"idle": 1, "closed": 1})
    assert net.why_disabled(closed, begin) == ["closed holds 1 and inhibits from 1 on"]


def test_immediate_transitions_of_the_highest_priority_come_first() -> None:
    net = producer()
    marking = net.marking({"idle": 1, "busy": 1})
    assert net.enabled(marking) == (0,)
    assert net.enabled(marking, by_priority=False) == (0, 1)


def test_rates_follow_the_servers() -> None:
    net = producer()
    marking = net.marking({"busy": 3})
    assert net.effective_rate(marking, 1) == 1.5
    two = net.with_transition(net.transition("end")._replace(servers=2))
    assert two.effective_rate(marking, 1) == 1.0
    assert two.effective_rate(net.initial_marking, 1) == 0


def test_parallel_arcs_add_up() -> None:
    net = Net([Place("P", 3)], [Transition("T")], [Arc("P", "T"), Arc("P", "T", 2)])
    assert net.inputs[0] == ((0, 3),)


def test_edits_give_a_new_net_and_leave_the_old_one() -> None:
    net = producer()
    smaller = net.without_places(["store"])
    assert "store" not in smaller.place_index and "store" in net.place_index
    assert all("store" not in arc[:2] for arc in smaller.arcs)
    assert net.with_arc(Arc("closed", "end")).inputs[1] == ((1, 1), (3, 1))
    assert net.with_place(Place("new", 4)).initial_marking == (2, 0, 0, 0, 4)
    assert net.with_marking({"closed": 1}).initial_marking == (0, 0, 0, 1)
    assert net == producer() and hash(net) == hash(producer())
    for edit in (
        lambda: net.without_places(["x"]),
        lambda: net.with_marking((1,)),
    ):
        with pytest.raises(NetError):
            edit()


def test_a_net_without_places_is_the_net_made_without_them() -> None:
    net = producer().with_arc(Arc("idle", "begin", 2)).with_arc(Arc("begin", "closed"))
    for gone in (["idle"], ["store"], ["closed", "busy"], [], [p.name for p in net.places]):
        smaller = net.without_places(gone)
        anew = Net(
            [p for p in net.places if p.name not in gone],
            net.transitions,
            [a for a in net.arcs if not {a.source, a.target} & set(gone)],
            net.name,
        )
        assert vars(smaller) == vars(anew)
    with pytest.raises(NetError, match="there is no place 'x'"):
        net.without_places(["x"])


@pytest.mark.parametrize(
    ("places", "transitions", "arcs", "message"),
    [
        ([Place("P"), Place("P")], [], [], "place 'P': the name is already taken by a place"),
        ([Place("P")], [Transition("P")], [], "already taken by a place"),
        ([Place("")], [], [], "has no name"),
        ([Place("P", -1)], [], [], "initial marking -1"),
        ([Place("P", 3, 2)], [], [], "above its capacity 2"),
        ([Place("P")], [Transition("T")], [Arc("P", "T", 0)], "weight 0"),
        ([Place("P")], [Transition("T")], [Arc("P", "T", -2)], "weight -2"),
        ([Place("P")], [Transition("T")], [Arc("P", "Q")], "no place or transition 'Q'"),
        ([Place("P"), Place("Q")], [], [Arc("P", "Q")], "it joins two places"),
        ([], [Transition("T"), Transition("U")], [Arc("T", "U")], "it joins two transitions"),
        ([Place("P")], [Transition("T")], [Arc("T", "P", 1, True)], "inhibitor arc goes from"),
        ([], [Transition("T", timed=True, rate=0.0)], [], "rate 0.0"),
        ([], [Transition("T", timed=True, rate=float("nan"))], [], "rate nan"),
        ([], [Transition("T", weight=-1.0)], [], "weight -1.0"),
        ([], [Transition("T", servers=0)], [], "servers 0"),
    ],
)
def test_what_is_not_a_net_is_refused_with_its_element(
    places: List[Any], transitions: List[Any], arcs: List[Any], message: str
) -> None:
    with pytest.raises(NetError, match=message):
        Net(places, transitions, arcs)


@given(st.data())
def test_firing_changes_the_marking_by_the_effect_and_never_below_zero(data: Any) -> None:
    number = data.draw(st.integers(1, 4))
    places = [Place("p%d" % i, data.draw(st.integers(0, 4))) for i in range(number)]
    pairs = st.dictionaries(st.integers(0, number - 1), st.integers(1, 3), max_size=number)
    ins, outs, stops = data.draw(pairs), data.draw(pairs), data.draw(pairs)
    arcs = [Arc("p%d" % p, "t", w) for p, w in ins.items()]
    arcs += [Arc("t", "p%d" % p, w) for p, w in outs.items()]
    arcs += [Arc("p%d" % p, "t", w, True) for p, w in stops.items()]
    net = Net(places, [Transition("t")], arcs)
    before = net.initial_marking
    expected = all(before[p] >= w for p, w in ins.items()) and all(
        before[p] < w for p, w in stops.items()
    )
    assert net.is_enabled(before, 0) is expected
    assert bool(net.why_disabled(before, 0)) is not expected
    if expected:
        after = net.fire(before, 0)
        assert min(after) >= 0
        assert all(after[p] - before[p] == outs.get(p, 0) - ins.get(p, 0) for p in range(number))
