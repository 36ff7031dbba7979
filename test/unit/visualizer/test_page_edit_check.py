"""What helps in the editor: the check of a document, the palette, the difference, the layout, and
what would happen at a marking."""

from __future__ import annotations

import copy
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, Dict, Iterator, List

import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from page_client import PageClient

from gspn_framework_package.formats.edited_document import document_of
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.ros.check_all import check_all
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.editing import check_workers
from gspn_framework_package.visualizer.editing.check_workers import CheckWorkers
from gspn_framework_package.visualizer.editing.choices import choices
from gspn_framework_package.visualizer.editing.findings import findings
from gspn_framework_package.visualizer.editing.palette import message_fields, palette
from gspn_framework_package.visualizer.project import Project

PLANS = Path(__file__).resolve().parents[3] / "plans"
SHIPPED = sorted(p.parent.name for p in PLANS.glob("*/plan.json"))


def never() -> bool:
    return False


def shipped(name: str) -> Dict[str, Any]:
    return document_of(str(PLANS / name))


def checked(document: Dict[str, Any], name: str = "patrol", **options: Any) -> Dict[str, Any]:
    path = str(PLANS / name / "plan.json")
    options = {"limit": 6000, "seconds": 60.0, **options}
    found = findings(document, path, str(PLANS), never, **options)
    json.dumps(found)
    return found


def errors(found: Dict[str, Any]) -> List[Dict[str, Any]]:
    return [finding for finding in found["findings"] if finding["level"] == "error"]


def elements(found: Dict[str, Any]) -> List[str]:
    """The elements of all errors, as kind:name."""
    return ["%s:%s" % (e["kind"], e["name"]) for error in errors(found) for e in error["elements"]]


# -- findings --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n in SHIPPED if n not in ("inspection", "depot")])
def test_it_finds_what_gspn_check_finds(name: str) -> None:
    report = check_all(read_plan(str(PLANS / name)))
    found = checked(shipped(name), name, limit=200_000)
    assert found["valid"] is not report.refused
    assert found["decided"] is report.complete
    texts = [finding["text"] for finding in found["findings"]]
    assert {item.text for item in report.items} <= set(texts)
    assert checked(shipped(name), name, limit=200_000, standalone=True)["valid"]


def test_what_the_limit_leaves_open_is_not_called_decided() -> None:
    found = checked(shipped("patrol"), limit=100)
    assert found["decided"] is False
    assert any("not decided" in f["text"] for f in found["findings"] if f["level"] == "warning")
    assert checked(shipped("patrol"))["decided"] is True


def test_what_takes_too_long_is_not_called_decided() -> None:
    found = checked(shipped("patrol"), seconds=0.0)
    assert found["decided"] is False and found["valid"] is True


def a_document() -> Dict[str, Any]:
    """A plan that passes: a robot goes round."""
    return {
        "plan": {
            "plan": "round",
            "actions": {"A": "actions.wait", "B": None},
            "robots": {"r": "A"},
        },
        "net": {
            "places": [{"name": "A", "tokens": 1}, {"name": "B"}],
            "transitions": [
                {"name": "go", "timed": True, "rate": 1},
                {"name": "back", "timed": True, "rate": 1},
            ],
            "arcs": [
                {"from": "A", "to": "go"},
                {"from": "go", "to": "B"},
                {"from": "B", "to": "back"},
                {"from": "back", "to": "A"},
            ],
        },
        "policy": None,
    }


def test_a_dead_marking_has_a_witness_with_the_markings_on_its_way() -> None:
    document = a_document()
    document["net"]["places"].append({"name": "Fuel", "tokens": 1})
    document["plan"]["resource_places"] = ["Fuel"]
    document["net"]["arcs"].append({"from": "Fuel", "to": "go"})
    found = checked(document)
    (dead,) = [f for f in found["findings"] if f["witness"]]
    assert dead["level"] == "warning" and dead["check"] == "dead_markings"
    assert dead["witness"] == ["go", "back"]
    assert dead["markings"] == [{"A": 1, "Fuel": 1}, {"B": 1}, {"A": 1}]
    assert {"kind": "place", "name": "A"} in dead["elements"]


