"""Simulated teams under fresh seeds, with faults, each looked at by the history checker."""

from __future__ import annotations

import hashlib
import os
import pathlib
import time

import pytest

from agreement.schedule import Schedule, run_schedule
from agreement.world import ViolationError
from benchmarks.agreement import draw_schedules
from gspn_framework_package import execution
from gspn_framework_package.execution.agreement import config

SCHEDULES = int(os.environ.get("GSPN_SCHEDULES", "200"))
FAILED = os.path.join(os.path.dirname(__file__), "failed_seeds.txt")

FAILED_AS_LARGE = [
    "489723877200:3:full:react-double",
    # a busy process kept a second one of its name from hearing that
    "221036329:4:full:react-double",
    # no fault: the log of a process that had ended was taken for that of its robot
]
"""Schedules of teams with the ways of large ones that ever failed, each with what it showed."""


def _failed():
    with open(FAILED, encoding="utf-8") as file:
        return [line.split("#")[0].strip() for line in file if line.split("#")[0].strip()]


@pytest.mark.parametrize("schedule", _failed())
def test_a_schedule_that_once_failed(schedule: str) -> None:
    run_schedule(Schedule.parse(schedule))


def _first_seed() -> int:
    """Other schedules for every other version of the code, and the same ones for the same code:
    whoever runs these tests again finds the same."""
    digest = hashlib.sha256()
    for path in sorted(pathlib.Path(execution.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:5], "big")


def test_fresh_seeds(capsys: pytest.CaptureFixture) -> None:
    first = _first_seed()
    failures = []
    number = blocked = 0
    begin = time.monotonic()
    for schedule in draw_schedules(first, SCHEDULES):
        try:
            blocked += run_schedule(schedule).blocked
        except ViolationError as error:
            failures.append("%s: %s" % (schedule, error))
        number += 1
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
    failures = []
    failed = [Schedule.parse(text) for text in FAILED_AS_LARGE]
    for schedule in [*failed, *draw_schedules(_first_seed(), 60, [3, 5])]:
        try:
            run_schedule(schedule)
        except ViolationError as error:
            failures.append("%s: %s" % (schedule, error))
    assert not failures
