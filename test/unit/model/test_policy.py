"""Policies and their look-up (thesis 2.3, 7.2.1)."""

from __future__ import annotations

import itertools
from typing import Any, List, Mapping, Optional, Tuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.model import policy_cell
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import PolicyError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.policy import Policy, PolicyTable
from gspn_framework_package.model.policy_cell import CountTest, cell_fits, ranges, written_cell

PLACES = ["P", "Q", "R"]


def net() -> Net:
    return (
        NetBuilder()
        .place("P")
        .place("Q")
        .place("R")
        .immediate("a", inputs="P", outputs="Q")
        .immediate("b", inputs="P", outputs="R")
        .immediate("c", inputs="Q", outputs="R")
        .exponential("d", inputs="R", outputs="P")
        .build()
    )


def ask(table: PolicyTable, marking: Tuple[int, ...], place: str) -> Optional[Mapping[str, float]]:
    found = table.distribution(marking, table.net.place_number(place))
    return None if found is None else {table.net.transitions[t].name: p for t, p in found.choices}


def test_cells_are_numbers_numeric_strings_or_a_dash() -> None:
    policy = Policy.from_table(PLACES, [((1, "2", "-"), {"a": "0.5", "b": 0.5})])
    assert policy.rows[0].counts == (1, 2, None)
    assert ask(policy.bind(net()), (1, 2, 9), "P") == {"a": 0.5, "b": 0.5}


def test_fewer_wildcards_go_first_then_file_order() -> None:
    rows: List[Any] = [
        (("-", "-", "-"), {"a": 1}),
        ((1, "-", 0), {"b": 1}),
        (("-", 0, 0), {"a": 1}),
        ((1, 0, 0), {"a": 0.5, "b": 0.5}),
    ]
    table = Policy.from_table(PLACES, rows).bind(net())
    assert ask(table, (1, 0, 0), "P") == {"a": 0.5, "b": 0.5}
    assert ask(table, (1, 3, 0), "P") == {"b": 1.0}
    assert ask(table, (2, 0, 0), "P") == {"a": 1.0}
    assert ask(table, (2, 2, 2), "P") == {"a": 1.0}
    assert table.overlaps() == [(0, 1, 2)]


def test_only_rows_that_speak_of_the_place_count_and_are_renormalised() -> None:
    rows: List[Any] = [((1, 1, 0), {"c": 1}), ((1, 1, "-"), {"a": 0.2, "b": 0.2, "c": 0.6})]
    table = Policy.from_table(PLACES, rows).bind(net())
    assert ask(table, (1, 1, 0), "P") == {"a": 0.5, "b": 0.5}
    assert ask(table, (1, 1, 0), "Q") == {"c": 1.0}
    assert ask(table, (1, 1, 0), "R") is None
    assert table.matches((1, 1, 0), 0) and not table.matches((0, 1, 0), 0)


def test_a_row_without_choices_lets_robots_wait_in_every_place() -> None:
    rows: List[Any] = [
        ((1, "-", "-"), {"a": 1}),
        ((1, 2, "-"), {}),
        ((1, 2, 0), {"a": 1}),
        (("-", "-", "-"), {}),
    ]
    table = Policy.from_table(PLACES, rows).bind(net())
    assert ask(table, (1, 2, 0), "P") == {"a": 1.0}
    assert ask(table, (1, 2, 1), "P") == {}
    assert ask(table, (1, 0, 0), "P") == {"a": 1.0}
    assert ask(table, (1, 2, 0), "Q") == {}
    assert ask(table, (3, 3, 3), "Q") == {} and table.matches((3, 3, 3), 0)
    found = table.distribution((1, 2, 1), 0)
    assert found is not None and found.row == 1
    assert table.overlaps() == []
    twice = Policy.from_table(["P", "Q"], [((1, "-"), {"a": 1}), (("-", 2), {})]).bind(net())
    assert ask(twice, (1, 2, 0), "P") == {"a": 1.0}
    assert twice.overlaps() == [(0, 0, 1)]


@pytest.mark.parametrize(
    ("places", "rows", "message"),
    [
        (PLACES, [((1, 1), {"a": 1})], "row 1: 2 cells for 3 places"),
        (PLACES, [((1, 1, "x"), {"a": 1})], "'x' is not a number of tokens"),
        (PLACES, [((1, 1, "=> 1"), {"a": 1})], "'=> 1' is not a number of tokens"),
        (PLACES, [((1, 1, ">= -1"), {"a": 1})], "'>= -1' is not a number of tokens"),
        (PLACES, [((1, 1, "<0"), {"a": 1})], "no number of tokens is < 0"),
        (PLACES, [((1, 1, 2**53 + 1), {"a": 1})], r"more than 2\*\*53 tokens"),
        (PLACES, [((1, 1, "> %d" % 2**60), {"a": 1})], r"more than 2\*\*53 tokens"),
        (PLACES, [((1, 1, "9" * 5000), {"a": 1})], "is not a number of tokens"),
        (PLACES, [((1, 1, "\u00b2"), {"a": 1})], "is not a number of tokens"),
        (PLACES, [((1, 1, float("inf")), {"a": 1})], "inf is not a number of tokens"),
        (PLACES, [((1, 1, -1), {"a": 1})], "-1 is not a number of tokens"),
        (PLACES, [((1, 1, 1), {"a": 1.2})], "probability 1.2"),
        (PLACES, [((1, 1, 1), {"a": 0.5})], "sum to 0.5"),
        (PLACES, [((1, 1, 1), {"a": 1.5, "b": -0.5})], "not between 0 and 1"),
        (PLACES, [((1, 1, 1), {"a": "much"})], "'much' is not a probability"),
        (["P", "P"], [], "occurs twice"),
        (["P", "X"], [], "no place 'X'"),
        (["P"], [((1,), {"zz": 1})], "no transition 'zz'"),
        (["P"], [((1,), {"d": 1})], "'d' is an exponential transition"),
    ],
)
def test_what_is_not_a_policy_is_refused_with_its_row(
    places: List[str], rows: List[Any], message: str
) -> None:
    with pytest.raises(PolicyError, match=message):
        Policy.from_table(places, rows).bind(net())


