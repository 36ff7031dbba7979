"""A live run beside its prediction: what the page's events report to a monitor, and what it publishes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from page_client import PageClient
from waiting import wait_for

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.attempts import AttemptFollower
from gspn_framework_package.execution.firing import firing_from_json
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.live_comparison import RunFollower
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.standalone_run import StandaloneRun
from gspn_framework_package.visualizer.team_events import TeamEvents

PLANS = Path(__file__).parents[3] / "plans"


class _Told:
    """A monitor that only notes what it is told."""

    def __init__(self):
        self.ended = []
        self.results = []
        self._running = {}

    def begin(self, robot, place, start):
        assert robot not in self._running
        self._running[robot] = (place, start)

    def end(self, robot, now, *, completed=True, result="", failed=""):
        place, start = self._running.pop(robot)
        self.ended.append((robot, place, round(start, 3), round(now, 3), completed, failed))

    def result(self, place, result, now):
        self.results.append((place, result))


def _told(plan, seconds):
    """What the page's events of a virtual run show, and the attempts in its log."""
    run = VirtualRun(plan, seed=4)
    events = TeamEvents(run.game)
    told, logged = _Told(), AttemptFollower(run.plan, agents=True)
    follower = RunFollower(run.plan, told, complete=True)
    attempts = []

    class Kept:
        def append(self, *records, durable=True):
            for record in records:
                attempts.extend(logged.take({**record, "wall": run.now, "mono": run.now}))
                if record["kind"] != "slot":
                    continue
                entries = [log_entries.from_json(e) for e in record["entries"]]
                firings = [firing_from_json(f, plan.net) for f in record["firings"]]
                for event in events.step(entries, firings, run.state, run.now):
                    follower.take(event)

    run.record_to(Kept())
    result = run.run(time=seconds)
    return told, attempts, follower, result


@pytest.mark.parametrize("name", ["rendezvous", "tokens", "measure", "patrol", "warehouse"])
def test_the_events_of_the_page_tell_the_same_as_the_log(name):
    plan = read_plan(str(PLANS / name))
    actions = [p for p in plan.action_places if plan.actions.get(p) is not None]
    plan = replace(
        plan,
        durations={p: Duration.gamma(8.0, 1.0 + i / 10) for i, p in enumerate(actions)},
        failures=dict.fromkeys(actions, 0.15),
        on_failure={"*": FailureRule.retry(100, delay=0.5)},
    ).validate()
    told, attempts, follower, result = _told(plan, 60.0)
    ends = [a for a in told.ended if a[4] and a[1] in actions]
    logged = [
        (a.robot, a.place, round(a.start, 3), round(a.end, 3), True, a.failed)
        for a in attempts
        if a.completed
    ]
    assert len(logged) > 15
    assert len(ends) == len(logged)
    for seen, known in zip(sorted(ends), sorted(logged)):
        assert (seen[:2], seen[4:]) == (known[:2], known[4:])
        assert seen[2:4] == pytest.approx(known[2:4], abs=2e-3)
    assert any(end[5] for end in ends)
    fired = {t.name: n for t, n in zip(plan.net.transitions, follower.counts)}
    assert fired == result.firings


def test_results_are_told_when_they_fire():
    plan = read_plan(str(PLANS / "patrol"))
    told, attempts, follower, result = _told(plan, 60.0)
    check = [name for place, name in told.results if place == "p1:Check_Temperature_L1"]
    completed = [a.result for a in attempts if a.completed and a.place == "p1:Check_Temperature_L1"]
    assert check == completed


# -- on the page -----------------------------------------------------------------------------------

ACTIONS = """
import time
seconds = 0.02
def work(): time.sleep(seconds)
"""

PLAN = {
    "plan": "ring",
    "net": {
        "places": [{"name": "a", "tokens": 1}, {"name": "b"}],
        "transitions": [
            {"name": "ab", "timed": True, "rate": 1},
            {"name": "ba", "timed": True, "rate": 1},
        ],
        "arcs": [
            {"from": "a", "to": "ab"},
            {"from": "ab", "to": "b"},
            {"from": "b", "to": "ba"},
            {"from": "ba", "to": "a"},
        ],
    },
    "actions": {"a": "ring_work.work", "b": "ring_work.work"},
    "robots": {"r": "a"},
}


@pytest.fixture(name="started")
def _started(tmp_path):
    clients = []

    def start(**fields):
        (tmp_path / "ring_work.py").write_text(ACTIONS)
        (tmp_path / "plan.json").write_text(json.dumps({**PLAN, **fields}))
        runs = str(tmp_path / "runs")
        project = Project(
            Folder(str(tmp_path)), lambda document: StandaloneRun(document, runs), runs=runs
        )
        clients.append(PageClient(project))
        return clients[-1]

    yield start
    for client in clients:
        client.project.close()


def _model(client, key):
    """The latest comparison that the page was told."""
    return client.get("/api/poll?id=" + key).get_json()["latest"].get("model", {})


def _start(client):
    key = client.post("/api/open", {"path": "plan.json"}).get_json()["id"]
    assert client.do("start", session=key, confirmed=True).status_code == 200
    return key


def test_a_plan_without_durations_has_no_model(started):
    client = started()
    key = _start(client)
    model = wait_for(lambda: _model(client, key) or None, what="the comparison")
    assert model == {
        "state": "none",
        "says": "the plan gives no durations, so there is no model to compare with",
    }


@pytest.mark.long
def test_a_run_that_is_slower_than_planned_raises_the_alarm_on_the_page(started):
    fast = {"mean": 0.005, "distribution": "gamma", "shape": 20}
    client = started(durations={"a": fast, "b": fast})
    key = _start(client)
    model = wait_for(
        lambda: (lambda m: m if m.get("alarms") else None)(_model(client, key)),
        what="an alarm",
        seconds=180,
    )
    assert model["state"] == "watching" and model["false_alarm_every"] == 30 * 86_400
    assert any("slower than planned" in alarm for alarm in model["alarms"])
    assert [cause["text"] for cause in model["causes"]] == model["alarms"]
    on = [stream for stream in model["streams"] if stream["on"]]
    assert on and all(stream["level"] > 0.5 and stream["says"] for stream in on)
    names = [curve["name"] for curve in model["curves"]]
    assert names[0] == "all transitions" and set(names[1:]) == {"ab", "ba"}
    assert model["curves"][0]["growth"][0] == pytest.approx(200, rel=0.05)
    notes = [note["text"] for note in client.board(key)["notes"]]
    assert any("slower than planned" in text for text in notes)
    assert client.do("stop", session=key).status_code == 200
    wait_for(lambda: _model(client, key)["state"] == "over", what="the end of the comparison")


@pytest.mark.long
def test_a_run_that_cannot_be_predicted_is_said_to_be_so(started):
    zero = {"mean": 0, "distribution": "deterministic"}
    client = started(
        durations={"a": zero, "b": zero}, actions={"a": "ring_work.work", "b": "ring_work.work"}
    )
    key = _start(client)
    model = wait_for(
        lambda: (lambda m: m if m.get("state") == "failed" else None)(_model(client, key)),
        what="the refusal",
        seconds=180,
    )
    assert "cannot be predicted" in model["says"]
