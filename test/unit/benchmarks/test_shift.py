"""A shift in the warehouse is judged by its logs (benchmarks.shift)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict

import pytest

from benchmarks.shift import fates, faults
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan

GOOD: Dict[str, Any] = {
    "orders": 3,
    "ended_once": 3,
    "outcomes": {"customers": {"done": 1}, "window": {"late": 1}, "cancelled": {"cancelled": 1}},
    "mean_wait_of_customers": 10.0,
    "mean_wait_of_urgent": 4.0,
    "most_moved_after_a_stop": 0.001,
    "refused": [],
    "returned_at": 300.0,
    "verdict": "valid",
    "contacts_with_people": 0,
}


def test_the_log_says_how_each_order_ended_and_how_long_it_waited(tmp_path: Path) -> None:
    run = VirtualRun(read_plan(plans_folder() + "/warehouse"), seed=4, environment=False)
    log = run.record_in(str(tmp_path / "run.jsonl"), "run", "log")
    run.begin()
    run.order(log_entries.Submit("order", "done", data={"pose": {}}))
    run.wait_until(2.0)
    for name in ("cancelled", "late"):
        run.order(log_entries.Submit("order", name, to="nobody"))
    run.order(log_entries.CancelTask("cancelled"))
    run.order(log_entries.CancelTask("late", late=True))
    while run.step(100.0):
        pass
    log.close()
    found = fates(read_log(str(tmp_path / "run.jsonl")))
    assert found.ended == {"cancelled": ["cancelled"], "late": ["late"], "done": ["done"]}
    assert found.waits == {"done": 0.0}


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"ended_once": 2}, "not every order ended exactly once"),
        (
            {"outcomes": {**GOOD["outcomes"], "urgent": {"late": 1}}},
            "orders of the kind 'urgent' ended as",
        ),
        ({"outcomes": {"cancelled": {"done": 2}}}, "no order was cancelled"),
        ({"mean_wait_of_urgent": 5.0}, "urgent orders did not wait less than half as long"),
        ({"most_moved_after_a_stop": 0.02}, "a robot moved after a stop"),
        ({"contacts_with_people": 1}, "something was touched"),
        ({"refused": ["no"]}, "the team refused orders"),
        ({"returned_at": 0.0}, "no robot was killed and came back"),
        ({"verdict": "rule 3: x"}, "the logs are not valid"),
    ],
)
def test_what_goes_wrong_in_a_shift_is_named(wrong: dict, text: str) -> None:
    assert faults(GOOD) == []
    (found,) = faults({**GOOD, **wrong})
    assert found.startswith(text)
