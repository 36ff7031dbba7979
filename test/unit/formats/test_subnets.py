"""Subnets: a place of a plan whose action is another plan."""

import json
import re
import shutil

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats import subnets
from gspn_framework_package.formats.plan_file import plan_document, read_plan
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.model.action import FunctionAction, ServerAction
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.subnet import Subnet

DOCK = {
    "plan": "dock",
    "parameters": {"station": "A", "pose": [0, 0]},
    "net": {
        "places": [
            {"name": "Approach"},
            {"name": "Wait"},
            {"name": "Docked"},
            {"name": "Station", "tokens": 1},
            {"name": "Gate", "tokens": 1},
        ],
        "transitions": [
            {"name": "arrive", "timed": True, "rate": 2},
            {"name": "plug"},
            {"name": "again"},
            {"name": "alarm", "timed": True, "rate": 0.5},
        ],
        "arcs": [
            {"from": "Approach", "to": "arrive"},
            {"from": "arrive", "to": "Wait"},
            {"from": "Wait", "to": "plug"},
            {"from": "Station", "to": "plug"},
            {"from": "plug", "to": "Docked"},
            {"from": "Wait", "to": "again"},
            {"from": "again", "to": "Approach"},
            {"from": "Approach", "to": "alarm"},
            {"from": "alarm", "to": "Wait"},
        ],
    },
    "policy": {
        "places": ["Station"],
        "rows": [
            {"marking": [1], "choose": {"plug": 1}},
            {"marking": [0], "choose": {"again": 1}},
        ],
    },
    "actions": {
        "Approach": {
            "type": "move_base_msgs/MoveBaseAction",
            "server": "move_base",
            "goal": {"frame": "map_${station}", "pose": "${pose}", "text": "$${kept}"},
            "outcomes": {"succeeded": "arrive"},
        },
        "Wait": "actions.wait",
        "Docked": None,
    },
    "resource_places": ["Station", "Gate"],
    "robots": {"alone": "Approach"},
    "timeout": {"Approach": 30, "*": 60},
    "on_failure": {"Wait": "fire again", "*": {"retry": 2}},
    "on_evict": {"Docked": {"Station": 1}},
    "durations": {"Approach": {"mean": 4}},
    "rates": {"arrive": {"rate": 3, "of": {"observations": 9}}},
    "events": {"alarm": {"topic": "alarm_${station}", "type": "std_msgs/Bool", "when": "data"}},
    "chance": ["Wait"],
}
HOME = {
    "plan": "home",
    "net": {
        "places": [
            {"name": "Work", "tokens": 1},
            {"name": "Left", "tokens": 1},
            {"name": "Right"},
            {"name": "Field", "tokens": 1},
        ],
        "transitions": [
            {"name": "go", "timed": True, "rate": 1},
            {"name": "stay"},
            {"name": "leave"},
            {"name": "back", "timed": True, "rate": 0.1},
        ],
        "arcs": [
            {"from": "Work", "to": "go"},
            {"from": "go", "to": "Left"},
            {"from": "Left", "to": "stay"},
            {"from": "stay", "to": "Right"},
            {"from": "Left", "to": "leave"},
            {"from": "leave", "to": "Work"},
            {"from": "Right", "to": "back"},
            {"from": "back", "to": "Work"},
        ],
    },
    "policy": {
        "places": ["Work"],
        "rows": [{"marking": ["-"], "choose": {"leave": 0.5, "stay": 0.5}}],
    },
    "actions": {
        "Work": "actions.work",
        "Left": {
            "plan": "dock",
            "entry": "Approach",
            "exit": "Docked",
            "with": {"station": "left", "pose": {"from": "task.pose"}},
        },
        "Right": {
            "plan": "dock",
            "entry": "Approach",
            "exit": "Docked",
            "share": {"Gate": "Field"},
        },
    },
    "resource_places": ["Field"],
    "robots": {"robot_1": "Work", "robot_2": "Left"},
    "spawn": ["Left", "Work"],
    "timeout": {"Left.Approach": 5},
    "chance": ["Left"],
    "on_evict": {"Left": {"Field": 1}},
}


