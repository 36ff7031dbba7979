"""What ``docs/developing.md`` says under "To add X, touch Y": each X is added here from a package
that stands for somebody else's, without a change to any other file."""

import json
import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from seams_table import SEAMS

from gspn_framework_package.analysis.sweeps import variation
from gspn_framework_package.cli import main as dispatcher
from gspn_framework_package.cli import mcp_tools
from gspn_framework_package.execution.actions import (
    ActionContext,
    Cancellation,
    load_action,
    load_actions,
    no_feedback,
)
from gspn_framework_package.execution.agreement.interface import OrderResult
from gspn_framework_package.execution.log_entries import Giver
from gspn_framework_package.formats import FORMATS, read_net, register, write_net
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import NetError, PlanError, UsageError
from gspn_framework_package.team.carrier import Operator, OperatorAnswer, OperatorRequest
from gspn_framework_package.team.commands import Commands
from gspn_framework_package.team.jobs import LocalJob

ROOT = Path(__file__).resolve().parents[3]


# -- the table

MAP = (ROOT / "docs" / "developing.md").read_text("utf-8")
TABLE = MAP[MAP.index("## To add X, touch Y") : MAP.index("## Tests")]
ROWS = {
    row.split(" | ")[0].strip("| "): row.split(" | ")[1]
    for row in TABLE.splitlines()
    if row.startswith("| ") and not row.startswith("| to add")
}


@pytest.mark.parametrize("row", ROWS)
def test_the_files_of_a_row_hold_the_names_that_it_gives(row):
    files = re.findall(r"`([\w./]+\.(?:py|js|json|txt))`", ROWS[row])
    places = [ROOT / "gspn_framework_package", ROOT]
    texts = [next(p / f for p in places if (p / f).is_file()).read_text("utf-8") for f in files]
    names = re.findall(r"`([A-Za-z_][\w.]*)(?:\([^`]*\))?`", ROWS[row])
    code = [name for name in names if name not in files and re.search("[A-Z_]", name)]
    parts = {part for name in code for part in name.split(".")}
    assert {n for n in parts if not any(re.search(r"\b%s\b" % n, t) for t in texts)} == set()


def test_the_rows_that_say_so_are_tested_here():
    assert {row for row in ROWS if row.endswith("(tested)")} == {s + " (tested)" for s in SEAMS}


@pytest.mark.parametrize("what", SEAMS)
def test_a_tested_row_names_what_the_test_touches(what):
    row = ROWS[what + " (tested)"]
    for where in SEAMS[what]:
        file, table = where.split(": ")
        assert "`%s`" % file in row and "`%s`" % table in row
    others = {"`formats/plan.schema.json`", "`ros/action_kinds.py`"}  # of this package's own kinds
    assert set(re.findall(r"`[a-z_/]+[.](?:py|json)`", row)) - others == {
        "`%s`" % where.split(": ")[0] for where in SEAMS[what]
    }


# -- a file format


@pytest.fixture
def toy_format(monkeypatch):
    from toys import toy_format

    monkeypatch.setattr("gspn_framework_package.formats.registry.FORMATS", dict(FORMATS))
    register(toy_format.FORMAT)
    return toy_format.FORMAT


def small_net():
    net = NetBuilder("toy").place("A", tokens=2).place("B")
    return net.immediate("go", inputs="A", outputs="B").build()


def test_a_format_is_written_recognised_and_read(toy_format, tmp_path):
    net = small_net()
    assert write_net(net, tmp_path / "net.toy") == []
    (tmp_path / "net.toy").rename(tmp_path / "of_any_name")
    assert read_net(tmp_path / "of_any_name") == net


def test_what_is_wrong_in_it_is_reported_with_its_line(toy_format, tmp_path):
    (tmp_path / "net.toy").write_text("toy net\nplace A 1\nplaec B 1\n")
    with pytest.raises(NetError) as caught:
        read_net(tmp_path / "net.toy")
    assert (caught.value.line, caught.value.file) == (3, str(tmp_path / "net.toy"))


