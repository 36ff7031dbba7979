"""The benchmarks that compare two policies: what they read from logs, and their intervals."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import inspection, room_policies
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError


def test_a_log_shows_what_the_run_of_it_counted(tmp_path: Path) -> None:
    plan = read_plan(plans_folder() + "/inspection")
    log = str(tmp_path / "run.jsonl")
    run = VirtualRun(plan, seed=4)
    writer = run.record_in(log, "run", "log")
    run.run(time=60.0)
    writer.close()
    for warm_up in (0.0, 20.0):
        result = VirtualRun(plan, seed=4).run(time=60.0, warmup=warm_up)
        due = sum(mean for name, mean in result.mean_tokens.items() if name.startswith("Due_"))
        done = sum(count for name, count in result.firings.items() if name.startswith("Inspected_"))
        seen = inspection.seen_in(log, plan, warm_up)
        # the log ends, and the warm-up of what is read from it, with a firing
        assert seen.due == pytest.approx(due, rel=0.05)
        assert seen.inspections * (60.0 - warm_up) == pytest.approx(done, abs=1.5) and done > 5
    with pytest.raises(ExecutionError, match="within 90 s"):
        inspection.seen_in(log, plan, 90.0)


def test_the_intervals_are_those_of_the_differences_in_pairs() -> None:
    seen = [(inspection.SiteRun(a, 1.0), inspection.SiteRun(a - 1.0, 1.5)) for a in (2.0, 4.0, 9.0)]
    found = inspection.compared(seen)
    assert found["runs"] == 3
    assert found["due"]["difference"] == {"mean": -1.0, "low": -1.0, "high": -1.0}
    assert found["due"]["gain"] == pytest.approx(-0.2)
    assert found["inspections"]["gain"] == pytest.approx(0.5)

    def runs(*visits: float) -> list:
        return [{"visits_per_hour": v, "two_in_one_location": int(v > 410)} for v in visits]

    room = room_policies.compared(runs(400.0, 404.0), runs(404.0, 412.0))
    assert room["difference"]["mean"] == 6.0
    assert room["difference"]["high"] - 6.0 == pytest.approx(12.706 * 2, rel=1e-3)
    assert not room["significant"] and room["relative"] == pytest.approx(6 / 402)
    assert room["rule_broken"] == {"old": 0, "new": 1}