def changed(data, **changes):
    return {**json.loads(json.dumps(data)), **changes}


@pytest.fixture
def folder(tmp_path):
    """A folder with the two plans; call it to write them, changed."""

    def write(home=HOME, dock=DOCK, **more):
        for name, data in {"home.json": home, "dock/plan.json": dock, **more}.items():
            file = tmp_path / name
            file.parent.mkdir(exist_ok=True)
            file.write_text(json.dumps(data, indent=1))
        return str(tmp_path / "home.json")

    return write


def test_a_subnet_comes_with_all_that_its_plan_says(folder):
    plan = read_plan(folder())
    assert [p.name for p in plan.net.places] == [
        "Work",
        *("Left." + name for name in ("Approach", "Wait", "Docked", "Station", "Gate")),
        *("Right." + name for name in ("Approach", "Wait", "Docked", "Station")),
        "Field",
    ]
    left, right = plan.actions["Left.Approach"], plan.actions["Right.Approach"]
    assert isinstance(left, ServerAction) and isinstance(right, ServerAction)
    assert left.server == right.server == "move_base"
    assert left.goal == {"frame": "map_left", "pose": {"from": "task.pose"}, "text": "${kept}"}
    assert right.goal == {"frame": "map_A", "pose": [0, 0], "text": "${kept}"}
    assert left.outcomes == {"succeeded": "Left.arrive"}
    assert plan.actions["Left.Wait"] == FunctionAction("dock/actions.wait", "Left_Wait")
    assert plan.actions["Left.Docked"] is None and "Left" not in plan.actions
    assert plan.resource_places == {
        "Field",
        "Left.Station",
        "Left.Gate",
        "Right.Station",
    }
    # robots of the subnet's own plan stay at home; those of the place start at its entry
    assert {r.name: r.place for r in plan.robots} == {"robot_1": "Work", "robot_2": "Left.Approach"}
    assert plan.spawn == ("Left.Approach", "Work")
    assert plan.net.named(plan.net.initial_marking, zeros=False) == {
        "Work": 1,
        "Left.Approach": 1,
        "Left.Station": 1,
        "Left.Gate": 1,
        "Right.Station": 1,
        "Field": 1,
    }
    assert plan.timeouts == {
        "Left.Approach": 5,
        "Left.Wait": 60,
        "Left.Docked": 60,
        "Right.Approach": 30,
        "Right.Wait": 60,
        "Right.Docked": 60,
    }
    rule = plan.failure_rule("Right.Wait")
    assert (rule.kind, rule.transition) == ("fire", "Right.again")
    assert plan.failure_rule("Right.Approach").times == 2
    assert plan.failure_rule("Work").kind == "wait"
    assert plan.on_evict == {
        "Left.Approach": {"Field": 1},
        "Left.Wait": {"Field": 1},
        "Left.Docked": {"Left.Station": 1, "Field": 1},
        "Right.Docked": {"Right.Station": 1},
    }
    assert plan.durations["Left.Approach"].mean == 4
    assert plan.net.transition("Right.arrive").rate == 3
    assert plan.file_net.transition("Right.arrive").rate == 2
    assert plan.evidence["rates", "Right.arrive"].observations == 9
    assert plan.events["Left.alarm"].topic == "alarm_left"
    assert plan.events["Right.alarm"].topic == "alarm_A"
    assert plan.chance == {"Left.Docked", "Left.Wait", "Right.Wait"}
    assert plan.subnets["Right"] == Subnet(
        "dock",
        "Right.Approach",
        "Right.Docked",
        ("Right.Approach", "Right.Wait", "Right.Docked", "Right.Station"),
        ("Right.arrive", "Right.plug", "Right.again", "Right.alarm"),
    )


