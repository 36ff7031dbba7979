"""Opening plans and nets for editing: who may, and what the document says."""

import json
import shutil

import pytest
from page_client import PageClient

from gspn_framework_package.formats.registry import read_net
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.guard import TOKEN_HEADER, Guard
from gspn_framework_package.visualizer.project import Project

TOKENS = {"token": "o" * 20, "viewer_token": "v" * 20}


def editor(folder, edits=True, guard=None):
    return PageClient(Project(Folder(str(folder)), edits=edits), guard)


@pytest.fixture(name="folder")
def _folder(tmp_path):
    for name in ("patrol", "warehouse", "tokens"):
        shutil.copytree("plans/" + name, str(tmp_path / name))
    return tmp_path


def opened(client, path):
    answer = client.get("/api/edit?id=file-" + path)
    assert answer.status_code == 200, answer.get_json()
    return answer.get_json()


def test_nothing_is_edited_unless_the_operator_said_so(folder):
    client = editor(folder, edits=False)
    for answer in (
        client.get("/api/edit?id=file-patrol/plan.json"),
        client.post("/api/edit/save?id=file-patrol/plan.json"),
        client.post("/api/edit/anything"),
    ):
        assert answer.status_code == 403 and "--edit" in answer.get_json()["error"]
    assert client.get("/api/hello").get_json()["edits"] is False


def test_only_the_operator_edits(folder):
    client = editor(folder, guard=Guard("0.0.0.0", 8090, **TOKENS))
    viewer, operator = ({TOKEN_HEADER: TOKENS[who]} for who in ("viewer_token", "token"))
    key = "?id=file-patrol/plan.json"
    for path in ("stream", "latest", "palette"):  # nor drafts, nor who edits
        assert client.get("/api/edit/%s%s&page=x" % (path, key), **viewer).status_code == 403
    for path in ("draft", "here", "save", "diff"):
        assert client.post("/api/edit/%s%s" % (path, key), {}, **viewer).status_code == 403
    answer = client.get("/api/edit?id=file-patrol/plan.json", **viewer)
    assert answer.status_code == 403 and "operator" in answer.get_json()["error"]
    assert client.get("/api/hello", **viewer).get_json()["edits"] is False
    assert client.get("/api/edit?id=file-patrol/plan.json", **operator).status_code == 200
    assert client.get("/api/hello", **operator).get_json()["edits"] is True
    assert client.get("/api/edit?id=file-patrol/plan.json").status_code == 401


def test_a_document_is_what_the_files_say(folder):
    client = editor(folder)
    for name in ("patrol", "tokens"):
        found = opened(client, name)
        plan = json.loads((folder / name / "plan.json").read_text())
        assert found["path"] == name + "/plan.json" and found["read_only"] == ""
        assert found["files"]["net"] == "net.xml" and found["files"]["plan"] == "plan.json"
        policy = plan.pop("policy")
        if isinstance(policy, str):
            assert found["files"]["policy"] == policy
            policy = json.loads((folder / name / policy).read_text())
        del plan["net"]
        assert found["document"]["policy"] == policy
        assert list(found["document"]["plan"].items()) == list(plan.items())
        nodes = found["document"]["net"]["places"]
        net = read_net(str(folder / name / "net.xml"))
        assert [(n["name"], tuple(n["position"])) for n in nodes] == [
            (place.name, place.position) for place in net.places
        ]
    subnet = opened(client, "warehouse")["document"]["plan"]["actions"]["Deliver"]
    assert subnet["plan"] == "dock.json"
    assert opened(client, "warehouse/dock.json")["files"]["net"] == "dock.xml"


def test_a_bare_net_opens_as_a_plan_to_be_completed(folder):
    found = opened(editor(folder), "patrol/net.xml")
    assert found["files"] == {"plan": None, "net": "net.xml", "policy": None}
    assert "its own folder" in found["read_only"]
    assert found["document"]["net"]["arcs"]


