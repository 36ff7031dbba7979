"""Rates and weights that depend on the marking: how they are written, and their value."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.composition import expand_place
from gspn_framework_package.model.errors import ExpressionError, NetError, RefusedError
from gspn_framework_package.model.marking_function import parse_value, quoted_place


@pytest.mark.parametrize(
    ("text", "counts", "value"),
    [
        ("2 * #a", {"a": 3}, 6),
        ("min(#a, N) / 2", {"a": 9}, 2),
        ("-mu * #a", {"a": 2}, 3),
        ("#'a b' + # c.d:e", {"a b": 1, "c.d:e": 2}, 3),
        ("#min * min(#min, 1)", {"min": 4}, 4),
        ("#N * N", {"N": 3}, 12),
        ("1 / #a", {"a": 0}, math.nan),
        ("log(#a)", {"a": 0}, math.nan),
    ],
)
def test_value(text, counts, value):
    function = parse_value(text, {"N": 4, "mu": -1.5})
    assert function.places == tuple(sorted(counts))
    assert function.value(counts) == pytest.approx(value, nan_ok=True)
    columns = {name: np.array([float(n)]) for name, n in counts.items()}
    assert function.values(columns) == pytest.approx([value], nan_ok=True)


def test_without_a_place_it_is_a_number():
    assert parse_value("2 * N", {"N": 3}) == 6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2 * #", "a place was expected after '#' at the end"),
        ("#3", "a place was expected after '#' before '3'"),
        ("#a + b", "'b' has no value"),
        ("#a #b", "an operator was expected"),
        ("min(#a", "'[)]' was expected"),
        ("#a >= 1", "an operator was expected"),
    ],
)
def test_what_cannot_be_read(text, message):
    with pytest.raises(ExpressionError, match=message):
        parse_value(text)


@pytest.mark.long
@given(st.text(min_size=1, max_size=5).filter(lambda s: not ("'" in s and '"' in s)))
def test_any_place_can_be_named(name):
    assert parse_value("1 + #" + quoted_place(name)).places == (name,)


def test_it_is_no_number():
    function = parse_value("#a")
    for operation in (
        lambda: 2 * function,
        lambda: function / 2,
        lambda: function > 0,
        lambda: 0 <= function,
        lambda: float(function),
        lambda: "%g" % function,
        lambda: np.array([function], dtype=np.float64),
        lambda: bool(function),
        lambda: math.isfinite(function),
    ):
        with pytest.raises(RefusedError, match="depends on the marking"):
            operation()


def net_with(rate):
    return (
        NetBuilder("n")
        .place("a", tokens=2)
        .place("b")
        .exponential("go", rate=rate, servers=None, inputs="a", outputs="b")
        .immediate("back", weight="3 * #b", inputs="b", outputs="a")
        .build()
    )


def test_the_net_computes_it_in_a_marking():
    net = net_with("1.5 - #b")
    assert net.effective_rate((2, 0), 0) == 3.0
    assert net.effective_rate((1, 1), 0) == 0.5
    assert net.effective_rate((0, 2), 0) == 0  # not enabled, so its value does not matter
    assert net.value((1, 1), 1) == 3


def test_a_value_that_is_not_above_0_names_transition_marking_and_expression():
    with pytest.raises(NetError) as caught:
        net_with("1 - #b").effective_rate((1, 1), 0)
    assert str(caught.value) == (
        "transition 'go': its rate '1 - #b' is 0 in (a: 1, b: 1) "
        "(it must be above 0 wherever the transition is enabled)"
    )
    with pytest.raises(NetError, match=r"is not a finite number in \(a: 2\)"):
        net_with("1 / #b").effective_rate((2, 0), 0)


def test_a_place_that_the_net_does_not_have():
    with pytest.raises(NetError, match="'go': there is no place 'c', which its rate '#c' names"):
        net_with("#c")
    with pytest.raises(NetError, match="names the place 'b', which is removed"):
        net_with("1 + #b").without_places(["b"])
    assert net_with("1 + #b").with_rates({"go": 2}).functions.keys() == {1}


def test_a_composed_net_names_the_places_by_their_new_names():
    outer = NetBuilder("o").place("p").exponential("in", outputs="p").exponential("out", inputs="p")
    inner = NetBuilder("i").place("a").place("z").exponential("t", "2 * #a", None, "a", "z")
    net = expand_place(outer.build(), "p", inner.build(), "a", "z")
    assert net.transition("p.t").rate.places == ("p.a",)
