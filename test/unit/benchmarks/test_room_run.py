"""The patrol's own plan with robots that drive, without ROS: its log is that of a real run."""

import pytest

from benchmarks.room_run import RoomRun
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.world.room_file import load_room

pytest.importorskip("pybullet")


def test_the_log_of_a_driving_team_is_valid(tmp_path):
    room = load_room(plans_folder() + "/patrol/critical_room.yaml")
    log = str(tmp_path / "run.jsonl")
    run = RoomRun(read_plan(plans_folder() + "/patrol/room.json"), room, 3, log)
    run.run(25.0)
    run.close()
    found = read_log(log)
    verdict = verify([found])
    assert verdict.violation is None
    assert verdict.robots == 4
    assert verdict.firings >= 4  # every robot has checked a location and moved on
    assert found.records[-1]["mono"] == pytest.approx(25.0)
    assert run.failures == []


def test_another_plan_is_refused():
    room = load_room(plans_folder() + "/patrol/critical_room.yaml")
    with pytest.raises(PlanError, match="not a place of the patrol"):
        RoomRun(read_plan(plans_folder() + "/rendezvous"), room)
