"""What the benchmark of the room with ROS reads from the logs of a run."""

import pytest

from benchmarks.room_report import FAULTS, figures, show_beside_thesis
from benchmarks.room_ros import count_policy_misses
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.formats.plan_json import plan_from_json

PLAN = {
    "plan": "choice",
    "net": {
        "places": [{"name": "A", "tokens": 2}, {"name": "B"}],
        "transitions": [{"name": "go", "timed": False}, {"name": "back", "timed": False}],
        "arcs": [
            {"from": "A", "to": "go"},
            {"from": "go", "to": "B"},
            {"from": "B", "to": "back"},
            {"from": "back", "to": "A"},
        ],
    },
    "actions": {"A": "act.go", "B": "act.go"},
    "robots": {"robot_1": "A", "robot_2": "A"},
}


@pytest.mark.parametrize(
    "known, missed",
    [
        ([(2, 0), (1, 1), (0, 2)], set()),
        ([(2, 0), (0, 2)], {(1, 1)}),
        ([], {(2, 0), (1, 1), (0, 2)}),
    ],
)
def test_draws_without_a_row_of_the_policy_are_counted(record_run, tmp_path, known, missed):
    (tmp_path / "act.py").write_text("def go(): pass\n")
    rows = [{"marking": list(marking), "choose": {"go": 0.5, "back": 0.5}} for marking in known]
    policy = {"policy": {"places": ["A", "B"], "rows": rows}} if rows else {}
    plan = plan_from_json({**PLAN, **policy}, folder=str(tmp_path))
    path = str(tmp_path / "run.jsonl")
    drawn = []
    for step in record_run(plan, path, 100):
        for firing in step.firings:
            change = -1 if firing.transition == "go" else 1
            drawn.append((firing.marking[0] - change, firing.marking[1] + change))
    assert count_policy_misses(read_log(path)) == sum(before in missed for before in drawn)
    assert {(2, 0), (1, 1)} <= set(drawn)


def test_the_table_beside_the_thesis_has_visits_cost_and_faults():
    report = {"robots": {"r1": {"laps": 1}}, "entries": 30, "simulated_seconds": 900.0}
    report.update(dict.fromkeys(FAULTS, 0), goals_aborted=2)
    cost = {"cpu_seconds_per_minute": 3.0, "memory_mb": 110.4}
    results = [{"robots": n, **figures(report), **cost} for n in (1, 5)]
    lines = show_beside_thesis(results).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    assert cells == [
        ["1", "smooth", "120", "goals_aborted 2", "5", "110"],
        ["5", "not tried", "120", "goals_aborted 2", "5", "110"],
    ]
