"""The panels of the mode EDIT: what is typed there is in the plan, or is said to be wrong; no key of a
plan file is without a form; a name is changed wherever it occurs."""

import json
from pathlib import Path

import pytest
from page_reading import resize
from shop import write_shop

from gspn_framework_package.execution.actions import (
    ActionContext,
    Cancellation,
    load_action,
    no_feedback,
)
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import (
    plan_from_json,
    plan_to_json,
    plan_to_short_json,
    schema,
)
from gspn_framework_package.model.duration import FAMILIES
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.event import SOURCE_KINDS
from gspn_framework_package.model.failure import FAILURE_KINDS
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.standalone_run import StandaloneRun

ROOT = Path(__file__).resolve().parents[2]

PLAN = {
    "plan": "shop",
    "net": {
        "places": [
            {"name": "Fetch", "tokens": 2},
            {"name": "Sort"},
            {"name": "Rest room"},
            {"name": "Charger", "tokens": 1},
            {"name": "Sorted"},
        ],
        "transitions": [
            {"name": "fetched", "timed": True, "rate": 0.5},
            {"name": "sorted", "weight": 3},
            {"name": "plug_in"},
            {"name": "unplug", "timed": True, "rate": 0.1},
        ],
        "arcs": [
            {"from": "Fetch", "to": "fetched"},
            {"from": "fetched", "to": "Sort"},
            {"from": "Sort", "to": "sorted"},
            {"from": "sorted", "to": "Fetch"},
            {"from": "sorted", "to": "Sorted"},
            {"from": "Sort", "to": "plug_in"},
            {"from": "Charger", "to": "plug_in"},
            {"from": "plug_in", "to": "Rest room"},
            {"from": "Rest room", "to": "unplug"},
            {"from": "unplug", "to": "Charger"},
            {"from": "unplug", "to": "Fetch"},
        ],
    },
    "policy": {
        "places": ["Charger", "Rest room"],
        "rows": [
            {"marking": [1, "-"], "choose": {"sorted": 0.8, "plug_in": 0.2}},
            {"marking": ["-", "-"], "choose": {"sorted": 1}},
        ],
    },
    "actions": {"Fetch": "actions.fetch", "Sort": "actions.sort", "Rest room": None},
    "resource_places": ["Charger", "Sorted"],
    "robots": {"robot_1": "Fetch", "robot_2": "Fetch"},
    "spawn": ["Fetch"],
    "on_failure": {"Sort": "fire plug_in", "*": "wait"},
    "timeout": {"Sort": 60},
    "routing": {"sorted": {"Sort": "Fetch"}},
    "on_lost": "hold",
    "on_evict": {"Rest room": {"Charger": 1}},
    "durations": {
        "Fetch": {
            "mean": 2,
            "distribution": "gamma",
            "shape": 4,
            "of": {"observations": 537, "logs": ["run.jsonl"], "interval": [1.18, 2.2]},
        }
    },
    "outcomes": {"Sort": {"probabilities": {"sorted": 0.5, "plug_in": 0.5}}},
    "failures": {"Fetch": {"probability": 0.02}},
    "own_times": {
        "robot_2": {
            "durations": {"Fetch": {"mean": 3}},
            "outcomes": {"Sort": {"probabilities": {"sorted": 0.9, "plug_in": 0.1}}},
            "failures": {"Fetch": {"probability": 0.1}},
        }
    },
    "rates": {"fetched": {"rate": 0.6}},
    "chance": ["Sort"],
    "events": {"unplug": {"topic": "door", "type": "std_msgs/Bool", "when": "data", "hold": True}},
    "tasks": {"done": ["sorted"]},
    "until": "Sorted >= 100 and 'Rest room' == 0",
    "seed": 7,
}

EVERYWHERE = """async (documents) => {
  const { renamed, without } = await import("/static/js/edit/rename.js");
  const found = [];
  for (const state of documents)
    for (const [kind, list] of [["place", "places"], ["transition", "transitions"]])
      for (const { name } of state.net[list]) {
        const there = { ...state, ...renamed(state, kind, name, "it's new") };
        const back = { ...there, ...renamed(there, kind, "it's new", name) };
        const { state: rest, said } = without(state, [`${kind}:${name}`]);
        found.push({ kind, name, there, same: JSON.stringify(back) === JSON.stringify(state), rest, said });
      }
  return found;
}"""


def document(data):
    plan = {key: value for key, value in data.items() if key not in ("net", "policy")}
    return {"plan": plan, "net": data["net"], "policy": data.get("policy")}


def plan_of(parts):
    data = {**parts["plan"], "net": parts["net"]}
    if parts["policy"] is not None:
        data["policy"] = parts["policy"]
    return plan_from_json(data)


