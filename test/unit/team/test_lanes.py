"""A robot's messages in lanes pass a router that drops what comes too soon in the same lane."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.team.lanes import (
    LANES,
    PASSED_BY_ROUTER,
    PAUSE,
    Lanes,
    router_limits,
)


@given(st.lists(st.floats(0.0, 0.1), max_size=200), st.integers(1, 5))
@settings(derandomize=True)
def test_no_message_of_a_lane_comes_too_soon_after_the_one_before(pauses, count):
    lanes, now, last, sent = Lanes(count), 100.0, {}, []
    for pause in pauses:
        now += pause
        lane, wait = lanes.take(now)
        assert 0.0 <= wait < 1.01 * PAUSE
        now += wait
        assert now - last.get(lane, 0.0) > 0.99 * PAUSE
        last[lane] = now
        sent.append(now)
    for early, late in zip(sent, sent[count:]):
        assert late - early > 0.99 * PAUSE


def test_a_robot_that_was_quiet_need_not_wait():
    lanes = Lanes()
    assert [lanes.take(5.0) for _ in range(LANES)] == [(lane, 0.0) for lane in range(LANES)]
    assert lanes.take(5.0) == (0, pytest.approx(PAUSE))


def test_a_router_lets_through_what_robots_send():
    limits = router_limits(["a/%d", "b/*/%d"])
    rules = [rule for item in limits for rule in item["rules"]]
    assert {rule["key_expr"] for rule in rules} == {
        text for lane in range(LANES) for text in ("a/%d" % lane, "b/*/%d" % lane)
    }
    assert {1.0 / rule["freq"] for rule in rules} == {PASSED_BY_ROUTER}
    assert PASSED_BY_ROUTER < PAUSE
