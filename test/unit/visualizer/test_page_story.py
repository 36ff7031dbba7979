"""The story of a run on the page: its routes, and the moments that times lead to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from page_client import PageClient

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.visualizer import run_stories
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project


@pytest.fixture(name="log", scope="module")
def _log(tmp_path_factory: Any) -> Path:
    path = tmp_path_factory.mktemp("runs") / "warehouse.jsonl"
    plan = plans_folder() + "/warehouse"
    assert main(["simulate", plan, "--time", "60", "--seed", "7", "--log", str(path)]) == 0
    return path


@pytest.fixture(name="client")
def _client(log: Path) -> PageClient:
    client = PageClient(Project(Folder(str(log.parent))))
    client.post("/api/open", {"path": log.name})
    hub = client.project.session("file-" + log.name).hub
    cursor = hub.news(None).cursor
    while hub.info.get("loading"):
        assert hub.wait(cursor, 20)
        cursor = hub.news(cursor).cursor
    return client


ID = "id=file-warehouse.jsonl"


def test_the_story_is_that_of_the_command(client: PageClient, log: Path, capsys: Any) -> None:
    assert main(["report", str(log), "--json", "--most", "200"]) == 0
    told = client.get("/api/story?" + ID).get_json()
    assert told == json.loads(capsys.readouterr().out)
    assert any(wait["for"] for wait in told["waits"])


def test_the_report_is_a_file_whose_moments_link_to_this_page(client: PageClient) -> None:
    answer = client.get("/api/report?" + ID)
    assert answer.headers["Content-Disposition"] == "attachment; filename=warehouse.html"
    link = "http://127.0.0.1:8090/#file-warehouse.jsonl&amp;slot="
    assert link in answer.get_data(as_text=True)


def test_a_time_leads_to_the_last_event_until_then(client: PageClient) -> None:
    hub = client.project.session("file-warehouse.jsonl").hub
    events = hub.events(0, 10**9, 10**9)
    for event in events[:: len(events) // 20]:
        expected = max(other["n"] for other in events if other["t"] <= event["t"])
        told = client.get("/api/moment?%s&t=%.4f" % (ID, event["t"])).get_json()
        assert told == {"epoch": hub.epoch, "event": expected}
    assert hub.event_at(0.0) == max(event["n"] for event in events if event["t"] <= 0.0)
    assert hub.event_at(1e9) == events[-1]["n"]
    hub.info["loading"] = True
    assert hub.event_at(1e9) is None
    assert hub.event_at(1.0) is not None


@pytest.mark.long
@pytest.mark.parametrize("t", ["", "-1", "1e3", "nan", "1.1234567", "9" * 20])
def test_what_is_no_time_is_refused(client: PageClient, t: str) -> None:
    assert client.get("/api/moment?%s&t=%s" % (ID, t)).status_code == 400


def test_a_net_without_a_run_has_no_story() -> None:
    client = PageClient()
    for path in ("story", "report"):
        answer = client.get("/api/%s?id=small" % path)
        assert answer.status_code == 400 and "no log" in answer.get_json()["error"]


def test_a_log_that_is_too_large_is_refused(client: PageClient, monkeypatch: Any) -> None:
    monkeypatch.setattr(run_stories, "STORY_BYTES", 1000)
    answer = client.get("/api/story?" + ID)
    assert answer.status_code == 400 and "gspn report" in answer.get_json()["error"]


def test_a_log_that_has_changed_is_named_without_its_folder(tmp_path: Path, log: Path) -> None:
    lines = log.read_text().splitlines(keepends=True)
    (tmp_path / "bad.jsonl").write_text("".join(lines[:20] + lines[21:]))
    client = PageClient(Project(Folder(str(tmp_path))))
    client.post("/api/open", {"path": "bad.jsonl"})
    error = client.get("/api/story?id=file-bad.jsonl").get_json()["error"]
    assert "bad.jsonl:21" in error and str(tmp_path) not in error
