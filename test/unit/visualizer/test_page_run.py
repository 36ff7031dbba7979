"""A plan that the page executes without ROS: its orders, and its end, which is shown whatever
breaks."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from full_disk import fill_the_disk
from page_client import PageClient
from waiting import wait_for

from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.standalone import StandaloneExecutor
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.visualizer import session, standalone_run
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.run_marks import RunMark, cut_runs
from gspn_framework_package.visualizer.standalone_run import StandaloneRun
from gspn_framework_package.visualizer.team_events import TeamEvents

ACTIONS = """
import threading
gate = threading.Event()
def go(): pass
def wait(is_cancelled): is_cancelled.wait(60)
def stuck(): gate.wait(60)
def fail(): raise ValueError("no")
"""

PLAN = {
    "plan": "ring",
    "net": {
        "places": [{"name": "a", "tokens": 1}, {"name": "b"}, {"name": "c"}, {"name": "store"}],
        "transitions": [
            {"name": "ab", "timed": False},
            {"name": "ba", "timed": False},
            {"name": "fill", "timed": True},
        ],
        "arcs": [
            {"from": "a", "to": "ab"},
            {"from": "ab", "to": "b"},
            {"from": "b", "to": "ba"},
            {"from": "ba", "to": "a"},
            {"from": "fill", "to": "store"},
        ],
    },
    "resource_places": ["store"],
    "robots": {"r": "a"},
}


@pytest.fixture(name="served")
def _served(tmp_path):
    """Make a folder with the plan ``ring`` and serve it; the actions of a, b and c are named."""
    clients = []

    def make(a="go", b="go", c="go", **fields):
        folder = tmp_path / "ring"
        folder.mkdir(exist_ok=True)
        (folder / "ring_work.py").write_text(ACTIONS)
        plan = {
            **PLAN,
            "actions": {"a": "ring_work." + a, "b": "ring_work." + b, "c": "ring_work." + c},
            **fields,
        }
        (folder / "plan.json").write_text(json.dumps(plan))
        runs = str(tmp_path / "runs")
        project = Project(
            Folder(str(tmp_path)), lambda document: StandaloneRun(document, runs), runs=runs
        )
        clients.append(PageClient(project))
        return clients[-1]

    yield make
    for client in clients:
        client.project.close()


def start(client, path="ring/plan.json"):
    key = client.post("/api/open", {"path": path}).get_json()["id"]
    answer = client.do("start", session=key, confirmed=True)
    return key, answer


def status(client, key):
    return client.board(key)["status"]


def ended(client, key):
    return wait_for(
        lambda: (lambda s: s if s["ended"] else None)(status(client, key)),
        what="the end of the run",
    )


def test_a_run_tells_its_name_and_records_itself_under_it(served, tmp_path):
    client = served()
    key, answer = start(client)
    assert answer.status_code == 200
    run = status(client, key)["run"]
    assert (tmp_path / "runs" / (run + ".jsonl")).is_file()
    assert client.do("stop", session=key, reason="enough").status_code == 200
    assert status(client, key) == {
        **status(client, key),
        "running": False,
        "ended": "enough",
        "fault": False,
    }
    assert read_log(str(tmp_path / "runs" / (run + ".jsonl"))).header["run"] == run
    assert client.do("stop", session=key).status_code == 409


def test_a_full_disk_ends_the_run_and_the_page_is_reported(served, monkeypatch):
    client = served()
    fill_the_disk(monkeypatch, after=20_000)
    key, _ = start(client)
    now = ended(client, key)
    assert now["fault"] and not now["running"] and "No space left" in now["ended"]
    assert str(client.project._folder.root) not in json.dumps(client.board(key))
    monkeypatch.undo()
    assert client.do("stop", session=key).status_code == 409  # it says so, rather than do nothing
    assert start(client)[1].status_code == 200
    assert not status(client, key)["ended"]


def test_a_run_that_an_action_stops_ends_as_a_fault_here_and_in_its_recording(served, tmp_path):
    client = served(a="fail", on_failure={"*": "stop"})
    key, _ = start(client)
    now = ended(client, key)
    assert now["fault"] and not now["finished"] and "no" in now["ended"]
    notes = [note["text"] for note in client.board(key)["notes"]]
    assert len(notes) == len(set(notes))  # shown once
    log = client.post("/api/open", {"path": "runs/%s.jsonl" % now["run"]}).get_json()["id"]
    again = ended(client, log)
    assert [again[k] for k in ("run", "ended", "fault", "finished")] == [
        now[k] for k in ("run", "ended", "fault", "finished")
    ]


def test_a_disk_that_is_full_at_the_start_refuses_the_start_and_leaves_nothing(
    served, monkeypatch, tmp_path
):
    client = served()
    fill_the_disk(monkeypatch, after=100)
    key, answer = start(client)
    assert answer.status_code == 409 and "cannot be recorded" in answer.get_json()["error"]
    assert os.listdir(str(tmp_path / "runs")) == []
    assert not status(client, key).get("running")


@pytest.mark.parametrize(
    "what",
    [
        (TokenGame, "reduce"),
        (StandaloneRun, "on_step"),
        (TeamEvents, "step"),
        (StandaloneExecutor, "_carry_out"),
    ],
)
def test_whatever_breaks_in_the_executor_ends_the_run(served, monkeypatch, what):
    client = served(a="wait")
    key, _ = start(client)
    wait_for(lambda: client.board(key)["robots"], what="the start")

    def broken(*args, **options):
        raise ZeroDivisionError("a fault of this program")

    monkeypatch.setattr(what[0], what[1], broken)
    client.do("stop", session=key)
    now = ended(client, key)
    assert now["fault"] and "ZeroDivisionError" in now["ended"]
    monkeypatch.undo()
    assert start(client)[1].status_code == 200


@pytest.mark.long
def test_a_run_that_does_not_react_is_given_up_and_says_so(served, monkeypatch):
    client = served()
    hold = threading.Event()
    monkeypatch.setattr(standalone_run, "STOP_SECONDS", 0.2)
    monkeypatch.setattr(StandaloneRun, "on_step", lambda *args: hold.wait(60))
    key, _ = start(client)
    old = client.project.session(key).activity
    assert client.do("stop", session=key).status_code == 200
    now = status(client, key)
    assert not now["running"] and now["fault"] and "did not react" in now["ended"]
    monkeypatch.undo()
    assert start(client)[1].status_code == 200
    hold.set()
    wait_for(lambda: old._executor.over, what="the end of the old run")
    assert status(client, key)["running"]  # what the old one still says does not reach the new one


def test_the_log_of_a_run_that_is_over_is_closed(served):
    closed = []
    close = EventLogWriter.close
    client = served()
    key, _ = start(client)
    run = client.project.session(key).activity
    run._log.close = lambda: closed.append(1) or close(run._log)
    client.do("stop", session=key)
    assert closed


def test_threads_that_cannot_be_started_are_failed_actions(served, monkeypatch):
    def submit(pool, task):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("gspn_framework_package.execution.worker_pool.WorkerPool.submit", submit)
    client = served()
    key, _ = start(client)
    wait_for(
        lambda: [r for r in client.board(key)["robots"] if r["phase"] == "failed"],
        what="the failure",
    )
    assert client.do("stop", session=key).status_code == 200


def test_orders_do_what_they_say(served):
    client = served(a="fail", b="wait", c="wait")
    key, _ = start(client)

    def robot():
        return next(iter(client.board(key)["robots"]), {})

    wait_for(lambda: robot().get("phase") == "failed", what="the failure")
    assert client.do("retry", session=key, robot="r").status_code == 200
    wait_for(
        lambda: robot().get("attempt") == 2 and robot()["phase"] == "failed", what="another attempt"
    )
    assert client.do("pause", session=key, robot="r").status_code == 200
    wait_for(lambda: robot().get("paused"), what="the pause of the robot")
    assert client.do("resume", session=key, robot="r").status_code == 200
    assert client.do("pause", session=key).status_code == 200
    wait_for(lambda: status(client, key)["paused"], what="the pause")
    assert client.do("resume", session=key).status_code == 200
    wait_for(lambda: not status(client, key)["paused"], what="the end of the pause")
    assert client.do("set_place", session=key, robot="r", place="c").status_code == 200
    wait_for(lambda: robot().get("place") == 2, what="the place")
    assert client.do("fire", session=key, transition="fill").status_code == 200
    wait_for(lambda: client.board(key)["marking"][3] == 1, what="the firing")
    assert client.do("leave", session=key, robot="r").status_code == 200
    wait_for(lambda: robot().get("phase") == "left", what="the robot to leave")
    assert status(client, key)["stalled"] == "no robot is left"


@pytest.mark.parametrize(
    ("command", "fields", "told"),
    [
        ("retry", {"robot": "r"}, "has not failed"),
        ("retry", {"robot": "x"}, "no agent 'x'"),
        ("retry", {}, "'robot' is missing"),
        ("pause", {"robot": "x"}, "no agent 'x'"),
        ("leave", {"robot": "x"}, "no agent 'x'"),
        ("set_place", {"robot": "r", "place": "store"}, "resource place"),
        ("set_place", {"robot": "r", "place": "x"}, "'x'"),
        ("set_place", {"robot": "r"}, "'place' is missing"),
        ("fire", {"transition": "x"}, "'x'"),
        ("evict", {"robot": "r"}, "cannot be done here"),
    ],
)
def test_orders_that_make_no_sense_are_refused(served, command, fields, told):
    client = served(a="wait")
    key, _ = start(client)
    wait_for(lambda: client.board(key)["robots"], what="the start")
    answer = client.do(command, session=key, **fields)
    assert answer.status_code in (400, 409) and told in answer.get_json()["error"]
    assert status(client, key)["running"]


@pytest.mark.parametrize(
    "spelling",
    ["ring", "ring/plan.json", "ring/./plan.json", "./ring", "ring//plan.json", "link.json"],
)
def test_one_plan_runs_once_however_it_is_written(served, tmp_path, spelling):
    client = served(a="wait")
    (tmp_path / "link.json").symlink_to(tmp_path / "ring" / "plan.json")
    first, answer = start(client)
    assert answer.status_code == 200
    second, answer = start(client, spelling)
    assert second == first and answer.status_code == 409
    assert client.get("/api/session?id=file-" + spelling).get_json()["id"] == first


def test_a_check_before_a_start_holds_nobody_and_is_not_begun_twice(served, monkeypatch):
    client = served(a="wait")
    key = client.post("/api/open", {"path": "ring"}).get_json()["id"]
    under_way, go_on = threading.Event(), threading.Event()
    check = standalone_run.verdict

    def slow(*args, **options):
        under_way.set()
        assert go_on.wait(30)
        return check(*args, **options)

    monkeypatch.setattr(standalone_run, "verdict", slow)
    threading.Thread(target=client.do, args=("start", key), kwargs={"confirmed": True}).start()
    assert under_way.wait(30)
    assert client.do("step", session=key).status_code == 200
    assert client.do("start", session=key, confirmed=True).status_code == 409
    assert client.do("simulate", session=key).status_code == 409
    go_on.set()
    wait_for(lambda: status(client, key)["running"], what="the run")


def test_a_layout_holds_nobody(served, monkeypatch):
    client = served(a="wait")
    key, _ = start(client)
    under_way, go_on = threading.Event(), threading.Event()
    lay_out = session.lay_out

    def slow(*args, **options):
        under_way.set()
        assert go_on.wait(30)
        return lay_out(*args, **options)

    monkeypatch.setattr(session, "lay_out", slow)
    answers = []
    thread = threading.Thread(
        target=lambda: answers.append(client.do("layout", session=key).status_code)
    )
    thread.start()
    assert under_way.wait(30)
    assert client.do("layout", session=key).status_code == 409  # once is enough
    assert client.do("pause", session=key).status_code == 200
    assert client.do("stop", session=key).status_code == 200
    go_on.set()
    thread.join(30)
    assert answers == [200]


# -- runs that were cut off ------------------------------------------------------------------------


def test_a_run_that_goes_on_is_marked_and_one_that_ended_is_not(served, tmp_path):
    client = served(a="wait")
    key, _ = start(client)
    assert cut_runs(str(tmp_path / "runs")) == []  # it goes on
    assert [p for p in os.listdir(str(tmp_path / "runs")) if p.endswith(".running")]
    client.do("stop", session=key)
    assert not [p for p in os.listdir(str(tmp_path / "runs")) if p.endswith(".running")]


def test_a_run_that_was_cut_off_is_reported_until_somebody_looks(served, tmp_path):
    runs = tmp_path / "runs"
    served(a="go")
    script = (
        "import sys, time; sys.path[:0] = %r\n"
        "from gspn_framework_package.visualizer.documents import Folder\n"
        "from gspn_framework_package.visualizer.hub import Hub\n"
        "from gspn_framework_package.visualizer.board import Board\n"
        "from gspn_framework_package.visualizer.standalone_run import StandaloneRun\n"
        "run = StandaloneRun(Folder(%r).open('ring/plan.json'), %r)\n"
        "run.begin(Hub('', Board(0, [])))\n"
        "print(run.run, flush=True)\n"
        "time.sleep(60)\n"
    ) % ([os.getcwd()], str(tmp_path), str(runs))
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True
    ) as process:
        run = process.stdout.readline().strip()
        wait_for(lambda: (runs / (run + ".jsonl")).stat().st_size > 5000, what="some events")
        process.send_signal(signal.SIGKILL)
    for _ in range(2):  # not only to the first that asks, nor only by the first server
        client = served(a="wait")
        (cut,) = client.get("/api/hello").get_json()["cut"]
        assert (
            cut["path"] == "ring/plan.json"
            and cut["log"] == "runs/%s.jsonl" % run
            and cut["events"] > 5
        )
    assert client.post("/api/open", {"path": cut["log"]}).status_code == 200
    assert client.get("/api/hello").get_json()["cut"] == []
    assert served(a="wait").get("/api/hello").get_json()["cut"] == []


def test_a_new_run_of_the_plan_supersedes_the_one_that_was_cut_off(served, tmp_path):
    client = served(a="wait")
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "old.jsonl").write_text("{}\n{}\n")
    mark = RunMark(str(tmp_path / "runs" / "old.jsonl"), "ring/plan.json")
    fcntl.flock(mark._file, fcntl.LOCK_UN)  # as when its process has died
    client = served(a="wait")
    assert client.get("/api/hello").get_json()["cut"] == [
        {"path": "ring/plan.json", "log": "runs/old.jsonl", "events": 1}
    ]
    start(client)
    assert client.get("/api/hello").get_json()["cut"] == []


def test_each_start_of_a_server_has_another_name(served):
    first, second = served(), served()
    assert (
        first.get("/api/hello").get_json()["server"] == first.get("/api/hello").get_json()["server"]
    )
    assert (
        first.get("/api/hello").get_json()["server"]
        != second.get("/api/hello").get_json()["server"]
    )


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"log": 3}', '{"log": "../../etc/passwd", "path": "x"}']
)
def test_a_mark_that_says_nothing_is_passed_over(tmp_path, text):
    Path(tmp_path, ".x.jsonl.running").write_text(text)
    assert cut_runs(str(tmp_path)) == []


def test_a_task_that_is_submitted_comes_in_once(served):
    client = served(a="wait", tasks={"queues": ["store"]})
    key, _ = start(client)
    task = {"transition": "fill", "id": "o1", "data": {"pose": [1, 2]}}
    for _ in range(2):
        answer = client.do("submit", session=key, **task)
        assert (answer.status_code, answer.get_json()["message"]) == (
            200,
            "task o1 enters by fill",
        )
    client.do("submit", session=key, transition="fill")
    found = wait_for(
        lambda: (lambda q: q if len(q) > 1 else None)(
            client.board(key).get("data", {}).get("queues", {}).get("store", [])
        ),
        what="the tasks in the queue",
    )
    assert found[0] == ["o1", {"pose": "[1, 2]"}]
    assert len(found) == 2 and found[1][0].startswith("page-")
    assert client.do("submit", session=key, transition="ab").status_code == 409
    assert client.do("submit", session=key, transition="fill", data=[1]).status_code == 400


def test_breakpoints_are_set_on_the_page_kept_in_a_file_and_hold_one_agent(served, tmp_path):
    client = served(robots={"r": "a"})
    key, _ = start(client)
    answer = client.do("breakpoints", session=key, names=["b"])
    assert (answer.status_code, answer.get_json()["message"]) == (200, "agents stop at: b")
    wait_for(
        lambda: any(robot.get("paused") for robot in client.board(key)["robots"]),
        what="the agent to stop",
    )
    assert client.board(key)["marking"][1] == 1
    session = client.project.sessions.get(key)
    assert session.hub.info["breakpoints"] == ["b"]
    file = tmp_path / "ring" / "breakpoints.json"
    assert json.loads(file.read_text()) == {"places": ["b"], "transitions": []}
    for names in (["store"], ["nothing"], "b"):
        assert client.do("breakpoints", session=key, names=names).status_code == 400
    assert client.do("breakpoints", session=key, names=[]).status_code == 200
    assert not file.exists() and session.hub.info["breakpoints"] == []
    client.do("resume", session=key, robot="r")
    fired = sum(client.board(key)["counts"])
    wait_for(lambda: sum(client.board(key)["counts"]) > fired + 2, what="the agent to go on")