def test_it_is_among_those_that_are_listed(toy_format, tmp_path):
    (tmp_path / "net").write_text("nothing that is known")
    with pytest.raises(Exception, match="toy nets"):
        read_net(tmp_path / "net")


def test_a_format_that_is_not_registered_is_refused(tmp_path):
    with pytest.raises(UsageError, match="does not show the format"):
        write_net(small_net(), tmp_path / "net.toy")


@pytest.mark.parametrize("changed", [{"name": "pipe"}, {"extensions": (".pnml",)}])
def test_a_name_or_extension_that_is_taken_is_refused(toy_format, changed):
    with pytest.raises(ValueError, match="shares its name or an extension"):
        register(replace(toy_format, **{"name": "other", "extensions": (".other",), **changed}))


# -- a verb


def test_a_verb_is_found_by_its_row(add, capsys):
    add("a verb", ("count", dispatcher.Verb("toys.toy_verb", "count words")))
    assert dispatcher.main(["count", "one", "two"]) == 0
    assert capsys.readouterr().out == "2\n"
    assert dispatcher.main(["--help"]) == 0
    assert "count words" in capsys.readouterr().out


# -- an order of the operator


class Host:
    """A robot whose replica takes every order."""

    robot, run = "robot_1", "monday"

    def __init__(self):
        self.entries = []

    def enqueue(self, function, *arguments):
        function(*arguments)

    def note_order(self, given):
        pass

    def order(self, entry, answer):
        self.entries.append(entry)
        answer(OrderResult("", True, "it is so"))


@pytest.fixture
def toy_order(add):
    from toys import toy_order

    add("an order of the operator", ("greet", toy_order.GREET))
    return toy_order


def test_an_order_is_a_verb_with_its_arguments(toy_order, monkeypatch, capsys):
    given = []

    class Client:
        def order(self, *order):
            given.append(order)
            return True, "it is so"

    monkeypatch.setattr("gspn_framework_package.cli.team_client.team_client", lambda _: Client())
    assert dispatcher.main(["--help"]) == 0
    assert "greet        have a robot greet somebody" in capsys.readouterr().out
    assert dispatcher.main(["greet", "robot_2", "--whom", "ann", "--run", "monday"]) == 0
    assert given == [("greet", "robot_2", "ann", "monday")]
    assert dispatcher.main(["greet"]) == 2


def test_a_robot_takes_the_order(toy_order):
    host = Host()
    request = OperatorRequest("greet", "robot_2", "ann", "monday")
    assert Commands(host).answer(request, Operator("bob")).success
    assert host.entries == [toy_order.greeting("robot_2", "ann")._replace(by=Giver("bob"))]
    refused = Commands(host).answer(OperatorRequest("greet", "robot_2", "x" * 300))
    assert refused == (False, "not a greeting: nobody has so long a name")
    assert "greet" in Commands(host).answer(OperatorRequest("sing")).message


def test_the_page_describes_the_order_and_gives_it(toy_order):
    from gspn_framework_package.visualizer.page_orders import PageOrders
    from gspn_framework_package.visualizer.project import Project

    described = Project(None).to_json()["orders"]["greet"]
    assert (described["where"], described["label"]) == ("more", "Greet")
    assert [field["name"] for field in described["fields"]] == ["robot", "whom"]
    asked, team = [], Mock(names={"/r2": "robot_2"}, gone=frozenset(), run="monday")
    status = {"robot": "robot_2", "run": "monday", "active": True, "log_length": 1}
    team.statuses.return_value = [("/r2", status)]

    def call(address, robot, request, answered):
        asked.append(request)
        answered(OperatorAnswer(True, "it is so"))
        return True

    orders = PageOrders(team, Mock(**{"line.return_value.call": call}))
    answer = orders.commands["greet"]({"robot": "robot_2", "whom": "ann"})
    assert answer == {"message": "it is so"}
    assert asked == [OperatorRequest("greet", "robot_2", "ann", "monday")]


# -- a tool for language models


