"""Changes of JSON files: what is not changed keeps its text."""

import copy
import glob
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
