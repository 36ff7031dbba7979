"""Changes of JSON files: what is not changed keeps its text."""

import copy
import glob
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gspn_framework_package.formats.json_file import json_text
from gspn_framework_package.formats.json_update import same, update_json

FILE = """\
{
  "$schema": "plan.schema.json",
  "plan": "p",   "seed": 1.0,
  "robots": { "b" : "Home",
              "a": "Home" },
  "rows": [
    {"marking": [1, "-"], "choose": {"t": 1.50}},
    {"marking": [2,0],   "choose": {"u": 1e0}}
  ],
  "rest": [1, 2,
    3, 4]
}
"""

SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 5), st.floats(-5, 5), st.text('aä"\\\n1', max_size=3)
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text("abc1", max_size=2), inner, max_size=4)
    ),
    max_leaves=12,
)
STYLES = st.sampled_from(
    [{}, {"indent": 2}, {"indent": "\t"}, {"separators": (",", ":")}, {"ensure_ascii": False}]
)


def changed(change):
    data = json.loads(FILE)
    change(data)
    text = update_json(FILE, data, ("robots",))
    assert json.loads(text) == data
    return text


def test_a_changed_value_is_all_that_changes():
    text = changed(lambda data: data["rows"][1]["choose"].update(u=0.5))
    assert text == FILE.replace("1e0", "0.5")
    text = changed(lambda data: data.update(plan="q"))
    assert text == FILE.replace('"p"', '"q"')
    text = changed(lambda data: data["rest"].insert(2, 9))
    assert text == FILE.replace("1, 2,\n", "1, 2, 9,\n")


def test_what_is_removed_takes_its_comma_along():
    assert '"plan": "p",   "rows"' not in changed(lambda data: data.pop("seed"))
    text = changed(lambda data: data["rows"].pop(0))
    assert '[\n    {"marking": [2,0],   "choose": {"u": 1e0}}\n  ]' in text
    assert changed(lambda data: data["rest"].clear()).endswith('"rest": []\n}\n')
    text = changed(lambda data: data.pop("$schema"))
    assert text.startswith('{\n  "plan": "p",   "seed"')


def test_what_is_new_looks_like_the_rest():
    text = changed(lambda data: data["rows"].append({"marking": [0, 0], "choose": {"t": 1}}))
    assert '1e0}},\n    {"marking": [0, 0], "choose": {"t": 1}}\n  ],' in text
    text = changed(lambda data: data.update(until="a == 1"))
    assert text == FILE.replace("3, 4]\n", '3, 4],\n  "until": "a == 1"\n')


def test_numbers_as_a_browser_sends_them_are_the_same():
    data = json.loads(FILE)
    data["seed"] = 1
    data["rows"][1]["choose"]["u"] = 1
    assert update_json(FILE, data) == FILE
    big = '{"seed": 12345678901234567890, "on": true}'
    assert update_json(big, {"seed": 12345678901234567000, "on": True}) == big
    assert update_json(big, {"seed": 1, "on": 1}) != big


def test_the_order_of_keys_is_kept_unless_it_matters():
    data = dict(reversed(list(json.loads(FILE).items())))
    assert update_json(FILE, data) == FILE
    data["robots"] = {"a": "Home", "b": "Home"}
    assert update_json(FILE, data) == FILE
    text = update_json(FILE, data, ("robots",))
    assert list(json.loads(text)["robots"]) == ["a", "b"] and text.startswith(FILE[:60])


def test_line_ends_and_a_byte_order_mark_stay():
    text = "\ufeff" + FILE.replace("\n", "\r\n")
    data = json.loads(FILE)
    data["long"] = {"key %d" % i: "value %d" % i for i in range(12)}
    new = update_json(text, data)
    assert new.startswith("\ufeff{\r\n") and "\n" not in new.replace("\r\n", "")
    assert json.loads(new[1:]) == data


@given(VALUES, VALUES, STYLES)
def test_any_value_becomes_any_other(old, new, style):
    text = json.dumps(old, **style)
    assert update_json(text, old) == text
    again = update_json(text, new)
    assert same(json.loads(again), new)
    assert update_json(again, json.loads(again)) == again
    assert same(json.loads(update_json(again, old)), old)


