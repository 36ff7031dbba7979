"""Arithmetic over named constants."""

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gspn_framework_package.model.constants import resolve_constants
from gspn_framework_package.model.errors import ExpressionError
from gspn_framework_package.model.expression import (
    as_whole,
    evaluate,
    names_in,
    parse,
    shorten,
    tokenize,
)


@pytest.mark.parametrize(
    "text, value",
    [
        ("1", 1),
        ("1.5e-3", 0.0015),
        (".5", 0.5),
        ("2.", 2),
        ("1+2*3", 7),
        ("(1+2)*3", 9),
        ("8/4/2", 1),
        ("8-4-2", 2),
        ("2^3^2", 512),
        ("-2^2", -4),
        ("2^-1", 0.5),
        ("--2", 2),
        ("+3 - -4", 7),
        ("2*-3", -6),
        ("min(3, 1, 2) + max(4)", 5),
        ("floor(2.7) + ceil(2.1) + round(2.5)", 8),
        ("abs(-3) + sqrt(16) + pow(2, 5) + mod(7, 4)", 42),
        ("ln(exp(2)) + log(exp(1))", 3),
        ("2*N + lambda", 6.5),
        ("'a name' * p1:Wait.x", 12),
        ("min", 100),
    ],
)
def test_values(text, value):
    constants = {"N": 3, "lambda": 0.5, "a name": 4, "p1:Wait.x": 3, "min": 100}
    assert evaluate(text, constants) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "at the end of ''"),
        ("1 +", "at the end of '1 +'"),
        ("1 2", "before '2' (character 3)"),
        ("(1", "')' was expected"),
        ("1)", "before ')'"),
        ("min()", "a number, a name or '(' was expected"),
        ("floor(1, 2)", "floor takes 1 argument, not 2"),
        ("pow(1)", "pow takes 2 arguments, not 1"),
        ("f(1)", "an operator was expected before '('"),
        ("1 $ 2", "unexpected character '$'"),
        ("'open", "a quote is opened and not closed"),
        ("x", "'x' has no value"),
        ("1/0", "division by zero"),
        ("0^-1", "division by zero"),
        ("1e308*10", "no finite real value"),
        ("9^9^9", "no finite real value"),
        ("(-1)^0.5", "no finite real value"),
        ("floor((-1)^0.5)", "no finite real value"),
        ("sqrt(-1)", "no finite real value"),
        ("log(0)", "no finite real value"),
        ("1 >= 2", "an operator was expected before '>='"),
        ("__import__('os')", "an operator was expected"),
        ("(" * 1000, "nested more than"),
        ("-" * 1000 + "1", "nested more than"),
        ("2^" * 1000 + "1", "nested more than"),
        ("1+" * 10_000 + "1", "characters, more than"),
    ],
)
def test_errors(text, message):
    with pytest.raises(ExpressionError) as raised:
        evaluate(text)
    assert message in str(raised.value)
    assert len(str(raised.value)) < 300


def test_a_long_sum_is_no_problem():
    assert evaluate("+".join(["1"] * 4000)) == 4000


EXPRESSIONS = st.recursive(
    st.one_of(st.integers(0, 50).map(str), st.sampled_from(["a", "b"])),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda t: "(%s %s %s)" % t),
        inner.map(lambda text: "(-%s)" % text),
        st.tuples(inner, inner).map(lambda t: "min(%s, %s)" % t),
    ),
    max_leaves=12,
)


@given(text=EXPRESSIONS, a=st.integers(-9, 9), b=st.integers(-9, 9))
def test_agrees_with_python_where_both_mean_the_same(text, a, b):
    expected = eval(text, {"__builtins__": {}}, {"a": a, "b": b, "min": min})
    assert evaluate(text, {"a": a, "b": b}) == expected
    assert names_in(parse(text)) == {name for name in "ab" if name in text}


@pytest.mark.long
@given(text=st.text(max_size=60))
def test_any_text_is_a_number_or_one_clear_error(text):
    try:
        value = evaluate(text, {"a": 1.0})
    except ExpressionError as error:
        assert "\n" not in error.message
    else:
        assert math.isfinite(value)


def test_tokens_know_where_they_are():
    assert [(t.kind, t.text, t.start) for t in tokenize("a >= 'b c'")] == [
        ("name", "a", 0),
        ("operator", ">=", 2),
        ("name", "b c", 5),
        ("end", "", 10),
    ]


def test_constants_over_constants():
    assert resolve_constants({"a": "2*b", "b": "c+1", "c": "4"}) == {"a": 10, "b": 5, "c": 4}
    assert resolve_constants({"a": "2*b", "b": "1"}, {"b": 5}) == {"a": 10, "b": 5}
    assert resolve_constants({"a": "1/0"}, {"a": 1}) == {"a": 1}  # what is given goes first


@pytest.mark.parametrize(
    "definitions, message",
    [
        ({"a": "a"}, "a -> a"),
        ({"x": "1", "a": "b+x", "b": "c", "c": "a"}, "a -> b -> c -> a"),
        ({"a": "b"}, "constant 'a': 'b' has no value"),
        ({"a": "1 +"}, "constant 'a': a number"),
        ({"a": "1/0"}, "constant 'a': division by zero"),
    ],
)
def test_constants_that_have_no_value(definitions, message):
    with pytest.raises(ExpressionError) as raised:
        resolve_constants(definitions)
    assert message in str(raised.value)


@pytest.mark.long
def test_a_long_chain_of_constants():
    definitions = {"c%d" % n: "c%d + 1" % (n + 1) for n in range(20_000)}
    definitions["c20000"] = "0"
    start = time.monotonic()
    assert resolve_constants(definitions)["c0"] == 20_000
    assert time.monotonic() - start < 30


def test_whole_numbers():
    assert [as_whole(v) for v in (3.0, -2.0, 2.5, math.inf, math.nan, 1e300)] == [
        3,
        -2,
        None,
        None,
        None,
        None,
    ]


def test_shorten():
    assert shorten("a\n  b") == "a b"
    assert shorten("x" * 100, 10) == "xxxxxxx..."
