"""The page's side of a fleet's history, and the way from a slot of a log to its event."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest
from logged_runs import Story, ring

from gspn_framework_package.execution.event_log import LogFile
from gspn_framework_package.execution.log_entries import Done, Failed
from gspn_framework_package.fleet.ingest import Ingest
from gspn_framework_package.fleet.store import Store
from gspn_framework_package.model.errors import InputError, LogError
from gspn_framework_package.visualizer import recording
from gspn_framework_package.visualizer.app import create_app
from gspn_framework_package.visualizer.fleet_page import RUN_KEY, FleetPage
from gspn_framework_package.visualizer.guard import Guard
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.recording import Recording


def long_story() -> Story:
    story = Story(ring()).start()
    for visit in range(1, 60):
        story.slot(visit * 2.0, Done("a", 0, visit, "t1" if visit % 2 else "t2"))
    story.slot(130.0, Failed("b", 0, 1, 1, "aborted"))
    return story


@pytest.fixture(name="fleet")
def _fleet(tmp_path: Path) -> FleetPage:
    log = long_story().save(tmp_path / "log.jsonl")
    store = Store(str(tmp_path / "store"), create=True)
    with store.locked():
        list(Ingest(store).read([log]))
    return FleetPage(store.folder)


def test_every_slot_of_a_log_leads_to_its_last_event(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "LINES_BETWEEN", 5)
    log = Recording(LogFile(long_story().save(tmp_path / "log.jsonl")))
    assert log.after_slot(30) is None  # not read so far
    last = [board.n for board, _ in log.read()][-1]
    found = [log.after_slot(slot) for slot in range(62)]
    assert found[-1] == found[-2] == last
    assert found == sorted(found, key=lambda n: n or 0)
    for slot in (1, 7, 30, 59):
        fired = [event for event in log.events(0, found[slot] or 0) if event["k"] == "fire"]
        assert fired[-1]["s"][0] == slot


def test_the_page_gets_reports_and_moments_with_their_replay(fleet: FleetPage) -> None:
    assert fleet.names() == {"robots": ["a", "b"], "places": ["A", "B"], "days": ["2001-09-09"]}
    (row,) = fleet.report({"by": "day", "robot": "b"})["rows"]
    assert (row["visits"], row["failures"]) == (1, 1)
    (failure, alarm) = fleet.moments({"robot": "b"})["moments"]
    assert (failure["kind"], alarm["kind"], failure["slot"]) == ("failure", "alarm", 60)
    project = Project(fleet=fleet)
    try:
        assert project.to_json()["history"] is True
        session = project.session(failure["id"])
        assert session is project.session(failure["id"])
        deadline = time.monotonic() + 60
        while session.activity.after_slot(60) is None:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        for unknown in (RUN_KEY + "other", RUN_KEY + "../x"):
            with pytest.raises(InputError, match="no log of this run"):
                project.session(unknown)
    finally:
        project.close()


def test_a_log_that_was_moved_away_is_named_without_its_folder(
    fleet: FleetPage, tmp_path: Path
) -> None:
    os.remove(tmp_path / "log.jsonl")
    (alarm, _) = fleet.moments({"robot": "b"})["moments"]
    with pytest.raises(LogError, match="must be where it was") as caught:
        Project(fleet=fleet).session(alarm["id"])
    assert str(tmp_path) not in str(caught.value)
    assert "log.jsonl" in str(caught.value)


def test_the_routes_refuse_what_makes_no_sense(fleet: FleetPage) -> None:
    def ask(project: Project, path: str) -> Any:
        client = create_app(project, Guard("127.0.0.1", 8090)).test_client()
        return client.get(path, base_url="http://127.0.0.1:8090")

    assert ask(Project(fleet=fleet), "/api/history/report?by=place").status_code == 200
    wrong = ask(Project(fleet=fleet), "/api/history/report?by=colour")
    assert (wrong.status_code, "colour" in wrong.get_json()["error"]) == (400, True)
    none = ask(Project(), "/api/history/names")
    assert "gspn serve --history" in none.get_json()["error"]
