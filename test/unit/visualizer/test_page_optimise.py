"""Computed policies on the page: the form, the answer in parts, and where it is saved."""

import copy
import json

import pytest
from page_client import HOST, PageClient, folder_project, small_net
from shop import write_shop
from waiting import wait_for

from gspn_framework_package.analysis.decisions.aims import Aim, AtLeast
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.visualizer import analysis_jobs
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.guard import TOKEN_HEADER, Guard
from gspn_framework_package.visualizer.optimise_form import FormError, request_in_form
from gspn_framework_package.visualizer.optimised import Optimised, proposed_name
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.session import Session

FORM = {
    "aim": "long_run",
    "maximise": True,
    "rewards": [{"name": "fast_done", "value": "1"}, {"name": "slow_done", "value": 1}],
    "never": ["Fast == 1 and Slow == 1"],
    "at_least": [{"name": "fast_done", "bound": "0.5"}],
    "may_wait": ["Choose"],
    "timing": "run",
    "fitted": True,
    "simulated": "0",
}


@pytest.fixture(name="plan")
def _plan(tmp_path):
    return read_plan(str(write_shop(tmp_path)))


def test_the_form_becomes_a_request(plan):
    request = request_in_form(FORM, plan)
    assert request.objective.aim is Aim.LONG_RUN and request.objective.maximise
    assert request.objective.rewards == {"fast_done": 1.0, "slow_done": 1.0}
    assert request.never == ("Fast == 1 and Slow == 1",)
    assert request.at_least == (AtLeast("fast_done", 0.5),)
    assert request.may_wait == {"Choose"} and request.reading == "run" and request.fitted
    least = request_in_form({**FORM, "maximise": False, "fitted": False}, plan)
    assert not least.objective.maximise and not least.fitted
    goal = {"goal": " Slow >= 1 ", "at_least": []}
    assert request_in_form({**FORM, "aim": "time_to", **goal}, plan).objective.goal == "Slow >= 1"
    found = request_in_form({**FORM, "aim": "discounted", "at_least": [], "discount": "0.1"}, plan)
    assert found.objective.discount == 0.1
    rates = [{"name": "fast_done", "low": "1.5", "high": 3}]
    found = request_in_form({**FORM, "at_least": [], "uncertain": rates, "teams": "own"}, plan)
    assert found.uncertain == {"fast_done": (1.5, 3.0)} and found.team_sizes == (1,)


@pytest.mark.parametrize(
    ("changes", "fields"),
    [
        ({"aim": "fame"}, {"aim": "choose an aim"}),
        ({"rewards": []}, {"rewards": "add a place"}),
        ({"rewards": 3}, {"rewards": "give a list"}),
        ({"rewards": [{"name": "", "value": "1"}]}, {"rewards.0.name": "choose a place"}),
        ({"rewards": [{"name": "fast_done", "value": ""}]}, {"rewards.0.value": "give a number"}),
        ({"rewards": [{"name": "Fast", "value": "1e999"}]}, {"rewards.0.value": "give a number"}),
        ({"rewards": [{"name": "Fast", "value": "0"}]}, {"rewards": "must not be 0"}),
        ({"rewards": [{"name": "Gone", "value": 1}]}, {"rewards.0.name": "'Gone'"}),
        (
            {"rewards": [{"name": "Fast", "value": 1}, {"name": "Fast", "value": 2}]},
            {"rewards": "'Fast' occurs twice"},
        ),
        ({"aim": "reach", "at_least": [], "goal": ""}, {"goal": "write a condition"}),
        ({"aim": "reach", "at_least": [], "goal": "Gone == 1"}, {"goal": "no place 'Gone'"}),
        ({"aim": "reach", "goal": "Fast == 1"}, {"aim": "constraints on the long run"}),
        ({"aim": "discounted", "at_least": [], "discount": "0"}, {"discount": "above 0"}),
        ({"aim": "discounted", "at_least": [], "discount": ""}, {"discount": "give a rate"}),
        ({"never": ["Fast == 1", "Fast =="]}, {"never.1": "Fast =="}),
        ({"never": ["Fast + " * 500]}, {"never.0": "at most 2000"}),
        ({"never": [7]}, {"never.0": "write a condition"}),
        ({"at_least": [{"name": "fast_done", "bound": None}]}, {"at_least.0.bound": "number"}),
        ({"at_least": [{"name": "Gone", "bound": 1}]}, {"at_least.0.name": "'Gone'"}),
        ({"at_least": ["x"]}, {"at_least.0.name": "choose"}),
        ({"may_wait": ["Gone"]}, {"may_wait.0": "no such place"}),
        ({"may_wait": [[]]}, {"may_wait.0": "choose a place"}),
        ({"timing": "walk"}, {"timing": "no reading 'walk'"}),
        ({"teams": "dream"}, {"teams": "choose plan, own, all"}),
        ({"uncertain": [{"name": "", "low": 1}]}, {"uncertain.0.name": "exponential"}),
        ({"uncertain": [{"name": "fast_done", "low": 1}]}, {"uncertain.0.high": "give a rate"}),
        (
            {"uncertain": [{"name": "take_fast", "low": 1, "high": 2}]},
            {"uncertain.0": "not an exp"},
        ),
        ({"uncertain": [{"name": "fast_done", "low": 3, "high": 2}]}, {"uncertain.0": "3 to 2"}),
        ({"simulated": "900"}, {"simulated": "0 to 60"}),
        (
            {"never": ["?"], "simulated": "x", "rewards": [{"name": "Fast", "value": "x"}]},
            {"never.0": "'?'", "simulated": "give a number", "rewards.0.value": "give a number"},
        ),
    ],
)
def test_what_is_wrong_is_said_at_its_field(changes, fields, plan):
    with pytest.raises(FormError) as caught:
        request_in_form({**FORM, **changes}, plan)
    found = caught.value.fields
    assert found.keys() == fields.keys()
    for name, words in fields.items():
        assert words in found[name]


