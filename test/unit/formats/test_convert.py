"""``gspn convert``."""

import json
from pathlib import Path

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import FORMATS, read_net, write_net
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.capacity import capacities_as_inhibitors

DATA = Path(__file__).parent / "data"
PLANS = Path(__file__).resolve().parents[3] / "plans"


def convert(*words):
    return main(["convert", *map(str, words)])


@pytest.mark.long
@pytest.mark.parametrize("name", ["pipe", "pnml", "pnpro"])
def test_every_plan_through_every_format(name, tmp_path, capsys):
    notes = []
    for plan in sorted(PLANS.iterdir()):
        net = read_net(plan / "net.xml")
        if name == "pnpro" and any(p.capacity is not None for p in net.places):
            net = capacities_as_inhibitors(net)  # GreatSPN has no capacities
            notes.append("gspn: note: capacities are written as equivalent inhibitor arcs")
        first, second = tmp_path / "first.file", tmp_path / "second.xml"
        assert convert(plan / "net.xml", first, "--to", name) == 0
        assert convert(first, second) == 0
        assert read_net(second).arcs == net.arcs
        assert [p._replace(position=None) for p in read_net(second).places] == [
            p._replace(position=None) for p in net.places
        ]
        assert [t._replace(position=None) for t in read_net(second).transitions] == [
            t._replace(position=None) for t in net.transitions
        ]
    out, told = capsys.readouterr()
    assert (out, told.splitlines()) == ("", notes)


def test_a_plan_stands_for_its_net(tmp_path):
    assert convert(PLANS / "measure", tmp_path / "n.xml") == 0
    assert read_net(tmp_path / "n.xml") == read_net(PLANS / "measure" / "net.xml")


def test_the_options_of_reading(tmp_path, capsys):
    out = tmp_path / "n.pnml"
    words = ["--net", "machine", "--const", "N=9", "--const", "lambda = 4", "--servers", "single"]
    assert convert(DATA / "greatspn.PNPRO", out, *words, "--controllable", "--json") == 0
    net = read_net(out)
    assert net.place("waiting").tokens == 9
    assert net.transition("begin")[2:6] == (4.0, 1.0, 1, 1)
    assert net.transition("plain").weight == 0
    assert json.loads(capsys.readouterr().out) == {
        "output": str(out),
        "format": "pnml",
        "net": "machine",
        "places": 3,
        "transitions": 5,
        "arcs": 10,
        "notes": [],
    }


def test_notes_go_to_standard_error(tmp_path, capsys):
    assert convert(DATA / "greatspn.PNPRO", tmp_path / "n.net", "--net", "machine") == 0
    shown = capsys.readouterr()
    assert shown.out == ""
    assert [line[:12] for line in shown.err.splitlines()] == ["gspn: note: "] * 2


def test_standard_output(capfdbinary):
    assert convert(DATA / "pipe_2.xml", "-", "--to", "tina") == 0
    assert capfdbinary.readouterr().out.startswith(b"net {Net-One}\npl {Caf\xc3\xa9} (2)\n")


@pytest.mark.parametrize(
    "words, message",
    [
        (["-"], "--to is required"),
        (["-", "--to", "pnml", "--json"], "cannot both go to standard output"),
        (["n.xyz"], "does not show the format"),
        (["n.xml", "--to", "word"], "there is no format 'word'"),
        (["n.xml", "--from", "jani"], "JANI is written, not read"),
        (["n.xml", "--const", "N"], "expected NAME=NUMBER"),
        (["n.xml", "--const", "N=x"], "expected NAME=NUMBER"),
        (["n.xml", "--const", "=1"], "expected NAME=NUMBER"),
        (["n.xml", "--label", "a=b"], "--label applies only to chains"),
        (["-", "--to", "drn"], "a chain is not written to standard output"),
        (["n.drn", "--label", "a"], "expected NAME=CONDITION"),
        (["n.drn", "--label", "a=Nowhere > 1"], "Nowhere"),
        (["n.drn", "--label", "init=Busy > 1"], "a label cannot be called 'init'"),
        (["n.drn", "--limit", "1"], "not decided within"),
    ],
)
def test_wrong_usage_has_one_clear_message(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = convert(DATA / "pipe_2.xml", *words)
    assert code == (1 if "not decided" in message else 2)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert len(shown.err.splitlines()) == 1
    assert message in shown.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [["--const", "N=1"], ["--net", "x"], ["--servers", "infinite"], ["--controllable"]],
    ids=" ".join,
)
def test_plans_say_themselves_how_their_net_is_read(words, tmp_path, capsys):
    assert convert(PLANS / "measure", tmp_path / "n.xml", *words) == 2
    assert "this is a plan, which has its own settings for that" in capsys.readouterr().err