def test_nodes_without_a_position_get_one(tmp_path):
    net = {
        "places": [{"name": "a", "tokens": 1}, {"name": "b"}],
        "transitions": [{"name": "t"}],
        "arcs": [{"from": "a", "to": "t"}, {"from": "t", "to": "b"}],
    }
    plan = {"net": net, "actions": {"a": None, "b": None}}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    client = editor(tmp_path)
    found = opened(client, "plan.json")["document"]["net"]
    spots = {tuple(n["position"]) for n in found["places"] + found["transitions"]}
    assert len(spots) == 3
    net["places"][0]["position"], net["transitions"][0]["position"] = [0, 0], [3, 4.5]
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    again = opened(client, "plan.json")
    found = again["document"]["net"]
    assert found["places"][0]["position"] == [0, 0]
    assert found["transitions"][0]["position"] == [3, 4.5]
    assert found["places"][1]["position"][1] > 4.5 and again["scale"] > 1
    assert again["etag"] != ""


def test_the_etag_is_of_all_files(folder):
    client, seen = editor(folder), set()
    for name in (None, "net.xml", "policy.json", "plan.json"):
        if name:
            path = folder / "patrol" / name
            path.write_text(path.read_text() + "\n")
        seen.add(opened(client, "patrol")["etag"])
    assert len(seen) == 4


@pytest.mark.parametrize("mapping", ["{'p1:Check_Temperature_L1': 'actions.sort'}", "{}", "?"])
def test_an_input_file_of_the_thesis_opens(folder, mapping):
    data = {
        "project_path": "/home/somebody/project/",
        "gspn": "net.xml",
        "place_to_function_mapping": mapping,
        "places_tuple": "('p1:Check_Temperature_L1', 'p3:Decide_L1')",
        "policy_dictionary": "{}",
    }
    (folder / "patrol/input.json").write_text(json.dumps(data))
    found = opened(editor(folder), "patrol/input.json")
    actions = found["document"]["plan"].get("actions", {})
    assert any(actions.values()) == ("sort" in mapping) and found["document"]["net"]["places"]
    assert "thesis" in found["read_only"] and found["files"]["net"] == "net.xml"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not JSON"),
        ("[]", "JSON object"),
        ('{"net": 3, "actions": {}}', "net"),
        ('{"net": "gone.xml", "actions": {}}', "gone.xml"),
        ('{"net": "../../../../etc/passwd", "actions": {}}', "outside"),
        ('{"net": "out.xml", "actions": {}}', "outside"),
        ('{"net": "", "actions": {}}', "name of a file"),
        ('{"net": "a\\u0000b", "actions": {}}', "name of a file"),
        ('{"net": {"file": "plan.json", "constants": 3}, "actions": {}}', "net"),
        ('{"net": ".", "actions": {}}', "folder"),
        ('{"net": {"places": []}, "actions": {}}', "net"),
        ('{"net": {"places": [], "transitions": [], "arcs": []}, "policy": 3}', "policy"),
        ('{"a": NaN}', "NaN"),
        ('{"a": ' + "[" * 3000 + "]" * 3000 + "}", "deep"),
    ],
)
def test_broken_files_are_explained(tmp_path, text, said):
    served = tmp_path / "served"
    served.mkdir()
    (served / "plan.json").write_text(text)
    (served / "out.xml").symlink_to(tmp_path / "secret.xml")
    shutil.copy("plans/tokens/net.xml", str(tmp_path / "secret.xml"))
    answer = editor(served).get("/api/edit?id=file-plan.json")
    assert answer.status_code in (400, 409)
    error = answer.get_json()["error"]
    assert said in error and str(tmp_path) not in error


@pytest.mark.parametrize(
    "key",
    ["", "small", "file-", "file-../x", "file-/etc/passwd", "file-gone.json", "file-a%00b",
     "upload-123", "file-%ED%A0%80"],
)  # fmt: skip
def test_only_files_of_the_folder_are_edited(folder, key):
    answer = editor(folder).get("/api/edit?id=" + key)
    assert answer.status_code in (400, 409) and answer.get_json()["error"]
