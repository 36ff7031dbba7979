"""What the page opens: files of the served folder, and uploads that reach for nothing else."""

import base64
import json
import os
from pathlib import Path

import pytest
from page_client import PageClient, folder_project, small_net

from gspn_framework_package.formats import plan_file
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.formats.registry import write_net
from gspn_framework_package.model.errors import (
    GspnError,
    InputError,
    LimitError,
    RefusedError,
    UsageError,
)
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.visualizer import documents
from gspn_framework_package.visualizer.documents import Folder, read_upload

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(name="served")
def _served(tmp_path):
    folder = tmp_path / "served"
    folder.mkdir()
    write_net(small_net(), folder / "net.xml")
    (folder / "plan.json").write_text(json.dumps(plan_of("net.xml")))
    write_net(small_net(), tmp_path / "secret.xml")
    return folder


def plan_of(net):
    plan = Plan(small_net(), actions={"a": None, "b": None}, robots=(RobotSpec("r1", "a"),))
    return {**plan_to_json(plan), "net": net}


def sent(**files):
    return [
        {"name": name.replace("__", "."), "content": base64.b64encode(data).decode()}
        for name, data in files.items()
    ]


def xml(net=None, tmp="/tmp"):
    path = os.path.join(tmp, "page_test_%d.xml" % os.getpid())
    write_net(net or small_net(), path)
    with open(path, "rb") as file:
        data = file.read()
    os.unlink(path)
    return data


def test_the_folder_lists_nets_and_plans(served):
    assert [(e.path, e.kind) for e in Folder(str(served)).entries()] == [
        ("net.xml", "net"),
        ("plan.json", "plan"),
    ]


def test_a_plan_file_is_listed_however_broken(served):
    (served / "broken").mkdir()
    (served / "broken" / "plan.json").write_text('{"plan": "x", ')
    (served / "broken" / "other.json").write_text('{"plan": "x", ')
    found = [e.path for e in Folder(str(served)).entries()]
    assert "broken/plan.json" in found and "broken/other.json" not in found
    with pytest.raises(GspnError, match="plan.json"):
        Folder(str(served)).open("broken/plan.json")


@pytest.mark.long
def test_a_plan_with_a_very_long_policy_is_listed(served):
    rows = [{"marking": [i % 2], "choose": {"u": 1}} for i in range(60_000)]
    actions = plan_of("net.xml")["actions"]
    long = {"net": "net.xml", "policy": {"places": ["b"], "rows": rows}, "actions": actions}
    (served / "long.json").write_text(json.dumps(long))
    (served / "other.json").write_text(json.dumps({"net": "net.xml", "rows": rows}))
    assert (served / "long.json").stat().st_size > 2 * plan_file._CHUNK
    found = {e.path: e.kind for e in Folder(str(served)).entries()}
    assert found["long.json"] == "plan" and "other.json" not in found


@pytest.mark.parametrize(
    "path", ["../secret.xml", "./../secret.xml", "x/../../secret.xml", "/etc/passwd", "a\0b"]
)
def test_nothing_outside_the_folder_is_opened(served, path):
    with pytest.raises(RefusedError, match="served folder"):
        Folder(str(served)).open(path)
    client = PageClient(folder_project(served))
    assert client.post("/api/open", {"path": path}).status_code == 409
    assert client.get("/api/session?id=file-" + path.replace("\0", "%00")).status_code == 409


def test_a_link_that_leads_out_is_not_followed(served, tmp_path):
    (served / "link.xml").symlink_to(tmp_path / "secret.xml")
    (served / "out").symlink_to(tmp_path)
    folder = Folder(str(served))
    assert "link.xml" not in [e.path for e in folder.entries()]
    for path in ("link.xml", "out/secret.xml"):
        with pytest.raises(RefusedError, match="served folder"):
            folder.open(path)


def test_only_plans_of_the_folder_are_executable(served):
    folder = Folder(str(served))
    assert folder.open("plan.json").executable
    assert not folder.open("net.xml").executable
    plan = json.dumps(plan_of("net.xml")).encode()
    uploaded = read_upload(sent(plan__json=plan, net__xml=xml()))
    assert uploaded.plan is not None and not uploaded.executable