@pytest.mark.parametrize("sign", ["<", "<=", ">", ">=", "!="])
@pytest.mark.parametrize("tokens", range(4))
def test_a_test_fits_the_counts_in_its_ranges(sign: str, tokens: int) -> None:
    cell = CountTest(sign, tokens)
    wanted = [n for n in range(7) if eval("%d %s %d" % (n, sign, tokens))]
    assert [n for n in range(7) if cell_fits(cell, n)] == wanted
    spans = ranges(cell)
    assert [n for n in range(7) if any(least <= n <= most for least, most in spans)] == wanted


def test_tests_are_read_and_come_after_exact_counts_and_before_wildcards() -> None:
    rows: List[Any] = [
        (("-", "-", "-"), {"a": 1}),
        ((">= 1", " !=2 ", 0), {"b": 1}),
        ((1, 0, 0), {"a": 0.5, "b": 0.5}),
        (("<3", "< 2", 0), {"a": 0.25, "b": 0.75}),
    ]
    policy = Policy.from_table(PLACES, rows)
    assert policy.rows[1].counts == (CountTest(">=", 1), CountTest("!=", 2), 0)
    assert list(map(written_cell, policy.rows[1].counts)) == [">= 1", "!= 2", 0]
    table = policy.bind(net())
    assert ask(table, (1, 0, 0), "P") == {"a": 0.5, "b": 0.5}
    assert ask(table, (1, 1, 0), "P") == {"b": 1.0}  # the first of two with as many tests
    assert ask(table, (0, 1, 0), "P") == {"a": 0.25, "b": 0.75}
    assert ask(table, (1, 2, 0), "P") == {"a": 1.0}
    assert table.overlaps() == [(0, 1, 3)]
    apart = [((">= 1", "-", 0), {"a": 1}), (("< 1", "-", "-"), {"b": 1}), (("-", "!= 0", 0), {})]
    assert Policy.from_table(PLACES, apart).bind(net()).overlaps() == [(0, 0, 2)]


cells = st.one_of(
    st.none(),
    st.integers(0, 2),
    st.sampled_from([CountTest(s, n) for s in ("<", "<=", ">", ">=", "!=") for n in (1, 2)]),
)


@given(
    st.lists(
        st.tuples(st.tuples(cells, cells, cells), st.sampled_from(["a", "b", "c", ""])), max_size=12
    ),
    st.tuples(st.integers(0, 2), st.integers(0, 2), st.integers(0, 2)),
    st.sampled_from(PLACES),
    st.booleans(),
)
def test_look_up_equals_a_scan(rows: List[Any], marking: Any, place: str, tree: bool) -> None:
    """... in groups, and in the tree for many groups."""
    with pytest.MonkeyPatch.context() as patch:
        if tree:
            patch.setattr(policy_cell, "MANY_GROUPS", 0)
        _look_up_equals_a_scan(rows, marking, place)


def _look_up_equals_a_scan(rows: List[Any], marking: Any, place: str) -> None:
    table = Policy.from_table(
        PLACES, [([written_cell(c) for c in m], {t: 1} if t else {}) for m, t in rows]
    ).bind(net())
    leaves = {"P": ["a", "b", ""], "Q": ["c", ""], "R": [""]}[place]

    def matches(counts: Any) -> bool:
        told = [(n, c) for c, n in zip(counts, marking) if c is not None]
        signs = ["%d %s" if isinstance(c, CountTest) else "%d == %s" for _, c in told]
        return all(eval(sign % (n, str(c))) for sign, (n, c) in zip(signs, told))

    matching = [
        (counts.count(None), sum(isinstance(c, CountTest) for c in counts), number, t)
        for number, (counts, t) in enumerate(rows)
        if t in leaves and matches(counts)
    ]
    expected = None
    if matching:
        chosen = min(matching)[-1]
        expected = {chosen: 1.0} if chosen else {}
    assert ask(table, marking, place) == expected
    assert table.matches(marking, 0) == any(matches(counts) for counts, _ in rows)


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(st.tuples(cells, cells, cells), st.sampled_from(["a", "b", "c", ""])), max_size=5
    )
)
def test_overlaps_are_rows_that_only_their_order_tells_apart(rows: List[Any]) -> None:
    table = Policy.from_table(
        PLACES, [([written_cell(c) for c in m], {t: 1} if t else {}) for m, t in rows]
    ).bind(net())
    for place, leaving in (("P", ["a", "b"]), ("Q", ["c"])):
        said = {(a, b) for p, a, b in table.overlaps() if p == net().place_number(place)}
        speaking = [n for n, (_, t) in enumerate(rows) if t in [*leaving, ""]]
        met = {
            (a, b)
            for a, b in itertools.combinations(speaking, 2)
            if rows[a][1] or rows[b][1]  # two rows that let robots wait do the same
            if table.precedence(a)[:2] == table.precedence(b)[:2]
            for marking in itertools.product(range(4), repeat=3)
            if table.row_matches(a, marking) and table.row_matches(b, marking)
        }
        assert said <= met
        assert bool(said) == bool(met)
