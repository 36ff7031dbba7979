"""Conditions on markings: the language, its two evaluations, its errors."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gspn_framework_package.model.condition import either, parse_condition
from gspn_framework_package.model.errors import ExpressionError

PLACES = ["p3", "robots_at_base", "p1:Check L1", "and"]


def holds_in(condition, markings, labels=()):
    columns = np.array(markings).T
    return condition.holds_in_columns(columns, len(markings), dict(labels)).tolist()


@pytest.mark.parametrize(
    ("text", "marking", "holds"),
    [
        ("p3 >= 1 and robots_at_base == 2", (1, 2, 0, 0), True),
        ("p3 >= 1 and robots_at_base == 2", (0, 2, 0, 0), False),
        ("'p1:Check L1' > 0", (0, 0, 1, 0), True),
        ('"p1:Check L1" > 0', (0, 0, 0, 0), False),
        ("#p3 = 2", (2, 0, 0, 0), True),
        ("not p3 > 1 or robots_at_base >= 5", (1, 0, 0, 0), True),
        ("not (p3 > 1 or robots_at_base >= 5)", (1, 5, 0, 0), False),
        ("p3 = 0 or p3 = 1 and robots_at_base = 1", (0, 7, 0, 0), True),
        ("(p3 + robots_at_base) * 2 - 1 >= 2^3 / 2", (1, 2, 0, 0), True),
        ("!(p3 != 1) && robots_at_base <> 3 | false", (1, 2, 0, 0), True),
        ("min(p3, robots_at_base, 4) = 2", (3, 2, 0, 0), True),
        ("min(p3) + max(robots_at_base) = 5", (3, 2, 0, 0), True),
        ("p3 / robots_at_base >= 0", (1, 0, 0, 0), False),
        ("p3 / robots_at_base != 0", (1, 0, 0, 0), False),
        ("'and' >= 1", (0, 0, 0, 1), True),
        ("true", (0, 0, 0, 0), True),
    ],
)
def test_meaning(text, marking, holds):
    condition = parse_condition(text, PLACES)
    assert condition.holds(marking) is holds
    assert holds_in(condition, [marking, marking]) == [holds, holds]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("p3", "is a number, not a condition"),
        ("p3 + 1", "is a number, not a condition"),
        ("p4 >= 1", "there is no place 'p4' \\(character 1.*did you mean 'p3'"),
        ("robots_at_base > 1 and p3", "a comparison was expected.*'p3' \\(character 24\\)"),
        ("p3 and robots_at_base > 1", "a comparison was expected"),
        ("(p3 > 1) + 1 > 2", "a number was expected.*character 1"),
        ("1 < p3 < 3", "comparisons are joined by 'and'"),
        ("p3 >= ", "at the end of"),
        ("p3 >= 1 p3", "an operator was expected before 'p3' \\(character 9\\)"),
        ("# >= 1", "a place was expected after '#'"),
        ("", "expected at the end"),
        ("p3 >= 1; import os", "before ';'"),
        ("__import__('os')", "there is no place '__import__'"),
        ("not " * 100 + "true", "nested more than"),
        ("(" * 100 + "p3 > 1" + ")" * 100, "nested more than"),
    ],
)
def test_errors_say_what_and_where(text, message):
    with pytest.raises(ExpressionError, match=message):
        parse_condition(text, PLACES)


def test_names_and_labels_it_looks_at():
    condition = parse_condition("deadlock and p3 == 1 or p3 == 2", PLACES, ["deadlock"])
    assert condition.places == ("p3",)
    assert condition.labels == ("deadlock",)
    assert condition.holds((1, 0, 0, 0), {"deadlock": True})
    assert not condition.holds((1, 0, 0, 0), {"deadlock": False})
    markings = [(1, 0, 0, 0), (1, 0, 0, 0), (2, 0, 0, 0)]
    labels = {"deadlock": np.array([True, False, False])}
    assert holds_in(condition, markings, labels) == [True, False, True]


def test_a_place_goes_before_a_label_of_its_name():
    assert parse_condition("deadlock == 0", ["deadlock"], ["deadlock"]).places == ("deadlock",)


def test_a_very_long_condition_is_no_problem():
    text = " or ".join("p3 == %d" % n for n in range(500))
    assert parse_condition(text, PLACES).holds((499, 0, 0, 0))


numbers = st.recursive(
    st.sampled_from(["a", "b", "c", "0", "1", "2.5"]),
    lambda inner: (
        st.builds("({0} {1} {2})".format, inner, st.sampled_from("+-*/^"), inner)
        | st.builds("{0}({1}, {2})".format, st.sampled_from(["min", "max"]), inner, inner)
        | st.builds("-{0}".format, inner)
    ),
    max_leaves=5,
)
conditions = st.recursive(
    st.builds(
        "{0} {1} {2}".format, numbers, st.sampled_from(["==", "!=", "<", "<=", ">", ">="]), numbers
    ),
    lambda inner: (
        st.builds("({0}) {1} ({2})".format, inner, st.sampled_from(["and", "or"]), inner)
        | st.builds("not ({0})".format, inner)
    ),
    max_leaves=4,
)


@example("a == min(a, (a / a))", [(0, 0, 0)])  # min of a number and "not a number"
@example("a == max((a / a), a)", [(0, 0, 0)])
@given(conditions, st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=10))
def test_both_evaluations_agree(text, markings):
    condition = parse_condition(text, ["a", "b", "c"])
    assert holds_in(condition, markings) == [condition.holds(m) for m in markings]


@pytest.mark.parametrize(
    ("first", "second", "joined"),
    [
        (None, None, None),
        ("a >= 1", None, "a >= 1"),
        (None, "b == 0 and a > 2", "b == 0 and a > 2"),
        ("a >= 1", "b == 0 and a > 2", "(a >= 1) or (b == 0 and a > 2)"),
    ],
)
def test_either_of_two_conditions(first, second, joined):
    assert either(first, second) == joined