def test_an_uploaded_plan_cannot_be_started(served):
    started = []
    client = PageClient(folder_project(served), start_execution=started.append)
    client.project._start_execution = started.append
    plan = json.dumps(plan_of("net.xml")).encode()
    key = client.post("/api/upload", {"files": sent(plan__json=plan, net__xml=xml())}).get_json()[
        "id"
    ]
    answer = client.do("start", session=key, confirmed=True)
    assert answer.status_code == 409 and "simulated, not executed" in answer.get_json()["error"]
    assert not started
    assert client.do("step", session=key).status_code == 200


@pytest.mark.parametrize(
    "where", ["{secret}", "../secret.xml", "/etc/passwd", "..\\..\\secret.xml"]
)
@pytest.mark.parametrize("form", ["own", "own file", "policy", "thesis"])
def test_an_uploaded_plan_reads_no_file_of_this_machine(tmp_path, where, form):
    secret = tmp_path / "secret.xml"
    write_net(small_net(), secret)
    path = where.format(secret=secret)
    if form == "own":
        plan = plan_of(path)
    elif form == "own file":
        plan = plan_of({"file": path})
    elif form == "policy":
        plan = {**plan_of("net.xml"), "policy": path}
    else:
        plan = {
            "gspn": path,
            "place_to_client_mapping": "{}",
            "resources_list": "[]",
            "places_tuple": "('a','b')",
            "policy_dictionary": "{}",
            "full_synchronization": "True",
        }
    with pytest.raises(GspnError, match="was not sent"):
        read_upload(sent(plan__json=json.dumps(plan).encode(), net__xml=xml()))


def test_an_uploaded_net_that_a_plan_names_is_found():
    plan = plan_of("C:\\somewhere\\net.xml")
    assert read_upload(sent(p__json=json.dumps(plan).encode(), net__xml=xml())).plan is not None


BOMB = (
    b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "%s">]><pnml><net>&b;</net></pnml>'
    % (b"&a;" * 50)
)


@pytest.mark.parametrize(
    "data",
    [
        BOMB,
        b'<!DOCTYPE x SYSTEM "file:///etc/passwd"><pnml><net id="n"/></pnml>',
        b'<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><pnml><net id="&e;"/></pnml>',
        b"<pnml><net>",
        b"",
        b"\x00\xff\xfe",
        b"{}",
    ],
)
def test_hostile_and_broken_uploads_get_one_message(data):
    client = PageClient()
    answer = client.post("/api/upload", {"files": sent(net__xml=data)})
    assert answer.status_code in (400, 409)
    assert (
        "root:" not in answer.get_json()["error"]
        and "gspn_upload_" not in answer.get_json()["error"]
    )


@pytest.mark.parametrize(
    "declared", ['<!ENTITY e "x">', '<!ENTITY e SYSTEM "file:///etc/passwd">', '<!ENTITY % e "x">']
)
def test_a_net_that_declares_entities_is_refused_whether_it_uses_them_or_not(declared):
    text = (ROOT / "plans/patrol/net.xml").read_bytes()
    begin = text.index(b"<pnml")
    hostile = b"<?xml version='1.0'?><!DOCTYPE pnml [" + declared.encode() + b"]>" + text[begin:]
    client = PageClient()
    assert client.post("/api/upload", {"files": sent(net__xml=text)}).status_code == 200
    answer = client.post("/api/upload", {"files": sent(net__xml=hostile)})
    assert answer.status_code == 400 and "XML entities" in answer.get_json()["error"]


def test_xml_that_nests_without_end_is_refused_by_the_parser():
    data = b"<pnml><net>" + b"<a>" * 1000 + b"</a>" * 1000 + b"</net></pnml>"
    answer = PageClient().post("/api/upload", {"files": sent(net__xml=data)})
    assert answer.status_code == 400 and "depth" in answer.get_json()["error"].lower()


