"""A run that continues under another plan, with another net: what the page shows of it, before and
after."""

import json
import shutil
from collections import Counter
from dataclasses import replace

import pytest
from deployed_log import NAMES, patrol, write_deployed_log

from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.documents import Document, Folder
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.reasons import reasons_in
from gspn_framework_package.visualizer.replay import Replay
from gspn_framework_package.visualizer.standalone_run import StandaloneRun


@pytest.fixture(name="deployed", scope="module")
def _deployed(tmp_path_factory):
    """A log (see ``deployed_log``), and its plans."""
    path = str(tmp_path_factory.mktemp("deployed") / "run.jsonl")
    return path, write_deployed_log(path)


def replayed(path):
    """A replay whose log has been read, and its hub."""
    activity, hub = Replay(path), Hub("", Board(0, []))
    activity.begin(hub)
    cursor = hub.news(None).cursor
    while hub.info.get("loading"):
        assert hub.wait(cursor, 20)
        cursor = hub.news(cursor).cursor
    return activity, hub


@pytest.mark.parametrize("between", [250, 3])
def test_a_replay_shows_each_part_of_a_run_in_the_net_of_its_plan(deployed, monkeypatch, between):
    monkeypatch.setattr("gspn_framework_package.visualizer.recording.LINES_BETWEEN", between)
    path, plans = deployed
    activity, hub = replayed(path)
    n = hub.board().n
    events = hub.events(0, n)
    assert [note["text"] for note in hub.board().notes] == []
    steps = list(replay(read_log(path)))
    fired = [(f, step.state) for step in steps for f in step.firings]
    shown = [event for event in events if event["k"] == "fire"]
    assert len(shown) == len(fired) > 60
    for event, (firing, _) in zip(shown, fired):
        net = (activity.plan_of(event["p"]) if event.get("p") else plans[0]).net
        assert net.transitions[event["tr"]].name == firing.transition
        for at in (event["n"], event["n"] - 1, event["n"]):  # back and forth
            board = hub.board_at(at)
            assert len(board.marking) == len(board_net(activity, plans, board).places)
        assert tuple(board.marking) == firing.marking
        places = [robot["place"] for robot in board.robots.values()]
        assert sorted(places) == sorted(p for p, k in enumerate(board.marking) for _ in range(k))
    changes = [event for event in events if event["k"] == "plan"]
    assert [(e["plan"], e["p"], e["name"]) for e in changes] == [(1, 1, "five"), (2, 2, "again")]
    assert activity.plan_of(1).net == plans[1].net and activity.plan_of(3) is None


def board_net(activity, plans, board):
    """The net of the plan that a board follows."""
    return (activity.plan_of(board.plan) or plans[0]).net


def test_firings_are_counted_on_where_a_transition_has_another_name_or_number(deployed):
    path, plans = deployed
    activity, hub = replayed(path)
    counted = {}
    for event in hub.events(0, hub.board().n):
        if event["k"] == "fire":
            net = board_net(activity, plans, hub.board_at(event["n"])).transitions
            name = net[event["tr"]].name
            name = NAMES.get(name, name)
            counted[name] = counted.get(name, 0) + 1
    board = hub.board()
    names = [t.name for t in board_net(activity, plans, board).transitions]
    assert dict(zip(names, board.counts)) == counted and counted["leave_X"] > 10


@pytest.fixture(name="session")
def _session(deployed, tmp_path):
    shutil.copy(deployed[0], str(tmp_path / "run.jsonl"))
    project = Project(Folder(str(tmp_path)))
    session = project.open("run.jsonl")
    cursor = session.hub.news(None).cursor
    while session.hub.info.get("loading"):
        assert session.hub.wait(cursor, 20)
        cursor = session.hub.news(cursor).cursor
    yield session
    project.close()


def test_the_page_gets_the_picture_of_each_plan(session):
    assert [p["name"] for p in session.scene_at(0)["places"]] == list("ABCD")
    assert [p["name"] for p in session.scene_at(2)["places"]] == list("EXDBA")
    assert session.scene_at(2)["plan"]["name"] == "again"
    with pytest.raises(InputError, match="not followed a plan with the number 3"):
        session.scene_at(3)


def test_reasons_are_those_of_the_plan_of_the_moment(session):
    first = next(e["n"] for e in session.hub.events(0, 10**6) if e["k"] == "plan")
    assert reasons_in(session, "leave_C", first - 1)["transition"] == "leave_C"
    assert reasons_in(session, "leave_X", first)["transition"] == "leave_X"
    with pytest.raises(InputError):
        reasons_in(session, "leave_C", first)


@pytest.mark.long
def test_a_live_run_goes_on_under_another_plan(tmp_path):
    (tmp_path / "actions.py").write_text("def work(is_cancelled):\n    is_cancelled.wait(0.005)\n")
    old, new = (
        replace(
            patrol(places, name),
            folder=str(tmp_path),
            durations={place: Duration.gamma(8.0, 0.01) for place in places},
        )
        for places, name in (("ABCD", "four"), ("EXDBA", "five"))
    )
    activity, hub = StandaloneRun(Document("four", old.net, old)), Hub("", Board(0, []))
    activity.begin(hub)
    try:
        cursor = _news(hub, hub.news(None).cursor, lambda board: sum(board.counts) > 3)
        activity._executor.deploy(new, NAMES)
        _news(hub, cursor, lambda board: board.plan == 1 and sum(board.counts) > 20)
        board = json.loads(hub.news(None).text)["snapshot"]["board"]  # of a viewer who comes late
        assert board["plan"] == 1 and sum(board["marking"]) == 2 and len(board["marking"]) == 5
        assert activity.plan_of(1).name == "five" and "five" in hub.info["says"]
        places = Counter(robot["place"] for robot in board["robots"])
        assert [places[p] for p in range(5)] == board["marking"]
        _news(hub, cursor, lambda _: _model(hub)["state"] == "watching")
        curves = {curve["name"] for curve in _model(hub)["curves"]}
        assert "leave_X" in curves and "leave_C" not in curves
    finally:
        activity.end()


def _model(hub):
    return json.loads(hub.news(None).text)["latest"]["model"]


def _news(hub, cursor, reached):
    """Wait until the board of a hub is as wanted; returns the cursor then."""
    while not reached(hub.board()):
        assert hub.wait(cursor, 30)
        cursor = hub.news(cursor).cursor
    return cursor
