"""Saving in the page: what was not edited keeps its bytes, and nothing is lost when it fails."""

import copy
import errno
import io
import json
import os
import shutil
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from page_client import PageClient
from waiting import wait_for

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.registry import FORMATS, read_net
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.editing import atomic
from gspn_framework_package.visualizer.editing.atomic import JOURNAL
from gspn_framework_package.visualizer.guard import HEADER
from gspn_framework_package.visualizer.project import Project

PLANS = ["patrol", "warehouse", "tokens", "inspection", "measure", "rendezvous", "fork_join"]


class Editor(PageClient):
    """A page whose operator edits plans."""

    def __init__(self, folder, **options):
        super().__init__(Project(Folder(str(folder)), edits=True, **options))

    def open(self, path):
        answer = self.get("/api/edit?id=file-" + path)
        assert answer.status_code == 200, answer.get_json()
        # as a browser reads and writes it: 1.0 becomes 1
        return json.loads(answer.get_data(), parse_float=_as_in_a_browser)

    def send(self, what, path, **fields):
        return self.post("/api/edit/%s?id=file-%s" % (what, path), fields)

    def save(self, path, opened):
        return self.send("save", path, etag=opened["etag"], document=opened["document"])


def _as_in_a_browser(text):
    value = float(text)
    return int(value) if value.is_integer() else value


@pytest.fixture(name="folder")
def _folder(tmp_path):
    for name in PLANS:
        shutil.copytree("plans/" + name, str(tmp_path / name))
    return tmp_path


@pytest.fixture(name="editor")
def _editor(folder):
    return Editor(folder)


