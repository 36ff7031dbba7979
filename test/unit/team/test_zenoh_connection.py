"""The page that watches a team over Zenoh: real agents, sessions and a router; no browser."""

from dataclasses import replace

import pytest
from zenoh_team import Agents, Hub, make_keys, wait_for

from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.team import host as host_module
from gspn_framework_package.visualizer.hub import Hub as PageHub
from gspn_framework_package.visualizer.team_watch import TeamWatch
from gspn_framework_package.visualizer.zenoh_connection import (
    ZenohConnection,
    is_activity,
    read_fired,
)

FIRED = {
    "plan": "hash",
    "run": "monday",
    "transition": "seen",
    "robot": "robot_1",
    "incarnation": 1,
    "visit": 1,
    "robots": ["robot_1"],
    "robot_places": ["Wait"],
    "places": ["Look", "Wait"],
    "counts": [0, 1],
    "slot": 3,
    "index": 0,
    "private_move": False,
    "hash": "",
    "details": "",
}


@pytest.fixture(name="agents")
def _agents(tmp_path, monkeypatch):
    monkeypatch.setattr(host_module, "FAREWELL", 0.3)
    hub = Hub(make_keys(tmp_path / "keys"))
    made = Agents(hub, tmp_path / "meeting")
    made.wait_for_team()
    yield made
    made.close()
    hub.close()


class Page:
    """What a page shows that watches with somebody's keys."""

    def __init__(self, agents, name, run=""):
        self.connection = ZenohConnection(agents.hub.access(name), run)
        self.watch = TeamWatch(agents.plan, self.connection, run)
        self.hub = PageHub("", self.watch._follower.board({}))
        self.watch.begin(self.hub)

    @property
    def status(self):
        return self.hub.board().status

    def phases(self):
        return {n: robot["phase"] for n, robot in self.hub.board().robots.items()}

    def places(self):
        board, net = self.hub.board(), self.watch.plan.net
        return {n: net.places[robot["place"]].name for n, robot in board.robots.items()}


@pytest.fixture(name="page")
def _page(agents):
    made = []

    def make(*given):
        made.append(Page(agents, *given))
        return made[-1]

    yield make
    for page in made:
        page.watch.end()


def test_a_page_with_an_operators_keys_shows_a_team_and_gives_orders(agents, page):
    shown = page("ann")
    wait_for(lambda: set(shown.phases().values()) == {"doing"}, 30)
    assert shown.status["run"] == "monday" and shown.status["running"]
    assert (
        "robots stop at: seen" in shown.watch.command("breakpoints", {"names": ["seen"]})["message"]
    )
    wait_for(lambda: shown.hub.info.get("breakpoints") == ["seen"], 30)
    shown.watch.command("breakpoints", {"names": []})
    shown.watch.command("set_place", {"robot": "robot_2", "place": "Wait"})
    wait_for(lambda: shown.places() == {"robot_1": "Look", "robot_2": "Wait"}, 30)
    with pytest.raises(RefusedError):
        shown.watch.command("evict", {"robot": "robot_7"})
    agents.let_them_meet()
    wait_for(lambda: shown.status["finished"], 30)
    wait_for(lambda: set(shown.places().values()) == {"Home"}, 30)


def test_a_page_with_a_watchers_keys_shows_the_same_and_follows_a_deployed_plan(agents, page):
    operator, watcher = page("ann", "monday"), page("screen", "monday")
    wait_for(lambda: watcher.phases() == dict.fromkeys(agents.hosts, "doing"), 30)
    assert watcher.watch.commands == {}
    wait_for(lambda: operator.phases() == watcher.phases(), 30)
    outcome = operator.watch.deploy(replace(agents.plan, seed=7), {}, lambda votes: None)
    assert outcome.done, outcome.message
    wait_for(lambda: watcher.hub.board().plan == 1, 30)
    agents.let_them_meet()
    wait_for(lambda: watcher.status["finished"], 30)


@pytest.mark.long
def test_a_page_says_that_the_router_is_gone_and_goes_on_when_it_is_back(agents, page):
    shown = page("ann")
    wait_for(lambda: set(shown.phases().values()) == {"doing"}, 30)
    agents.hub.router.close()
    wait_for(lambda: "does not answer; trying again" in shown.status["unreachable"], 30)
    with pytest.raises(RefusedError, match="no connection with the team"):
        shown.watch.command("pause", {})
    agents.hub.reopen()
    wait_for(lambda: shown.status["unreachable"] == "", 30)
    agents.let_them_meet()
    wait_for(lambda: shown.status["finished"], 30)


@pytest.mark.parametrize("name", sorted(set(FIRED) - {"incarnation", "hash"}))
@pytest.mark.parametrize("value", [None, {}, [None], 1.5])
def test_a_firing_that_is_none_is_not_taken(name, value):
    assert read_fired(FIRED).transition == "seen"
    assert read_fired({**FIRED, name: value}) is None


def test_an_activity_that_is_none_is_not_taken():
    whole = {
        "robot": "robot_1",
        "run": "monday",
        "plan": "hash",
        "state": "Doing",
        "waits_for": "",
        "needs_operator": False,
        "ended": None,
        "finished": False,
        "fault": False,
        "feedback": [],
    }
    assert is_activity(whole)
    for name in whole:
        assert not is_activity({**whole, name: 1.5})