def test_tokens_of_a_resource_in_a_subnet_are_no_robots(folder):
    unnamed = {key: value for key, value in HOME.items() if key != "robots"}
    plan = read_plan(folder(unnamed))
    assert [robot.place for robot in plan.robots] == ["Work", "Left.Approach"]


def test_each_policy_decides_for_its_own_places(folder):
    plan = read_plan(folder())
    table, net = plan.policy.bind(plan.net), plan.net

    def says(place, **tokens):
        marking = [tokens.get(p.name.replace(".", "_"), 0) for p in net.places]
        found = table.distribution(marking, net.place_number(place))
        if found is None:
            return table.matches(marking, net.place_number(place))
        return {net.transitions[t].name: p for t, p in found.choices}

    assert says("Left.Docked") == {"leave": 0.5, "stay": 0.5}
    assert says("Left.Wait", Left_Station=1) == {"Left.plug": 1}
    assert says("Left.Wait") == says("Left.Wait", Right_Station=1) == {"Left.again": 1}
    assert says("Left.Wait", Left_Station=2) is False  # no row of its own: the weights decide
    assert says("Right.Wait", Right_Station=1) == {"Right.plug": 1}
    assert says("Right.Docked") is True  # the outer policy has a row, but none for this place


def test_a_row_in_which_a_subnet_waits_lets_nobody_else_wait(folder):
    waits = {"places": ["Station"], "rows": [{"marking": ["-"], "choose": {}}]}
    plan = read_plan(folder(dock=changed(DOCK, policy=waits)))
    table, net = plan.policy.bind(plan.net), plan.net
    inside = table.distribution(net.initial_marking, net.place_number("Left.Wait"))
    assert inside is not None and not inside.choices
    outside = table.distribution(net.initial_marking, net.place_number("Left.Docked"))
    assert outside is not None and len(outside.choices) == 2
    assert table.overlaps() == []


def test_a_plan_with_subnets_is_written_and_read_as_a_whole(folder):
    plan = read_plan(folder())
    data = json.loads(json.dumps(plan_to_json(plan)))
    again = plan_from_json(data)
    assert again.hash() == plan.hash()
    assert again.subnets == plan.subnets and again.policy == plan.policy
    assert again.events == plan.events and again.actions == plan.actions
    assert plan_to_json(again) == data


def test_a_new_plan_keeps_its_subnets_unless_it_needs_another_net(folder, tmp_path):
    file = folder()
    plan = read_plan(file)
    learned = plan.with_rates({"Left.arrive": 7.0})
    data = plan_document(file, learned, str(tmp_path))
    assert data["actions"]["Left"]["plan"] == "dock"
    (tmp_path / "learned.json").write_text(json.dumps(data))
    again = read_plan(str(tmp_path / "learned.json"))
    assert again.net.transition("Left.arrive").rate == 7
    assert again.net.transition("Right.arrive").rate == 3
    assert again.file_net.transition("Left.arrive").rate == 2
    whole = plan_document(file, learned, str(tmp_path / "elsewhere"))
    assert plan_from_json(whole).hash() == learned.hash()