def content(folder):
    return {
        str(p.relative_to(folder)): (p.read_bytes(), p.stat().st_mtime_ns)
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.mark.long
@pytest.mark.parametrize("name", PLANS + ["warehouse/dock.json"])
def test_saving_without_edits_writes_nothing(folder, editor, name):
    before = content(folder)
    opened = editor.open(name)
    answer = editor.save(name, opened)
    assert answer.status_code == 200, answer.get_json()
    assert answer.get_json()["etag"] == opened["etag"] and answer.get_json()["written"] == []
    assert content(folder) == before


def test_one_edit_changes_one_line_of_one_file(folder, editor):
    before = content(folder)
    opened = editor.open("patrol")
    opened["document"]["plan"]["seed"] = 5
    answer = editor.save("patrol", opened).get_json()
    assert answer["written"] == ["patrol/plan.json"] and answer["etag"] != opened["etag"]
    opened = {**opened, "etag": answer["etag"]}
    opened["document"]["net"]["places"][0]["tokens"] = 2
    opened["document"]["plan"]["robots"]["robot_9"] = opened["document"]["net"]["places"][0]["name"]
    answer = editor.save("patrol", opened).get_json()
    assert set(answer["written"]) == {"patrol/plan.json", "patrol/net.xml"}
    after = content(folder)
    assert {n for n in before if before[n] != after[n]} == {"patrol/plan.json", "patrol/net.xml"}
    assert before.keys() == after.keys()
    for name in ("patrol/plan.json", "patrol/net.xml"):
        old, new = before[name][0].splitlines(), after[name][0].splitlines()
        assert len(set(old) - set(new)) <= 2 and len(set(new) - set(old)) <= 4
    plan = read_plan(str(folder / "patrol"))
    assert plan.seed == 5 and plan.net.places[0].tokens == 2


def test_edits_that_were_undone_write_nothing(folder, editor):
    for name in ("patrol", "warehouse"):
        opened, before = editor.open(name), content(folder)
        first = copy.deepcopy(opened)
        opened["document"]["net"]["places"][0]["position"] = [1, 2]
        opened["document"]["plan"] = dict(reversed(list(opened["document"]["plan"].items())))
        opened["document"]["net"]["places"][0]["position"] = first["document"]["net"]["places"][0][
            "position"
        ]
        assert editor.save(name, opened).get_json()["written"] == []
        assert content(folder) == before


def test_the_policy_stays_in_its_file(folder, editor):
    opened = editor.open("patrol")
    opened["document"]["policy"]["rows"].pop()
    answer = editor.save("patrol", opened).get_json()
    assert answer["written"] == ["patrol/policy.json"]
    assert json.loads((folder / "patrol/policy.json").read_text()) == opened["document"]["policy"]
    opened = editor.open("patrol")
    opened["document"]["policy"] = None
    assert editor.save("patrol", opened).get_json()["written"] == ["patrol/plan.json"]
    assert "policy" not in json.loads((folder / "patrol/plan.json").read_text())


def test_what_the_net_file_cannot_hold_goes_into_the_plan(folder, editor):
    opened, before = editor.open("tokens"), content(folder)
    timed = next(t for t in opened["document"]["net"]["transitions"] if t.get("timed"))
    timed["servers"] = 3
    answer = editor.save("tokens", opened).get_json()
    assert answer["written"] == ["tokens/plan.json"] and answer["files"]["net"] is None
    assert ".xml files cannot represent it" in answer["notes"][0]
    assert content(folder)["tokens/net.xml"] == before["tokens/net.xml"]
    net = read_plan(str(folder / "tokens")).net
    assert net.transitions[net.transition_index[timed["name"]]].servers == 3
    again = editor.open("tokens")
    assert editor.save("tokens", again).get_json()["written"] == []


def test_positions_that_the_page_made_up_are_not_saved(tmp_path):
    net = {
        "places": [{"name": "a", "tokens": 1}, {"name": "b"}],
        "transitions": [{"name": "t", "weight": 1.0}],
        "arcs": [{"from": "a", "to": "t"}, {"from": "t", "to": "b"}],
    }
    plan = {"net": net, "actions": {"a": None, "b": None}}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    editor = Editor(tmp_path)
    opened = editor.open("plan.json")
    assert opened["laid_out"] and editor.save("plan.json", opened).get_json()["written"] == []
    opened["document"]["net"]["places"][1]["tokens"] = 2
    assert editor.save("plan.json", opened).status_code == 200
    text = (tmp_path / "plan.json").read_text()
    assert "position" not in text and '"weight": 1.0' in text and '"tokens": 2' in text
    opened = editor.open("plan.json")
    opened["document"]["net"]["arcs"][0]["bends"] = [[1, 2.5]]
    assert editor.save("plan.json", opened).status_code == 200  # where it is drawn is kept, too
    assert (tmp_path / "plan.json").read_text().count("position") == 3
    (tmp_path / "plan.json").write_text(text)
    opened = editor.open("plan.json")
    opened["document"]["net"]["places"][0]["position"] = [7, 7.5]
    assert editor.save("plan.json", opened).status_code == 200
    assert (tmp_path / "plan.json").read_text().count("position") == 3
    again = editor.open("plan.json")
    assert not again["laid_out"] and again["document"] == opened["document"]


@pytest.mark.parametrize("format", ["pipe", "pnml", "pnpro", "tina"])
def test_a_net_of_every_format_is_edited(tmp_path, format):
    net = read_net("plans/tokens/net.xml")
    name = "net" + FORMATS[format].extensions[0]
    (tmp_path / name).write_bytes(FORMATS[format].to_bytes(net))
    plan = json.loads(Path("plans/tokens/plan.json").read_text())
    (tmp_path / "plan.json").write_text(json.dumps({**plan, "net": name}, indent=2))
    shutil.copy("plans/tokens/actions.py", str(tmp_path))
    editor = Editor(tmp_path)
    opened, before = editor.open("plan.json"), content(tmp_path)
    assert editor.save("plan.json", opened).get_json()["written"] == []
    assert content(tmp_path) == before
    timed = next(t for t in opened["document"]["net"]["transitions"] if t.get("timed"))
    timed["rate"] = 0.75
    answer = editor.save("plan.json", opened).get_json()
    assert answer["written"] == (["plan.json"] if format == "tina" else [name]), answer
    saved = editor.open("plan.json")
    now = {t["name"]: t for t in saved["document"]["net"]["transitions"]}
    assert now[timed["name"]]["rate"] == 0.75


@st.composite
def edits(draw, document):
    """The document after a few edits, which it survives as a plan."""
    new = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["move", "rate", "seed", "place", "text", "timeout", "arc"]))
        if kind == "move":
            node = draw(st.sampled_from(new["net"]["places"]))
            node["position"] = draw(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=2))
        elif kind == "rate":
            node = draw(st.sampled_from(new["net"]["transitions"]))
            key = "rate" if node.get("timed") else "weight"
            node[key] = draw(st.floats(1e-6, 1e6))
        elif kind == "seed":
            new["plan"]["seed"] = draw(st.integers(0, 2**53 - 1))
        elif kind == "place":
            name = "new %d" % len(new["net"]["places"])
            new["net"]["places"].append({"name": name, "position": [1, 2.5]})
            if draw(st.booleans()):
                transition = new["net"]["transitions"][0]["name"]
                new["net"]["arcs"].append({"from": transition, "to": name})
            new["plan"]["resource_places"] = [*new["plan"].get("resource_places", []), name]
        elif kind == "text":
            text = st.text(st.characters(blacklist_categories=["Cs"]), max_size=20)
            new["plan"]["description"] = draw(text)
        elif kind == "timeout":
            place = draw(st.sampled_from(sorted(new["plan"]["actions"])))
            if new["plan"]["actions"][place] and not isinstance(
                new["plan"]["actions"][place], dict
            ):
                new["plan"].setdefault("timeout", {})[place] = draw(st.floats(0.1, 100))
        else:
            arc = draw(st.sampled_from(new["net"]["arcs"]))
            arc["weight"] = draw(st.integers(1, 3))
    return new