def test_every_format_has_its_own_endings():
    endings = [ending for entry in FORMATS.values() for ending in entry.extensions]
    assert len(endings) == len(set(endings))


def test_a_place_becomes_a_net(tmp_path, capsys):
    outer = (
        NetBuilder("outer")
        .place("Idle", 1)
        .place("Inspect")
        .immediate("start", inputs="Idle", outputs="Inspect")
        .exponential("done", inputs="Inspect", outputs="Idle")
        .build()
    )
    inner = (
        NetBuilder("inner")
        .place("Approach")
        .place("Look")
        .exponential("arrive", inputs="Approach", outputs="Look")
        .build()
    )
    write_net(outer, tmp_path / "outer.xml")
    write_net(inner, tmp_path / "inner.pnml")
    whole = tmp_path / "whole.xml"
    expand = ["--expand", "Inspect", tmp_path / "inner.pnml", "Approach"]
    assert convert(tmp_path / "outer.xml", whole, *expand, "Look") == 0
    assert [p.name for p in read_net(whole).places] == ["Idle", "Inspect.Approach", "Inspect.Look"]
    assert convert(tmp_path / "outer.xml", whole, *expand, "Nowhere") == 2
    assert "Nowhere" in capsys.readouterr().err
    assert convert(tmp_path / "outer.xml", tmp_path / "chain.tra", *expand, "Look") == 2


def test_a_constant_that_the_file_does_not_have_is_an_error(tmp_path, capsys):
    whole = tmp_path / "net.pnml"
    assert convert(DATA / "greatspn.PNPRO", whole, "--net", "machine", "--const", "NN=3") == 2
    assert "the constant 'NN' does not occur in the file" in capsys.readouterr().err
    assert convert(DATA / "greatspn.PNPRO", whole, "--net", "machine", "--const", "N=3") == 0
    assert read_net(whole).place("waiting").tokens == 3


def test_an_input_file_of_the_thesis_becomes_a_plan(tmp_path, capsys):
    folder, new = tmp_path / "old", tmp_path / "new"
    folder.mkdir()
    new.mkdir()
    net = (
        NetBuilder("net")
        .place("a", 2)
        .place("b")
        .exponential("go", inputs="a", outputs="b")
        .build()
    )
    write_net(net, folder / "net.xml", "pipe")
    (folder / "work.py").write_text("def here(id):\n    return 'go'\n")
    data = {
        "project_path": ".",
        "gspn": "net.xml",
        "places_tuple": "('a',)",
        "policy_dictionary": "{(1,): {'go': 1}}",
        "place_to_function_mapping": "{'a': 'work.here', 'b': None}",
    }
    (folder / "input.json").write_text(json.dumps(data))
    assert convert(folder / "input.json", new) == 0
    assert "policy row 1: left out 'go', which is exponential" in capsys.readouterr().err
    written = json.loads((new / "plan.json").read_text())
    assert sorted(written) == ["actions", "net", "plan", "policy", "robots"]
    assert written["robots"] == {"1": "a", "2": "a"}
    assert (new / "work.py").read_text() == (folder / "work.py").read_text()
    assert read_plan(str(new)).hash() == read_plan(str(folder / "input.json")).hash()
    assert main(["run", "--quiet", str(new)]) == 0
    capsys.readouterr()

    assert convert(folder / "input.json", new) == 2  # never over one that is there
    assert "plan.json: the file exists already" in capsys.readouterr().err
    assert convert(folder / "input.json", tmp_path / "plan.json", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["notes"][-1] == "work.py belongs beside the plan, in %s" % tmp_path


def test_every_plan_is_the_same_as_one_file(tmp_path, capsys):
    for plan in sorted(PLANS.iterdir()):
        if (plan / "plan.json").is_file():
            assert convert(plan, tmp_path / (plan.name + ".json")) == 0
            assert (
                read_plan(str(tmp_path / (plan.name + ".json"))).hash()
                == read_plan(str(plan)).hash()
            )
    assert convert(PLANS / "measure" / "net.xml", tmp_path / "net.json") == 2
    assert "this is a net, not a plan" in capsys.readouterr().err
