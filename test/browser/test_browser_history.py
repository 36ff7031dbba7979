"""The history of a fleet in a browser: reports, and the replay of a moment."""

from dataclasses import replace

import pytest
from page_reading import settle

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import LogFile
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.fleet.ingest import Ingest
from gspn_framework_package.fleet.reports import Question, history_report
from gspn_framework_package.fleet.store import Store
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.visualizer.fleet_page import FleetPage
from gspn_framework_package.visualizer.project import Project


@pytest.fixture(name="store")
def _store(tmp_path):
    """A store with two days of a slow patrol, in which the operator moved a robot."""
    plan = read_plan(plans_folder() + "/patrol")
    slow = {place: Duration.exponential(900.0) for place in plan.action_places}
    run = VirtualRun(replace(plan, durations=slow, timeouts={}).validate(), agents=True)
    writer = run.record_in(str(tmp_path / "run.jsonl"), "patrol", "log")
    run.begin()
    while run.step(100_000.0):
        pass
    run.order(log_entries.SetPlace("robot_2", "p2:Alarm_L1"))
    while run.step(170_000.0):
        pass
    writer.close()
    store = Store(str(tmp_path / "store"), create=True)
    with store.locked():
        assert [log.error for log in Ingest(store).read([str(tmp_path / "run.jsonl")])] == [""]
    return store


def _cells(page):
    return page.eval_on_selector_all(
        "#fleet-table tbody tr",
        "rows => rows.map(row => [...row.children].map(cell => cell.textContent))",
    )


def test_the_history_leads_to_the_replay_of_a_moment(store, site, open_page, axe, tmp_path):
    site_ = site(Project(fleet=FleetPage(store.folder)))
    page = open_page(site_.address, ready=False)
    page.click("#open-history")
    page.wait_for_selector("#fleet-table")
    assert [row[0] for row in _cells(page)] == ["robot_1", "robot_2", "robot_3", "robot_4"]
    assert page.locator(".fleet-plots svg.plot").count() == 2
    axe(page, "history")
    page.select_option("#fleet-by", "day")
    page.wait_for_selector("#fleet-table th:has-text('1970-01-02')")
    rows = history_report(store, Question(("day",)))
    assert [int(row[2].replace(",", "")) for row in _cells(page)] == [row["visits"] for row in rows]
    page.select_option("#fleet-robot", "robot_2")
    page.click("#fleet-table button:has-text('1970-01-02')")
    page.wait_for_selector("#fleet-moments h3:has-text('1970-01-02')")
    page.click("#fleet-moments li:has-text('order') a")
    page.wait_for_selector("#mode:has-text('REPLAY')")
    records = LogFile(str(tmp_path / "run.jsonl")).checked_records()
    slot = next(
        r["slot"] for r in records if any(e["entry"] == "set_place" for e in r.get("entries", ()))
    )
    key = "history-" + store.runs()[0]["key"]
    activity = site_.session(key).activity
    page.wait_for_function("() => window.gspn.model.board.n > 0")
    settle(page, activity.after_slot(slot))
    page.go_back()
    page.wait_for_selector("#fleet-table th:has-text('1970-01-02')")  # as it was left