def same_document(a, b):
    """Whether two documents are the same but for the order of new nodes and rounding."""

    def key(document):
        document = json.loads(json.dumps(document), parse_int=float)
        net = document["net"]
        nodes = sorted(
            json.dumps(
                # 0.0 is added since -0.0 equals 0.0, but is written in another way
                {**n, "position": [round(float(x), 3) + 0.0 for x in n["position"]]},
                sort_keys=True,
            )
            for n in [*net["places"], *net["transitions"]]
        )
        arcs = sorted(json.dumps(_without_ones(arc), sort_keys=True) for arc in net["arcs"])
        return nodes, arcs, document["plan"], document["policy"]

    for mine, other in zip(key(a), key(b)):
        assert mine == other
    return True


def _without_ones(arc):
    return {k: v for k, v in arc.items() if (k, v) != ("weight", 1)}


@pytest.mark.long
@pytest.mark.parametrize("name", ["patrol", "warehouse"])
def test_any_edits_are_saved_and_taken_back(folder, editor, name):
    first = editor.open(name)
    before = {k: v[0] for k, v in content(folder).items()}

    @settings(suppress_health_check=list(HealthCheck), deadline=None, max_examples=12)
    @given(st.data())
    def comes_and_goes(data):
        opened = editor.open(name)
        new = data.draw(edits(opened["document"]))
        answer = editor.send("save", name, etag=opened["etag"], document=new)
        assert answer.status_code in (200, 400), answer.get_json()
        if answer.status_code == 400:  # not a plan any more: nothing was written
            assert editor.open(name)["etag"] == opened["etag"]
            return
        saved = editor.open(name)
        assert saved["etag"] == answer.get_json()["etag"]
        new["net"]["transitions"] = [_rounded(t) for t in new["net"]["transitions"]]
        saved["document"]["net"]["transitions"] = [
            _rounded(t) for t in saved["document"]["net"]["transitions"]
        ]
        assert same_document(saved["document"], new)
        for path, text in before.items():
            (folder / path).write_bytes(text)

    comes_and_goes()
    assert editor.open(name)["etag"] == first["etag"]


def _rounded(transition):
    """A transition without the weight and rate that are the default."""
    return {k: v for k, v in transition.items() if (k, v) not in (("weight", 1), ("priority", 1))}


# -- conflicts, and what goes wrong --------------------------------------------------------------


@pytest.mark.parametrize("file", ["plan.json", "net.xml", "policy.json"])
def test_somebody_elses_change_is_not_overwritten(folder, editor, file):
    mine, theirs = editor.open("patrol"), editor.open("patrol")
    if file == "plan.json":
        theirs["document"]["plan"]["seed"] = 77
    elif file == "net.xml":
        theirs["document"]["net"]["places"][0]["position"] = [5, 5]
    else:
        theirs["document"]["policy"]["rows"].pop()
    assert editor.save("patrol", theirs).get_json()["written"] == ["patrol/" + file]
    before = content(folder)
    mine["document"]["plan"]["seed"] = 3
    answer = editor.save("patrol", mine)
    assert answer.status_code == 412 and "somebody" in answer.get_json()["error"]
    found = answer.get_json()["theirs"]
    assert found["etag"] == editor.open("patrol")["etag"] and content(folder) == before
    mine["etag"] = found["etag"]
    assert editor.save("patrol", mine).status_code == 200


def refused(editor, folder, path, opened, status, said, **changes):
    before = content(folder)
    document = {**opened["document"], **changes}
    answer = editor.send("save", path, etag=opened["etag"], document=document)
    assert answer.status_code in status, answer.get_json()
    assert said in answer.get_json()["error"], answer.get_json()
    assert content(folder) == before


