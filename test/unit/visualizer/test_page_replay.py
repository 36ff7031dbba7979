"""Recorded runs on the page: event logs and rosbags lead to the marking that the run had."""

import json

import pytest

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.visualizer.bag_replay import TYPE, BagReplay
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.replay import Replay

PLAN = "plans/tokens/instant.json"


@pytest.fixture(name="recorded", scope="module")
def _recorded(record_run, tmp_path_factory):
    """An event log of 200 firings, the firings, and the state at the end."""
    path = str(tmp_path_factory.mktemp("runs") / "run.jsonl")
    steps = record_run(read_plan(PLAN), path, 200)
    return path, [f for step in steps for f in step.firings], steps[-1].state


def finished(activity):
    """A hub that has taken in all of a replay."""
    hub = Hub("", Board(0, []))
    activity.begin(hub)
    cursor = hub.news(None).cursor
    while hub.info.get("loading"):  # asked after the cursor was taken: the end of the loading is news to it
        assert hub.wait(cursor, 20)
        cursor = hub.news(cursor).cursor
    return hub


def test_an_event_log_leads_to_the_state_of_the_run(recorded):
    path, firings, state = recorded
    hub = finished(Replay.of_file(path))
    board = hub.board()
    assert tuple(board.marking) == state.marking
    assert sum(board.counts) == len(firings)
    assert board.status["ended"] == "stopped by the operator"
    middle = next(e for e in hub.events(0, 10**9) if e.get("s") == [firings[100].slot, firings[100].index])
    assert tuple(hub.board_at(middle["n"]).marking) == firings[100].marking
    times = [e["t"] for e in hub.events(0, 10**9)]
    assert times == sorted(times)


def test_a_log_that_was_cut_is_shown_as_far_as_it_goes(recorded, tmp_path):
    path, _, _ = recorded
    with open(path, "rb") as file:
        data = file.read()
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(data[: data.index(b"\n", len(data) // 2) + 10])  # amid a line, wherever the half falls
    hub = finished(Replay.of_file(str(cut)))
    assert hub.board().n > 50
    assert any("cut off" in note["text"] for note in hub.board().notes)


def test_a_log_that_contradicts_itself_says_where(recorded, tmp_path):
    path, firings, _ = recorded
    with open(path) as file:
        lines = file.readlines()
    at = next(i for i, line in enumerate(lines) if i > 50 and json.loads(line).get("firings"))
    record = json.loads(lines[at])
    record["firings"][0]["transition"] = firings[0].transition + "x"
    bad = tmp_path / "bad.jsonl"
    bad.write_text("".join(lines[:at]) + json.dumps(record) + "\n" + "".join(lines[at + 1 :]))
    hub = finished(Replay.of_file(str(bad)))
    assert any("cannot be followed" in n["text"] and ":%d" % (at + 1) in n["text"] for n in hub.board().notes)


@pytest.mark.parametrize("data", [b"", b"nonsense\n", b'{"kind": "header"}\n'])
def test_what_is_no_log_is_refused(data, tmp_path):
    (tmp_path / "x.jsonl").write_bytes(data)
    with pytest.raises(LogError):
        Project(Folder(str(tmp_path))).open("x.jsonl")


def messages(plan, firings, run="run"):
    """The firings as messages of the type that a bag holds."""
    genpy_dynamic = pytest.importorskip("genpy.dynamic")
    pytest.importorskip("rosbag")
    with open("msg/FiredTransition.msg") as file:
        text = file.read()
    header_text = "uint32 seq\ntime stamp\nstring frame_id\n"
    full = text + "\n" + "=" * 80 + "\nMSG: std_msgs/Header\n" + header_text
    kind = genpy_dynamic.generate_dynamic(TYPE, full)[TYPE]
    for firing in firings:
        message = kind()
        message.plan, message.run, message.transition = plan.hash(), run, firing.transition
        message.robot, message.visit = firing.robot, firing.visit
        message.robots = [m.robot for m in firing.moves]
        message.robot_places = [m.target for m in firing.moves]
        message.places = [p.name for p in plan.net.places]
        message.counts = list(firing.marking)
        message.slot, message.index = firing.slot, firing.index
        yield message


def write_bag(path, items):
    import genpy
    import rosbag

    with rosbag.Bag(str(path), "w") as bag:
        for i, message in enumerate(items):
            bag.write("/fired_transitions", message, genpy.Time.from_sec(100 + 0.1 * i))


def test_a_bag_leads_to_the_marking_of_the_run(recorded, tmp_path):
    _, firings, state = recorded
    plan = read_plan(PLAN)
    write_bag(tmp_path / "run.bag", messages(plan, firings))
    hub = finished(BagReplay(str(tmp_path / "run.bag"), [read_plan("plans/patrol"), plan]))
    assert tuple(hub.board().marking) == state.marking
    assert sum(hub.board().counts) == len(firings)
    assert hub.board().t == pytest.approx(0.1 * (len(firings) - 1), abs=1e-3)


def test_of_two_runs_in_a_bag_the_first_is_shown(recorded, tmp_path):
    """Two teams on one master: their firings are on one topic."""
    _, firings, state = recorded
    plan = read_plan(PLAN)
    pairs = zip(messages(plan, firings), messages(plan, firings, "another"))
    write_bag(tmp_path / "run.bag", (message for pair in pairs for message in pair))
    hub = finished(BagReplay(str(tmp_path / "run.bag"), [plan]))
    assert tuple(hub.board().marking) == state.marking
    assert sum(hub.board().counts) == len(firings)
    assert not [e for e in hub.events(0, 10**9) if e["k"] == "mark"]
    assert [note["text"].endswith(": another") for note in hub.board().notes] == [True]


def test_firings_that_a_bag_lacks_are_told(recorded, tmp_path):
    _, firings, state = recorded
    plan = read_plan(PLAN)
    write_bag(tmp_path / "gaps.bag", messages(plan, firings[5:50] + firings[53:]))
    hub = finished(BagReplay(str(tmp_path / "gaps.bag"), [plan]))
    assert tuple(hub.board().marking) == state.marking
    marks = [e for e in hub.events(0, 10**9) if e["k"] == "mark"]
    assert {e["why"] for e in marks} == {"firings are missing in the bag"}


def test_a_bag_of_an_unknown_plan_or_without_firings_is_refused(recorded, tmp_path):
    _, firings, _ = recorded
    plan = read_plan(PLAN)
    write_bag(tmp_path / "run.bag", messages(plan, firings[:3]))
    with pytest.raises(LogError, match="plan is not known"):
        BagReplay(str(tmp_path / "run.bag"), [read_plan("plans/patrol")])
    write_bag(tmp_path / "empty.bag", [])
    with pytest.raises(LogError, match="no firings"):
        BagReplay(str(tmp_path / "empty.bag"), [plan])
    (tmp_path / "nonsense.bag").write_bytes(b"not a bag")
    with pytest.raises(GspnError, match="not a rosbag"):
        BagReplay(str(tmp_path / "nonsense.bag"), [plan])
