"""Analyses that the page asks for: each in a process that is limited and can be killed."""

import io
import json
import resource
import subprocess
import sys
from unittest import mock

import pytest
from page_client import PageClient, small_net
from waiting import wait_for

from benchmarks.nets import kanban
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.visualizer import analysis_jobs, analysis_worker
from gspn_framework_package.visualizer.analysis_jobs import JOBS_AT_ONCE
from gspn_framework_package.visualizer.analysis_worker import ANALYSIS_MEMORY
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.session import Session

LONG = {"limit": 10**9, "seconds": 100}
"""With 7 cards of Kanban, and nothing to hold it: most of a minute."""


@pytest.fixture(name="ask")
def _ask():
    clients = []

    def make(net, plan=None):
        project = Project()
        project.show(Session("net", Document("net", net, plan)))
        clients.append(PageClient(project))
        return clients[-1]

    yield make
    for client in clients:
        client.app.extensions["gspn_jobs"].close()


def start(client, **fields):
    return client.post("/api/analysis?id=net", fields)


def job_of(client, answer):
    return client.app.extensions["gspn_jobs"]._jobs[answer.get_json()["job"]]


def ended(client, answer):
    def report():
        found = client.get("/api/analysis/" + answer.get_json()["job"]).get_json()
        return found if found["state"] != "running" else None

    return wait_for(report, seconds=60, what="the analysis")


@pytest.mark.long
def test_a_small_net_is_analysed(ask):
    client = ask(small_net())
    report = ended(client, start(client, structure=True, timing=True))
    assert report["state"] == "done", report["error"]
    assert report["result"]["bounded"] is True
    # its one tangible marking is never left: the token is back at once
    assert report["result"]["likely_states"] == [
        {"marking": {"a": 1}, "probability": 1.0, "mean_stay": "infinite"}
    ]


@pytest.fixture(name="ask_long")
def _ask_long(ask, monkeypatch):
    # the limit that ships is reached in two seconds
    monkeypatch.setattr(analysis_jobs, "MOST_STATES", 10**9)
    return ask(kanban(7))


def test_more_than_a_few_at_once_are_refused_and_each_can_be_killed(ask_long):
    client = ask_long
    running = [start(client, **LONG) for _ in range(JOBS_AT_ONCE)]
    refused = start(client, **LONG)
    assert refused.status_code == 409 and "running already" in refused.get_json()["error"]
    for answer in running:
        process = job_of(client, answer)._process
        assert client.post("/api/analysis/%s/cancel" % answer.get_json()["job"]).status_code == 200
        process.wait(20)
        assert ended(client, answer)["state"] == "cancelled"
    assert start(client, **LONG).status_code == 200


def test_time_over_ends_the_process(ask_long):
    client = ask_long
    answer = start(client, **{**LONG, "seconds": 1})
    report = ended(client, answer)
    assert report["state"] == "failed" and "not decided within 1 s" in report["error"]
    job_of(client, answer)._process.wait(20)


@pytest.mark.parametrize(
    "fields", [{"limit": 2_000_001}, {"limit": 0}, {"seconds": 121}, {"seconds": 0}, {"limit": "5"}]
)
def test_limits_have_limits(ask, fields):
    assert start(ask(small_net()), **fields).status_code == 400


@pytest.fixture(name="refusal")
def _refusal(monkeypatch, capsys):
    """What the program of an analysis answers to a request that it refuses. It runs in this process:
    each of its own takes seconds to start."""

    def refusal(**fields):
        request = {**fields, "net": net_to_json(small_net()), "limit": 1000, "seconds": 10}
        monkeypatch.setattr(analysis_worker, "_limit_itself", lambda seconds: None)
        monkeypatch.setattr(sys, "stdin", io.StringIO(json.dumps(request)))
        assert analysis_worker.main() == 1
        return json.loads(capsys.readouterr().out.splitlines()[-1])["error"]

    return refusal


@pytest.mark.long
def test_what_the_program_refuses_is_reported(ask):
    client = ask(small_net())
    report = ended(client, start(client, simulate={"until": 3}))
    assert (report["state"], report["error"]) == ("failed", "'until' must be a condition")


@pytest.mark.parametrize(
    "simulate",
    [
        {"replications": 100_001, "time": 1},
        {"replications": 0, "time": 1},
        {"time": -1},
        {"time": "x"},
        [],
        {"until": 3},
        {},
    ],
)
def test_simulated_runs_have_limits(refusal, simulate):
    error = refusal(simulate=simulate)
    assert error and "Traceback" not in error


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ([], "must be an object"),
        ({"time": 1}, "no parameter to vary"),
        ({"time": 1, "vary": "robots=1"}, "a list of texts"),
        ({"time": 1, "vary": ["tokens:a=1"] * 21}, "more than 20 entries"),
        ({"time": 1, "vary": ["tokens:a=1..401"]}, "at most 400 points"),
        ({"time": 1, "vary": ["policy=/etc/passwd"]}, "cannot read policies from files"),
        ({"time": 1, "vary": ["speed=1"]}, "write robots"),
        ({"time": 1, "vary": ["tokens:a=1"], "measure": ["x"]}, "no 'x' to measure"),
        ({"vary": ["tokens:a=1"]}, "how long is a run"),
    ],
)
def test_a_sweep_that_makes_no_sense_is_refused(refusal, sweep, message):
    assert message in refusal(sweep=sweep)