def test_a_document_that_is_no_plan_is_not_saved(folder, editor):
    opened = editor.open("patrol")
    plan, net = opened["document"]["plan"], opened["document"]["net"]
    for changes, said in (
        ({"plan": {**plan, "seeed": 1}}, "seeed"),
        ({"plan": {**plan, "actions": {"Nowhere": None}}}, "Nowhere"),
        ({"plan": {"plan": "x"}}, "actions"),
        ({"plan": 3}, "'plan'"),
        ({"net": None}, "'net'"),
        ({"net": {**net, "arcs": [{"from": "a", "to": "b"}]}}, "'a'"),
        ({"net": {**net, "places": [{"name": ""}]}}, "places"),
        ({"net": {**net, "places": net["places"] * 2}}, "place"),
        ({"net": {"places": 3, "transitions": [], "arcs": []}}, "places"),
        ({"policy": {"places": ["Nowhere"], "rows": []}}, "Nowhere"),
        ({"policy": []}, "policy"),
        ({"plan": {**plan, "description": "\ud800"}}, "character"),
        ({"plan": {**plan, "seed": 10**400}}, "digits"),
    ):
        refused(editor, folder, "patrol", opened, (400,), said, **changes)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"etag": "x", "document": {"plan": {"seed": NaN}, "net": {}}}', "number"),
        ('{"etag": "x", "document": {"plan": {"seed": 1e999}, "net": {}}}', "number"),
        ('{"etag": "x", "document": %s1%s}' % ('{"plan": ' * 500, "}" * 500), "deep"),
        ('{"etag": "x", "document": %s1%s}' % ("[" * 100_000, "]" * 100_000), "JSON"),
        ('{"etag": "x"}', "document"),
        ('{"document": 1}', "document"),
        ("[]", "object"),
        ("", "JSON"),
    ],
)
def test_no_document_at_all_is_refused(folder, editor, text, said):
    before = content(folder)
    for what in ("save", "save_as", "draft", "export"):
        answer = editor.post("/api/edit/%s?id=file-patrol" % what, data=text)
        forgets = what == "draft" and text == '{"etag": "x"}'
        assert answer.status_code == (200 if forgets else 400), answer.get_json()
        assert forgets or said in answer.get_json()["error"]
    assert content(folder) == before


def test_other_pages_and_oversized_documents_are_refused(folder, editor):
    before = content(folder)
    opened = editor.open("patrol")
    body = {"etag": opened["etag"], "document": {**opened["document"], "policy": None}}
    url = "/api/edit/save?id=file-patrol"
    for headers in (
        {"Origin": "http://evil.example"},
        {HEADER.replace("-", "_"): None},
        {"Sec_Fetch_Site": "cross-site"},
        {"Host": "evil.example"},
    ):
        assert editor.post(url, body, **headers).status_code in (403, 421)
    assert editor.post(url, body, Content_Type="text/plain").status_code == 400
    assert editor.get(url).status_code == 405
    answer = editor.post(url, data=b'{"a": "%s"}' % (b"x" * 12_000_001))
    assert answer.status_code == 413 and "12 MB" in answer.get_json()["error"]
    assert content(folder) == before


def test_a_name_that_is_a_script_is_only_a_name(folder, editor):
    name = "<script>alert(1)</script>"
    opened = editor.open("patrol")
    opened["document"]["net"]["places"].append({"name": name, "position": [1, 1]})
    opened["document"]["plan"]["resource_places"] = [name]
    assert editor.save("patrol", opened).status_code == 200
    assert b"&lt;script&gt;" in (folder / "patrol/net.xml").read_bytes()
    assert editor.open("patrol")["document"]["net"]["places"][-1]["name"] == name
    answer = editor.send("export", "patrol", document=opened["document"], format="pnml")
    assert answer.status_code == 200 and b"<script" not in answer.get_data()
    answer = editor.get("/api/edit?id=file-patrol")
    assert answer.mimetype == "application/json"
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


def test_links_out_of_the_folder_are_not_followed(folder, tmp_path_factory, editor):
    outside = tmp_path_factory.mktemp("outside")
    shutil.copy(str(folder / "patrol/net.xml"), str(outside / "net.xml"))
    opened = editor.open("patrol")
    os.unlink(str(folder / "patrol/net.xml"))
    os.symlink(str(outside / "net.xml"), str(folder / "patrol/net.xml"))
    opened["document"]["net"]["places"][0]["position"] = [3, 3]
    refused(editor, folder, "patrol", opened, (409,), "outside")
    assert (outside / "net.xml").read_bytes() == Path("plans/patrol/net.xml").read_bytes()
    os.symlink(str(outside), str(folder / "away"))
    for path in ("away/net.xml", "../x", "/etc/passwd", "patrol/%00"):
        answer = editor.send("save", path, etag="x", document=opened["document"])
        assert answer.status_code in (400, 409)


