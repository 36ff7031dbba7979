"""Plan files: read, written, and refused with one clear message."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any, Dict

import pytest

from gspn_framework_package.formats.plan_file import plan_document, read_plan, read_policy
from gspn_framework_package.formats.plan_json import (
    check_schema,
    plan_from_json,
    plan_to_json,
    schema,
)
from gspn_framework_package.model.action import FunctionAction, ServerAction
from gspn_framework_package.model.errors import GspnError, PlanError
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import (
    LostKind,
    Synchronisation,
    Transport,
)
from gspn_framework_package.model.policy import Policy

PLANS = Path(__file__).resolve().parents[3] / "plans"
NET = {
    "places": [{"name": "P", "tokens": 1}, {"name": "Q"}, {"name": "count"}],
    "transitions": [
        {"name": "T", "timed": True, "rate": 2.0, "servers": None},
        {"name": "back", "priority": 2, "weight": 0.5},
        {"name": "stay"},
    ],
    "arcs": [
        {"from": "P", "to": "T"},
        {"from": "T", "to": "Q"},
        {"from": "T", "to": "count", "weight": 2},
        {"from": "Q", "to": "back"},
        {"from": "back", "to": "P"},
        {"from": "Q", "to": "stay"},
        {"from": "stay", "to": "Q"},
    ],
}
FULL: Dict[str, Any] = {
    "plan": "everything",
    "net": NET,
    "policy": {"places": ["P", "Q"], "rows": [{"marking": ["-", 1], "choose": {"back": 1}}]},
    "actions": {
        "P": "work.go",
        "Q": {
            "type": "move_base_msgs/MoveBaseAction",
            "server": "move_base",
            "goal": {"target_pose": {"header": {"frame_id": "map"}}},
            "outcomes": {"aborted": "stay"},
        },
    },
    "resource_places": ["count"],
    "synchronisation": "partial",
    "transport": "zenoh",
    "robots": [
        {"name": "red", "place": "P", "actions": {"Q": None}},
        {"name": "blue", "place": "P"},
    ],
    "spawn": ["P", "Q"],
    "seed": 7,
    "strict": True,
    "on_failure": {"P": {"retry": 2, "delay": 0.5}, "Q": "fire stay", "*": "stop"},
    "timeout": {"*": 10},
    "routing": {"T": {"P": "Q"}},
    "environment": "simulate",
    "on_lost": "fire T",
    "on_evict": {"P": {"count": 1}},
    "until": "count >= 10",
    "agreement": {"evict_after": 5, "fence_after": 2, "fsync": True, "witnesses": ["w"]},
}


def act(**action: Any) -> Dict[str, Any]:
    """The plan with this action."""
    return changed(actions={**FULL["actions"], "P": action})


def changed(**changes: Any) -> Dict[str, Any]:
    data = json.loads(json.dumps(FULL))
    data.update(changes)
    return data


def write(folder: Path, data: Any) -> str:
    path = folder / "plan.json"
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    return str(path)


def test_everything_that_a_plan_can_say_is_read(tmp_path: Path) -> None:
    write(tmp_path, FULL)
    plan = read_plan(str(tmp_path))
    assert plan.action("blue", "P") == FunctionAction("work.go", "P")
    move_base = plan.action("blue", "Q")
    assert isinstance(move_base, ServerAction) and move_base.outcomes == {"aborted": "stay"}
    assert plan.action("red", "Q") is None
    assert plan.synchronisation is Synchronisation.PARTIAL
    assert plan.transport is Transport.ZENOH
    assert plan.failure_rule("P") == FailureRule.retry(2, 0.5)
    assert plan.failure_rule("count").kind == "stop"
    assert plan.timeout("Q") == 10
    assert (plan.on_lost.kind, plan.on_lost.transition) == (LostKind.FIRE, "T")
    assert (plan.timing.evict_after, plan.timing.fence_after, plan.fsync) == (5, 2, True)
    assert (
        plan.simulate_environment and plan.strict and plan.seed == 7 and plan.until == "count >= 10"
    )
    assert plan.folder == str(tmp_path)


def test_a_plan_is_written_self_contained_and_is_the_same_plan() -> None:
    plan = plan_from_json(changed())
    again = plan_from_json(json.loads(json.dumps(plan_to_json(plan))))
    assert again == plan
    assert again.hash() == plan.hash()
    assert plan_from_json(changed(seed=8)).hash() != plan.hash()


@pytest.mark.parametrize(
    "name",
    ["patrol", "measure", "rendezvous", "tokens", "fork_join", "inspection", "warehouse", "depot"],
)
def test_the_example_plans_are_plans(name: str) -> None:
    plan = read_plan(str(PLANS / name))
    assert plan_from_json(plan_to_json(plan)).hash() == plan.hash()


def test_a_team_of_another_size(tmp_path: Path) -> None:
    plan = plan_from_json(changed())
    two = plan.for_robots(2)
    assert [r.name for r in two.robots] == ["red", "blue"]
    assert two.net.named(two.net.initial_marking, zeros=False) == {"P": 2}
    five = plan.for_robots(5)
    assert [(r.name, r.place) for r in five.robots][2:] == [
        ("robot_3", "P"),
        ("robot_4", "Q"),
        ("robot_5", "P"),
    ]
    assert five.net.named(five.net.initial_marking, zeros=False) == {"P": 4, "Q": 1}


def test_robots_are_dealt_where_a_plan_names_none() -> None:
    data = changed()
    del data["robots"]
    plan = plan_from_json(data)
    assert [(r.name, r.place) for r in plan.robots] == [("robot_1", "P")]


@pytest.mark.long
@pytest.mark.parametrize(
    ("data", "message"),
    [
        ('{"net": ', "plan.json:1: it is not JSON"),
        ('{"net": "a", "net": "b"}', "the key 'net' occurs twice"),
        ("[1]", "a plan is a JSON object, not a list"),
        ("1", "a plan is a JSON object, not a number"),
        ("null", "a plan is a JSON object, not null"),
        ("[" * 100000, "nested too deeply"),
        ({"actions": {}}, "'net' is a required property"),
        (changed(colour="red"), "'colour' was unexpected.*known here: .*synchronisation"),
        (changed(transport="pigeon"), "transport: 'pigeon' is not one of"),
        (changed(synchronisation="some"), "synchronisation: 'some' is not one of"),
        (changed(net="gone.xml"), "gone.xml: cannot read it"),
        (changed(policy="gone.json"), "gone.json: cannot read it"),
        (changed(actions={"P": 3}), "actions.P: "),
        (changed(actions={"Z": None}), "actions: the net has no place 'Z'"),
        (
            act(server="s", goal={"goal": {"from": "a b"}}),
            "actions.P: 'a b' is not a name of data",
        ),
        (act(server="s", keep={"goal": "x"}, outcomes={"aborted": "back"}), "does not leave"),
        (act(server="s", keep={"mission.x": "x"}), "'mission.x' is not a name of data"),
        (act(service="s", type="a/B", keep={"x": "a +"}), "actions.P: the condition 'a .' cannot"),
        (act(service="s", type="a/B", keep={"x": "a + 1"}), "'a . 1' is not the name of a field"),
        (act(wait_for="t", type="a/B", when="level <"), "actions.P: the condition 'level <' canno"),
        (act(publish="t", type="a/B", message={"a": [{"from": ""}]}), "'' is not a name of data"),
        (act(command=["ls", {"from": "1"}]), "actions.P: '1' is not a name of data"),
        (act(command=["ls"], keep="a.b"), "actions.P: 'a.b' is not a name of data"),
        (changed(resource_places=["Z"]), "resource_places: the net has no place 'Z'"),
        (changed(groups={"G": ["Z"]}), "groups.G: there is no place or transition 'Z'"),
        (changed(groups={"G": ["P"], "H": ["P"]}), "groups.H: 'P' is in the group 'G' already"),
        (changed(groups={"G": []}), "groups.G: "),
        (changed(robots={"r": "Z"}), "robot 'r': the net has no place 'Z'"),
        (changed(robots={"r": "count"}), "'count' is a resource place"),
        (changed(robots=[{"name": "r", "place": "P"}] * 2), "two robots are named 'r'"),
        (
            changed(on_failure={"P": "fire back"}),
            "on_failure of 'P': 'back' does not leave that place",
        ),
        (changed(on_failure={"P": "fire X"}), "the net has no transition 'X'"),
        (changed(on_failure={"P": "panic"}), "on_failure.P: "),
        (changed(timeout={"P": 0}), "timeout.P: "),
        (changed(routing={"T": {"P": "P"}}), "routing: 'T' does not lead from 'P' to 'P'"),
        (changed(on_evict={"P": {"Q": 1}}), "on_evict: 'Q' is not a resource place"),
        (changed(until="count >="), "until: "),
        (changed(until="__import__('os')"), "until: "),
        (
            changed(policy={"places": ["P"], "rows": [{"marking": [1], "choose": {"back": 1.2}}]}),
            "policy row 1: probability 1.2",
        ),
        (
            changed(policy={"places": ["P"], "rows": [{"marking": [1], "choose": {"nope": 1}}]}),
            "policy row 1: the net has no transition 'nope'",
        ),
        (
            changed(net={**NET, "arcs": [{"from": "P", "to": "nowhere"}]}),
            "no place or transition 'nowhere'",
        ),
        (changed(net={**NET, "arcs": [{"from": "P", "to": "T", "weight": -1}]}), "weight: -1"),
    ],
)
def test_what_is_not_a_plan_is_refused_with_file_and_element(
    tmp_path: Path, data: Any, message: str
) -> None:
    with pytest.raises(GspnError, match=message) as caught:
        read_plan(write(tmp_path, data))
    assert caught.value.exit_code == 2
    assert caught.value.file


def test_a_folder_without_a_plan_and_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(GspnError, match="there is no plan.json in that folder"):
        read_plan(str(tmp_path))
    with pytest.raises(GspnError, match="cannot read it"):
        read_plan(str(tmp_path / "gone.json"))


def test_the_schema_describes_itself() -> None:
    import jsonschema

    jsonschema.Draft7Validator.check_schema(schema())


FIXED = [
    [],
    ["net"],
    ["net", "places", 0],
    ["net", "transitions", 1],
    ["net", "arcs", 3],
    ["policy"],
    ["policy", "rows", 0],
    ["actions", "Q"],
    ["robots", 1],
    ["on_failure", "P"],
    ["agreement"],
]
"""The objects of FULL whose keys are not names that a user chose."""


@pytest.mark.parametrize("path", FIXED, ids=str)
def test_an_unknown_key_is_refused_with_its_line(tmp_path, path):
    data = json.loads(json.dumps(FULL))
    element = data
    for step in path:
        element = element[step]
    element["leaks"] = 1
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(data, indent=1))
    with pytest.raises(GspnError) as caught:
        read_plan(str(file))
    lines = file.read_text().splitlines()
    assert caught.value.file == str(file)
    assert caught.value.line is not None
    if caught.value.line != next(
        number for number, line in enumerate(lines, 1) if '"leaks"' in line
    ):
        # one of several forms
        assert "not valid under any of the given schemas" in caught.value.message


@pytest.mark.parametrize(
    "old, new, element, message",
    [
        (
            '"timed": true, ',
            "",
            "transition 'T'",
            "it has a rate, which immediate transitions do not have",
        ),
        (
            '{"name": "back", ',
            '{"name": "back", "timed": true, ',
            "transition 'back'",
            "which timed transitions",
        ),
        ('{"marking": ["-", 1]', '{"marking": ["-", "=> 1"]', "policy row 1", "'=> 1' is not a"),
        ('"until": "count >= 10"', '"until": "cuont >= 10"', "until", "cuont"),
        ('"evict_after": 5', '"evict_after": NaN', None, "NaN is not a number that can be used"),
        (
            '"evict_after": 5',
            '"evict_after": 1e999',
            None,
            "1e999 is not a number that can be used",
        ),
        ('"seed": 7', '"seed": -Infinity', None, "-Infinity is not a number"),
        ('"seed": 7', '"seed": 1%s' % ("0" * 5000), None, "... is not a number that can be used"),
        ('"everything"', '"\\ud800"', None, "a character that does not exist ('\\ud800')"),
        ('"name": "Q"', '"name": "\\uDC00Q"', None, "a character that does not exist"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(tmp_path, old, new, element, message):
    text = json.dumps(FULL).replace('"net":', '"net":\n').replace(old, "\n" + new)
    assert new in text
    file = tmp_path / "plan.json"
    file.write_text(text)
    with pytest.raises(GspnError) as caught:
        read_plan(str(file))
    assert message in str(caught.value)
    assert caught.value.element == element
    assert caught.value.line == text[: text.index("\n" + new) + 1].count("\n") + 1


def test_a_whole_pair_of_surrogates_is_a_character(tmp_path):
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(dict(FULL, plan="\U0001f600")))
    assert "\\ud83d\\ude00" in file.read_text()
    assert read_plan(str(file)).name == "\U0001f600"


def test_a_new_policy_is_written_in_place_of_the_file_that_had_the_old_one(tmp_path):
    folder = tmp_path / "patrol"
    shutil.copytree(PLANS / "patrol", folder)
    plan = read_plan(str(folder))
    names = [t.name for t in plan.net.transitions if not t.timed]
    policy = Policy.from_table([plan.net.places[0].name], [(["-"], {names[0]: 1.0})])
    same = plan_document(str(folder), plan, str(folder))
    assert same["policy"] == "policy.json"
    data = plan_document(str(folder), plan.with_policy(policy), str(folder))
    (folder / "new.json").write_text(json.dumps(data))
    again = read_plan(str(folder / "new.json"))
    assert again.policy == policy
    assert again.with_policy(plan.policy).hash() == plan.hash()


SCHEMA = schema()
WRONG = [None, True, -1, 1.5, "", "a b", [], [1], ["a", 1], [[]], [{"zzz": 1}]]
WRONG += [{}, {"zzz": 1}, {"a": None}, {"a": 7}, {"a": {"zzz": 1}}, {"a": [1]}]
RAW = re.compile(
    r"given schemas|is not of type|should not be valid|does not match|Additional properties"
    r"|too short|non-unique|\bNone\b"
)


@pytest.mark.long
@pytest.mark.parametrize("name", SCHEMA["properties"])
def test_a_wrong_value_is_reported_in_words_with_its_name(name):
    for value in WRONG:
        try:
            check_schema({"net": "net.xml", "actions": {}, name: value})
        except PlanError as error:
            assert error.element is not None and error.element.split(".")[0] == name
            assert not RAW.search(error.message), error.message


@pytest.mark.parametrize(
    "part, element, message",
    [
        ({"robots": {"r": 5}}, "robots.r", "5 is not text"),
        ({"robots": ["r"]}, "robots.0", '"r" is not an object'),
        ({"robots": [{"name": "r", "plcae": "P"}]}, "robots.0", "'plcae' was unexpected"),
        ({"robots": 3}, "robots", "3 is not one of the possible values: an object; a list"),
        (
            {"actions": {"P": {"server": "s", "gaol": {}}}},
            "actions.P",
            "'gaol' was unexpected (did you mean 'goal'?",
        ),
        (
            {"actions": {"P": {"servr": "s", "goal": {}}}},
            "actions.P",
            "'servr' was unexpected (did you mean 'server'?",
        ),
        (
            {"actions": {"P": {"server": "s", "outcomes": {"succeeded": 5}}}},
            "actions.P.outcomes.succeeded",
            "5 is not text",
        ),
        (
            {"actions": {"P": {"server": "s", "outcomes": {"suceeded": "T"}}}},
            "actions.P.outcomes",
            "'suceeded' is not one of ['succeeded', 'aborted', 'rejected', 'preempted'] "
            "(did you mean 'succeeded'?",
        ),
        ({"actions": {"P": {"command": "ls", "outcomes": []}}}, "actions.P.", " is not "),
        ({"on_failure": {"*": "retry"}}, "on_failure.*", '"retry" is not possible here'),
        (
            {"events": {"T": {"after": 1, "topic": "t", "type": "a/B"}}},
            "events.T",
            "only one of 'after' and 'topic' is possible",
        ),
    ],
)
def test_what_is_wrong_in_a_part_is_reported_by_its_own_name(part, element, message):
    with pytest.raises(PlanError) as caught:
        check_schema({"net": "net.xml", "actions": {}, **part})
    assert (caught.value.element or "").startswith(element)
    assert message in str(caught.value)


def test_a_cell_that_compares_is_written_as_it_was_read(tmp_path):
    row = {"marking": [" >=1", "!= 2"], "choose": {"back": 1}}
    data = {**FULL, "policy": {"places": ["P", "Q"], "rows": [row]}}
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(data))
    plan = read_plan(str(file))
    assert plan_to_json(plan)["policy"]["rows"][0]["marking"] == [">= 1", "!= 2"]
    assert plan_from_json(plan_to_json(plan)).hash() == plan.hash()
    exact = {**row, "marking": [1, "-"]}
    other = {**data, "policy": {"places": ["P", "Q"], "rows": [exact]}}
    assert plan_from_json(other).hash() != plan.hash()


def test_a_row_of_a_policy_file_is_named_with_its_line(tmp_path):
    file = tmp_path / "policy.json"
    file.write_text(
        '{"places": ["P"],\n"rows": [{"marking": [1], "choose": {}},\n'
        '{"marking": ["< 0"], "choose": {}}]}'
    )
    with pytest.raises(GspnError, match="policy.json:3: policy row 2: no number of tokens is < 0"):
        read_policy(str(file))
