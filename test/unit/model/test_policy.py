"""Policies and their look-up (thesis 2.3, 7.2.1)."""

from __future__ import annotations

from typing import Any, List, Mapping, Optional, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gspn_framework_package.model import policy as model
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import PolicyError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.policy import Policy, PolicyTable

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


cells = st.one_of(st.none(), st.integers(0, 2))


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
            patch.setattr(model, "MANY_GROUPS", 0)
        _look_up_equals_a_scan(rows, marking, place)


def _look_up_equals_a_scan(rows: List[Any], marking: Any, place: str) -> None:
    table = Policy.from_table(
        PLACES, [(["-" if c is None else c for c in m], {t: 1} if t else {}) for m, t in rows]
    ).bind(net())
    leaves = {"P": ["a", "b", ""], "Q": ["c", ""], "R": [""]}[place]
    matching = [
        (counts.count(None), number, t)
        for number, (counts, t) in enumerate(rows)
        if t in leaves and all(c is None or c == n for c, n in zip(counts, marking))
    ]
    expected = None
    if matching:
        chosen = min(matching)[2]
        expected = {chosen: 1.0} if chosen else {}
    assert ask(table, marking, place) == expected
    assert table.matches(marking, 0) == any(
        all(c is None or c == n for c, n in zip(counts, marking)) for counts, _ in rows
    )
