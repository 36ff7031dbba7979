"""Recorded runs on the page: event logs and rosbags lead to the marking that the run had."""

import json
import random
import shutil
from functools import partial

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.visualizer.bag_replay import TYPE, BagReplay, bag_track
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.poses import PoseTrack
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.replay import Replay
from gspn_framework_package.visualizer.team_events import TeamEvents

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
    # asked after the cursor was taken: the end of the loading is news to it
    while hub.info.get("loading"):
        assert hub.wait(cursor, 20)
        cursor = hub.news(cursor).cursor
    return hub


def test_an_event_log_leads_to_the_state_of_the_run(recorded):
    path, firings, state = recorded
    hub = finished(Replay(path))
    board = hub.board()
    assert tuple(board.marking) == state.marking
    assert sum(board.counts) == len(firings)
    assert board.status["ended"] == "stopped by the operator"
    middle = next(
        e for e in hub.events(0, 10**9) if e.get("s") == [firings[100].slot, firings[100].index]
    )
    assert tuple(hub.board_at(middle["n"]).marking) == firings[100].marking
    times = [e["t"] for e in hub.events(0, 10**9)]
    assert times == sorted(times)


def test_a_log_that_was_cut_is_shown_as_far_as_it_goes(recorded, tmp_path):
    path, _, _ = recorded
    with open(path, "rb") as file:
        data = file.read()
    cut = tmp_path / "cut.jsonl"
    # amid a line, wherever the half falls
    cut.write_bytes(data[: data.index(b"\n", len(data) // 2) + 10])
    hub = finished(Replay(str(cut)))
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
    hub = finished(Replay(str(bad)))
    assert any(
        "cannot be read further" in n["text"] and ":%d" % (at + 1) in n["text"]
        for n in hub.board().notes
    )


@pytest.mark.parametrize("data", [b"", b"nonsense\n", b'{"kind": "header"}\n'])
def test_what_is_no_log_is_refused(data, tmp_path):
    (tmp_path / "x.jsonl").write_bytes(data)
    with pytest.raises(LogError):
        Project(Folder(str(tmp_path))).open("x.jsonl")


def read_at_once(path):
    """The events of a log, numbered, by the token game alone."""
    log = read_log(path)
    events = TeamEvents(TokenGame(log.plan, agents=True))
    board = events.board(False, "run")
    found = []
    for step in replay(log):
        for event in events.step(step.entries, step.firings, step.state, 0.0):
            event["n"] = board.n + 1
            board.apply(event)
            found.append(event)
    return found


def without_time(event):
    return {key: value for key, value in event.items() if key != "t"}


def test_a_long_log_is_looked_up_in_its_file(recorded, monkeypatch):
    path, _, _ = recorded
    monkeypatch.setattr("gspn_framework_package.visualizer.recording.LINES_BETWEEN", 3)
    monkeypatch.setattr("gspn_framework_package.visualizer.recording.MARKS", 8)
    monkeypatch.setattr("gspn_framework_package.visualizer.recording.AT_HAND", 40)
    hub = finished(Replay(path))
    recording = hub._history
    assert len(recording._marks) <= 8  # whatever the length of the log
    expected = read_at_once(path)
    n = hub.board().n
    found = hub.events(0, n, limit=n)
    assert [without_time(event) for event in found[: len(expected)]] == [
        without_time(event) for event in expected
    ]
    assert [event["n"] for event in found] == list(range(1, n + 1))
    source, board, at = random.Random(3), recording.first_board(), {}
    for event in [None, *found]:
        if event is not None:
            board.apply(event)
        at[board.n] = board.copy()
    for k in [0, 1, n - 1, n, n + 5, *(source.randint(0, n) for _ in range(60))]:
        assert hub.board_at(k).to_json() == at[min(k, n)].to_json()
        first = max(0, k - source.randint(0, 30))
        assert [event["n"] for event in hub.events(first, k)] == list(
            range(first + 1, min(k, n) + 1)
        )
        assert recording._at_hand() <= 40 or len(recording._stretches) == 1


def test_viewers_are_told_how_far_a_log_has_been_read_and_fetch_what_they_look_at(recorded):
    path, _, _ = recorded
    hub = Hub("", Board(0, []))
    activity = Replay(path)
    activity.begin(hub)
    cursor, news = hub.news(None).cursor, {}
    while hub.info["loading"]:
        assert hub.wait(cursor, 20)
        told = hub.news(cursor)
        cursor, news = told.cursor, json.loads(told.text)
        assert "events" not in news
    assert hub.board().n == cursor.n and hub.info["progress"] == 1.0
    assert json.loads(hub.news(cursor._replace(n=0)).text)["head"]["n"] == cursor.n


def test_the_clock_is_that_of_the_log(recorded, tmp_path):
    path, _, _ = recorded
    with open(path) as file:
        header, *lines = [json.loads(line) for line in file][:8]
    clocks = [(100, 5.0), (100.5, 5.5), (9999, 6.0), (50, 6.5), (51, 0.1), (50.2, 0.2), (51, 1.0)]
    # the wall clock is set twice, and the host starts again once
    expected = [0, 0.5, 1.0, 1.5, 2.5, 2.6, 3.4]
    made = tmp_path / "clock.jsonl"
    lines = [{**line, "wall": wall, "mono": mono} for line, (wall, mono) in zip(lines, clocks)]
    made.write_text("".join(json.dumps(line) + "\n" for line in [header, *lines]))
    events = finished(Replay(str(made))).events(0, 1000)
    times = {tuple(e["s"])[0]: e["t"] for e in events if e["k"] == "fire"}
    slots = [line["slot"] for line in lines]
    assert (
        times == {slot: pytest.approx(t) for slot, t in zip(slots, expected) if slot in times}
        and len(times) > 3
    )


def test_a_log_that_changes_under_the_page_is_reported(recorded, tmp_path, monkeypatch):
    path, _, _ = recorded
    monkeypatch.setattr("gspn_framework_package.visualizer.recording.LINES_BETWEEN", 20)
    copy = tmp_path / "copy.jsonl"
    shutil.copy(path, str(copy))
    hub = finished(Replay(str(copy)))
    n = hub.board().n
    with open(str(copy), "r+b") as file:
        file.truncate(2000)
    with pytest.raises(LogError, match="the log has changed since"):
        # a single board may be one of those kept in memory
        for at in range(n):
            hub.board_at(at)
    with pytest.raises(LogError, match="the log has changed since"):
        hub.events(0, n)
    copy.unlink()
    with pytest.raises(LogError, match="cannot be read"):
        hub.events(0, n)


def test_whatever_breaks_in_the_reading_ends_it_and_is_reported(recorded, monkeypatch):
    path, _, _ = recorded
    count = []

    def broken(*_):
        count.append(1)
        if len(count) > 5:
            raise ZeroDivisionError("a fault of this program")
        return []

    monkeypatch.setattr(TeamEvents, "step", broken)
    hub = finished(Replay(path))
    assert not hub.info["loading"]
    assert any(
        "cannot be read further: ZeroDivisionError" in note["text"] for note in hub.board().notes
    )


@pytest.mark.parametrize(
    "line",
    [
        "[" * 100_000,
        "3",
        "{}",
        '{"kind": 3}',
        '{"kind": "slot"}',
        '{"kind": "slot", "slot": []}',
        '{"kind": "snapshot", "slot": 1, "state": 3}',
    ],
)
def test_a_line_that_is_no_record_ends_the_reading_and_is_named(recorded, tmp_path, line):
    path, _, _ = recorded
    with open(path) as file:
        lines = file.readlines()[:20]
    bad = tmp_path / "bad.jsonl"
    bad.write_text("".join(lines) + line + "\n")
    hub = finished(Replay(str(bad)))
    assert any(
        "cannot be read further" in note["text"] and "bad.jsonl:21" in note["text"]
        for note in hub.board().notes
    )
    assert not any(str(tmp_path) in note["text"] for note in hub.board().notes)


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
    genpy, rosbag = pytest.importorskip("genpy"), pytest.importorskip("rosbag")

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


def test_a_bag_says_from_when_on_its_run_follows_another_plan(recorded, tmp_path):
    path, firings, _ = recorded
    plan = read_log(path).plan
    heard = list(messages(plan, firings[:20]))
    for message in heard[12:]:
        message.plan = "another"
    write_bag(tmp_path / "run.bag", heard)
    board = finished(BagReplay(str(tmp_path / "run.bag"), [plan])).board()
    assert tuple(board.marking) == firings[11].marking
    assert "from 1.2 s on, the run follows another plan" in board.notes[-1]["text"]


def odometry(x):
    """A message that says where a robot is: only the fields that are read."""
    genpy_dynamic = pytest.importorskip("genpy.dynamic")
    parts = [
        "PoseIn pose",
        "MSG: nav_msgs/PoseIn\nPoseAt pose",
        "MSG: nav_msgs/PoseAt\nNumbers position\nNumbers orientation",
        "MSG: nav_msgs/Numbers\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    ]
    text = ("\n" + "=" * 80 + "\n").join(parts) + "\n"
    message = genpy_dynamic.generate_dynamic("nav_msgs/Odometry", text)["nav_msgs/Odometry"]()
    message.pose.pose.position.x, message.pose.pose.orientation.w = x, 1.0
    return message


def test_a_bag_and_a_log_beside_one_show_where_the_robots_were(recorded, tmp_path, capsys):
    """A robot drives 1 m every second for a minute, then stands still."""
    path, firings, _ = recorded
    log = read_log(path)
    first = log.plan.robots[0].name
    genpy, rosbag = pytest.importorskip("genpy"), pytest.importorskip("rosbag")
    began = next(record["wall"] for record in log.records if "wall" in record)

    def write(file, begin, fired, robot=first):
        with rosbag.Bag(str(tmp_path / file), "w") as bag:
            for i, message in enumerate(messages(log.plan, fired)):
                bag.write("/fired_transitions", message, genpy.Time.from_sec(begin + 0.1 * i))
            for i in [*range(60), 300]:
                at = genpy.Time.from_sec(begin + i)
                bag.write("/fleet/%s/odom" % robot, odometry(float(min(i, 60))), at)
                bag.write("/nobody/odom", odometry(99.0), at)

    write("run.bag", 100.0, firings)
    write("beside.bag", began, [])
    write("others.bag", began, [], "somebody")
    write("simulated_clock.bag", 0.0, [])
    (tmp_path / "nonsense.bag").write_bytes(b"not a bag")
    beside = partial(bag_track, str(tmp_path / "beside.bag"))
    for activity in BagReplay(str(tmp_path / "run.bag"), [log.plan]), Replay(path, beside):
        found = finished(activity).poses_around(40.5)
        assert (found["from"], found["to"]) == (10.5, 70.5)
        where = [moment["robots"] for moment in found["moments"] if abs(moment["t"] - 40) < 0.01]
        assert where == [{first: {"pose": [40.0, 0.0, 0.0], "by": "odom"}}]
        assert found["moments"][0]["t"] <= 10.5 and found["moments"][-1]["t"] > 58
    for file, why in (
        ("others", "has no poses of the robots"),
        ("simulated_clock", "has no poses of the robots"),
        ("nonsense", "not a readable rosbag"),
    ):
        assert main(["replay", path, "--poses", str(tmp_path / (file + ".bag"))]) == 2
        out = capsys.readouterr().err
        assert why in out and "Traceback" not in out and len(out.splitlines()) <= 2


def test_a_track_keeps_two_moments_a_second_and_the_last_one():
    track = PoseTrack()
    for i in range(101):
        track.add(i / 10, {"r": {"pose": [i, 0, 0]}})
    track.add(60.0, {"r": {"pose": [100, 0, 0]}})  # it stood still
    found = track.around(5.0, now=20.0)
    assert (found["from"], found["to"], len(track)) == (0.0, 20.0, len(found["moments"]))
    times = [moment["t"] for moment in found["moments"]]
    assert times[0] == 0 and times[-1] == 10 and 20 <= len(times) <= 26
    assert max(b - a for a, b in zip(times, times[1:])) <= 0.5


def test_firings_that_a_bag_lacks_are_reported(recorded, tmp_path):
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
    with pytest.raises(LogError, match="plan is unknown"):
        BagReplay(str(tmp_path / "run.bag"), [read_plan("plans/patrol")])
    write_bag(tmp_path / "empty.bag", [])
    with pytest.raises(LogError, match="no firings"):
        BagReplay(str(tmp_path / "empty.bag"), [plan])
    (tmp_path / "nonsense.bag").write_bytes(b"not a bag")
    with pytest.raises(GspnError, match="not a readable rosbag"):
        BagReplay(str(tmp_path / "nonsense.bag"), [plan])


def test_a_plan_learns_from_a_bag_as_far_as_it_goes(recorded, tmp_path, capsys):
    _, firings, _ = recorded
    write_bag(tmp_path / "run.bag", messages(read_plan(PLAN), firings))
    out = tmp_path / "new.json"
    assert main(["fit", PLAN, str(tmp_path / "run.bag"), "-o", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert any(place["mean"] for place in report["places"].values())
    assert any("not when their actions end" in note for note in report["notes"])
    assert read_plan(str(out)).evidence
    assert main(["fit", "plans/patrol", str(tmp_path / "run.bag"), "-o", str(out), "--force"]) == 2
    assert "not of this net" in capsys.readouterr().err
    assert main(["fit", PLAN, str(out), "-o", str(out), "--force"]) == 2
