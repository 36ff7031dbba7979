"""The difference of two edited documents, and the documents themselves."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any, Dict, List

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.difference import DocumentChange, document_difference
from gspn_framework_package.formats.edited_document import (
    document_from_json,
    document_of,
    plan_of_document,
)
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import GspnError

PLANS = Path(__file__).resolve().parents[3] / "plans"
SHIPPED = sorted(p.parent.name for p in PLANS.glob("*/plan.json"))


def a_document() -> Dict[str, Any]:
    return {
        "plan": {
            "plan": "p",
            "actions": {"A": "actions.a", "B": None},
            "robots": {"r1": "A"},
            "timeout": {"*": 3},
            "seed": 1,
        },
        "net": {
            "name": "n",
            "places": [{"name": "A", "tokens": 1, "position": [0, 0]}, {"name": "B"}],
            "transitions": [{"name": "t"}, {"name": "u", "timed": True, "rate": 2.0}],
            "arcs": [{"from": "A", "to": "t"}, {"from": "t", "to": "B"}],
        },
        "policy": {
            "places": ["A", "B"],
            "rows": [
                {"marking": [1, "-"], "choose": {"t": 1}},
                {"marking": ["-", 2], "choose": {}},
            ],
        },
    }


def told(old: Dict[str, Any], new: Dict[str, Any]) -> List[str]:
    return [str(change) for change in document_difference(old, new)]


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_the_document_of_a_shipped_plan_is_the_same_plan(name: str) -> None:
    document = document_of(str(PLANS / name))
    read = read_plan(str(PLANS / name))
    assert plan_of_document(document, str(PLANS / name / "plan.json")).hash() == read.hash()
    assert document_difference(document, json.loads(json.dumps(document))) == []


def test_each_kind_of_change_is_reported() -> None:
    old, new = a_document(), a_document()
    net, plan, policy = new["net"], new["plan"], new["policy"]
    net["places"][0].update(tokens=2, position=[5, 5])
    net["places"].append({"name": "C"})
    net["transitions"].pop()
    net["arcs"][0]["weight"] = 2
    net["arcs"].append({"from": "B", "to": "t", "inhibitor": True})
    plan["actions"] = {"A": "actions.b", "C": None}
    plan["robots"] = [{"name": "r1", "place": "B"}, {"name": "r2", "place": "A"}]
    plan["timeout"] = {"*": 4, "A": 1}
    plan["seed"] = 2
    policy["rows"][0]["choose"] = {"t": 0.5, "u": 0.5}
    policy["rows"][1] = {"marking": ["-", "-"], "choose": {}}
    assert told(old, new) == [
        "~ place A, tokens: 1 -> 2",
        "~ place A, position: [0, 0] -> [5, 5]",
        "+ place C",
        '- transition u: {"timed": true, "rate": 2.0}',
        "~ arc A -> t, weight: 1 -> 2",
        '+ arc B -> t: {"inhibitor": true}',
        "~ action A: actions.a -> actions.b",
        "- action B",
        "+ action C",
        "~ robot r1, place: A -> B",
        '+ robot r2: {"place": "A"}',
        "~ setting timeout, *: 3 -> 4",
        "+ setting timeout, A: 1",
        "~ setting seed: 1 -> 2",
        '~ policy row A: 1, choose: {"t": 1} -> {"t": 0.5, "u": 0.5}',
        "- policy row B: 2",
        "+ policy row any marking",
    ]
    assert all(
        "position" not in str(change) for change in document_difference(old, new, positions=False)
    )


def test_what_means_the_same_is_no_difference() -> None:
    old, new = a_document(), a_document()
    new["net"]["places"][1].update(tokens=0)
    new["net"]["transitions"][0].update(timed=False, weight=1.0, priority=1)
    new["net"]["arcs"][0].update(weight=1, inhibitor=False)
    new["plan"]["robots"] = [{"name": "r1", "place": "A", "actions": {}}]
    new["plan"] = dict(reversed(list(new["plan"].items())))
    new["policy"] = {
        "places": ["B", "A"],
        "rows": [
            {"marking": ["-", "1"], "choose": {"t": 1.0}},
            {"marking": [2, "-"], "choose": {}},
        ],
    }
    assert told(old, new) == []


def test_true_is_not_one() -> None:
    old, new = a_document(), a_document()
    new["plan"]["seed"] = True
    assert told(old, new) == ["~ setting seed: 1 -> true"]


@pytest.mark.parametrize(
    ("part", "key", "what"),
    [
        ("net", "arcs", "~ the order of the arcs"),
        ("net", "places", "~ the order of the places"),
        ("policy", "rows", "~ the order of the rows of the policy"),
    ],
)
def test_the_order_is_reported_where_it_counts(part: str, key: str, what: str) -> None:
    new = a_document()
    new[part][key].reverse()
    assert told(a_document(), new) == [what]


def test_a_policy_that_comes_or_goes_is_reported_even_without_rows() -> None:
    without = {**a_document(), "policy": None}
    empty = {**a_document(), "policy": {"rows": []}}
    assert told(without, empty) == ['+ setting policy: {"rows": []}']
    assert told(empty, without) == ['- setting policy: {"rows": []}']


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 2) | st.sampled_from(["", "A", "t", "-", "r1"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["name", "from", "to", "A", "tokens", "marking", "choose", "place"]),
            inner,
            max_size=3,
        )
    ),
    max_leaves=6,
)
KEYS = [
    ("net",),
    ("plan",),
    ("policy",),
    ("net", "places"),
    ("net", "arcs"),
    ("net", "x"),
    ("plan", "actions"),
    ("plan", "robots"),
    ("plan", "timeout"),
    ("policy", "rows"),
    ("policy", "places"),
]


@pytest.mark.long
@given(st.lists(st.tuples(st.sampled_from(KEYS), JSON), max_size=4))
@settings(max_examples=150)
def test_a_half_drawn_document_is_compared_without_a_traceback(edits: Any) -> None:
    new = a_document()
    for path, value in edits:
        inside = new
        for key in path[:-1]:
            if not isinstance(inside.get(key), dict):
                inside[key] = {}
            inside = inside[key]
        inside[path[-1]] = value
    for change in [
        *document_difference(a_document(), new),
        *document_difference(new, a_document()),
    ]:
        assert change.what in ("added", "removed", "changed")
        json.dumps(change.to_json())
        assert str(change)
    assert document_difference(new, copy.deepcopy(new)) == []


NAMES = st.sampled_from(["A", "B", "C", "D"])


@st.composite
def nets(draw: Any) -> Dict[str, Any]:
    places = draw(st.dictionaries(NAMES, st.integers(0, 2), max_size=4))
    arcs = draw(st.dictionaries(NAMES, st.integers(1, 2), max_size=4))
    return {
        "plan": {"actions": draw(st.dictionaries(NAMES, st.sampled_from([None, "a.b"])))},
        "net": {
            "places": [{"name": n, "tokens": k} for n, k in places.items()],
            "transitions": [{"name": "t"}],
            "arcs": [{"from": n, "to": "t", "weight": w} for n, w in arcs.items()],
        },
        "policy": None,
    }


@given(nets(), nets())
def test_the_changes_applied_to_the_old_document_make_the_new_one(
    old: Dict[str, Any], new: Dict[str, Any]
) -> None:
    def content(document: Dict[str, Any]) -> Dict[str, Any]:
        net = document["net"]
        return {
            "place": {p["name"]: p for p in net["places"]},
            "arc": {"%s>%s" % (a["from"], a["to"]): a for a in net["arcs"]},
            "action": dict(document["plan"]["actions"]),
        }

    found = content(copy.deepcopy(old))
    changes = [change for change in document_difference(old, new) if change.kind != "order"]
    for change in changes:
        elements = found[change.kind]
        if change.what == "removed":
            assert elements.pop(change.name) == change.old
        elif change.key:
            assert elements[change.name][change.key] == change.old
            elements[change.name][change.key] = change.new
        else:
            assert (change.name in elements) is (change.what == "changed")
            elements[change.name] = change.new
    assert found == content(new)
    backwards = [c for c in document_difference(new, old) if c.kind != "order"]
    swap = {"added": "removed", "removed": "added", "changed": "changed"}
    assert {(swap[c.what], c.kind, c.name, c.key) for c in backwards} == {
        (c.what, c.kind, c.name, c.key) for c in changes
    }


def test_the_verb_lists_the_changes_and_exits_by_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = document_of(str(PLANS / "patrol"))
    document["plan"]["seed"] = 7
    whole = {**document["plan"], "net": document["net"], "policy": document["policy"]}
    (tmp_path / "other.json").write_text(json.dumps(whole))
    assert main(["diff", str(PLANS / "patrol"), str(tmp_path / "other.json")]) == 1
    assert capsys.readouterr().out == "+ setting seed: 7\n1 change\n"
    assert main(["diff", str(PLANS / "patrol"), str(PLANS / "patrol")]) == 0
    capsys.readouterr()
    assert main(["diff", str(PLANS / "patrol"), str(tmp_path / "other.json"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["changes"] == [
        DocumentChange("added", "setting", "seed", "", None, 7).to_json()
    ]
    assert main(["diff", str(PLANS / "patrol"), str(tmp_path / "none")]) == 2
    assert "none" in capsys.readouterr().err


def test_a_net_is_a_document_with_an_empty_plan() -> None:
    document = document_of(str(PLANS / "patrol" / "net.xml"))
    assert document["plan"] == {} and document["policy"] is None
    assert document["net"]["places"] == document_of(str(PLANS / "patrol"))["net"]["places"]


def test_a_document_that_is_no_plan_says_where() -> None:
    document = a_document()
    document["net"]["arcs"].append({"from": "A", "to": "B"})
    with pytest.raises(GspnError) as found:
        plan_of_document(document, "plan.json")
    assert found.value.element == "arc from 'A' to 'B'"
    with pytest.raises(GspnError, match="net: it is not an object"):
        plan_of_document({"plan": {}, "net": None, "policy": None}, "plan.json")
    assert document_from_json({"plan": "p", "net": {"places": []}})["policy"] is None
