"""The page of a team without ROS: agents of this process, a router, and what the page shows when it
is gone."""

import sys
from pathlib import Path

import pytest

from gspn_framework_package.team import host as host_module
from gspn_framework_package.visualizer.project import project_of_team
from gspn_framework_package.visualizer.team_watch import TeamWatch

sys.path.append(str(Path(__file__).parents[1] / "unit" / "team"))

pytest.importorskip("zenoh")


@pytest.fixture(name="agents")
def _agents(tmp_path, monkeypatch):
    from zenoh_team import Agents, Hub

    monkeypatch.setattr(host_module, "FAREWELL", 0.3)
    hub = Hub()
    made = Agents(hub, tmp_path / "meeting")
    yield made
    made.close()
    hub.close()


def test_a_team_over_zenoh_is_watched_and_ordered(agents, site, open_page, picture):
    from gspn_framework_package.visualizer.zenoh_connection import ZenohConnection

    watch = TeamWatch(agents.plan, ZenohConnection(agents.hub.access("screen")), "monday")
    page = open_page(site(project_of_team(str(agents.folder), agents.plan, watch)).address)
    page.wait_for_selector("#frame-name:has-text('a team of robots on Zenoh')")
    page.wait_for_selector(".robot-card[data-robot='robot_1']:has-text('acts')")
    page.click("#pause-team")
    page.wait_for_selector(".alarm:has-text('The team is paused')")
    agents.hub.router.close()
    page.wait_for_selector(".alarm:has-text('Cut off')")
    picture(page, "cut_off")
    agents.hub.reopen()
    page.wait_for_selector(".alarm:has-text('Cut off')", state="detached")
    page.click("#pause-team")
    page.wait_for_selector(".alarm:has-text('The team is paused')", state="detached")
    agents.let_them_meet()
    page.wait_for_selector(".alarm.good:has-text('Finished')")
    page.wait_for_selector("#log li:has-text('meet')")
