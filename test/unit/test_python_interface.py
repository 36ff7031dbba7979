"""The Python interface ``gspn``: its names, its examples, and how its answers show themselves."""

import doctest
import importlib
import inspect
import json
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest
from waiting import PATIENCE

import gspn
from gspn.results import Result
from gspn.tables import SHOWN, html_table, text_table
from gspn.teams import TeamFiring
from gspn_framework_package.team.orders import ORDERS

ROOT = Path(__file__).resolve().parents[2]
NAMES = Path(__file__).with_name("python_interface.txt")

SHUTTLE = (
    gspn.Net("shuttle")
    .place("Here", tokens=1)
    .place("There")
    .exponential("go", "Here", "There", rate=4.0)
    .exponential("come", "There", "Here", rate=4.0)
)


def public_interface():
    """Yield the public names with their signatures, and those of what they return."""
    from gspn import results, subjects, teams

    for name in sorted(set(gspn.__all__) - {"__version__"}):
        yield from declared(name, getattr(gspn, name))
    for name, found in sorted({**vars(results), **vars(subjects), **vars(teams)}.items()):
        if is_answer(found):
            attributes = re.findall(r":ivar (\w+):", found.__doc__ or "")
            yield "%s: %s" % (name, ", ".join(attributes)), found


def is_answer(found):
    if not isinstance(found, type):
        return False
    return issubclass(found, (Result, TeamFiring)) and found is not Result


def declared(name, found):
    if not inspect.isclass(found):
        yield name + signature(found), found
        return
    yield name + (signature(found.__init__) if found in (gspn.Net, gspn.Team) else ""), found
    if issubclass(found, Exception):
        return
    for base in reversed(found.__mro__[:-1]):
        for member, value in vars(base).items():
            if member.startswith("_"):
                continue
            if isinstance(value, property):
                yield "%s.%s" % (name, member), value
            elif inspect.isfunction(value):
                yield "%s.%s%s" % (name, member, signature(value)), value


def signature(function):
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(inspect.signature(function)))
    return re.sub(r"\(self(, )?", "(", text)


@pytest.mark.parametrize(
    "module",
    ["gspn", "gspn.results", "gspn.subjects", "gspn_framework_package.formats.example_plans"],
)
def test_the_examples_of_the_docstrings(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(importlib.import_module(module))
    assert result.attempted
    assert result.failed == 0


def test_the_public_names_are_those_of_the_list():
    there = "".join(line + "\n" for line, _ in public_interface())
    assert there == NAMES.read_text("utf-8"), (
        "a change of what is promised: docs/python.md says how; the list is %s" % NAMES.name
    )


def test_every_public_name_has_an_example_and_names_its_parameters():
    errors = {"GspnError", "InputError", "LimitError", "RefusedError"}
    for line, found in public_interface():
        name = re.match(r"[\w.]+", line).group()
        if name in errors or is_answer(found) or name in ("Picture", "Plan", "Result"):
            assert found.__doc__, name
            continue
        assert ">>> " in found.__doc__, name
        if inspect.isfunction(found):
            for parameter in inspect.signature(found).parameters:
                asked = ":param %s:" % parameter
                assert parameter == "self" or asked in found.__doc__, (name, parameter)


def test_the_page_names_all_of_them_and_nothing_else():
    text = (ROOT / "docs" / "python.md").read_text("utf-8")
    named = set(re.findall(r"^\| `(\.?\w+)", text, re.MULTILINE))
    there = {
        re.match(r"[\w.]+", line).group()
        for line, found in public_interface()
        if not is_answer(found)
    }
    assert named == {re.sub(r"^\w+(?=\.)", "", name) for name in there}
    assert len({name for name in named if name.lstrip(".") not in ORDERS}) <= 45


def test_a_team_takes_the_orders_of_the_table():
    for_people = {"breakpoints", "force_evict", "trust"}
    verbs = {name for name, order in ORDERS.items() if order.example is not None}
    methods = {name for name, _ in inspect.getmembers(gspn.Team, inspect.isfunction)}
    assert methods & set(ORDERS) == verbs - for_people
    for name in verbs - for_people - {"status"}:
        there = dict(inspect.signature(getattr(gspn.Team, name)).parameters)
        del there["self"]
        fields = {field.name: field for field in ORDERS[name].fields}
        assert list(there) == list(fields), name
        for parameter in there.values():
            required = parameter.default is inspect.Parameter.empty
            assert required == fields[parameter.name].required, (name, parameter.name)


def test_without_ros_a_team_is_an_input_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "rospy", None)
    with pytest.raises(gspn.InputError, match=r"^gspn\.Team needs ROS"):
        gspn.Team("/")


