"""The input files of the thesis on the command line and on the page, as they were written."""

import base64
import json
import shutil

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.registry import write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.visualizer.documents import Folder, read_upload

WORK = """
def work_here(id):
    assert id in (1, 2), id
    return 'go'


def work_there(id):
    print('agent', id)
"""


@pytest.fixture(name="folder")
def _folder(tmp_path):
    net = (
        NetBuilder("net")
        .place("a", 2)
        .place("b")
        .exponential("go", inputs="a", outputs="b")
        .build()
    )
    write_net(net, tmp_path / "two_places.xml", "pipe")
    (tmp_path / "work.py").write_text(WORK)
    data = {
        "project_path": "/home/somebody/project/",
        "gspn": "two_places.xml",
        "place_to_function_mapping": "{'a': 'work.work_here', 'b': 'work.work_there'}",
        "places_tuple": "('a', 'b')",
        "policy_dictionary": "{(0,1): {'t4':1}, (1,0): {'go':1}}",
    }
    (tmp_path / "input.json").write_text(json.dumps(data))
    offline = {
        "project_path": "/home/somebody/project/",
        "gspn": "two_places.xml",
        "place_to_function_mapping": "?",
    }
    (tmp_path / "offline.json").write_text(json.dumps(offline))
    return tmp_path


def test_it_is_checked_and_run(folder, capfd):
    assert main(["check", "--standalone", str(folder / "input.json")]) == 0
    assert "policy row 1: left out 't4', which the net does not have" in capfd.readouterr().out
    assert main(["run", "--json", str(folder / "input.json")]) == 0
    told = [
        json.loads(line) for line in capfd.readouterr().out.splitlines() if line.startswith("{")
    ]
    assert [event["event"] for event in told] == ["firing", "firing", "end"]
    assert told[-1]["marking"] == {"a": 0, "b": 2}


def test_the_page_opens_it_as_a_plan(folder):
    served = Folder(str(folder))
    assert ("input.json", "plan") in [(entry.path, entry.kind) for entry in served.entries()]
    document = served.open("input.json")
    assert document.executable
    assert any("left out 't4'" in note for note in document.notes)


@pytest.mark.parametrize("how", ["served", "uploaded"])
def test_the_page_opens_what_has_no_real_mapping_or_policy(folder, how):
    if how == "served":
        served = Folder(str(folder))
        assert ("offline.json", "plan") in [(entry.path, entry.kind) for entry in served.entries()]
        document = served.open("offline.json")
    else:
        sent = [folder / "offline.json", folder / "two_places.xml"]
        document = read_upload(
            [{"name": p.name, "content": base64.b64encode(p.read_bytes()).decode()} for p in sent]
        )
    assert document.plan is None and not document.executable
    assert [place.name for place in document.net.places] == ["a", "b"]
    assert any(note.startswith("taken for a net, not for a plan: ") for note in document.notes)


def test_a_net_that_is_not_there_is_an_error_in_any_case(folder, capfd):
    shutil.move(str(folder / "two_places.xml"), str(folder / "elsewhere.xml"))
    for name in ("input.json", "offline.json"):
        assert main(["serve", "--port", "0", str(folder / name)]) == 2
        assert "two_places.xml does not exist" in capfd.readouterr().err