def test_a_link_inside_the_folder_stays_a_link(folder, editor):
    (folder / "patrol/net.xml").rename(folder / "shared.xml")
    os.symlink("../shared.xml", str(folder / "patrol/net.xml"))
    opened = editor.open("patrol")
    opened["document"]["net"]["places"][0]["position"] = [3, 3]
    assert editor.save("patrol", opened).get_json()["written"] == ["shared.xml"]
    assert (folder / "patrol/net.xml").is_symlink()


def test_a_file_that_vanished_loses_nothing(folder, editor):
    opened = editor.open("patrol")
    opened["document"]["plan"]["seed"] = 4
    os.unlink(str(folder / "patrol/plan.json"))
    answer = editor.save("patrol/plan.json", opened)
    assert answer.status_code in (400, 409) and "another plan" in answer.get_json()["error"]
    kept = editor.send(
        "draft", "patrol/plan.json", etag=opened["etag"], document=opened["document"]
    )
    assert kept.get_json()["kept"]
    answer = editor.send("save_as", "patrol/plan.json", document=opened["document"], name="saved")
    assert answer.status_code == 200, answer.get_json()
    assert read_plan(str(folder / "saved")).seed == 4


def _full(monkeypatch, room):
    """From now on writes of the editor end after ``room`` bytes."""
    fsync, left = os.fsync, [room]

    def flush(descriptor):
        left[0] -= os.fstat(descriptor).st_size
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    monkeypatch.setattr(atomic.os, "fsync", flush)


def test_a_full_disk_changes_nothing(folder, editor, monkeypatch):
    opened = editor.open("patrol")
    opened["document"]["plan"]["seed"] = 4
    opened["document"]["net"]["places"][0]["position"] = [3, 3]
    for room in (0, 9000):  # neither has room, or only the first has
        with monkeypatch.context() as patch:
            _full(patch, room)
            refused(editor, folder, "patrol", opened, (400,), "No space left")
            answer = editor.send("save_as", "patrol", document=opened["document"], name="copy")
            assert answer.status_code == 400 and not (folder / "copy").exists()
    assert sorted(p.name for p in folder.iterdir()) == sorted(PLANS)
    assert editor.save("patrol", opened).status_code == 200


def test_a_folder_that_is_read_only_is_reported(folder, editor, monkeypatch):
    opened = editor.open("patrol")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert "is not writable" in editor.open("patrol")["read_only"]
    opened["document"]["plan"]["seed"] = 4
    refused(editor, folder, "patrol", opened, (409,), "is not writable")
    monkeypatch.undo()

    opened_by_os = os.open

    def read_only(path, flags, *rest):
        if flags & os.O_WRONLY:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return opened_by_os(path, flags, *rest)

    monkeypatch.setattr(atomic.os, "open", read_only)
    refused(editor, folder, "patrol", opened, (400,), "Read-only")


class Death(BaseException):
    """The server's end."""


@pytest.mark.parametrize("survived", [0, 1])
def test_a_server_that_dies_while_saving_leaves_a_whole_plan(folder, monkeypatch, survived):
    editor = Editor(folder)
    opened = editor.open("patrol")
    opened["document"]["plan"]["seed"] = 4
    opened["document"]["net"]["places"][0]["position"] = [3, 3]
    replace, done = os.replace, []

    def replaced(source, target):
        if not str(target).endswith(JOURNAL):
            if len(done) == survived:
                raise Death
            done.append(target)
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(atomic.os, "replace", replaced)
        with pytest.raises(Death):
            editor.save("patrol", opened)
    assert (folder / "patrol" / JOURNAL).exists()
    again = Editor(folder).open("patrol")
    assert again["document"] == opened["document"]
    assert not [p for p in (folder / "patrol").iterdir() if p.name.startswith(".")]


def test_a_journal_leads_nowhere_else(folder, tmp_path_factory, editor):
    outside = tmp_path_factory.mktemp("outside") / "file"
    outside.write_text("precious")
    part = folder / "patrol/.x.gspn-part"
    part.write_text("bad")
    for data in (
        "{",
        "[]",
        '{"files": 3}',
        json.dumps({"files": [{"path": str(outside), "temporary": ".x.gspn-part",
                               "before": atomic._hash(b"precious"), "after": atomic._hash(b"bad")}]}),
        json.dumps({"files": [{"path": "net.xml", "temporary": "plan.json",
                               "before": atomic._hash_of(str(folder / "patrol/net.xml")),
                               "after": atomic._hash_of(str(folder / "patrol/plan.json"))}]}),
    ):  # fmt: skip
        (folder / "patrol" / JOURNAL).write_text(data)
        editor.open("patrol")
        assert outside.read_text() == "precious"
        assert read_plan(str(folder / "patrol")).net.places
        assert not (folder / "patrol" / JOURNAL).exists()


