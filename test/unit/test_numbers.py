"""Numbers that nobody can mean are refused in one line with exit code 2, wherever they are
given."""

import json
import os

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats import read_net
from gspn_framework_package.model.errors import InputError, PlanError
from gspn_framework_package.model.net import MAX_COUNT, Arc, Net, Place, Transition
from gspn_framework_package.model.plan import MAX_ROBOTS

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
MEASURE = os.path.join(ROOT, "plans", "measure")

NET = """<pnml><net id="n" type="P/T net">
<place id="P"><initialMarking><value>%s</value></initialMarking></place><place id="Q"/>
<transition id="T"><timed><value>true</value></timed></transition>
<arc id="a" source="P" target="T"/><arc id="b" source="T" target="Q"/></net></pnml>"""


def write(tmp_path, tokens):
    path = tmp_path / "n.xml"
    path.write_text(NET % tokens)
    return str(path)


@pytest.mark.parametrize(
    "tokens", [2**53 + 1, 2**63, 2**64, 10**200], ids=lambda tokens: "%.3g" % tokens
)
@pytest.mark.parametrize(
    "verb", ["analyse", "simulate --time 1", "convert - --to pnml", "draw -o x.svg"]
)
def test_more_tokens_than_anything_can_count(tmp_path, capsys, tokens, verb):
    name, *words = verb.split()
    assert main([name, write(tmp_path, tokens), *words]) == 2
    shown = capsys.readouterr().err
    assert "place 'P': its initial marking is larger than 2**53" in shown
    assert ":2: " in shown


def test_the_most_tokens_are_counted_exactly(tmp_path):
    assert read_net(write(tmp_path, MAX_COUNT)).place("P").tokens == MAX_COUNT


@pytest.mark.parametrize(
    "net",
    [
        ([Place("P", 0, MAX_COUNT + 1)], [Transition("T")], []),
        ([Place("P")], [Transition("T", priority=MAX_COUNT + 1)], []),
        ([Place("P")], [Transition("T", True, 1.0, servers=MAX_COUNT + 1)], []),
        ([Place("P")], [Transition("T")], [Arc("P", "T", MAX_COUNT + 1)]),
        ([Place("P")], [Transition("T")], [Arc("P", "T", MAX_COUNT + 1, True)]),
    ],
)
def test_other_counts_have_the_same_bound(net):
    with pytest.raises(InputError, match="larger than 2"):
        Net(*net)


OPTIONS = [
    ["simulate", "NET", "--time", "1", "--seed", "-1"],
    ["simulate", "NET", "--time", "1", "--seed", "9" * 5000],
    ["simulate", "NET", "--time", "1", "--replications", "1000000000"],
    ["simulate", "NET", "--time", "1", "--replications", "0"],
    ["simulate", "NET", "--time", "nan"],
    ["simulate", "NET", "--time", "0"],
    ["simulate", "NET", "--time", "1", "--warmup", "inf"],
    ["simulate", "NET", "--time", "1", "--confidence", "nan"],
    ["simulate", "PLAN", "--time", "1", "--robots", "1000000000"],
    ["analyse", "NET", "--limit", "-1"],
    ["analyse", "NET", "--at", "nan"],
    ["analyse", "NET", "--at", "-1"],
    ["analyse", "NET", "--time-to-steady-state", "nan"],
    ["analyse", "PLAN", "--robots", "1000000000"],
    ["check", "PLAN", "--robots", "1000000000"],
    ["check", "PLAN", "--robots", "-1"],
    ["check", "PLAN", "--limit", "-1"],
    ["run", "PLAN", "--agents", "1000000000"],
    ["run", "PLAN", "--seconds", "nan"],
    ["run", "PLAN", "--firings", "-3"],
    ["run", "PLAN", "--seed", "1e3"],
    ["plot", "NET", "-o", "p.svg", "--points", "1000000000"],
    ["plot", "NET", "-o", "p.svg", "--time", "nan"],
    ["plot", "NET", "-o", "p.svg", "--time", "1e300"],
    ["draw", "NET", "-o", "p.svg", "--limit", "-4"],
    ["draw", "NET", "-o", "p.svg", "--timeout", "nan"],
    ["convert", "NET", "x.drn", "--limit", "0"],
    ["convert", "NET", "x.pnml", "--const", "N=nan"],
    ["convert", "NET", "x.pnml", "--const", "\udcff=1"],
    ["demo", "--plan", "PLAN", "--robots", "-1"],
    ["demo", "--plan", "PLAN", "--port", "70000"],
    ["demo", "--plan", "PLAN", "--seconds", "nan"],
    ["film", "-o", "x.mp4", "--robots", "1000000000"],
    ["film", "-o", "x.mp4", "--seconds", "nan"],
    ["film", "-o", "x.mp4", "--speed", "0"],
]


@pytest.mark.parametrize(
    "words", OPTIONS, ids=lambda words: " ".join(words)[:60].encode("ascii", "replace").decode()
)
def test_options_have_bounds(tmp_path, capsys, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    known = {"NET": write(tmp_path, 3), "PLAN": MEASURE}
    assert main([known.get(word, word) for word in words]) == 2
    shown = capsys.readouterr().err
    assert "internal error" not in shown
    assert len(shown.splitlines()[-1]) < 300
    assert sorted(os.listdir(str(tmp_path))) == ["n.xml"]


PLAN = {
    "net": {
        "places": [{"name": "P", "tokens": 1}, {"name": "Q"}],
        "transitions": [
            {"name": "T", "timed": True, "rate": 1},
            {"name": "U", "timed": True, "rate": 1},
        ],
        "arcs": [
            {"from": "P", "to": "T"},
            {"from": "T", "to": "Q"},
            {"from": "Q", "to": "U"},
            {"from": "U", "to": "P"},
        ],
    },
    "actions": {"P": None, "Q": None},
}


@pytest.mark.parametrize(
    "path, value",
    [
        (["net", "places", 0, "tokens"], 10**12),
        (["net", "places", 0, "tokens"], 2**64),
        (["net", "arcs", 0, "weight"], 2**64),
        (["agreement"], {"evict_after": 1e300}),
        (["agreement"], {"fence_after": 1e10}),
        (["timeout"], {"P": 1e300}),
        (["on_failure"], {"P": {"retry": 1, "delay": 1e300}}),
    ],
)
def test_keys_of_a_plan_have_bounds(tmp_path, capsys, path, value):
    data = json.loads(json.dumps(PLAN))
    element = data
    for step in path[:-1]:
        element = element[step]
    element[path[-1]] = value
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(data))
    assert main(["check", str(file)]) == 2
    shown = capsys.readouterr().err
    assert str(file) in shown
    assert len(shown.splitlines()) == 1


def test_a_team_has_a_bound():
    from gspn_framework_package.formats.plan_file import read_plan

    plan = read_plan(MEASURE)
    with pytest.raises(PlanError, match="from 1 to 10000 robots"):
        plan.for_robots(MAX_ROBOTS + 1)
    with pytest.raises(PlanError, match="from 1 to 10000 robots"):
        plan.for_robots(0)