def test_a_robot_lost_in_a_witness_goes_from_its_place() -> None:
    document = a_document()
    net, plan = document["net"], document["plan"]
    net["places"][0]["tokens"] = 2
    net["places"].append({"name": "Key", "tokens": 1})
    plan.update(resource_places=["Key"], robots={"r": "A", "s": "A"})
    net["arcs"] += [{"from": "Key", "to": "go"}, {"from": "back", "to": "Key"}]
    found = checked(document)
    (lost,) = [f for f in found["findings"] if f["check"] == "dead_after_loss"]
    assert lost["witness"] == ["go", "(robot lost in B)"]
    assert lost["markings"] == [{"A": 2, "Key": 1}, {"A": 1, "B": 1}, {"A": 1}]


def test_what_is_found_inside_a_subnet_is_reported_at_its_place() -> None:
    document = shipped("warehouse")
    document["plan"]["timeout"]["Deliver.Approach"] = -1
    found = checked(document, "warehouse")
    assert not found["valid"]
    assert elements(found) == ["place:Deliver"]


@pytest.mark.parametrize(
    ("edit", "where"),
    [
        (lambda d: d["net"]["arcs"].append({"from": "A", "to": "B"}), ["arc:A>B"]),
        (lambda d: d["net"]["arcs"].append({"from": "A", "to": "nowhere"}), ["arc:A>nowhere"]),
        (lambda d: d["net"]["places"].append({"name": "A"}), ["place:A"]),
        (lambda d: d["net"]["places"][1].update(tokens=-1), ["place:B"]),
        (lambda d: d["net"]["places"][1].update(tokens="x"), ["place:B"]),
        (lambda d: d["net"]["transitions"][1].update(rate=0), ["transition:back"]),
        (lambda d: d["net"]["transitions"][1].pop("timed"), ["transition:back"]),
        (lambda d: d["plan"]["actions"].pop("B"), ["place:B"]),
        (lambda d: d["plan"].pop("actions"), ["place:A", "place:B"]),
        (lambda d: d["plan"]["actions"].update(B={"nothing": 1}), ["place:B"]),
        (lambda d: d["plan"].update(robots={}), ["place:A"]),
        (lambda d: d["plan"].update(robots=[{"name": "r", "place": "C"}]), ["robot:r"]),
        (lambda d: d["plan"].update(timeout={"B": -2}), ["place:B"]),
        (lambda d: d["plan"].update(on_failure={"B": "go"}), ["place:B"]),
        (lambda d: d["plan"].update(events={"go": {"topic": 3}}), ["transition:go"]),
        (
            lambda d: d.update(
                policy={"places": ["A"], "rows": [{"marking": [1], "choose": {"go": 1}}]}
            ),
            ["row:1", "transition:go"],
        ),
        (
            lambda d: d.update(
                policy={"places": ["A"], "rows": [{"marking": [1, 2], "choose": {}}]}
            ),
            ["row:1"],
        ),
        (lambda d: d["plan"]["actions"].update(B="actions.no_such_function"), ["place:B"]),
    ],
)
def test_an_error_is_reported_at_its_element(edit: Any, where: List[str]) -> None:
    document = a_document()
    assert checked(document)["valid"]
    edit(document)
    found = checked(document)
    assert not found["valid"]
    assert elements(found) == where


def test_all_faults_of_a_half_drawn_net_are_told_at_once() -> None:
    document = a_document()
    document["net"]["arcs"] += [{"from": "A", "to": "B"}, {"from": "go", "to": "x"}]
    document["net"]["transitions"][1]["rate"] = -1
    document["plan"]["timeout"] = {"B": -2}
    assert elements(checked(document)) == [
        "transition:back",
        "arc:A>B",
        "arc:go>x",
        "place:B",
    ] or sorted(elements(checked(document))) == sorted(
        ["transition:back", "arc:A>B", "arc:go>x", "place:B"]
    )