@pytest.mark.parametrize(
    ("decide", "message"),
    [
        ([], "must be an object"),
        ({"kind": 3}, "must be texts"),
        ({"kind": "ever"}, "no question 'ever'"),
        ({"kind": "never"}, "was expected"),
        ({"kind": "moves"}, "a net has no policy"),
    ],
)
def test_a_question_about_all_markings_that_makes_no_sense_is_refused(refusal, decide, message):
    assert message in refusal(decide=decide)


@pytest.mark.parametrize("rewards", [{"a": "x"}, {"nothing": 1}, [1]])
def test_rewards_that_make_no_sense_are_refused(refusal, rewards):
    error = refusal(timing=True, rewards=rewards)
    assert error and "Traceback" not in error


@pytest.mark.long
def test_the_process_limits_its_memory_and_processor_time():
    script = """
import json, resource
from gspn_framework_package.visualizer.analysis_worker import _limit_itself
_limit_itself(10.0)
print(json.dumps([resource.getrlimit(resource.RLIMIT_AS), resource.getrlimit(resource.RLIMIT_CPU)]))
"""
    found = json.loads(
        subprocess.run([sys.executable, "-c", script], stdout=subprocess.PIPE, check=True).stdout
    )
    assert found[0] == [ANALYSIS_MEMORY, ANALYSIS_MEMORY]
    assert found[1][0] != resource.RLIM_INFINITY and found[1][0] <= 60


@pytest.mark.long
def test_the_present_marking_is_that_which_is_shown_and_keeps_the_policy(ask):
    plan = read_plan("plans/patrol")
    client = ask(plan.net, plan)
    client.do("step", session="net", steps=5)

    def states(**fields):
        answer = start(client, policy=True, **fields)
        report = ended(client, answer)
        assert report["state"] == "done", report["error"]
        return answer.get_json()["event"], report["result"]["states"]["total"]

    _, begun = states()
    client.do("clear", session="net")
    assert states(**{"from": "marking", "event": 0}) == (0, begun)
    assert states(**{"from": "marking"}) == (6, 1)
    assert start(client, **{"from": "marking", "event": "x"}).status_code == 400


@pytest.mark.long
def test_a_plan_is_read_as_it_runs_or_as_its_net(ask):
    plan = read_plan("plans/rendezvous")
    client = ask(plan.net, plan)

    def found(**fields):
        report = ended(client, start(client, policy=True, **fields))
        return report["result"] or report["error"]

    run, net = found(), found(reading="net")
    assert list(run["timing"]["splits"]) == ["At_Dock", "Docked"]
    assert (run["timing"]["reading"], net["timing"]["reading"]) == ("run", "net")
    assert run["states"]["total"] > net["states"]["total"]
    assert "no reading 'walk'" in found(reading="walk")
    assert "'reading' must be" in found(reading=[1])


@pytest.mark.parametrize(
    ("worker", "told"),
    [
        ("print(3, flush=True); import time; time.sleep(60)", "cannot be read"),
        ("print('{\"part\": 3}', flush=True)", "cannot be read"),
        ("import sys; sys.stderr.write('x' * 1_000_000 + '\\nno more'); sys.exit(3)", "no more"),
        ("import os; os.kill(os.getpid(), 9)", "exit code -9"),
        ("import os; os.close(0); os.close(1); os._exit(1)", "the analysis failed"),
    ],
)
def test_whatever_becomes_of_the_process_ends_the_analysis(ask, monkeypatch, worker, told):
    monkeypatch.setattr(analysis_jobs, "_WORKER", ["-c", worker])
    client = ask(small_net())
    key = start(client, structure=True, seconds=100).get_json()["job"]

    def report():
        return client.get("/api/analysis/" + key).get_json()

    wait_for(lambda: report()["state"] != "running", what="the end of the analysis")
    assert report()["state"] == "failed" and told in report()["error"]


def test_a_process_that_ends_while_it_is_cancelled_is_no_error(ask, monkeypatch):
    """Python 3.8 raises that of a process that another thread has just waited for."""
    worker = "import sys, time; sys.stdin.close(); sys.stdout.close(); time.sleep(0.5)"
    monkeypatch.setattr(analysis_jobs, "_WORKER", ["-c", worker])
    client = ask(small_net())
    key = start(client, structure=True, seconds=100).get_json()["job"]
    gone = mock.Mock(side_effect=ProcessLookupError)
    with mock.patch.object(subprocess.Popen, "kill", gone):
        assert client.post("/api/analysis/%s/cancel" % key).status_code == 200
    assert gone.called


def test_a_process_that_cannot_be_started_is_reported(ask, monkeypatch):
    client = ask(small_net())
    monkeypatch.setattr(sys, "executable", "/nowhere/python3")
    answer = start(client, structure=True)
    assert answer.status_code == 503 and "cannot do that now" in answer.get_json()["error"]