def test_nested_subnets(folder):
    arm = changed(
        DOCK, plan="arm", policy={"places": [], "rows": []}, chance=[], parameters={"station": "x"}
    )
    arm["actions"]["Approach"]["goal"] = {"which": "${station}"}
    dock = changed(DOCK)
    dock["actions"]["Approach"] = {
        "plan": "../arm.json",
        "entry": "Approach",
        "exit": "Docked",
        "with": {"station": "arm of ${station}"},
    }
    dock["actions"]["Wait"] = None
    del dock["timeout"]["Approach"], dock["durations"]
    dock["events"] = {}
    plan = read_plan(folder(changed(HOME, timeout={}), dock, **{"arm.json": arm}))
    assert plan.actions["Left.Approach.Approach"].goal == {"which": "arm of left"}
    assert plan.actions["Left.Approach.Wait"].function == "actions.wait"
    assert plan.subnets["Left"].entry == "Left.Approach.Approach"
    assert plan.subnets["Left.Approach"].parent == "Left"
    assert set(plan.subnets["Left.Approach"].places) < set(plan.subnets["Left"].places)
    assert plan.subnet_of("Left.Approach.Wait") == "Left.Approach"
    assert plan.subnet_of("Left.Wait") == "Left" and plan.subnet_of("Work") == ""
    assert {r.name: r.place for r in plan.robots}["robot_2"] == "Left.Approach.Approach"
    assert plan.decided_in("Left") == ("Left.Approach.Docked", "Left.Wait")
    # the arm has no policy: there the weights decide, whatever rows others have
    table, p = plan.policy.bind(plan.net), plan.net.place_number("Left.Approach.Wait")
    assert table.distribution(plan.net.initial_marking, p) is None
    assert not table.matches(plan.net.initial_marking, p)
    assert plan_from_json(plan_to_json(plan)).policy == plan.policy


def test_an_action_says_the_names_of_its_own_plan(folder):
    plan = read_plan(folder())
    assert plan.transition_meant("Left.Approach", "arrive") == "Left.arrive"
    assert plan.transition_meant("Left.Docked", "leave") == "leave"
    assert plan.transition_meant("Left.Approach", "plug") == "plug"  # does not leave: left as it is
    assert plan.transition_meant("Left.Approach", "") == ""
    assert plan.transition_meant("Work", "go") == "go"


def test_a_run_goes_through_a_subnet_with_its_own_functions(folder, tmp_path):
    dock = changed(DOCK, events={})
    dock["actions"]["Approach"] = {
        "function": "actions.approach",
        "settings": {"station": "${station}"},
    }
    file = folder(dock=dock)
    (tmp_path / "actions.py").write_text("def work():\n    return 'go'\n")
    (tmp_path / "dock" / "actions.py").write_text(
        "from names import ARRIVE\n"
        "def approach(station):\n    return ARRIVE, {'station': station}\n"
        "def wait():\n    pass\n"
    )
    (tmp_path / "dock" / "names.py").write_text("ARRIVE = 'arrive'\n")
    fired = []

    class Record(Listener):
        def on_step(self, slot, entries, firings, state):
            fired.extend(firing.transition for firing in firings)

    run = StandaloneExecutor(read_plan(file).for_robots(1), Record(), firing_limit=3)
    run.start()
    run.wait(60)
    assert fired[:3] == ["go", "Left.arrive", "Left.plug"]


def edit(path, value):
    """Changes of a plan: sets the element at ``path``."""

    def apply(data):
        data = changed(data)
        part = data
        for step in path[:-1]:
            part = part[step]
        part[path[-1]] = value
        return data

    return apply


LEFT = HOME["actions"]["Left"]