def test_an_empty_document_and_a_lone_node_are_no_fault_of_the_program() -> None:
    empty: Dict[str, Any] = {
        "plan": {},
        "net": {"places": [], "transitions": [], "arcs": []},
        "policy": None,
    }
    assert checked(empty)["findings"]
    empty["net"]["places"].append({"name": "A"})
    assert elements(checked(empty)) == []
    document = a_document()
    document["net"]["transitions"].append({"name": "alone"})
    (loose,) = [f for f in checked(document)["findings"] if f["text"].startswith("no arc")]
    assert loose["elements"] == [{"kind": "transition", "name": "alone"}]
    assert loose["level"] == "warning"


def test_what_is_being_drawn_is_judged_once_there_is_something_to_judge() -> None:
    document: Dict[str, Any] = {
        "plan": {"plan": "new", "actions": {}},
        "net": {
            "places": [{"name": "P%d" % n} for n in range(14)],
            "transitions": [{"name": "T%d" % n, "timed": True} for n in range(14)],
            "arcs": [],
        },
        "policy": None,
    }
    before = checked(document)
    assert {f["level"] for f in before["findings"]} == {"note"} and not before["valid"]
    document["net"]["arcs"] += [{"from": "P3", "to": "T3"}, {"from": "T3", "to": "P4"}]
    drawn = checked(document)
    assert not errors(drawn) and drawn["doubts"] == ["has no robots yet"] and not drawn["valid"]
    document["net"]["places"][3]["tokens"] = 1
    judged = [f for f in checked(document)["findings"] if f["level"] == "error"]
    assert [sorted(e["name"] for e in f["elements"]) for f in judged] == [["P3", "P4"]]
    assert not [f for f in checked(document)["findings"] if f["level"] == "warning"]


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-1, 3) | st.sampled_from(["A", "go", "", "x.y", "*"]),
    lambda inner: (
        st.lists(inner, max_size=2)
        | st.dictionaries(
            st.sampled_from(["name", "A", "place", "plan", "file"]), inner, max_size=2
        )
    ),
    max_leaves=4,
)
PATHS = [
    ("net", "places"),
    ("net", "places", 0),
    ("net", "places", 1, "name"),
    ("net", "transitions", 0, "rate"),
    ("net", "arcs", 1, "to"),
    ("net", "arcs", 1),
    ("net", "arcs"),
    ("plan",),
    ("plan", "actions"),
    ("plan", "actions", "B"),
    ("plan", "robots"),
    ("plan", "timeout"),
    ("plan", "events"),
    ("policy",),
]