# -- drafts --------------------------------------------------------------------------------------


def test_drafts_are_kept_until_the_plan_is_saved(folder, editor):
    opened = editor.open("patrol")
    assert opened["draft"] is None
    opened["document"]["plan"]["seed"] = "not yet"
    fields = {"etag": opened["etag"], "document": opened["document"]}
    kept = editor.send("draft", "patrol", **fields).get_json()
    found = Editor(folder).open("patrol/plan.json")["draft"]
    assert found["document"] == opened["document"] and found["etag"] == opened["etag"]
    assert kept == {"kept": True, "version": found["version"]}
    assert found["saved_at"] > 0 and not found["outdated"]
    paths = [f["path"] for f in editor.get("/api/hello").get_json()["files"]]
    assert not any(path.startswith(".") for path in paths)
    other = editor.open("patrol")
    other["document"]["plan"]["seed"] = 3
    assert editor.save("patrol", other).status_code == 200
    assert editor.open("patrol")["draft"] is None
    editor.send("draft", "patrol", **fields)
    assert editor.open("patrol")["draft"]["outdated"]
    assert editor.send("draft", "patrol", document=None).get_json() == {
        "kept": False,
        "version": "",
    }
    assert editor.open("patrol")["draft"] is None


def test_drafts_are_bounded_and_stay_in_the_folder(folder, editor, tmp_path_factory, monkeypatch):
    from gspn_framework_package.visualizer.editing import drafts

    opened = editor.open("patrol")
    fields = {"etag": opened["etag"], "document": opened["document"]}
    monkeypatch.setattr(drafts, "MOST_DRAFTS", 2)
    for number in range(3):
        answer = editor.send("draft", "gone_%d.json" % number, **fields)
        assert answer.status_code == 200, answer.get_json()
    assert editor.send("draft", "patrol", **fields).status_code == 200
    assert editor.send("draft", "tokens", **fields).status_code == 200
    answer = editor.send("draft", "measure", **fields)
    assert answer.status_code == 409 and "2 drafts" in answer.get_json()["error"]
    monkeypatch.setattr(drafts, "LARGEST_DRAFT", 10)
    assert editor.send("draft", "patrol", **fields).status_code == 400
    monkeypatch.undo()
    shutil.rmtree(str(folder / drafts.DRAFTS))
    outside = tmp_path_factory.mktemp("outside")
    os.symlink(str(outside), str(folder / drafts.DRAFTS))
    assert editor.send("draft", "patrol", **fields).status_code == 409
    assert list(outside.iterdir()) == [] and editor.open("patrol")["draft"] is None


# -- several people in one plan ------------------------------------------------------------------


def test_a_state_that_is_based_on_an_earlier_one_is_refused_with_the_present_one(folder, editor):
    opened = editor.open("patrol")
    name = "patrol/plan.json"

    def state(seed):
        plan = {**opened["document"]["plan"], "seed": seed}
        return {**opened["document"], "plan": plan}

    def send(what, page, version, seed):
        fields = {"etag": opened["etag"], "version": version, "page": page}
        return editor.send(what, name, document=state(seed), **fields)

    first = send("draft", "ann", opened["etag"], 1).get_json()
    for what in ("draft", "save"):
        refused = send(what, "ben", opened["etag"], 2)
        assert refused.status_code == 412
        theirs = refused.get_json()["theirs"]
        assert theirs["document"] == state(1) and theirs["draft"]
        assert theirs["version"] == first["version"]
    second = send("draft", "ben", theirs["version"], 3).get_json()
    assert send("save", "ann", first["version"], 1).status_code == 412

    # who deletes the draft deletes nobody else's work
    fields = {"etag": opened["etag"], "document": None, "page": "ann"}
    assert editor.send("draft", name, version=first["version"], **fields).get_json()["kept"]
    editor.send("here", name, page="ben")
    assert editor.send("draft", name, **fields).get_json()["kept"]
    assert editor.send("draft", name, etag=opened["etag"], document=state(9)).status_code == 412
    assert send("save", "ben", second["version"], 3).status_code == 200
    latest = editor.get("/api/edit/latest?id=file-" + name).get_json()
    assert not latest["draft"] and latest["document"]["plan"]["seed"] == 3
    refused = send("draft", "ann", second["version"], 4)
    assert refused.get_json()["theirs"]["version"] == latest["version"]


