"""Deploying from the page into a run of its server: the question, the outcome, and every refusal."""

import json

import pytest
from deployed_log import round_of
from page_client import PageClient
from waiting import wait_for

from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.standalone_run import StandaloneRun

ACTIONS = """
def wait(is_cancelled):
    is_cancelled.wait(60)
"""


def plan(places, name, action="actions.wait", **more):
    return {
        "plan": name,
        "net": round_of(places),
        "actions": dict.fromkeys(places, action),
        "robots": {"r": places[0]},
        **more,
    }


@pytest.fixture(name="client")
def _client(tmp_path):
    """A page on a folder of plans, in which the first one runs: its robot stays in A."""
    (tmp_path / "actions.py").write_text(ACTIONS)
    for name, data in {
        "four": plan("ABCD", "four"),
        "renamed": plan("XBCDE", "renamed"),
        "broken": plan("ABCD", "broken", action="actions.none"),
        "partial": plan("ABCD", "partial", synchronisation="partial"),
    }.items():
        (tmp_path / (name + ".json")).write_text(json.dumps(data))
    client = PageClient(Project(Folder(str(tmp_path)), StandaloneRun))
    client.post("/api/open", {"path": "four.json"})
    assert client.do("start", session="file-four.json", confirmed=True).status_code == 200
    yield client
    client.project.close()


KEY = "?id=file-four.json"


def deploy(client, path, **fields):
    """How the run ended: (state, what is said)."""
    answer = client.post("/api/deploy" + KEY, {"path": path, **fields})
    if answer.status_code != 200:
        return "refused", answer.get_json()["error"]

    def ended():
        found = client.get("/api/deploy" + KEY).get_json()
        return found if found["state"] != "looking" else None

    found = wait_for(ended, what="the end of the deployment")
    return found["state"], found["says"]


def test_the_page_shows_what_would_change_and_asks_for_the_names_that_are_gone(client):
    runs = client.get("/api/deploy/targets").get_json()["runs"]
    assert [run["id"] for run in runs] == ["file-four.json"]
    look = client.post("/api/deploy/look" + KEY, {"path": "renamed.json"}).get_json()
    assert (look["present"], look["plan"]) == ("four", "renamed")
    assert {"place", "transition", "arc"} <= {change["kind"] for change in look["changes"]}
    assert look["gone"] == [
        {"name": "A", "kind": "action place"},
        {"name": "leave_A", "kind": "transition"},
    ]
    assert look["names"]["action place"][:2] == ["X", "E"]


def test_a_run_goes_on_under_the_plan_that_is_deployed(client):
    names = {"A": "X", "leave_A": "leave_X"}
    assert deploy(client, "renamed.json", map=names) == (
        "done",
        "the run follows the plan 'renamed'",
    )
    board = client.board("file-four.json")
    assert board["plan"] == 1 and board["marking"] == [1, 0, 0, 0, 0]
    scene = client.get("/api/scene" + KEY + "&plan=1").get_json()["scene"]
    assert [place["name"] for place in scene["places"]] == list("XBCDE")
    # the next question is about what runs now
    look = client.post("/api/deploy/look" + KEY, {"path": "four.json"}).get_json()
    assert look["present"] == "renamed"
    assert {"name": "X", "kind": "action place"} in look["gone"]


@pytest.mark.parametrize(
    "path, fields, says",
    [
        ("renamed.json", {}, "is in 'A', which is not an action place of the new plan"),
        ("renamed.json", {"map": {"A": "nowhere"}}, "'A' is mapped to 'nowhere'"),
        ("renamed.json", {"map": ["A"]}, "'map' must be an object"),
        ("broken.json", {}, "none"),
        ("partial.json", {}, "it changes 'synchronisation'"),
        ("none.json", {}, "there is no such file"),
        ("../four.json", {}, "only files of the served folder"),
        ("renamed.json", {"run": "another"}, "the order is for run 'another'"),
    ],
)
def test_a_refusal_says_why_and_the_run_goes_on_as_it_did(client, path, fields, says):
    state, text = deploy(client, path, **fields)
    assert state == "refused" and says in text and "Traceback" not in text
    board = client.board("file-four.json")
    assert "plan" not in board and board["status"]["running"]


def taking_robots(places):
    """A round that the last robot leaves for good."""
    data = plan(places, "taking")
    data["net"]["transitions"].append({"name": "gone", "timed": True, "rate": 1})
    data["net"]["arcs"].append({"from": places[0], "to": "gone"})
    return data


def test_what_the_check_refuses_is_shown_and_not_deployed(client, tmp_path):
    (tmp_path / "taking.json").write_text(json.dumps(taking_robots("ABCD")))
    for key, answer in (("broken", "there is no 'none'"), ("taking", "gone takes 1 robot(s)")):
        look = client.post("/api/deploy/look" + KEY, {"path": key + ".json"}).get_json()
        assert look["refused"] and look["verdict"] == "refused"
        assert answer in look["findings"][0]["text"] and look["findings"][0]["level"] == "error"
        state, says = deploy(client, key + ".json")
        assert state == "refused" and answer in says
    assert client.board("file-four.json")["marking"] == [1, 0, 0, 0]
    look = client.post("/api/deploy/look" + KEY, {"path": "renamed.json"}).get_json()
    assert not look["refused"] and look["verdict"] == "may run"


def test_without_a_run_there_is_nothing_to_deploy_to(client):
    client.post("/api/open", {"path": "renamed.json"})
    answer = client.post("/api/deploy?id=file-renamed.json", {"path": "four.json"})
    assert (
        answer.status_code == 409
        and "no run here that could follow another" in answer.get_json()["error"]
    )
    client.do("stop", session="file-four.json")
    assert client.get("/api/deploy/targets").get_json()["runs"] == []
    state, text = deploy(client, "renamed.json")
    assert state == "refused" and "there is no run here that could follow another plan" in text