def test_importing_it_imports_next_to_nothing():
    code = "import sys, gspn; print(*sys.modules)"
    ran = subprocess.run(
        [sys.executable, "-S", "-c", code],
        cwd=str(ROOT),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    imported = ran.stdout.split()
    assert "gspn" in imported
    own = {name for name in imported if name.startswith("gspn")}
    assert own == {"gspn", "gspn_framework_package"}
    assert not {"numpy", "scipy", "lxml", "jsonschema"} & set(imported)


def test_types_are_declared():
    for package in ("gspn", "gspn_framework_package"):
        assert (ROOT / package / "py.typed").is_file()


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'lod'"):
        gspn.lod  # noqa: B018


# -- reading and building ----------------------------------------------------------------------------


def test_a_net_is_read_from_a_file_and_from_its_text(tmp_path):
    path = tmp_path / "shuttle.pnml"
    assert SHUTTLE.save(str(path)) == []
    for source in (path, str(path), path.read_text("utf-8")):
        net = gspn.load(source)
        assert isinstance(net, gspn.Net)
        assert (net.places, net.transitions) == (("Here", "There"), ("go", "come"))


def test_a_plan_is_read_from_its_object_and_its_text(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plan = SHUTTLE.plan(robots={"ann": "Here"})
    for source in (
        plan.to_dict(),
        json.dumps(plan.to_dict()),
        json.dumps(plan.to_dict(), indent=1),
    ):
        assert gspn.load(source).to_dict() == plan.to_dict()


@pytest.mark.parametrize(
    "source, message",
    [
        ("{", "the text is not JSON"),
        ("{}", "^'net' is a required"),
        ("<pnml>\n", "text:"),
        ("no_such_file.xml", "no_such_file.xml: cannot read it"),
    ],
)
def test_what_cannot_be_read_is_an_input_error(source, message):
    with pytest.raises(gspn.InputError, match=message):
        gspn.load(source)


def test_building_leaves_the_net_as_it_was_and_says_which_step_is_wrong():
    assert SHUTTLE.place("Away").places == ("Here", "There", "Away")
    assert SHUTTLE.places == ("Here", "There")
    with pytest.raises(gspn.InputError, match="'Hre'"):
        SHUTTLE.exponential("stay", "Hre", "Here")


def test_a_saved_plan_has_what_was_computed(tmp_path):
    plan = gspn.example("measure").optimise(reward={"T3": 1.0}, at_least={"T6": 0.1}).plan
    plan.save(str(tmp_path / "better"))
    again = gspn.load(tmp_path / "better")
    assert again.to_dict()["policy"] == plan.to_dict()["policy"]
    assert (tmp_path / "better" / "actions.py").is_file()
    with pytest.raises(gspn.InputError, match="exists already"):
        plan.save(str(tmp_path / "better"))
    assert plan.save(str(tmp_path / "better"), overwrite=True) == []


@pytest.mark.parametrize(
    "ask, message",
    [
        (lambda net: net.transient([-1.0]), "-1 is not a time"),
        (lambda net: net.passage("Here", [float("nan")]), "nan is not a time"),
        (lambda net: net.draw("tree"), "there is no 'tree'"),
        (lambda net: net.plot("passage"), "belong together"),
        (lambda net: net.steady(reward={"Hre": 1.0}), "Hre"),
        (lambda net: net.prove(never="Hre > 1"), "Hre"),
        (lambda net: net.simulate(), "time"),
        (lambda net: net.draw().save("net.gif"), "net.gif"),
    ],
)
def test_a_wrong_question_is_an_input_error(ask, message):
    with pytest.raises(gspn.InputError, match=message):
        ask(SHUTTLE)


def test_a_run_records_a_log_and_ends_at_its_limit(tmp_path):
    plan = gspn.example("rendezvous")
    ran = plan.run(seconds=0.2, log=str(tmp_path / "run.jsonl"))
    assert ran.reason == "the limit of 0.2 seconds"
    assert (tmp_path / "run.jsonl").stat().st_size > 0
    with pytest.raises(gspn.InputError, match="exists already"):
        plan.run(seconds=0.2, log=str(tmp_path / "run.jsonl"))


def test_a_plan_that_the_check_refuses_does_not_run():
    plan = SHUTTLE.plan(robots={"ann": "Here"}, actions={"Here": "actions.no_such"})
    assert not plan.check().accepted
    with pytest.raises(gspn.RefusedError, match="^the check refuses the plan"):
        plan.run(seconds=0.1)


def test_programs_run_only_when_they_are_allowed():
    actions = {"Here": {"command": ["true"]}, "There": None}
    plan = SHUTTLE.plan(robots={"ann": "Here"}, actions=actions)
    with pytest.raises(gspn.RefusedError):
        plan.run(firings=2)
    assert len(plan.run(firings=2, allow_commands=True).firings) >= 2


# -- answers -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module", name="plan")
def _plan():
    return gspn.example("measure")


ANSWERS = {
    "check": lambda plan: plan.check(),
    "states": lambda plan: plan.states(),
    "steady": lambda plan: plan.steady(reward={"T3": 1.0}),
    "transient": lambda plan: plan.transient([0.5, 2.0]),
    "passage": lambda plan: plan.passage("P4 == 1", within=[1.0]),
    "prove": lambda plan: plan.prove(never_fires="T1", always="P1 <= 2"),
    "query": lambda plan: plan.query("P>=0.5 [ F<=2 P3 >= 1 ]"),
    "simulate": lambda plan: plan.simulate(20.0, replications=20),
    "optimise": lambda plan: plan.optimise(reward={"T3": 1.0}),
    "run": lambda plan: plan.run(firings=1),
}


@pytest.mark.parametrize("question", ANSWERS)
def test_an_answer_shows_itself_and_gives_its_numbers_away(plan, question, monkeypatch):
    answer = ANSWERS[question](plan)
    assert isinstance(answer, Result)
    json.dumps(answer.to_dict(), allow_nan=False)
    assert "object at 0x" not in repr(answer)
    assert len(repr(answer).splitlines()) >= 1
    shown = answer._repr_html_()
    assert "<pre>" in shown
    if question in ("check", "steady", "transient", "passage", "prove", "simulate", "run"):
        assert "<table>" in shown
    assert "<script" not in shown
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=list))
    rows = answer.to_frame()
    assert rows
    assert all(row.keys() == rows[0].keys() for row in rows)