def test_a_draft_of_an_earlier_release_is_the_latest_state_too(folder, editor):
    opened = editor.open("patrol/plan.json")
    editor.send("draft", "patrol/plan.json", **{k: opened[k] for k in ("etag", "document")})
    (file,) = (folder / ".gspn_drafts").iterdir()
    draft = json.loads(file.read_text())
    draft["document"]["plan"]["seed"] = 8
    file.write_text(json.dumps({k: draft[k] for k in ("path", "etag", "saved_at", "document")}))
    found = editor.open("patrol/plan.json")["draft"]
    latest = editor.get("/api/edit/latest?id=file-patrol/plan.json").get_json()
    assert latest["draft"] and latest["document"]["plan"]["seed"] == 8
    assert latest["version"] == found["version"] and found["history"] is None
    told = editor.send("here", "patrol/plan.json", page="ann").get_json()
    assert told["version"] == found["version"]


def test_pages_at_one_plan_hear_of_each_other(editor):
    name = "?id=file-patrol/plan.json"
    stream = editor.get("/api/edit/stream%s&page=ann" % name)
    messages = stream.iter_encoded()

    def news():
        found = next(m for m in messages if m.startswith(b"data: {"))
        return json.loads(found[len(b"data: ") :])

    assert [e["page"] for e in news()["editors"]] == ["ann"]
    editor.post("/api/edit/here" + name, {"page": "ben", "selection": ["place:Dock"], "at": [1, 2]})
    ben = {"page": "ben", "number": 2, "selection": ["place:Dock"], "at": [1, 2]}
    heard = news()
    assert heard["editors"][1:] == [ben]
    opened = editor.open("patrol/plan.json")
    assert heard["version"] == opened["etag"]
    kept = editor.post(
        "/api/edit/draft" + name,
        {"page": "ben", "version": heard["version"], **opened},
    ).get_json()
    assert news()["version"] == kept["version"]
    stream.close()
    told = editor.post("/api/edit/here" + name, {"page": "ben"}).get_json()
    assert [e["page"] for e in told["editors"]] == ["ben"]
    for fields in ({}, {"page": 3}, {"page": "x", "selection": [1]}, {"page": "x", "at": ["1"]}):
        assert editor.post("/api/edit/here" + name, fields).status_code == 400


# -- new plans, and exports ----------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("name", [*PLANS, "patrol/net.xml"])
def test_a_plan_is_saved_as_another(folder, editor, name):
    opened = editor.open(name)
    answer = editor.send("save_as", name, document=opened["document"], name="my copy")
    assert answer.status_code == 200, answer.get_json()
    assert answer.get_json() == {"path": "my copy/plan.json", "id": "file-my copy/plan.json"}
    copied = editor.open("my copy")
    assert copied["document"] == opened["document"] or name == "patrol/net.xml"
    if "/" not in name:
        assert read_plan(str(folder / "my copy")).net == read_plan(str(folder / name)).net
        assert (folder / "my copy/actions.py").exists()
    again = editor.send("save_as", name, document=opened["document"], name="my copy")
    assert again.status_code == 409 and "exists" in again.get_json()["error"]


@pytest.mark.parametrize(
    "name", ["", "..", ".hidden", "a/b", "a\0b", "a\\b", "x" * 90, None, 3, " a", "a ", "a."]
)
def test_a_new_plan_has_a_proper_name(folder, editor, name):
    before = content(folder)
    document = editor.open("patrol")["document"]
    for answer in (
        editor.send("save_as", "patrol", document=document, name=name),
        editor.post("/api/edit/new", {"template": "", "name": name}),
    ):
        assert answer.status_code == 400 and "name" in answer.get_json()["error"]
    assert content(folder) == before


def test_a_new_plan_is_empty_or_of_a_template(folder, editor):
    answer = editor.post("/api/edit/new", {"template": "", "name": "mine"})
    assert answer.status_code == 200, answer.get_json()
    opened = editor.open("mine")
    assert opened["document"]["plan"] == {"plan": "mine", "actions": {}}
    assert editor.save("mine", opened).get_json()["written"] == []
    opened["document"]["net"]["places"].append({"name": "Home", "tokens": 1, "position": [0, 0]})
    opened["document"]["plan"]["actions"]["Home"] = None
    assert editor.save("mine", opened).status_code == 200
    assert read_plan(str(folder / "mine")).net.places[0].name == "Home"
    templates = editor.get("/api/hello").get_json()["templates"]
    for name in templates:
        answer = editor.post("/api/edit/new", {"template": name, "name": "of " + name})
        assert answer.status_code == 200, answer.get_json()
        assert editor.open("of " + name)["document"]["plan"]["actions"]
    answer = editor.post("/api/edit/new", {"template": "../patrol", "name": "x"})
    assert answer.status_code == 400 and "template" in answer.get_json()["error"]