def test_a_tool_is_a_row_that_names_a_verb(add, tmp_path):
    machine(tmp_path)
    row = mcp_tools.TOOLS["analyse"]._replace(about="count markings", fields={"plan": {}})
    add("a tool for language models", ("count", row))
    tools = mcp_tools.PlanTools(str(tmp_path), False, mcp_tools.CallLimits(100.0, 200_000))
    listed = {tool["name"]: tool["description"] for tool in tools.listed()}
    assert listed["count"] == "count markings"
    found = json.loads(tools.call("count", {"plan": "machine.xml"}, lambda seconds: False))
    assert found["states"]["total"] == 2


# -- a parameter of a sweep


def test_a_parameter_of_a_sweep_is_a_row(add, tmp_path, capsys):
    def faster(net, element, factor, timing):
        return net.with_rates({t.name: t.rate * factor for t in net.transitions})

    row = variation._KINDS["rate"]._replace(change=faster, of_element=False)
    add("a parameter of `gspn sweep`", ("speed", row))
    words = ["sweep", machine(tmp_path), "--vary", "speed=1,2", "--measure", "fail", "--json"]
    assert dispatcher.main([*words, "--time", "200", "--replications", "20"]) == 0
    slow, fast = json.loads(capsys.readouterr().out)["points"]
    assert (slow["values"], fast["values"]) == ({"speed": 1}, {"speed": 2})
    assert fast["measures"]["throughput"]["fail"]["mean"] == pytest.approx(
        2 * slow["measures"]["throughput"]["fail"]["mean"], rel=0.2
    )


# -- a measure


@pytest.fixture
def toy_measures():
    from toys import toy_measure

    from gspn_framework_package.analysis.report_measures import MEASURES

    MEASURES.extend(toy_measure.MEASURES)
    yield
    del MEASURES[-len(toy_measure.MEASURES) :]


def machine(folder):
    net = NetBuilder("machine").place("up", tokens=1).place("down")
    net.exponential("fail", rate=1.0, inputs="up", outputs="down")
    net.exponential("repair", rate=3.0, inputs="down", outputs="up")
    write_net(net.build(), folder / "machine.xml")
    return str(folder / "machine.xml")


