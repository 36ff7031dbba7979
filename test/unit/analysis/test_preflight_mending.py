"""A finding with one obvious mend says it: mended as it says, it is gone."""

import copy
import json

import pytest

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.formats.plan_file import read_plan

PLAN = {
    "plan": "fork",
    "net": {
        "places": [
            {"name": "Hub", "tokens": 1},
            {"name": "Left"},
            {"name": "Right"},
            {"name": "Queue", "tokens": 1},
        ],
        "transitions": [
            {"name": "left", "weight": 3},
            {"name": "right", "weight": 1},
            {"name": "done", "timed": True, "rate": 1},
            {"name": "back", "timed": True, "rate": 1},
        ],
        "arcs": [
            {"from": "Hub", "to": "left"},
            {"from": "Queue", "to": "left"},
            {"from": "left", "to": "Left"},
            {"from": "Hub", "to": "right"},
            {"from": "right", "to": "Right"},
            {"from": "Left", "to": "done"},
            {"from": "done", "to": "Hub"},
            {"from": "Right", "to": "back"},
            {"from": "back", "to": "Hub"},
            {"from": "done", "to": "Queue"},
        ],
    },
    "actions": {"Hub": None, "Left": "actions.f", "Right": "actions.f"},
    "resource_places": ["Queue"],
    "robots": {"r": "Hub"},
}


def without_action(plan):
    del plan["actions"]["Hub"]


def more_tokens(plan):
    plan["net"]["places"][0]["tokens"] = 3


def strict(plan):
    plan["strict"] = True


def strict_with_rows(plan):
    plan["policy"] = {"places": ["Queue"], "rows": [{"marking": [0], "choose": {"right": 1}}]}


def tasks(plan):
    plan["tasks"] = {"queues": ["Queue"], "done": ["done"]}
    plan["net"]["arcs"].pop()


def silent(plan):
    plan["net"]["transitions"][2] = {"name": "done"}
    plan["policy"] = {"places": ["Queue"], "rows": [{"marking": ["-"], "choose": {"done": 1}}]}


def growing(plan):
    plan["net"]["transitions"].append({"name": "order", "timed": True, "rate": 1})
    plan["net"]["arcs"].append({"from": "order", "to": "Queue"})


def held(plan):
    net = plan["net"]
    plan["robots"]["s"] = "Hub"
    net["places"][0]["tokens"] = 2
    net["places"].pop(2), plan["actions"].pop("Right")
    net["transitions"] = net["transitions"][::2]
    net["arcs"] = [a for a in net["arcs"] if not {a["from"], a["to"]} & {"right", "Right", "back"}]


def put(part, path, value):
    step, rest = path[0], path[1:]
    if step == "-":
        part.append(value)
    elif isinstance(part, list):
        put(next(node for node in part if node["name"] == step), rest, value)
    elif rest:
        put(part.setdefault(step, [] if rest[0] == "-" else {}), rest, value)
    else:
        part[step] = value


def report(folder, plan):
    (folder / "actions.py").write_text("def f():\n    pass\n")
    (folder / "plan.json").write_text(json.dumps(plan))
    return check(read_plan(str(folder))).to_json()["items"]


@pytest.mark.long
@pytest.mark.parametrize(
    "fault, found, label",
    [
        (without_action, "actions", "no action there"),
        (more_tokens, "initial", "a token for each robot"),
        (strict, "policy", "add a row for this marking"),
        (strict_with_rows, "policy", "add a row for this marking"),
        (tasks, "tasks", "give the task back to Queue"),
        (silent, "policy", "add a row for it"),
        (growing, "resource_bounds", "room for 20 tokens"),
        (held, "dead_after_loss", "give back what a lost robot held"),
    ],
)
def test_a_finding_that_is_mended_as_it_says_is_gone(tmp_path, fault, found, label):
    plan = copy.deepcopy(PLAN)
    fault(plan)
    mends = [item["mend"] for item in report(tmp_path, plan) if item.get("mend")]
    assert {mend["label"] for mend in mends} == {label}
    if "policy" not in plan:
        plan["policy"] = {"places": [], "rows": []}
    for mend in mends:
        for path, value in mend["set"]:
            put(plan, path, value)
    left = [item for item in report(tmp_path, plan) if item["check"] == found]
    assert not any("mend" in item for item in left), left


def test_a_missing_row_chooses_by_the_weights_of_what_can_fire(tmp_path):
    plan = copy.deepcopy(PLAN)
    strict_with_rows(plan)
    (mend,) = [item["mend"] for item in report(tmp_path, plan) if item.get("mend")]
    row = {"marking": [1], "choose": {"left": 0.75, "right": 0.25}}
    assert mend["set"] == [[["policy", "rows", "-"], row]]