@pytest.mark.long
@given(st.lists(st.tuples(st.sampled_from(PATHS), ANYTHING), min_size=1, max_size=3))
@settings(max_examples=60, deadline=None)
def test_no_document_gives_a_traceback(edits: Any) -> None:
    document: Any = a_document()
    for path, value in edits:
        inside = document
        try:
            for step in path[:-1]:
                inside = inside[step]
            inside[path[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue
    before = copy.deepcopy(document)
    found = checked(document)
    assert document == before
    assert found["valid"] is not bool(errors(found))


def test_a_subnet_outside_the_served_folder_is_not_read(tmp_path: Path) -> None:
    document = a_document()
    outside = {"plan": "../../secret.json", "entry": "A", "exit": "A"}
    document["plan"]["actions"]["B"] = outside
    found = checked(document)
    assert elements(found) == ["place:B"] and "outside the folder" in errors(found)[0]["text"]
    document = a_document()
    document["net"] = {"file": "/etc/passwd"}
    assert "not in a file" in errors(checked(document))[0]["text"]


# -- what would happen -----------------------------------------------------------------------------


def at_marking(document: Dict[str, Any], marking: Any, name: str = "patrol") -> Dict[str, Any]:
    return choices(document, str(PLANS / name / "plan.json"), str(PLANS), marking)


def test_choices_name_the_row_that_applies_and_its_probabilities() -> None:
    document = shipped("tokens")
    assert [row["marking"] for row in document["policy"]["rows"]] == [[0], ["-"]]
    (place,) = [a["from"] for a in document["net"]["arcs"] if a["to"] == "t5"]
    found = at_marking(document, {place: 1}, "tokens")
    (here,) = found["places"]
    assert here["place"] == place and here["tokens"] == 1
    chosen = {t["name"]: t["probability"] for t in here["transitions"] if t["enabled"]}
    rows = {
        1: {"t5": 0.5, "t6": 0.5},
        2: {"t5": 0.8, "t6": 0.2},
    }
    assert chosen == pytest.approx(rows[here["row"]])
    assert "row %d of the policy applies" % here["row"] in here["why"]
    assert set(found["enabled"]) == set(chosen)


def test_choices_without_a_policy_are_those_of_the_weights() -> None:
    document = a_document()
    for transition, weight in zip(document["net"]["transitions"], (3, 1)):
        transition.pop("timed")
        transition.pop("rate")
        transition["weight"] = weight
    document["net"]["arcs"][2] = {"from": "A", "to": "back"}
    (here,) = at_marking(document, {"A": 2})["places"]
    assert {t["name"]: t["probability"] for t in here["transitions"]} == {"go": 0.75, "back": 0.25}
    assert here["row"] is None and "weights decide" in here["why"]
    with pytest.raises(GspnError, match="no place 'X'"):
        at_marking(document, {"X": 1})
    with pytest.raises(GspnError, match="not a number of tokens"):
        at_marking(document, {"A": -1})


def fork(places: str, rows: List[Dict[str, Any]]) -> Dict[str, Any]:
    """A plan: from each place an immediate transition with its name in small letters, back to it."""
    arcs = [{"from": p, "to": p.lower()} for p in places]
    arcs += [{"from": p.lower(), "to": p} for p in places]
    net = {
        "places": [{"name": p, "tokens": 1} for p in places],
        "transitions": [{"name": p.lower()} for p in places],
        "arcs": arcs,
    }
    policy = {"places": list(places), "rows": rows}
    return {"plan": places, "net": net, "actions": dict.fromkeys(places), "policy": policy}


def test_only_rows_that_apply_to_a_place_are_said_to_match_too(tmp_path: Path) -> None:
    inside = fork("XY", [{"marking": [1, 0], "choose": {"x": 1}}])
    (tmp_path / "inside.json").write_text(json.dumps(inside))
    rows = [
        {"marking": [1, 1], "choose": {"a": 1}},
        {"marking": [1, "-"], "choose": {"b": 1}},
        {"marking": ["-", "-"], "choose": {}},
    ]
    outside = fork("ABC", rows)
    outside["actions"]["C"] = {"plan": "inside.json", "entry": "X", "exit": "Y"}
    outside["policy"]["places"] = ["A", "B"]
    outside["net"]["transitions"][2].update(timed=True, rate=1)
    (tmp_path / "plan.json").write_text(json.dumps(outside))
    document = document_of(str(tmp_path / "plan.json"))
    marking = {"A": 1, "B": 1, "C": 1}
    found = choices(document, str(tmp_path / "plan.json"), str(tmp_path), marking)
    why = {place["place"]: place["why"] for place in found["places"]}
    assert why == {
        "A": "row 1 of the policy applies; it takes precedence over row 3, which also matches",
        "B": "row 2 of the policy applies; it takes precedence over row 3, which also matches",
        "C.X": "row 4 of the policy applies",
    }


# -- the palette -----------------------------------------------------------------------------------


def test_the_palette_reads_functions_without_running_anything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_MASTER_URI", raising=False)
    folder = tmp_path / "served"
    shutil.copytree(PLANS / "warehouse", folder / "warehouse")
    (folder / "warehouse" / "evil.py").write_text(
        "import pathlib\npathlib.Path(%r).touch()\n\n\n"
        "def shout(robot, is_cancelled, loud=3, *, why):\n    '''Shouts.'''\n"
        % str(tmp_path / "ran")
    )
    (folder / "warehouse" / "broken.py").write_text("def (")
    (tmp_path / "outside.py").write_text("def secret(): pass")
    os.symlink(str(tmp_path / "outside.py"), str(folder / "warehouse" / "linked.py"))
    found = palette(Folder(str(folder)), "warehouse/plan.json")
    json.dumps(found)
    by_name = {f["name"]: f for f in found["functions"]}
    assert not (tmp_path / "ran").exists()
    assert by_name["evil.shout"]["doc"] == "Shouts."
    assert by_name["evil.shout"]["cancellable"] is True
    assert by_name["evil.shout"]["parameters"] == [
        {"name": "loud", "required": False, "default": 3},
        {"name": "why", "required": True},
    ]
    assert "actions.Fetch" in by_name and by_name["actions.Fetch"]["cancellable"]
    assert not any(name.startswith(("linked", "broken")) for name in by_name)
    (dock,) = [p for p in found["plans"] if p["file"] == "dock.json"]
    assert "Approach" in dock["places"] and "station" in dock["parameters"]
    assert "function" in found["kinds"] and found["ros"] is None


def test_why_the_fields_of_an_action_are_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "'x' is not the name of a type" == message_fields("server", "x")["why"]
    assert "is not the name of a type" in message_fields("publish", "../x/Name")["why"]
    monkeypatch.setitem(sys.modules, "gspn_framework_package.ros.message_fields", None)
    found = message_fields("publish", "std_msgs/String")
    assert found == {"sent": None, "received": None, "why": "this server runs without ROS"}
    with pytest.raises(GspnError, match="'function' have no message"):
        message_fields("function", "std_msgs/String")


# -- the processes ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def workers() -> Iterator[CheckWorkers]:
    pool = CheckWorkers()
    yield pool
    pool.close()


def asked(document: Dict[str, Any], name: str = "patrol", **fields: Any) -> Dict[str, Any]:
    return {
        "document": document,
        "path": str(PLANS / name / "plan.json"),
        "root": str(PLANS),
        "limit": 200_000,
        "standalone": False,
        **fields,
    }


def test_a_newer_request_cancels_the_older_one(workers: CheckWorkers) -> None:
    slow: Dict[str, Any] = {}

    def ask() -> None:
        slow.update(workers.ask("a", "check", 300.0, **asked(shipped("inspection"), "inspection")))

    thread = threading.Thread(target=ask)
    thread.start()
    end = time.monotonic() + 120
    while not any(w.request for w in workers._workers) and time.monotonic() < end:
        time.sleep(0.01)
    other = workers.ask("b", "check", 60.0, **asked(a_document()))
    assert other["answer"]["valid"]
    assert thread.is_alive(), "a request about another document cancels nothing"
    newer = workers.ask("a", "check", 60.0, **asked(a_document()))
    thread.join(120)
    assert slow == {"cancelled": True}
    assert newer["answer"]["valid"]


def test_a_process_that_dies_is_replaced(workers: CheckWorkers) -> None:
    assert workers.ask("c", "check", 60.0, **asked(a_document()))["answer"]["valid"]
    for worker in list(workers._workers):
        worker.process.kill()
        worker.process.wait()
    end = time.monotonic() + 120
    while time.monotonic() < end:  # the death is noticed a moment later
        found = workers.ask("c", "check", 60.0, **asked(a_document()))
        if "answer" in found:
            break
    assert found["answer"]["valid"]


def test_a_fault_in_a_process_is_an_answer(workers: CheckWorkers) -> None:
    found = workers.ask("d", "choices", 60.0, **asked(a_document(), marking=7))
    assert "a marking must be an object" in found["error"]


def test_no_process_outlives_a_server_that_is_killed() -> None:
    code = (
        "from gspn_framework_package.visualizer.editing.check_workers import CheckWorkers\n"
        "import time\n"
        "workers = CheckWorkers()\nworkers.warm()\n"
        "print(*[w.process.pid for w in workers._workers], flush=True)\ntime.sleep(600)\n"
    )
    root = str(PLANS.parent)
    server = subprocess.Popen([sys.executable, "-c", code], cwd=root, stdout=subprocess.PIPE)
    assert server.stdout is not None
    pids = [int(word) for word in server.stdout.readline().split()]
    assert len(pids) == check_workers.WORKERS
    server.kill()
    server.wait()
    server.stdout.close()
    end = time.monotonic() + 120
    while any(alive(pid) for pid in pids) and time.monotonic() < end:
        time.sleep(0.1)
    assert not any(alive(pid) for pid in pids)


def alive(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


# -- over HTTP -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageClient]:
    folder = tmp_path_factory.mktemp("served")
    for name in ("patrol", "warehouse"):
        shutil.copytree(PLANS / name, folder / name)
    found = PageClient(Project(Folder(str(folder)), edits=True))
    yield found
    found.app.extensions["gspn_checks"].close()


def test_the_routes_answer(client: PageClient) -> None:
    key = "file-patrol/plan.json"
    document = client.get("/api/edit?id=" + key).get_json()["document"]

    def post(what: str, body: Any, status: int = 200) -> Any:
        answer = client.post("/api/edit/%s?id=%s" % (what, key), body)
        assert answer.status_code == status, answer.get_data()
        return answer.get_json()

    found = post("check", {"document": document, "revision": 3, "full": True})
    assert (found["revision"], found["valid"], found["decided"]) == (3, True, True)
    assert post("diff", {"from": "saved", "to": document}) == {"changes": []}
    changed = copy.deepcopy(document)
    changed["plan"]["seed"] = 9
    expected = {"what": "added", "kind": "setting", "name": "seed", "key": ""}
    (change,) = post("diff", {"from": "saved", "to": changed})["changes"]
    assert {**expected, "from": None, "to": 9} == change
    assert post("diff", {"from": document, "to": changed})["changes"] == [change]
    (running,) = post("diff", {"from": "running", "to": changed})["changes"]
    assert (running["name"], running["to"]) == ("seed", 9)
    half = copy.deepcopy(document)
    half["net"]["arcs"].append({"from": "nowhere"})
    layout = post("layout", {"document": half})
    names = {p["name"] for p in document["net"]["places"]}
    assert set(layout["places"]) == names
    assert len({tuple(p) for p in layout["places"].values()}) == len(names)
    marking = {p["name"]: p.get("tokens", 0) for p in document["net"]["places"]}
    assert post("choices", {"document": document, "marking": marking})["places"]
    assert client.get("/api/edit/palette?id=" + key).get_json()["functions"]
    fields = client.get("/api/edit/fields?kind=publish&type=std_msgs/String").get_json()
    assert fields["sent"] or fields["why"]


@pytest.mark.parametrize("what", ["check", "diff", "layout", "choices"])
def test_the_routes_refuse_what_is_no_document(client: PageClient, what: str) -> None:
    path = "/api/edit/%s?id=" % what
    for body in ({}, {"document": 3, "to": 3}, {"document": {"net": 1}, "to": []}):
        answer = client.post(path + "file-patrol/plan.json", body)
        assert answer.status_code == 400 and "document" in answer.get_json()["error"]
    good = {"plan": {}, "net": {"places": [], "transitions": [], "arcs": []}, "policy": None}
    body = {"document": good, "to": good, "from": "saved", "marking": {}}
    if what != "layout":  # it needs no file
        for key in ("file-../x", "file-none/plan.json", "other", ""):
            assert client.post(path + key, body).status_code in (400, 409)
    assert client.post(path + "file-patrol/plan.json", body, X_Gspn_Page=None).status_code == 403


def test_a_message_does_not_tell_the_folders_of_the_machine(client: PageClient) -> None:
    document = client.get("/api/edit?id=file-warehouse/plan.json").get_json()["document"]
    document["plan"]["actions"]["Deliver"]["plan"] = "none.json"
    document["plan"]["actions"]["Park"] = "actions.NoSuch"
    found = client.post(
        "/api/edit/check?id=file-warehouse/plan.json", {"document": document}
    ).get_json()
    assert elements(found)[0] == "place:Deliver"
    assert str(client.project.folder.root) not in json.dumps(found)
