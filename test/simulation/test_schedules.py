"""Simulated teams under fresh seeds, with faults, each looked at by the history checker."""

from __future__ import annotations

import os
import time

import pytest

from gspn_framework_package.benchmark.agreement import draw_schedules
from gspn_framework_package.execution.agreement import config
from gspn_framework_package.execution.agreement_simulation.schedule import Schedule, run_schedule
from gspn_framework_package.execution.agreement_simulation.world import ViolationError

SCHEDULES = int(os.environ.get("GSPN_SCHEDULES", "2500"))
SECONDS = float(os.environ.get("GSPN_SCHEDULE_SECONDS", "35"))
FAILED = os.path.join(os.path.dirname(__file__), "failed_seeds.txt")


def _failed():
    with open(FAILED, encoding="utf-8") as file:
        return [line.split("#")[0].strip() for line in file if line.split("#")[0].strip()]


@pytest.mark.parametrize("schedule", _failed())
def test_a_schedule_that_once_failed(schedule: str) -> None:
    run_schedule(Schedule.parse(schedule))


def test_fresh_seeds(capsys: pytest.CaptureFixture) -> None:
    """As many as fit into the time; at least 100, however slow the machine is."""
    first = time.time_ns() // 1000 % 10**12
    failures = []
    number = blocked = 0
    begin = time.monotonic()
    for schedule in draw_schedules(first, SCHEDULES):
        try:
            blocked += run_schedule(schedule).blocked
        except ViolationError as error:
            failures.append("%s: %s" % (schedule, error))
        number += 1
        if time.monotonic() - begin > SECONDS and number >= 100:
            break
    with capsys.disabled():
        rate = number / (time.monotonic() - begin) * 60
        print(
            "\n%d simulated teams, seeds from %d on, %.0f a minute: %d violations"
            % (number, first, rate, len(failures))
        )
    assert not failures, "add to %s: %s" % (FAILED, failures)
    assert blocked < number / 20, "%d of %d teams were left without a quorum" % (blocked, number)


def test_teams_that_keep_the_ways_of_large_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the agreement does otherwise with more than eight robots (rarer heartbeats, proposals
    that are gathered, no votes for those who are not the leader), tested with few, which are
    faster."""
    monkeypatch.setattr(config, "SMALL_TEAM", 2)
    first = time.time_ns() // 1000 % 10**12
    failures = []
    for schedule in draw_schedules(first, 60, [3, 5]):
        try:
            run_schedule(schedule)
        except ViolationError as error:
            failures.append("%s: %s" % (schedule, error))
    assert not failures