@pytest.fixture(name="shop")
def _shop(tmp_path):
    """A client of a server that serves the shop's folder, and has computed its best policy."""
    write_shop(tmp_path)
    guard = Guard("127.0.0.1", 8090, viewer_token="v" * 16, token="o" * 16)
    client = PageClient(folder_project(tmp_path), guard)
    client.role = {TOKEN_HEADER.replace("-", "_"): "o" * 16}
    client.viewer = {TOKEN_HEADER.replace("-", "_"): "v" * 16}
    client.folder = tmp_path
    client.key = client.post("/api/open", {"path": "plan.json"}, **client.role).get_json()["id"]
    asked = {"optimise": FORM, "seconds": 100}
    path = "/api/analysis?id=" + client.key
    client.job = client.post(path, asked, **client.role).get_json()["job"]

    def report():
        found = client.get("/api/analysis/" + client.job, **client.role).get_json()
        return found if found["state"] != "running" else None

    client.report = wait_for(report, seconds=60, what="the policy")
    assert client.report["state"] == "done", client.report["error"]
    yield client
    client.app.extensions["gspn_jobs"].close()


def saved(client, name, **fields):
    path = "/api/analysis/%s/save" % client.job
    return client.post(path, {"name": name, **fields}, **client.role)


def test_a_policy_is_computed_and_told_in_parts(shop):
    found = shop.report["result"]["optimised"]
    assert found["value"] == pytest.approx(2.0) and found["gain"] == pytest.approx(0.5)
    assert "plan" not in found
    assert found["asked"]["never"] == FORM["never"] and found["asked"]["may_wait"] == ["Choose"]
    assert shop.report["saves_as"] == "plan_optimised.json"
    # whoever may look sees the latest answer, and the plan
    latest = shop.get("/api/optimised?id=" + shop.key, **shop.viewer).get_json()
    assert latest == {"job": shop.job}
    rows = shop.get("/api/analysis/%s/rows?from=0&limit=9" % shop.job, **shop.viewer).get_json()
    assert rows["total"] == rows["changed"] == 1
    assert rows["rows"][0]["choose"] == {"take_fast": 1} and rows["rows"][0]["differs"] is True
    path = "/api/analysis/%s/choices?at=0&id=%s" % (shop.job, shop.key)
    here = shop.get(path, **shop.viewer).get_json()["choices"]
    half = {"take_fast": 0.5, "take_slow": 0.5}
    assert here == [{"place": "Choose", "present": half, "best": {"take_fast": 1.0}}]
    plan = shop.get("/api/analysis/%s/plan" % shop.job, **shop.viewer)
    assert "attachment" in plan.headers["Content-Disposition"]
    assert plan.get_json()["policy"]["rows"][0]["choose"] == {"take_fast": 1}
    assert shop.get("/api/analysis/none/plan", **shop.viewer).status_code == 400
    wrong = shop.post(
        "/api/analysis?id=" + shop.key, {"optimise": {**FORM, "never": ["?"]}}, **shop.role
    )
    assert wrong.status_code == 400 and wrong.get_json()["fields"].keys() == {"never.0"}