@pytest.mark.parametrize(
    "home, dock, file, text",
    [
        (edit(["actions", "Left", "entry"], "Nowhere"), None, "home.json", "'Nowhere' is not an"),
        (edit(["actions", "Left", "exit"], "Station"), None, "home.json", "'Station' is not an"),
        (edit(["actions", "Left", "plan"], "no.json"), None, "no.json", "no.json"),
        (edit(["actions", "Left", "with"], {"x": 1}), None, "plan.json", "no parameter 'x'"),
        (
            edit(["actions", "Left", "share"], {"Wait": "Field"}),
            None,
            "home.json",
            "not a resource",
        ),
        (edit(["actions", "Left", "share"], {"Gate": "Work"}), None, "home.json", "not a resource"),
        (edit(["actions", "Nowhere"], LEFT), None, "home.json", "no place 'Nowhere'"),
        (edit(["timeout"], {"Left": 5}), None, "home.json:", "Left.PLACE"),
        (edit(["durations"], {"Left": {"mean": 5}}), None, "home.json:", "is a subnet"),
        (edit(["until"], "Left >= 1"), None, "home.json:", "is a subnet"),
        (edit(["policy", "places"], ["Left"]), None, "home.json", "is a subnet"),
        (
            edit(["policy", "rows", 0, "choose"], {"Left.plug": 1}),
            None,
            "home.json",
            "its own policy",
        ),
        (
            edit(
                ["net", "arcs", 2], {"from": "Left", "to": "stay", "inhibitor": True, "weight": 2}
            ),
            None,
            "home.json:",
            "inhibitor",
        ),
        (
            edit(["robots"], [{"name": "r", "place": "Work", "actions": {"Left": None}}]),
            None,
            "home.json:",
            "is a subnet",
        ),
        (None, edit(["timeout"], {"Nowhere": 5}), "plan.json", "no place 'Nowhere'"),
        (None, edit(["events", "alarm", "topic"], "${x}"), "plan.json:", "events.alarm"),
        (None, edit(["actions", "Wait"], {"servr": "x"}), "plan.json:", "actions.Wait"),
        (None, edit(["policy", "rows", 0, "choose"], {"arrive": 1}), "plan.json", "exponential"),
        (None, edit(["net"], "no.xml"), "no.xml", "no.xml"),
    ],
)
def test_what_is_wrong_says_where(folder, home, dock, file, text):
    with pytest.raises(GspnError) as raised:
        read_plan(folder(home(HOME) if home else HOME, dock(DOCK) if dock else DOCK))
    assert file in str(raised.value).split(" ")[0] and text in str(raised.value)


def test_a_policy_inside_cannot_decide_at_the_exit(folder):
    dock = changed(DOCK)
    dock["net"]["transitions"].append({"name": "out"})
    dock["net"]["arcs"] += [{"from": "Docked", "to": "out"}, {"from": "out", "to": "Approach"}]
    dock["policy"]["rows"][0]["choose"] = {"out": 0.5, "plug": 0.5}
    with pytest.raises(GspnError, match=r"dock/plan.json: policy row 1: 'out' leaves the exit"):
        read_plan(folder(dock=dock))


def test_a_plan_inside_itself_is_refused(folder):
    dock = changed(DOCK, on_failure={})
    dock["actions"]["Wait"] = {"plan": "../home.json", "entry": "Work", "exit": "Work"}
    with pytest.raises(GspnError, match="subnet of itself: home.json in plan.json in home.json"):
        read_plan(folder(dock=dock))


def test_nesting_cannot_grow_without_bound(folder, monkeypatch):
    monkeypatch.setattr(subnets, "MOST_NODES_TOGETHER", 2_000)
    level = {
        "net": {"places": [{"name": "a"}, {"name": "b"}], "transitions": [], "arcs": []},
        "actions": {"a": None, "b": None},
    }
    more = {"level0.json": level}
    for k in range(1, 30):
        part = {"plan": "level%d.json" % (k - 1), "entry": "a", "exit": "a"}
        more["level%d.json" % k] = {**level, "actions": {"a": part, "b": part}}
    last = edit(["actions", "Left"], {"plan": "level29.json", "entry": "a", "exit": "a"})(HOME)
    with pytest.raises(GspnError, match="more than 2000 nodes"):
        read_plan(folder({**last, "chance": []}, **more))


def test_parameters_of_a_plan_by_itself(folder, tmp_path):
    folder()
    plan = read_plan(str(tmp_path / "dock"))
    assert plan.actions["Approach"].goal == {"frame": "map_A", "pose": [0, 0], "text": "${kept}"}
    assert plan.subnets == {} and plan.policy.scopes == ()
    without = changed(DOCK)
    del without["parameters"]
    (tmp_path / "dock" / "plan.json").write_text(json.dumps(without))
    assert read_plan(str(tmp_path / "dock")).actions["Approach"].goal["pose"] == "${pose}"