def test_what_is_wrong_is_said_with_its_witness(plan):
    found = plan.prove(never="P4 >= 1")
    assert not found.proven
    assert found.answers[0]["verdict"] == "violated"
    assert found.answers[0]["sequence"][-1] == "T2"
    assert found.certificates == [None]


def test_without_pandas_the_error_says_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(gspn.InputError, match="pip install pandas"):
        SHUTTLE.steady().to_frame()


def test_pictures_are_svg_or_a_file(tmp_path, plan):
    assert plan._repr_svg_().startswith("<svg")
    assert plan.net.draw("chain").svg.startswith("<svg")
    picture = plan.plot("throughput", time=5.0, only="T1")
    assert picture._repr_svg_().startswith("<svg")
    for name in ("net.svg", "net.png", "net.dot"):
        plan.draw().save(str(tmp_path / name))
        assert (tmp_path / name).stat().st_size > 100


def test_without_graphviz_a_notebook_shows_the_text(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert SHUTTLE._repr_svg_() is None
    with pytest.raises(gspn.InputError, match="Graphviz"):
        SHUTTLE.draw().svg  # noqa: B018


def test_a_table_shows_its_first_rows_and_escapes_names():
    records = [{"name": "<b>", "n": n, "yes": n == 0, "x": None} for n in range(SHOWN + 2)]
    lines = list(text_table(records))
    assert lines[0].split() == ["name", "n", "yes", "x"]
    assert lines[1].split() == ["<b>", "0", "yes"]
    assert lines[-1] == "... and 2 more"
    table = html_table(records)
    assert "<td>&lt;b&gt;</td>" in table
    assert table.count("<tr>") == SHOWN + 1


def test_the_examples_are_listed():
    ran = subprocess.run(
        [sys.executable, "-m", "gspn.examples"],
        cwd=str(ROOT),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=60 * PATIENCE,
    )
    assert [name for name in gspn.example_names() if name + ": " not in ran.stdout] == []
    assert "gspn new --example NAME DIR" in ran.stdout


def test_a_reader_that_leaves_early_sees_no_traceback():
    command = '"$0" -u -m gspn.examples | head -n 1'
    ran = subprocess.run(
        ["bash", "-c", command, sys.executable],
        cwd=str(ROOT),
        capture_output=True,
        text=True,
        timeout=60 * PATIENCE,
    )
    assert ran.stdout.count("\n") == 1 and ran.stderr == ""


def test_the_example_of_the_page(tmp_path, monkeypatch, capsys):
    readme = (ROOT / "README.md").read_text("utf-8")
    page = (ROOT / "docs" / "python.md").read_text("utf-8")
    (tmp_path / "charge").mkdir()
    plan = re.search(r"```json charge/plan.json\n(.*?)```", readme, re.DOTALL).group(1)
    (tmp_path / "charge" / "plan.json").write_text(plan)
    code = re.search(r"```python\n(.*?)```", page, re.DOTALL).group(1)
    assert "seconds=5" in code
    monkeypatch.chdir(tmp_path)
    exec(code.replace("seconds=5", "seconds=0.1"), {})
    shown = capsys.readouterr().out
    assert "may run" in shown
    assert "best policy" in shown
    assert (tmp_path / "better.json").is_file()