def names_in(value):
    """All texts of a document, keys and values. An action server has a name of its own."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield key
            if key != "server":
                yield from names_in(item)
    elif isinstance(value, list):
        for item in value:
            yield from names_in(item)
    else:
        yield value


@pytest.fixture(name="open_editor")
def _open_editor(site, open_page, tmp_path):
    """Opens the plan of a folder in the mode EDIT; ``before(page)`` is called where it is opened."""

    def make(folder, before=lambda page: None):
        runs = str(tmp_path / "runs")
        project = Project(
            Folder(str(folder)), lambda opened: StandaloneRun(opened, runs), runs=runs, edits=True
        )
        page = open_page(site(project).address, ready=False, reduced_motion="reduce")
        page.wait_for_selector("#opening button")
        page.click("#opening button:has-text('plan.json')")
        page.wait_for_selector("body[data-ready]")
        before(page)
        page.click("#ed-open")
        page.wait_for_function("() => window.gspn?.edit")
        page.wait_for_selector("#ed-tab-policy")
        return page

    return make


@pytest.fixture(name="editor")
def _editor(open_editor, tmp_path):
    folder = tmp_path / "plan"
    folder.mkdir()
    (folder / "actions.py").write_text("def fetch():\n    pass\n\n\ndef sort():\n    pass\n")
    (folder / "plan.json").write_text(json.dumps(PLAN, indent=2))
    return open_editor(folder)


def state(page):
    return page.evaluate("() => gspn.edit.document.state")


def choose(page, *keys):
    page.evaluate("(keys) => gspn.edit.choose(keys)", list(keys))


def settle(page):
    """Wait until the panel that is shown is drawn as the document is."""
    page.wait_for_function(
        "() => gspn.edit.parts.every((part) => !part.stale || !part.element?.getClientRects().length)"
    )


def control(page, key):
    return page.locator("[data-key=%s]:visible" % json.dumps(key))


def enter(page, key, text):
    """Fill a field and leave it."""
    control(page, key).fill(text)
    page.keyboard.press("Tab")
    settle(page)


def unfold(page, panel):
    """Open every section of a panel, also those that are made meanwhile."""
    page.click("#ed-tab-%s" % panel)
    page.wait_for_selector("#ed-%s *" % panel)
    while page.evaluate(
        """(id) => {
          const closed = [...document.querySelectorAll(`#${id} details:not([open])`)];
          for (const details of closed) details.open = true;
          return closed.length;
        }""",
        "ed-%s" % panel,
    ):
        settle(page)


def keys_of(page):
    return set(
        page.evaluate(
            "() => [...document.querySelectorAll('.ed-form [data-key]')].map((it) => it.dataset.key)"
        )
    )


def test_a_node_is_renamed_and_removed_wherever_a_plan_names_it(editor):
    """Every node of the plan here and of the shipped plans gets another name and its own back; and is
    removed. What is left reads as a plan each time."""
    shipped = [
        json.loads(json.dumps(plan_to_short_json(read_plan(str(path)))))
        for path in sorted((ROOT / "plans").glob("*/plan.json"))
        if len(read_plan(str(path)).net.places) < 60
    ]
    documents = [document(data) for data in [PLAN, *shipped]]
    assert len(documents) > 4
    found = editor.evaluate(EVERYWHERE, documents)
    assert len(found) > 60
    for case in found:
        where = "%s %s" % (case["kind"], case["name"])
        assert case["same"], where
        assert case["name"] not in set(names_in(case["there"])), where
        assert plan_of(case["there"]).net
        assert case["name"] not in set(names_in(case["rest"])), where
        try:
            plan_of(case["rest"])
        except GspnError as error:
            pytest.fail("without %s: %s" % (where, error))
    gone = {case["name"]: case["said"] for case in found[:9]}
    assert "the robot 'robot_1', which starts there" in gone["Fetch"]
    assert "the column 'Rest room' of the policy" in gone["Rest room"]
    assert any("until" in text for text in gone["Sorted"])
    assert "row 2 of the policy, which chose nothing else" in gone["sorted"]
    # the texts of the condition and of the rules follow the names
    renamed = next(case for case in found if case["name"] == "Rest room")
    assert renamed["there"]["plan"]["until"] == 'Sorted >= 100 and "it\'s new" == 0'
    renamed = next(case for case in found if case["name"] == "plug_in")
    assert renamed["there"]["plan"]["on_failure"]["Sort"] == "fire it's new"
    # nothing else has changed: the plan with the other name is the same plan
    plan = plan_of(document(PLAN))
    assert plan_to_json(plan_of(found[0]["there"]))["seed"] == plan_to_json(plan)["seed"]


def test_properties_of_what_is_selected(editor, axe, picture):
    page = editor
    choose(page, "place:Fetch")
    # what is wrong is said at the field and stays out of the plan; typing is one edit
    before = state(page)
    name = "net.place:Fetch"
    tokens = control(page, name + ".tokens")
    tokens.fill("two")
    page.wait_for_selector("#ed-properties .wrong:has-text(\"'two' is not a number\")")
    assert tokens.get_attribute("aria-invalid") == "true"
    assert state(page) == before
    tokens.fill("")
    tokens.press_sequentially("31")
    assert state(page)["net"]["places"][0]["tokens"] == 31
    assert page.locator("#ed-properties [aria-invalid]").count() == 0
    page.click("#ed-undo")
    assert state(page) == before
    settle(page)
    assert tokens.input_value() == "2"
    # undo works from the keyboard in a field that was entered, and the focus stays
    capacity = control(page, name + ".capacity")
    capacity.fill("4")
    page.keyboard.press("Enter")
    assert state(page)["net"]["places"][0]["capacity"] == 4
    settle(page)
    page.keyboard.press("Control+z")
    assert state(page) == before
    assert page.evaluate("() => document.activeElement.dataset.key") == name + ".capacity"
    # a name: not one that is taken; then it is another everywhere, and stays selected
    enter(page, name + ".name", "sorted")
    page.wait_for_selector(
        "#ed-properties .wrong:has-text(\"there is a transition 'sorted' already\")"
    )
    enter(page, name + ".name", "Shelf")
    page.wait_for_selector("#ed-properties h2:has-text('Shelf')")
    now = state(page)
    assert "Fetch" not in set(names_in(now))
    assert now["plan"]["robots"] == {"robot_1": "Shelf", "robot_2": "Shelf"}
    page.click("#ed-undo")
    assert state(page) == before
    # a transition of the other kind keeps no key that does not apply
    choose(page, "transition:fetched")
    control(page, "net.transition:fetched.timed").select_option(label="immediate")
    assert set(state(page)["net"]["transitions"][0]) == {"name", "position"}
    page.click("#ed-undo")
    control(page, "net.transition:fetched.servers.endless").check()
    assert state(page)["net"]["transitions"][0]["servers"] is None
    # a rate may depend on the marking, and follows the names of places
    before = state(page)
    enter(page, "net.transition:fetched.rate", "0.5 * #Sort")
    assert state(page)["net"]["transitions"][0]["rate"] == "0.5 * #Sort"
    choose(page, "place:Sort")
    enter(page, "net.place:Sort.name", "Sort it")
    assert state(page)["net"]["transitions"][0]["rate"] == "0.5 * #'Sort it'"
    page.click("#ed-undo")
    page.click("#ed-undo")
    assert state(page) == before
    # several at once: what they have in common
    choose(page, "transition:sorted", "transition:plug_in")
    priority = control(page, "net.transition.priority")
    assert priority.input_value() == "1"
    assert control(page, "net.transition.weight").get_attribute("placeholder") == "several values"
    enter(page, "net.transition.priority", "4")
    assert [t.get("priority") for t in state(page)["net"]["transitions"]] == [None, 4, 4, None]
    # an arc, and the same arc after an edit that came from elsewhere
    choose(page, "arc:Charger>plug_in")
    enter(page, "net.arc:Charger>plug_in.weight", "2")
    assert state(page)["net"]["arcs"][6]["weight"] == 2
    control(page, "net.arc:Charger>plug_in.inhibitor").check()
    assert state(page)["net"]["arcs"][6]["inhibitor"] is True
    page.click("#ed-undo")
    settle(page)
    assert not control(page, "net.arc:Charger>plug_in.inhibitor").is_checked()
    # an action is chosen from what there is; one that is not whole yet stays in the form
    choose(page, "place:Sort")
    key = "plan.actions.Sort"
    control(page, key + " palette").select_option(label="actions.fetch")
    assert state(page)["plan"]["actions"]["Sort"] == "actions.fetch"
    page.click("#ed-undo")
    control(page, key + ".kind").select_option(label="a call of a service")
    page.wait_for_selector("#ed-properties .wrong:has-text('Not in the plan yet')")
    assert state(page)["plan"]["actions"]["Sort"] == "actions.sort"
    # it is red once somebody leaves the form as it is
    control(page, key + ".kind").focus()
    colour = (
        """() => getComputedStyle(document.querySelector("#ed-properties [data-verdict]")).color"""
    )
    filling_in = page.evaluate(colour)
    page.focus("#ed-search")
    assert page.evaluate(colour) != filling_in
    control(page, key + ".kind").focus()
    enter(page, key + ".service", "shelf")
    enter(page, key + ".type", "shelf_msgs/Put")  # not installed: any fields can be given
    assert state(page)["plan"]["actions"]["Sort"] == {
        "service": "shelf",
        "type": "shelf_msgs/Put",
    }
    page.wait_for_selector("#ed-properties .message :text('Any fields can be given here')")
    control(page, key + ".request add").fill("data")
    page.keyboard.press("Enter")
    control(page, key + ".request.data kind").select_option(label="from data")
    enter(page, key + ".request.data", "task.pose")
    control(page, key + ".outcomes add").select_option("aborted")
    control(page, key + ".outcomes.aborted").select_option(label="plug_in")
    assert state(page)["plan"]["actions"]["Sort"] == {
        "service": "shelf",
        "type": "shelf_msgs/Put",
        "request": {"data": {"from": "task.pose"}},
        "outcomes": {"aborted": "plug_in"},
    }
    # what was learned says from what; a value that is changed by hand no longer does
    choose(page, "place:Fetch")
    unfold(page, "properties")
    page.wait_for_selector(
        "#ed-properties :text('537 observations in run.jsonl; 95 % interval 1.18 to 2.2')"
    )
    picture(page, "edit_properties")
    axe(page, "the properties of a place")
    page.set_viewport_size({"width": 1440, "height": 900})
    enter(page, "plan.durations.Fetch.mean", "3")
    assert state(page)["plan"]["durations"]["Fetch"] == {
        "mean": 3,
        "distribution": "gamma",
        "shape": 4,
    }
    control(page, "plan.durations.Fetch.distribution").select_option("uniform")
    assert state(page)["plan"]["durations"]["Fetch"] == {
        "distribution": "uniform",
        "low": 1.5,
        "high": 4.5,
    }
    enter(page, "plan.durations.Fetch.low", "9")
    page.wait_for_selector("#ed-properties .wrong:has-text('low must be below high')")
    assert state(page)["plan"]["durations"]["Fetch"]["low"] == 1.5
    plan_of(state(page))


def test_a_function_that_is_missing_is_written_in_the_form(editor, axe, picture, tmp_path):
    page, file = editor, tmp_path / "plan" / "tasks.py"
    page.evaluate(
        """() => gspn.edit.document.edit("Set", ({ plan }) => ({ plan: { ...plan, actions: {
        ...plan.actions, Sort: { function: "tasks.sort", settings: { speed: 2, box: "red" } } } } }))"""
    )
    finding = "#ed-findings :text('no tasks.py')"
    page.wait_for_selector(finding, state="attached")
    choose(page, "place:Sort")
    control(page, "plan.actions.Sort write").click()
    area = page.locator("#ed-properties textarea")
    area.wait_for()
    said = "#ed-properties .source-text [role=status]"
    page.wait_for_selector(said + ":has-text('Parameters: speed: float, box: str')")
    stub = area.input_value()
    assert "Returns the transition to fire: plug_in, or sorted, or None" in stub
    # what is wrong is said with its line; a new line begins below the last one
    area.press("Control+End")
    page.keyboard.type("for")
    page.wait_for_selector(said + ".wrong:has-text('Line 8: invalid syntax')")
    area.fill(stub.replace("    return None\n", "    if box:"))
    area.press("Control+End")
    page.keyboard.press("Enter")
    page.keyboard.type("return 'sorted'")
    assert area.input_value().endswith("\n    if box:\n        return 'sorted'")
    page.wait_for_selector(said + ":not(.wrong):has-text('box: str')")
    # it is kept while something else is selected, and nothing is written before somebody says so
    choose(page, "place:Fetch")
    choose(page, "place:Sort")
    assert area.input_value().endswith("return 'sorted'") and not file.exists()
    picture(page, "function")
    axe(page, "a function is written")
    resize(page, 1280, 800)
    # and with the draft when one leaves, also if nothing else is unsaved
    page.keyboard.press("Control+s")
    page.wait_for_function("() => !gspn.edit.document.dirty")
    page.click("#ed-close")
    page.click("dialog button:has-text('Leave without saving')")
    page.click("#ed-open")
    page.click("#ed-draft-continue")
    assert not page.evaluate("() => gspn.edit.document.dirty")
    choose(page, "place:Sort")
    area.wait_for()
    assert area.input_value().endswith("return 'sorted'") and not file.exists()
    control(page, "source tasks.sort save").click()
    page.wait_for_selector(said + ":has-text('Written to tasks.py')")
    page.wait_for_selector(finding, state="detached")  # the check has seen it
    page.wait_for_selector("#ed-properties option:has-text('tasks.sort')", state="attached")
    made = load_action(str(tmp_path / "plan"), "tasks.sort", {"speed": 2, "box": "red"})
    context = ActionContext("Sort", "robot_1", no_feedback, Cancellation())
    assert made(context).transition == "sorted"
    # what somebody else wrote meanwhile is there when it is opened again
    text = file.read_text().replace("if box", "if not box")
    file.write_text(text)
    control(page, "source tasks.sort close").click()
    control(page, "plan.actions.Sort write").click()
    area.wait_for()
    assert area.input_value() == text
    # a module that ships with Python is not offered for writing
    with page.expect_response(lambda it: "edit/function" in it.url and it.json().get("problem")):
        page.evaluate(
            """() => gspn.edit.document.edit("Set", ({ plan }) => ({ plan: { ...plan, actions: {
            ...plan.actions, Sort: "json.dumps" } } }))"""
        )
    page.wait_for_selector("[data-key='plan.actions.Sort write']", state="detached")


def test_every_key_of_a_plan_has_a_form(editor, axe, picture):
    """The keys of the schema, compared with the controls of the panels."""
    page = editor
    before = state(page)
    whole = schema()
    kinds = {
        form["required"][0]: form
        for form in whole["definitions"]["action"]["oneOf"]
        if "required" in form
    }
    examples = {
        "function": {"function": "actions.fetch", "settings": {"speed": 1}},
        "server": {"server": "move_base"},
        "service": {"service": "s", "type": "a/B"},
        "publish": {"publish": "s", "type": "a/B"},
        "wait_for": {"wait_for": "s", "type": "a/B"},
        "command": {"command": ["ls"]},
        "plan": {"plan": "other.json", "entry": "A", "exit": "B"},
    }
    assert set(kinds) | {"plan"} == set(examples)
    page.evaluate(
        """(examples) => gspn.edit.document.edit("all kinds", ({ plan, net }) => ({
          plan: {
            ...plan,
            actions: Object.fromEntries(Object.entries(examples).map(([kind, it]) => [`P_${kind}`, it])),
            robots: [{ name: "r", place: "P_server", actions: { P_server: examples.command } }],
            durations: Object.fromEntries([["gamma", { shape: 1, mean: 1 }], ["erlang", { phases: 2, mean: 1 }],
              ["lognormal", { sigma: 1, mean: 1 }], ["uniform", { low: 1, high: 2 }], ["empirical", { quantiles: [1, 2] }],
              ["hyper-erlang", { branches: [{ probability: 1, phases: 1, mean: 1 }] }]]
              .map(([distribution, rest]) => [`P_${distribution}`, { distribution, ...rest, of: { observations: 3 } }])),
            agreement: { evict_after: 5 },
            on_failure: { "*": { retry: 3, delay: 1 } },
          },
          net: { ...net, places: [...net.places, ...Object.keys(examples).map((kind) => ({ name: `P_${kind}` }))] },
        }))""",
        examples,
    )
    unfold(page, "plan")
    keys = keys_of(page)
    picture(page, "edit_plan")

    def has(key):
        return any(found == key or found.startswith((key + ".", key + " ")) for found in keys)

    missing = [
        key
        for key in whole["properties"]
        if key not in ("net", "policy", "subnets") and not has("plan." + key)
    ]
    definitions = whole["definitions"]
    for kind, form in [*kinds.items(), ("plan", definitions["subnet"])]:
        own = "kind" if kind == "function" else kind
        wanted = set(form["properties"]) - ({"function"} if own == "kind" else set())
        missing += [
            "%s: %s" % (kind, key)
            for key in wanted
            if not has("plan.actions.P_%s.%s" % (kind, key))
        ]
    for key in definitions["duration"]["properties"]:
        if not any(
            has("plan.durations.P_%s.%s" % (kind, key))
            for kind in definitions["duration"]["properties"]["distribution"]["enum"]
        ):
            missing.append("duration: " + key)
    for path, part in (
        ("plan.events.unplug", whole["properties"]["events"]["additionalProperties"]),
        ("plan.agreement", whole["properties"]["agreement"]),
        ("plan.tasks", whole["properties"]["tasks"]),
        ("plan.outcomes.Sort", whole["properties"]["outcomes"]["additionalProperties"]),
        ("plan.failures.Fetch", whole["properties"]["failures"]["additionalProperties"]),
        ("plan.own_times.robot_2", whole["properties"]["own_times"]["additionalProperties"]),
        ("plan.rates.fetched", whole["properties"]["rates"]["additionalProperties"]),
        ("plan.durations.P_gamma.of", definitions["evidence"]),
        (
            "plan.durations.P_hyper-erlang.branches.0",
            definitions["duration"]["properties"]["branches"]["items"],
        ),
        ("plan.robots.0", whole["properties"]["robots"]["oneOf"][1]["items"]),
        (
            "plan.on_failure.*",
            whole["properties"]["on_failure"]["additionalProperties"]["oneOf"][1],
        ),
    ):
        missing += [
            "%s.%s" % (path, key) for key in part["properties"] if not has("%s.%s" % (path, key))
        ]
    assert not missing
    net = definitions["net"]["properties"]
    page.click("#ed-tab-properties")
    for key, part in (
        ("place:Fetch", "places"),
        ("transition:unplug", "transitions"),
        ("transition:sorted", "transitions"),
        ("arc:Fetch>fetched", "arcs"),
    ):
        choose(page, key)
        page.wait_for_selector("#ed-properties h2")
        settle(page)
        keys = keys_of(page)
        timed = key == "transition:unplug"
        other = (
            {"weight", "priority"}
            if timed
            else {"rate", "servers"}
            if part == "transitions"
            else {"from", "to"}
        )
        assert [
            k
            for k in net[part]["items"]["properties"]
            if k not in other and not has("net.%s.%s" % (key, k))
        ] == []
    choose(page)
    # the plan as a whole: robots, a condition, a time-out, an event, parameters
    page.click("#ed-undo")
    assert state(page) == before
    unfold(page, "plan")
    enter(page, "plan.until", "Gone >= 1")
    page.wait_for_selector("#ed-plan .wrong:has-text(\"there is no place 'Gone'\")")
    enter(page, "plan.until", "Sorted >= 5")
    page.click("[data-key='plan.robots add']")
    enter(page, "plan.robots.2.name", "robot_1")
    page.wait_for_selector("#ed-plan .wrong:has-text('another robot has this name')")
    enter(page, "plan.robots.2.name", "carrier")
    control(page, "plan.timeout add").select_option("*")
    enter(page, "plan.timeout.*", "0")
    page.wait_for_selector("#ed-plan .wrong:has-text('more than 0')")
    enter(page, "plan.timeout.*", "90")
    enter(page, "plan.events.unplug.topic", "")
    page.wait_for_selector("#ed-plan .wrong:has-text('type needs topic')")
    enter(page, "plan.events.unplug.topic", "gate")
    control(page, "plan.parameters add").fill("speed")
    page.keyboard.press("Enter")
    enter(page, "plan.parameters.speed", "fast")
    now = state(page)["plan"]
    assert now["until"] == "Sorted >= 5"
    assert now["robots"] == {"robot_1": "Fetch", "robot_2": "Fetch", "carrier": "Fetch"}
    assert now["timeout"] == {"Sort": 60, "*": 90}
    assert now["events"]["unplug"] == {**PLAN["events"]["unplug"], "topic": "gate"}
    assert now["parameters"] == {"speed": "fast"}
    plan_of(state(page))
    axe(page, "the plan")


def test_the_goal_of_an_action_has_the_fields_of_its_type(editor, axe, picture):
    """Types of ROS: fields with their defaults, nested, lists, data; without the type, any fields."""
    pytest.importorskip("move_base_msgs.msg")
    page = editor
    goal = "plan.actions.Fetch.goal"
    page.evaluate(
        """() => gspn.edit.document.edit("goal", ({ plan }) => ({ plan: { ...plan, actions: { ...plan.actions,
          Fetch: { server: "move_base", type: "move_base_msgs/MoveBaseAction", goal: { speed: 3 } } } } }))"""
    )
    choose(page, "place:Fetch")
    page.wait_for_selector("#ed-properties .message .typed-part")
    page.wait_for_selector("#ed-properties .wrong:has-text('The type has no field of this name')")
    control(page, goal + ".speed remove").click()
    unfold(page, "properties")
    enter(page, goal + ".target_pose.header.frame_id", "map")
    enter(page, goal + ".target_pose.header.stamp", "now")
    enter(page, goal + ".target_pose.header.seq", "-1")
    page.wait_for_selector("#ed-properties .wrong:has-text('uint32 must be from 0 to 4294967295')")
    enter(page, goal + ".target_pose.header.seq", "")
    enter(page, goal + ".target_pose.pose.position.x", "2.5")
    control(page, goal + ".target_pose.pose.orientation source").click()
    enter(page, goal + ".target_pose.pose.orientation", "task.heading")
    picture(page, "edit_goal")
    axe(page, "a goal")

    def action(place="Fetch"):
        return state(page)["plan"]["actions"][place]

    assert action()["goal"] == {
        "target_pose": {
            "header": {"frame_id": "map", "stamp": "now"},
            "pose": {"position": {"x": 2.5}, "orientation": {"from": "task.heading"}},
        }
    }
    # what is emptied is not written: the field has its default
    enter(page, goal + ".target_pose.pose.position.x", "")
    control(page, goal + ".target_pose.pose.orientation source").click()
    assert action()["goal"] == {"target_pose": {"header": {"frame_id": "map", "stamp": "now"}}}

    # a message with lists, of messages and of numbers of which there are 36
    path = "plan.actions.Sort"
    page.evaluate(
        """() => gspn.edit.document.edit("message", ({ plan }) => ({ plan: { ...plan, actions: { ...plan.actions,
          Sort: { publish: "poses", type: "geometry_msgs/PoseArray" },
          "Rest room": { publish: "pose", type: "geometry_msgs/PoseWithCovariance" } } } }))"""
    )
    choose(page, "place:Sort")
    page.wait_for_selector("#ed-properties .message:has(code:has-text('PoseArray')) .typed-part")
    unfold(page, "properties")
    control(page, path + ".message.poses add").click()
    control(page, path + ".message.poses add").click()
    unfold(page, "properties")
    enter(page, path + ".message.poses.1.position.y", "4")
    control(page, path + ".message.poses.0 source").click()
    assert action("Sort")["message"] == {"poses": [{"from": "task.id"}, {"position": {"y": 4}}]}
    choose(page, "place:Rest room")
    page.wait_for_selector(
        "#ed-properties .message:has(code:has-text('PoseWithCovariance')) .typed-part"
    )
    unfold(page, "properties")
    field = "plan.actions.Rest room.message.covariance"
    enter(page, field, "1 2")
    page.wait_for_selector("#ed-properties .wrong:has-text('36 numbers are needed')")
    enter(page, field, "0 " * 36)
    assert action("Rest room")["message"]["covariance"] == [0] * 36
    plan_of(state(page))

    # a type that is not here: any fields can be given, and the form says why
    enter(page, "plan.actions.Rest room.type", "nowhere/Pose")
    page.wait_for_selector(
        "#ed-properties .message .muted:has-text(\"no message type 'nowhere/Pose'\")"
    )
    control(page, "plan.actions.Rest room.message add").fill("speed")
    page.keyboard.press("Enter")
    enter(page, "plan.actions.Rest room.message.speed", "fast")
    assert action("Rest room")["message"]["speed"] == "fast"


def test_a_subnet_and_data_that_is_kept(open_editor, tmp_path, picture):
    """Keys inside actions: the files, parameters and resources of other plans, fields of results."""
    pytest.importorskip("std_srvs.srv")
    folder = tmp_path / "plan"
    folder.mkdir()
    dock = {
        "plan": "dock",
        "net": {
            "places": [{"name": "Approach"}, {"name": "Docked"}, {"name": "Plug", "tokens": 1}],
            "transitions": [{"name": "docked", "timed": True, "rate": 1}],
            "arcs": [
                {"from": "Approach", "to": "docked"},
                {"from": "docked", "to": "Docked"},
                {"from": "docked", "to": "Plug"},
                {"from": "Plug", "to": "docked"},
            ],
        },
        "actions": {"Approach": None, "Docked": None},
        "resource_places": ["Plug"],
        "parameters": {"station": "here"},
    }
    (folder / "dock.json").write_text(json.dumps(dock))
    of_one_place = ("on_failure", "timeout", "outcomes", "own_times", "chance", "routing")
    plan = {key: value for key, value in PLAN.items() if key not in of_one_place}
    (folder / "plan.json").write_text(json.dumps(plan))
    page = open_editor(folder)
    choose(page, "place:Sort")
    path = "plan.actions.Sort"
    control(page, path + ".kind").select_option(label="another plan (subnet)")
    page.wait_for_selector("#ed-properties [data-key='plan.actions.Sort palette']")
    control(page, path + " palette").select_option(label="dock.json")
    settle(page)
    control(page, path + ".with add").fill("station")
    page.keyboard.press("Enter")
    enter(page, path + ".with.station", "left")
    offered = "(input) => [...input.list.options].map(({ value }) => value)"
    assert control(page, path + ".with add").evaluate(offered) == ["station"]
    assert control(page, path + ".share add").evaluate(offered) == ["Plug"]
    control(page, path + ".share add").fill("Plug")
    page.keyboard.press("Enter")
    settle(page)
    assert state(page)["plan"]["actions"]["Sort"] == {
        "plan": "dock.json",
        "entry": "Approach",
        "exit": "Docked",
        "with": {"station": "left"},
        "share": {"Plug": "Charger"},
    }
    picture(page, "edit_subnet")
    # what a service returns is kept as data: its fields are offered
    choose(page, "place:Fetch")
    control(page, "plan.actions.Fetch.kind").select_option(label="a call of a service")
    settle(page)
    enter(page, "plan.actions.Fetch.service", "look")
    enter(page, "plan.actions.Fetch.type", "std_srvs/Trigger")
    page.wait_for_selector("#ed-properties .message:has-text('It has no fields')")
    control(page, "plan.actions.Fetch.keep add").fill("shelf")
    page.keyboard.press("Enter")
    settle(page)
    field = "plan.actions.Fetch.keep.shelf"
    assert control(page, field).evaluate(offered) == ["success", "message"]
    enter(page, field, "message")
    assert state(page)["plan"]["actions"]["Fetch"]["keep"] == {"shelf": "message"}
    # and the subnet opens from its form
    page.keyboard.press("Control+s")
    page.wait_for_function("() => !gspn.edit.document.dirty")
    choose(page, "place:Sort")
    control(page, path + " open").click()
    page.wait_for_selector("#ed-crumbs strong:has-text('dock.json')")


def test_the_policy_as_a_table(editor, axe, picture):
    page = editor
    before = state(page)
    page.click("#ed-tab-policy")
    page.wait_for_selector("#ed-policy table")
    row = "policy.rows.0"
    # probabilities enter the plan when they add up to 1
    enter(page, row + ".choose.sorted", "0.5")
    page.wait_for_selector("#ed-policy .wrong:has-text('add up to 0.7, not 1')")
    assert state(page)["policy"] == PLAN["policy"]
    enter(page, row + ".choose.plug_in", "0.5")
    assert state(page)["policy"]["rows"][0]["choose"] == {"sorted": 0.5, "plug_in": 0.5}
    assert page.locator("#ed-policy .wrong:visible").count() == 0
    enter(page, row + ".marking.0", "many")
    page.wait_for_selector("#ed-policy .wrong:has-text('a comparison such as >= 1, or - for any')")
    assert page.locator("#ed-policy .meets").all_text_contents() == [
        "goes before row 2",
        "row 1 goes first",
    ]
    enter(page, "policy.rows.1.marking.0", " !=1")
    assert state(page)["policy"]["rows"][1]["marking"] == ["!= 1", "-"]
    assert page.locator("#ed-policy .meets").all_text_contents() == ["", ""]
    enter(page, "policy.rows.1.marking.0", "> 0")
    assert page.locator("#ed-policy .meets").all_text_contents() == [
        "goes before row 2",
        "row 1 goes first",
    ]
    enter(page, "policy.rows.1.marking.0", "-")
    enter(page, row + ".marking.0", "2")
    # two columns need no sideways scroll, and no button needs a rare glyph
    for width in (1280, 1024):
        resize(page, width, 720)
        wide, shown = page.locator("#ed-policy .scroll").first.evaluate(
            "(element) => [element.scrollWidth, element.clientWidth]"
        )
        assert wide <= shown, width
    assert control(page, row + " Duplicate").locator("svg path").count() == 1
    picture(page, "edit_policy_1024")
    # rows: duplicated (which never applies, and is marked), moved, removed; columns
    control(page, row + " Duplicate").click()
    page.wait_for_selector("#ed-policy tr.marked:has-text('this row never applies')")
    assert len(state(page)["policy"]["rows"]) == 3
    control(page, "policy.rows.1 Move down").click()
    assert [r["marking"] for r in state(page)["policy"]["rows"]] == [[2, "-"], ["-", "-"], [2, "-"]]
    control(page, "policy.rows.2 remove").click()
    control(page, "policy.places add").select_option("Sort")
    assert state(page)["policy"]["places"] == ["Charger", "Rest room", "Sort"]
    assert [r["marking"] for r in state(page)["policy"]["rows"]] == [[2, "-", "-"], ["-", "-", "-"]]
    control(page, "policy.places.Charger remove").click()
    assert [r["marking"] for r in state(page)["policy"]["rows"]] == [["-", "-"], ["-", "-"]]
    control(page, "policy.rows add").click()
    settle(page)
    assert page.evaluate("() => document.activeElement.dataset.key") == "policy.rows.2.marking.0"
    control(page, "policy.rows.2.choose.plug_in name").select_option(label="sorted")
    assert state(page)["policy"]["rows"][2]["choose"] == {"sorted": 1}
    # a finding of the check is shown at its row
    page.evaluate(
        """() => {
          gspn.edit.findings = [{ level: "warning", text: "it is never reached", elements: [{ kind: "row", name: "3" }] }];
          gspn.edit.dispatchEvent(new CustomEvent("findings", { detail: gspn.edit.findings }));
        }"""
    )
    page.wait_for_selector("#ed-policy tr.marked:has-text('it is never reached')")
    picture(page, "edit_policy")
    axe(page, "the policy")
    plan_of(state(page))
    while page.is_enabled("#ed-undo"):
        page.click("#ed-undo")
    assert state(page) == before


OPTIMISE = """async () => {
  const { get, post } = await import("/static/js/api.js");
  const rewards = [{ name: "fast_done", value: "1" }, { name: "slow_done", value: "1" }];
  const optimise = { aim: "long_run", maximise: true, rewards, simulated: "0" };
  const { job } = await post("analysis", { optimise, limit: 1000, seconds: 60 }, { id: gspn.page.model.session.id });
  for (;;) {
    const { state, error } = await get(`analysis/${job}`);
    if (state === "done") return "";
    if (state !== "running" && state !== "waiting") return error || state;
    await new Promise((resolve) => setTimeout(resolve, 200));
  }
}"""


def test_rows_that_the_optimiser_proposes_are_taken_over(open_editor, tmp_path):
    folder = tmp_path / "plan"
    folder.mkdir()
    write_shop(folder)

    def compute(page):
        assert page.evaluate(OPTIMISE) == ""

    page = open_editor(folder, compute)
    page.click("#ed-tab-policy")
    page.click("summary:has-text('Rows that the optimiser proposes')")
    page.click("text=Look for a computed policy")
    page.wait_for_selector("#ed-policy td:has-text('take_fast') >> nth=0")
    before = state(page)
    page.click("[aria-label^='Take over the proposed row'] >> nth=0")
    row = state(page)["policy"]["rows"][-1]
    assert row["choose"] == {"take_fast": 1}
    assert plan_of(state(page)).policy.rows
    page.click("#ed-undo")
    assert state(page) == before
    page.click("text=Take over the whole policy")
    page.wait_for_function("() => gspn.edit.document.dirty")
    assert state(page)["policy"]["rows"] != before["policy"]["rows"]
    plan_of(state(page))


def test_what_other_packages_add_has_a_form(open_editor, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "test" / "unit" / "seams"))
    from toys import toy_family, toy_rule, toy_source

    monkeypatch.setitem(FAILURE_KINDS, "patience", toy_rule.PATIENCE)
    monkeypatch.setitem(FAMILIES, "at-least", toy_family.AT_LEAST)
    monkeypatch.setitem(SOURCE_KINDS, "timer", toy_source.TIMER)
    rule = {"patience": 2, "delay": 1, "then": "fire plug_in"}
    timer = {"unplug": {"timer": {"minutes": 2}}}
    (tmp_path / "plan").mkdir()
    (tmp_path / "plan" / "plan.json").write_text(
        json.dumps({**PLAN, "on_failure": {"Sort": rule}, "events": timer})
    )
    page = open_editor(tmp_path / "plan")
    unfold(page, "plan")
    enter(page, "plan.on_failure.Sort.delay", "0.5")
    enter(page, "plan.events.unplug.timer.minutes", "3")
    control(page, "plan.durations.Fetch.distribution").select_option(label="at-least")
    settle(page)
    enter(page, "plan.durations.Fetch.least", "4")
    plan = state(page)["plan"]
    assert plan["on_failure"]["Sort"] == {**rule, "delay": 0.5}
    assert plan["events"] == {"unplug": {"timer": {"minutes": 3}}}
    assert plan["durations"]["Fetch"] == {"distribution": "at-least", "least": 4, "rest": 1}
    # it can be chosen for a place, and follows the names
    control(page, "plan.on_failure.Sort").select_option(label="stop the team")
    assert state(page)["plan"]["on_failure"]["Sort"] == "stop"
    control(page, "plan.on_failure.Sort").select_option(label="be patient, then fire")
    settle(page)
    assert state(page)["plan"]["on_failure"]["Sort"]["patience"] == 3
    page.click("#ed-undo")
    page.click("#ed-undo")
    found = page.evaluate(EVERYWHERE, [state(page)])
    there = next(case["there"] for case in found if case["name"] == "plug_in")
    assert there["plan"]["on_failure"]["Sort"]["then"] == "fire it's new"