def test_a_recorded_run_with_subnets_follows_the_rules(folder, tmp_path, record_run):
    home, dock = changed(HOME), changed(DOCK, events={})
    dock["actions"].update(Approach="actions.approach", Wait=None, Out=None)
    dock["net"]["places"].append({"name": "Out"})
    dock["net"]["transitions"].append({"name": "unplug"})
    dock["net"]["arcs"] += [
        {"from": "Docked", "to": "unplug"},
        {"from": "unplug", "to": "Out"},
        {"from": "unplug", "to": "Station"},
    ]
    home["actions"]["Left"]["exit"] = home["actions"]["Right"]["exit"] = "Out"
    del dock["policy"]  # so the weights decide inside, although the plan around has rows
    file = folder(home, dock)
    (tmp_path / "actions.py").write_text("def work():\n    return 'go'\n")
    (tmp_path / "dock" / "actions.py").write_text(
        "import time\ndef approach():\n    time.sleep(0.001)\n    return 'arrive'\n"
    )
    log = str(tmp_path / "run.jsonl")
    plan = read_plan(file)
    steps = record_run(plan, log, 60)
    assert read_log(log).plan.subnets == plan.subnets
    assert {f.transition for s in steps for f in s.firings} >= {"Left.plug", "Right.arrive", "stay"}
    assert verify([read_log(log)]).violation is None


def test_groups_hold_subnets_and_are_held_by_them(folder, tmp_path):
    dock = changed(DOCK, groups={"Queue": ["Wait", "again", "Gate"]})
    file = folder(changed(HOME, groups={"Both": ["Left", "leave"], "Far": ["Right"]}), dock)
    plan = read_plan(file)
    left = plan.subnets["Left"]
    assert plan.group_nodes == {
        "Left.Queue": ("Left.Wait", "Left.again", "Left.Gate"),
        "Right.Queue": ("Right.Wait", "Right.again"),  # its gate is the field around it
        "Both": (*left.places, *left.transitions, "leave"),
        "Far": (*plan.subnets["Right"].places, *plan.subnets["Right"].transitions),
    }
    again = plan_from_json(plan_to_json(plan))
    assert again.groups == plan.groups and again.hash() == plan.hash() == read_plan(folder()).hash()

    folder(changed(HOME, groups={"Both": ["Left", "leave"], "Far": ["Right"]}), dock)
    picture = tmp_path / "net.dot"
    assert main(["draw", file, "-o", str(picture)]) == 0
    lines = [line.strip() for line in picture.read_text().splitlines()]
    depth, inside = 0, {}  # title -> number of boxes around it
    for line in lines:
        title = re.search(r'graph \[label="(.+?)"', line)
        depth += line.startswith("subgraph") - (line == "}")
        if title:
            inside[title[1]] = depth
    assert inside["Both"] == 1 and inside["Left"] == 2 and inside["Left.Queue"] == 3
    assert {inside["Far"], inside["Right"]} == {1, 2} and inside["Right.Queue"] == 3


def test_commands_know_subnets(folder, tmp_path, capsys):
    file = folder()
    main(["check", file, "--json"])
    items = [i for i in json.loads(capsys.readouterr().out)["items"] if i["check"] == "subnets"]
    assert [item["subnet"] for item in items] == ["Left", "Right"]
    picture = tmp_path / "net.dot"
    assert main(["draw", file, "-o", str(picture)]) == 0
    text = picture.read_text()
    assert text.count("subgraph") == 2 and 'label="Left"' in text
    if shutil.which("dot"):
        assert main(["draw", file, "-o", str(tmp_path / "net.svg")]) == 0
        svg = (tmp_path / "net.svg").read_text()
        assert svg.count('class="cluster"') == 2 and svg.count('class="node"') == 23
        # a shade, whose edge crosses no name
        boxes = re.findall(r"cluster_.*\n<path ([^>]*)", svg)
        assert len(boxes) == 2
        assert all('stroke="transparent"' in b or 'stroke="none"' in b for b in boxes)