@pytest.mark.parametrize(
    "name", ["../x.xml", "/etc/x.xml", "a/b.xml", "..", "", "x\\y.xml", "a\0.xml"]
)
def test_names_of_uploads_are_names_only(name):
    with pytest.raises(GspnError, match="valid name"):
        read_upload([{"name": name, "content": base64.b64encode(xml()).decode()}])


@pytest.mark.parametrize(
    "files", [None, [], [1], [{"name": "x.xml", "content": "***"}], [{}] * 11, "x"]
)
def test_uploads_that_make_no_sense_are_refused(files):
    with pytest.raises(GspnError):
        read_upload(files)


def test_a_net_that_is_too_large_to_show_is_refused(monkeypatch):
    monkeypatch.setattr(documents, "MOST_DRAWN_NODES", 3)
    with pytest.raises(LimitError, match="too large for the page"):
        read_upload(sent(net__xml=xml()))
    monkeypatch.setattr(documents, "MOST_DRAWN_NODES", 4)
    monkeypatch.setattr(documents, "ARCS", 3)
    with pytest.raises(LimitError, match="too large for the page"):
        read_upload(sent(net__xml=xml()))


def with_subnet(path):
    plan = plan_of("net.xml")
    return {**plan, "actions": {"a": {"plan": path, "entry": "a", "exit": "a"}, "b": None}}


@pytest.mark.parametrize(
    "where", ["{secret}", "../secret.json", "link/secret.json", "pipe", "a\0b"]
)
def test_a_subnet_of_an_upload_is_read_only_if_it_was_sent(tmp_path, where):
    secret = tmp_path / "secret.json"
    secret.write_text('{"password": "hunter2"}')
    data = json.dumps(with_subnet(where.format(secret=secret))).encode()
    with pytest.raises(InputError, match="was not sent") as caught:
        read_upload(sent(plan__json=data, net__xml=xml()))
    assert "hunter2" not in str(caught.value) and "password" not in str(caught.value)


def test_python_files_of_an_upload_are_left_out():
    files = sent(plan__json=json.dumps(plan_of("net.xml")).encode(), net__xml=xml())
    assert read_upload([*files, *sent(actions__py=b"import os")]).plan is not None
    with pytest.raises(UsageError, match="neither a net nor a plan"):
        read_upload(sent(actions__py=b"import os"))


@pytest.mark.parametrize("kind", ["outside", "link", "pipe", "nested"])
def test_a_subnet_in_the_served_folder_leads_nowhere_else(served, kind):
    (served.parent / "other.json").write_text(json.dumps(plan_of("net.xml")))
    names = {"outside": "../other.json", "link": "link.json", "pipe": "pipe.json"}
    os.symlink(str(served.parent / "other.json"), str(served / "link.json"))
    os.mkfifo(str(served / "pipe.json"))
    (served / "inner.json").write_text(json.dumps(with_subnet("../other.json")))
    path = names.get(kind, "inner.json")
    (served / "outer.json").write_text(json.dumps(with_subnet(path)))
    with pytest.raises(GspnError, match="it is a pipe" if kind == "pipe" else "outside the folder"):
        Folder(str(served)).open("outer.json")


def test_the_run_net_of_a_plan_is_shown(served):
    client = PageClient(folder_project(served))
    key = client.post("/api/open", {"path": "plan.json"}).get_json()["id"]
    opened = client.post("/api/run_net?id=%s" % key, {})
    assert opened.status_code == 200
    shown = client.get("/api/session?id=%s" % opened.get_json()["id"]).get_json()
    assert shown["title"] == "plan.json, its run net" and not shown["executable"]
    names = [node["name"] for kind in ("places", "transitions") for node in shown["scene"][kind]]
    assert sorted(shown["meanings"]) == sorted(names)
    assert "all robots in a" in shown["meanings"].values()
    assert client.do("step", session=opened.get_json()["id"]).status_code == 200


def test_a_net_has_no_run_net(served):
    client = PageClient(folder_project(served))
    key = client.post("/api/open", {"path": "net.xml"}).get_json()["id"]
    answer = client.post("/api/run_net?id=%s" % key, {})
    assert answer.status_code == 400 and "only a plan has" in answer.get_json()["error"]
