"""Robots that wait where the next order is likely."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.waiting_places import (
    HOUR,
    NORTH,
    best,
    day_in_room,
    learned,
    orders,
    waits,
    warehouse,
)


@pytest.mark.long
def test_robots_wait_where_the_recorded_days_had_orders(tmp_path: Any) -> None:
    plan = warehouse()
    fitted = learned(plan, 3, str(tmp_path))
    assert fitted.periods == [0, 2, 4, 6]
    busy = fitted.clock.net.transition("order_north_2_4").number * HOUR
    assert busy == pytest.approx(NORTH[2], rel=0.35)
    shipped, new = waits(plan, plan.policy, 3), waits(fitted.clock, best(fitted.clock), 3)
    assert shipped.value and new.value and new.value < 0.7 * shipped.value


def test_a_day_in_the_room_is_driven() -> None:
    pytest.importorskip("pybullet")
    ((when, _),) = orders(18, 15.0)
    found = day_in_room(warehouse(), 18, 2.0)
    assert found.picked == 1 and 35.0 < found.waited < 120.0 - when