def test_exports_are_of_what_is_on_the_page(folder, editor):
    opened = editor.open("warehouse")
    opened["document"]["plan"]["seed"] = 12
    answer = editor.send("export", "warehouse", document=opened["document"], format="zip")
    assert answer.status_code == 200 and "warehouse.zip" in answer.headers["Content-Disposition"]
    archive = zipfile.ZipFile(io.BytesIO(answer.get_data()))
    archive.extractall(str(folder / "unpacked"))
    plan = read_plan(str(folder / "unpacked/warehouse"))
    assert plan.seed == 12 and plan.net == read_plan(str(folder / "warehouse")).net
    assert "warehouse/actions.py" in archive.namelist()
    for format in FORMATS:
        answer = editor.send("export", "patrol", document=editor.open("patrol")["document"],
                             format=format)  # fmt: skip
        if format == "prism":
            assert answer.status_code == 400 and "immediate" in answer.get_json()["error"]
            continue
        assert answer.status_code == 200, answer.get_json()
        if FORMATS[format].reader is not None:
            name = folder / ("net" + FORMATS[format].extensions[0])
            name.write_bytes(answer.get_data())
            assert len(read_net(str(name)).places) == len(
                read_plan(str(folder / "patrol")).net.places
            )
    answer = editor.send("export", "patrol", document=opened["document"], format="exe")
    assert answer.status_code == 400 and "no such format" in answer.get_json()["error"]


# -- the open page -------------------------------------------------------------------------------


def test_a_saved_plan_is_opened_anew_unless_it_runs(folder):
    editor = Editor(folder)
    key = editor.post("/api/open", {"path": "patrol"}).get_json()["id"]
    session = editor.project.sessions.get(key)
    opened = editor.open("patrol")
    opened["document"]["net"]["places"].append({"name": "extra", "position": [0, 0]})
    opened["document"]["plan"]["resource_places"] = ["extra"]
    assert editor.save("patrol", opened).status_code == 200
    assert session.hub.closed is not None and "saved" in session.hub.closed
    places = editor.get("/api/session?id=" + key).get_json()["scene"]["places"]
    assert "extra" in [p["name"] for p in places]
    session = editor.project.sessions.get(key)
    session._starting = True  # as while it runs
    opened = editor.open("patrol")
    opened["document"]["plan"]["seed"] = 9
    assert editor.save("patrol", opened).status_code == 200
    assert session.hub.closed is None and editor.project.sessions.get(key) is session
    session._starting = False
    answer = editor.do("start", key, confirmed=True)
    assert answer.status_code == 409
    editor.post("/api/open", {"path": "patrol"})
    wait_for(lambda: session.hub.closed is not None)
    assert editor.project.sessions.get(key).document.plan.seed == 9


def test_a_plan_drawn_on_the_page_is_a_file_that_can_be_compared(folder, editor):
    new = editor.post("/api/edit/new", {"template": "", "name": "drawn"}).get_json()
    path = new["path"]
    opened = editor.open(path)
    document = opened["document"]
    names = ["Place %d" % n for n in range(12)]
    turns = ["Turn %d" % n for n in range(12)]
    document["net"].update(
        places=[{"name": p, "position": [90 * n, 0]} for n, p in enumerate(names)],
        transitions=[{"name": t, "position": [90 * n, 90]} for n, t in enumerate(turns)],
        arcs=[{"from": p, "to": t} for p, t in zip(names, turns)]
        + [{"from": t, "to": p} for p, t in zip([*names[1:], names[0]], turns)],
    )
    document["plan"].update(actions=dict.fromkeys(names))
    answer = editor.save(path, opened)
    assert answer.status_code == 200, answer.get_json()
    before = (folder / path).read_text().splitlines()
    assert max(map(len, before)) <= 120
    opened = editor.open(path)
    renamed = json.loads(json.dumps(opened).replace('"Place 7"', '"Depot"'))
    assert editor.save(path, renamed).status_code == 200
    after = (folder / path).read_text().splitlines()
    changed = [line.strip() for line in after if line not in before]
    assert changed == [
        '{"name": "Depot", "position": [630, 0]},',
        '{"from": "Depot", "to": "Turn 7"},',
        '{"from": "Turn 6", "to": "Depot"},',
        '"Depot": null,',
    ]
    assert len(before) == len(after)
