"""The benchmark of the alarm, in small."""

from pathlib import Path

from benchmarks.alarms import paces_of, regular, watched
from gspn_framework_package.formats.plan_file import read_plan

PATROL = Path(__file__).parents[3] / "plans" / "patrol"


def test_a_slower_robot_is_noticed_and_named_and_no_other():
    plan = regular(read_plan(str(PATROL)), 59.0)
    paces = paces_of(plan, 100.0)
    strict, lenient = watched(
        plan,
        260.0,
        paces,
        [30 * 86_400.0, 3600.0],
        seed=1,
        slowness=lambda robot, place, now: 1.3 if robot == "robot_2" and now > 120 else 1.0,
    )
    first, early = strict.alarms[0], lenient.alarms[0]
    assert (first.robot, first.direction) == ("robot_2", "slower")
    assert 120 < early.at <= first.at < 220
    assert abs(first.change - 0.3) < 0.15