@pytest.mark.parametrize("path", sorted(glob.glob("plans/*/*.json")))
def test_edits_of_shipped_files_come_and_go(path):
    with open(path, encoding="utf-8") as file:
        text = file.read()
    data = json.loads(text)
    edited = {**copy.deepcopy(data), "added": {"by": ["somebody", 1]}}
    there = update_json(text, edited)
    assert json.loads(there) == edited
    assert set(text.splitlines()) - set(there.splitlines()) <= {text.splitlines()[-2]}
    assert update_json(there, data) == text


NODES = 40


def drawn(nodes=NODES):
    """A plan as the page draws it."""
    names = [("Place %d" % n, "Transition %d" % n) for n in range(nodes)]
    return {
        "plan": "drawn",
        "net": {
            "name": "drawn",
            "places": [{"name": p, "position": [10.0 * n, 5.5]} for n, (p, _) in enumerate(names)],
            "transitions": [{"name": t, "timed": True, "rate": 0.5} for _, t in names],
            "arcs": [{"from": p, "to": t} for p, t in names],
        },
        "actions": {p: "actions.work" for p, _ in names},
        "policy": {"places": [p for p, _ in names], "rows": []},
    }


def lines_apart(before, after):
    """How many lines of a text another one lacks, and the other way round."""
    old, new = before.splitlines(), after.splitlines()
    return len([line for line in old if line not in new]), len([x for x in new if x not in old])


def renamed(data):
    return json.loads(json.dumps(data).replace('"Place 7"', '"Depot"'))


@pytest.mark.parametrize("style", [{}, {"separators": (",", ":")}, {"indent": 2}])
def test_a_rename_is_a_difference_of_a_few_lines(style):
    text = update_json(json.dumps(drawn(), **style), drawn(NODES + 1))
    assert json.loads(text) == drawn(NODES + 1)
    again = update_json(text, renamed(drawn(NODES + 1)))
    assert json.loads(again) == renamed(drawn(NODES + 1))
    assert lines_apart(text, again) == (4, 4)  # the place, its arc, its action, in the policy


def test_a_plan_that_grows_gets_lines_as_it_does():
    text = '{"plan": "drawn", "net": {"places": [], "transitions": [], "arcs": []}}\n'
    for count in (1, 2, 3, NODES):
        text = update_json(text, drawn(count))
    assert max(map(len, text.splitlines())) <= 120
    assert '\n      {"name": "Place 3", "position": [30.0, 5.5]},\n' in text


def test_a_row_that_was_a_long_line_stays_one():
    row = '{"marking": [%s], "choose": {"t": 0.50}}' % ", ".join(["0"] * 60)
    file = '{\n  "rows": [\n    %s\n  ]\n}\n' % row
    data = json.loads(file)
    data["rows"][0]["choose"]["t"] = 1
    assert update_json(file, data) == file.replace("0.50", "1")


def test_new_text_has_a_line_for_each_node_arc_and_row():
    text = json_text(drawn())
    assert json.loads(text) == drawn()
    lines = [line.strip().rstrip(",") for line in text.splitlines()]
    assert '{"from": "Place 5", "to": "Transition 5"}' in lines
    assert lines_apart(text, json_text(renamed(drawn()))) == (4, 4)
    assert json_text({"plan": "p", "net": "net.xml"}) == (
        '{\n  "plan": "p",\n  "net": "net.xml"\n}\n'
    )
    groups = {"seed": 1, "groups": {"In": ["A", "t"], "Out": ["B"]}}
    lines = '  "groups": {\n    "In": ["A", "t"],\n    "Out": ["B"]\n  }\n'
    assert json_text(groups).endswith(lines + "}\n")
    assert update_json('{\n  "seed": 1\n}\n', groups).endswith(lines + "}\n")
    assert json_text({}) == "{}\n" and json_text([]) == "[]\n"


@given(VALUES)
def test_new_text_says_the_value_and_needs_no_update(value):
    text = json_text(value)
    assert same(json.loads(text), value) and update_json(text, value) == text
