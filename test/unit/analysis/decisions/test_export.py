"""Decisions become few rows, which decide as asked."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.analysis.decisions.export import Decided, policy_of
from gspn_framework_package.analysis.plan.markings import PlanMarkings
from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import CancelledError, PolicyError
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy

Asked = Dict[Tuple[int, ...], Mapping[str, float]]


def decided(asked: Asked) -> Decided:
    return Decided(np.array(list(asked)), tuple(asked.values()))


def says(plan: Plan, policy: Policy, marking: Sequence[int], p: int) -> Dict[str, float]:
    """What robots in place ``p`` may do: the rows' distribution; nothing if none of it is
    enabled."""
    net = plan.net
    found = policy.bind(net).distribution(marking, p)
    choices = found.choices if found is not None else ()
    if not any(net.is_enabled(marking, t) for t, _ in choices):
        return {}
    return {net.transitions[t].name: v for t, v in choices}


def wanted(plan: Plan, choice: Mapping[str, float], marking: Sequence[int], p: int) -> Any:
    net = plan.net
    mine = {
        t: v
        for t, v in choice.items()
        if v > 0 and any(q == p for q, _ in net.inputs[net.transition_index[t]])
    }
    if not any(net.is_enabled(marking, net.transition_index[t]) for t in mine):
        return {}
    return {t: pytest.approx(v / sum(mine.values()), abs=1e-12) for t, v in mine.items()}


def assert_as_asked(plan: Plan, asked: Asked, policy: Policy) -> None:
    """The policy decides as asked, and has a row wherever somebody could fire."""
    net = plan.net
    for marking, choice in asked.items():
        for name in plan.action_places:
            p = net.place_index[name]
            leaving = [t for t in net.consumers[p] if not net.transitions[t].timed]
            if any(net.is_enabled(marking, t) for t in leaving):
                assert says(plan, policy, marking, p) == wanted(plan, choice, marking, p)
                assert policy.bind(net).matches(marking, p)


@st.composite
def problems(draw: Any) -> Tuple[Plan, Asked]:
    """Plans in which robots decide alone and together, and what is asked of them in some
    markings."""
    places = ["p%d" % i for i in range(draw(st.integers(2, 4)))]
    builder = NetBuilder()
    for place in [*places, "tool"]:
        builder.place(place, capacity=draw(st.sampled_from([None, None, 2])))
    names = ["t%d" % i for i in range(draw(st.integers(1, 5)))]
    for name in names:
        inputs = draw(st.lists(st.sampled_from(places), min_size=1, max_size=2, unique=True))
        inhibitors = draw(st.sampled_from([{}, {}, {"tool": 1}, {places[0]: 2}]))
        builder.immediate(
            name, inputs=inputs, outputs=draw(st.sampled_from(places)), inhibitors=inhibitors
        )
    plan = Plan(builder.build(), resource_places=frozenset(["tool"]))
    count = st.integers(0, draw(st.integers(1, 2)))
    markings = draw(
        st.lists(st.tuples(*[count] * (len(places) + 1)), min_size=1, max_size=30, unique=True)
    )
    regular = draw(st.booleans())
    asked: Asked = {}
    for marking in markings:
        source = random.Random(marking[0] if regular else draw(st.integers(0, 99)))
        chosen = source.sample(names, min(len(names), source.randrange(4)))
        asked[marking] = {t: w / len(chosen) for t, w in zip(chosen, [1.0] * len(chosen))}
    return plan, asked


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(problems(), st.randoms(use_true_random=False))
def test_rows_decide_as_asked(problem: Tuple[Plan, Asked], source: random.Random) -> None:
    """... in whatever order the markings come, and no column is without a count."""
    plan, asked = problem
    merged = policy_of(plan, decided(asked))
    assert_as_asked(plan, asked, merged)
    items = list(asked.items())
    source.shuffle(items)
    assert policy_of(plan, decided(dict(items))) == merged
    assert all(
        any(row.counts[i] is not None for row in merged.rows) for i in range(len(merged.places))
    )
    assert not merged.bind(plan.net).overlaps()


def corridor() -> Plan:
    """Two robots go left or right; a light and a few more counts say where."""
    builder = NetBuilder("corridor").place("here", tokens=2).place("left").place("right")
    for name in ("light", "dust", "dirt"):
        builder.place(name)
    builder.immediate("go_left", inputs="here", outputs="left")
    builder.immediate("go_right", inputs="here", outputs="right")
    builder.exponential("from_left", inputs="left", outputs="here", servers=None)
    builder.exponential("from_right", inputs="right", outputs="here", servers=None)
    return Plan(
        builder.build(),
        resource_places=frozenset(["light", "dust", "dirt"]),
        actions={p: FunctionAction("actions.f", p) for p in ("here", "left", "right")},
        robots=(RobotSpec("a", "here"), RobotSpec("b", "here")),
    ).validate()


def all_markings(places: int) -> List[Tuple[int, ...]]:
    return [
        (robots, left, 2 - robots - left, *(number // 6**i % 6 for i in range(places)))
        for robots in (1, 2)
        for left in range(3 - robots)
        for number in range(6**places)
    ]


def test_one_row_and_one_for_each_exception() -> None:
    plan = corridor()
    asked: Asked = {m: {"go_left": 1.0} for m in all_markings(3)}
    for marking in asked:
        if marking[3] == 4:
            asked[marking] = {"go_right": 1.0}
    policy = policy_of(plan, decided(asked))
    assert policy.places == ("light",)
    assert [(row.counts, dict(row.choices)) for row in policy.rows] == [
        ((4,), {"go_right": 1.0}),
        ((None,), {"go_left": 1.0}),
    ]


def test_a_small_change_changes_few_rows() -> None:
    plan = corridor()
    asked: Asked = {
        m: {"go_left": 1.0} if m[3] > 2 or (m[4] == 1 and m[0] == 2) else {"go_right": 1.0}
        for m in all_markings(3)
    }
    before = policy_of(plan, decided(asked))
    assert len(before.rows) < 10
    source = random.Random(5)
    for marking in source.sample(list(asked), 10):
        (chosen,) = asked[marking]
        changed = {**asked, marking: {"go_left" if chosen == "go_right" else "go_right": 1.0}}
        after = policy_of(plan, decided(changed))
        rows = [
            {
                (tuple((p, c) for p, c in zip(policy.places, row.counts) if c is not None), row[1])
                for row in policy.rows
            }
            for policy in (before, after)
        ]
        assert len(rows[0] ^ rows[1]) <= 3


def test_robots_wait_where_nothing_is_chosen_and_the_check_finds_no_gap() -> None:
    plan = replace(corridor(), strict=True)
    reached = PlanMarkings(plan, 1000, losses=True)
    space = reached.space.markings(np.arange(len(reached.space)))
    asked: Asked = {
        tuple(m): {} if m[1] == 1 else {"go_left": 0.25, "go_right": 0.75} for m in space.tolist()
    }
    policy = policy_of(plan, decided(asked))
    assert [(row.counts, dict(row.choices)) for row in policy.rows] == [
        ((0,), {"go_left": 0.25, "go_right": 0.75}),
        ((None,), {}),
    ]
    report = check(plan.with_policy(policy))
    assert not report.refused and not report.of("policy_overlaps")
    assert {item.severity for item in report.of("policy")} == {Severity.OK}


def test_what_cannot_be_written_is_refused() -> None:
    plan = corridor()
    marking = (1, 0, 0, 0, 0, 0)
    for choice, text in (({"nowhere": 1.0}, "nowhere"), ({"from_left": 1.0}, "from_left")):
        with pytest.raises(PolicyError, match=text):
            policy_of(plan, decided({marking: choice}))
    twice = Decided(np.array([marking, marking]), ({"go_left": 1.0}, {"go_right": 1.0}))
    with pytest.raises(PolicyError, match="two decisions"):
        policy_of(plan, twice)
    with pytest.raises(CancelledError):
        policy_of(plan, decided({marking: {"go_left": 1.0}}), cancel=lambda: True)
    assert policy_of(plan, Decided(np.zeros((0, 6), dtype=int), ())) == Policy()