def test_a_measure_is_in_the_text_the_json_and_the_csv(toy_measures, tmp_path, capsys):
    path, table = machine(tmp_path), tmp_path / "numbers.csv"
    assert dispatcher.main(["analyse", path, "--csv", str(table)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {"transitions without inputs: none", "most tokens: 1"} <= set(lines)
    assert "share of time in repair: 0.25" in lines
    assert {"fullest,,1,,", "sources,,[],,"} <= set(table.read_text().splitlines())
    assert dispatcher.main(["analyse", path, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["sources"], data["fullest"]) == ([], 1)
    assert data["busy"] == pytest.approx(0.25)
    assert data["titles"]["timing"] == {"busy": "share of time in repair"}


def test_a_measure_that_is_a_number_has_an_interval(toy_measures, tmp_path, capsys):
    machine(tmp_path)
    learned = {"mean": 3.0, "of": {"observations": 20, "logs": ["a.jsonl"]}}
    plan = {
        "net": "machine.xml",
        "actions": {"up": {"command": ["true"]}},
        "durations": {"up": learned},
    }
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    words = ["analyse", str(tmp_path)]
    assert dispatcher.main([*words, "--json"]) == 0, capsys.readouterr()
    data = json.loads(capsys.readouterr().out)
    low, high = data["intervals"]["busy"]
    assert low < data["busy"] < high
    assert dispatcher.main(words) == 0
    shown = "share of time in repair: %.6g (%.6g to %.6g)" % (data["busy"], low, high)
    assert shown in capsys.readouterr().out


def test_a_measure_that_is_not_decided_has_its_reason(toy_measures, tmp_path, capsys):
    assert dispatcher.main(["analyse", machine(tmp_path), "--json", "--limit", "1"]) == 1
    data = json.loads(capsys.readouterr().out)
    assert data["fullest"] is data["busy"] is None
    assert data["undecided"]["busy"] == data["undecided"]["steady_state"]
    assert "not decided" in data["undecided"]["fullest"]


def test_a_measure_of_a_part_that_is_left_out_is_null(toy_measures, tmp_path, capsys):
    words = ["analyse", machine(tmp_path), "--json", "--no-structure", "--no-time"]
    assert dispatcher.main(words) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["sources"], data["fullest"], data["busy"]) == (None, 1, None)
    assert data["undecided"]["sources"] == data["undecided"]["busy"] == "left out, as requested"


# -- a kind of action


def plan_in(folder, first, then=None):
    net = NetBuilder("choice").place("A", tokens=1).place("B").place("C")
    for name in ("first", "second"):
        net.immediate(name, inputs="A", outputs="B")
        net.immediate(name + "_back", inputs="B", outputs="A")
    net.immediate("on", inputs="B", outputs="C")
    write_net(net.build(), folder / "net.xml")
    plan = {
        "net": "net.xml",
        "actions": {"A": first, "B": then or first, "C": None},
        "until": "C >= 1",
    }
    (folder / "plan.json").write_text(json.dumps(plan))
    return str(folder)


def in_turn(*transitions):
    return {"function": "toys.toy_action.InTurn", "settings": {"transitions": transitions}}


def test_a_kind_of_action_runs_from_its_settings(tmp_path, capsys):
    folder = plan_in(tmp_path, in_turn("first"), in_turn("on", "on"))
    log = str(tmp_path / "log.jsonl")
    assert dispatcher.main(["check", folder, "--modules", "toys"]) == 0
    run = ["run", folder, "--log", log, "--modules", "toys"]
    assert dispatcher.main(run) == 0, capsys.readouterr()
    fired = re.findall(r'"transition": ?"(\w+)"', Path(log).read_text())
    assert fired == ["first", "on"]


def test_settings_are_kept_when_a_plan_is_written(tmp_path, capsys):
    folder = plan_in(tmp_path, in_turn("first", "on"))
    assert dispatcher.main(["convert", folder, str(tmp_path / "one.json")]) == 0
    assert read_plan(str(tmp_path / "one.json")).actions == read_plan(folder).actions


def test_a_kind_of_action_with_a_key_of_its_own(toy_kind, tmp_path, capsys):
    folder = plan_in(tmp_path, {"say": "hello"}, {"say": {"from": "said"}})
    log = str(tmp_path / "log.jsonl")
    assert dispatcher.main(["run", folder, "--log", log]) == 0, capsys.readouterr()
    assert toy_kind.said[:2] == ["hello", 1]
    assert dispatcher.main(["verify", log]) == 0
    assert dispatcher.main(["convert", folder, str(tmp_path / "one.json")]) == 0
    assert read_plan(str(tmp_path / "one.json")).actions == read_plan(folder).actions
    pytest.importorskip("rospy")
    pytest.importorskip("gspn_framework_package.msg")
    from gspn_framework_package.ros.action_kinds import jobs

    assert {type(job) for job in jobs(read_plan(folder), "robot_1", "/x").values()} == {LocalJob}


@pytest.mark.parametrize(
    "settings, message",
    [
        ({}, "its parameter 'transitions'.*under settings"),
        ({"transitions": [], "speed": 1}, "no parameter for the setting 'speed'"),
        ({"transitions": [], "robot": "r"}, "'robot' has a reserved name"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, message):
    with pytest.raises(PlanError, match=message):
        load_action(None, "toys.toy_action.InTurn", settings)


def test_each_choice_of_settings_has_its_own_object(tmp_path):
    plan = read_plan(plan_in(tmp_path, in_turn("first", "on")))
    other = FunctionAction("toys.toy_action.InTurn", "C", {"transitions": ["first_back"]})
    actions = load_actions(replace(plan, actions={**plan.actions, "C": other}), "robot_1")
    context = ActionContext("A", "robot_1", no_feedback, Cancellation())
    assert actions["A"] is actions["B"]
    assert [actions[place](context).transition for place in "AC"] == ["first", "first_back"]