@pytest.mark.long
def test_a_plan_is_saved_beside_the_present_one_and_replaces_nothing_unasked(shop):
    present = (shop.folder / "plan.json").read_bytes()
    answer = saved(shop, "plan_optimised.json").get_json()
    assert answer == {"name": "plan_optimised.json", "path": "plan_optimised.json"}
    new = read_plan(str(shop.folder / "plan_optimised.json"))
    assert dict(new.policy.rows[0].choices) == {"take_fast": 1.0}
    # once more: only when it is confirmed
    (shop.folder / "plan_optimised.json").write_bytes(present)
    refused = saved(shop, "plan_optimised.json")
    assert refused.status_code == 409 and refused.get_json()["exists"] is True
    assert saved(shop, "plan_optimised.json", overwrite="yes").status_code == 409
    assert (shop.folder / "plan_optimised.json").read_bytes() == present
    assert saved(shop, "plan_optimised.json", overwrite=True).status_code == 200
    assert (shop.folder / "plan_optimised.json").read_bytes() != present
    # never: the open plan itself, under any name; what is not a plan; another folder
    (shop.folder / "link.json").symlink_to("plan.json")
    (shop.folder / "notes.json").write_text("{}")
    (shop.folder / "loose.json").symlink_to("/nowhere/there.json")
    (shop.folder / "sub").mkdir()
    for name in ("plan.json", "link.json", "notes.json", "loose.json"):
        answer = saved(shop, name, overwrite=True)
        assert answer.status_code == 409 and "exists" not in answer.get_json(), name
    for name in ("../x.json", "sub/x.json", "/tmp/x.json", ".x.json", "x", "x.txt", "", None, 3):
        assert saved(shop, name, overwrite=True).status_code == 400, name
    assert (shop.folder / "plan.json").read_bytes() == present
    assert (shop.folder / "notes.json").read_text() == "{}"
    assert str(shop.folder) not in saved(shop, "notes.json").get_json()["error"]
    assert proposed_name(str(shop.folder / "plan.json")) == "plan_optimised_2.json"
    # nor by those who may only look, nor by another page
    path = "/api/analysis/%s/save" % shop.job
    before = sorted(shop.folder.iterdir())
    for headers in (shop.viewer, {}, {**shop.role, "Origin": "http://evil.example"}):
        assert shop.post(path, {"name": "mine.json"}, **headers).status_code in (401, 403)
    assert shop.get(path, Host=HOST, **shop.role).status_code == 405
    assert sorted(shop.folder.iterdir()) == before


@pytest.mark.long
def test_a_plan_without_a_file_is_downloaded_and_not_saved(tmp_path):
    plan = read_plan(str(write_shop(tmp_path)))
    project = Project()
    project.show(Session("log", Document("a run", plan.net, plan)))
    client = PageClient(project)
    assert client.get("/api/session?id=log").get_json()["saves"] is False
    assert client.get("/api/optimised?id=log").get_json() == {"job": None}
    job = client.post("/api/analysis?id=log", {"optimise": FORM}).get_json()["job"]
    path = "/api/analysis/" + job
    wait_for(lambda: client.get(path).get_json()["state"] == "done", seconds=60, what="the policy")
    assert client.get(path).get_json()["saves_as"] is None
    answer = client.post(path + "/save", {"name": "plan_optimised.json"})
    assert answer.status_code == 409 and "download" in answer.get_json()["error"]
    assert json.loads(client.get(path + "/plan").get_data())["plan"] == "shop"
    client.app.extensions["gspn_jobs"].close()


@pytest.mark.long
def test_only_the_latest_policies_are_kept(monkeypatch, shop):
    monkeypatch.setattr(analysis_jobs, "POLICIES_KEPT", 1)
    jobs = shop.app.extensions["gspn_jobs"]
    jobs._jobs["later"] = copy.copy(jobs._jobs[shop.job])
    assert shop.post("/api/analysis?id=" + shop.key, {}, **shop.role).status_code == 200
    assert shop.get("/api/analysis/later/rows", **shop.role).status_code == 200
    gone = shop.get("/api/analysis/%s/rows" % shop.job, **shop.role)
    assert gone.status_code == 400 and "(any more)" in gone.get_json()["error"]


def test_a_net_has_no_policy_to_compute():
    project = Project()
    project.show(Session("net", Document("net", small_net())))
    answer = PageClient(project).post("/api/analysis?id=net", {"optimise": FORM})
    assert answer.status_code == 400 and "only a plan" in answer.get_json()["error"]


def test_rows_come_in_pages_and_those_that_differ_first(plan):
    rows = [{"marking": [n], "choose": {}} for n in range(1200)]
    found = Optimised(plan, {"policy": {"places": ["Choose"], "rows": rows}}, [700, 900], [3])
    first = found.rows(0, 4)
    assert [row["number"] for row in first["rows"]] == [701, 901, 1, 2]
    assert [row["differs"] for row in first["rows"]] == [True, True, None, None]
    assert (first["total"], first["changed"]) == (1200, 2)
    numbers = [
        row["number"] for start in (0, 500, 1000) for row in found.rows(start, 10**6)["rows"]
    ]
    assert sorted(numbers) == list(range(1, 1201))
    assert found.rows(5000, 10)["rows"] == []
