"""Which functions a plan may name: those of its folder, of modules that whoever starts the run
allows, and those that come with the package. A plan without Python cannot run programs."""

import json
import os
import subprocess
import sys
import uuid

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.execution.actions import PythonAction, load_action
from gspn_framework_package.execution.event_functions import EventFunctions
from gspn_framework_package.execution.function_source import why_not_callable
from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import PlanError, UsageError
from gspn_framework_package.team.plan_examination import with_folder

STDLIB = os.path.dirname(os.path.realpath(subprocess.__file__))


@pytest.fixture(autouse=True)
def nothing_allowed():
    allow_modules(())
    yield
    allow_modules(())


def plan_of(function, settings=None, **more):
    action = {"function": function, "settings": settings or {}}
    places = [{"name": "A", "tokens": 1}, {"name": "B"}]
    transitions = [{"name": "go"}]
    arcs = [{"from": "A", "to": "go"}, {"from": "go", "to": "B"}]
    net = {"places": places, "transitions": transitions, "arcs": arcs}
    return {"net": net, "actions": {"A": action, "B": None}, "until": "B >= 1", **more}


@pytest.fixture
def folder(tmp_path):
    inside, outside = tmp_path / "plan", tmp_path / "outside"
    inner = "inner_%s" % uuid.uuid4().hex  # a process imports a name only once
    inside.mkdir()
    outside.mkdir()
    (outside / "evil.py").write_text("def run(cmd=''):\n    pass\n")
    (inside / "plan.json").write_text(json.dumps(plan_of("actions.go")))
    (inside / "actions.py").write_text(
        "import functools\nimport subprocess\nfrom subprocess import getoutput\n"
        "from {} import mine\nfrom gspn_framework_package.world import room\n"
        "made = functools.partial(subprocess.getoutput, 'true')\n"
        "def go():\n    pass\nclass Act:\n    def __call__(self):\n        pass\n"
        "part = functools.partial(go)\n".format(inner)
    )
    (inside / (inner + ".py")).write_text("def mine():\n    pass\n")
    (inside / "subprocess.py").write_text("def own():\n    pass\n")
    os.symlink(str(outside / "evil.py"), str(inside / "linked.py"))
    os.symlink(str(outside), str(inside / "way"))
    return inside


OTHERS = [
    ("subprocess.getoutput", {"cmd": "touch {made}"}),
    ("os.system", {"command": "touch {made}"}),
    ("builtins.eval", {}),
    ("builtins.exec", {}),
    ("posix.system", {"command": "touch {made}"}),
    ("gspn_framework_package.execution.commands.Command", {}),
    ("gspn_framework_package.cli.main.main", {"arguments": []}),
    ("gspn_framework_package.world.parking.carry_out", {}),
    ("actions.getoutput", {"cmd": "touch {made}"}),
    ("actions.made", {}),
    ("actions.subprocess.getoutput", {"cmd": "touch {made}"}),
    ("actions.os.system", {"command": "touch {made}"}),
    ("actions.__class__", {}),
    ("actions.__repr__", {}),
    ("actions.__builtins__.eval", {}),
    ("__main__.run", {}),
    ("linked.run", {}),
    ("way/evil.run", {}),
    ("way.evil.run", {}),
    ("../outside/evil.run", {}),
    ("./../outside/evil.run", {}),
    (STDLIB + "/subprocess.getoutput", {"cmd": "touch {made}"}),
    ("//" + STDLIB + "/subprocess.getoutput", {"cmd": "touch {made}"}),
    (os.path.join("..", "..", "..", "..", "..") + STDLIB + "/os.system", {}),
]


@pytest.mark.parametrize("name, settings", OTHERS)
def test_a_function_from_elsewhere_is_neither_loaded_nor_run(folder, capsys, name, settings):
    made = folder / "made"
    filled = {key: str(value).format(made=made) for key, value in settings.items()}
    with pytest.raises(PlanError) as caught:
        load_action(str(folder), name, filled)
    assert caught.value.hint or "is not the name" in str(caught.value)
    (folder / "plan.json").write_text(json.dumps(plan_of(name, filled)))
    assert main(["run", str(folder)]) in (1, 2)  # refused by the check, or by what loads it
    assert not made.exists()


@pytest.mark.parametrize("name", [name for name, _ in OTHERS[:7]] + ["linked.run", "way/evil.run"])
def test_the_check_refuses_it_and_says_what_to_do(folder, capsys, name):
    (folder / "subprocess.py").unlink()
    (folder / "plan.json").write_text(json.dumps(plan_of(name)))
    assert main(["check", str(folder)]) == 1
    told = [line for line in capsys.readouterr().out.splitlines() if "functions" in line]
    assert len(told) == 1 and name in told[0] and "--modules" in told[0]


def test_the_check_follows_imports_of_single_names(folder):
    assert not why_not_callable(str(folder), "actions.mine", {}, PythonAction)
    (folder / "subprocess.py").unlink()
    why = why_not_callable(str(folder), "actions.getoutput", {}, PythonAction)
    assert "the module 'subprocess'" in why


@pytest.mark.parametrize(
    "name", ["actions.go", "actions.Act", "actions.mine", "actions.part", "subprocess.own"]
)
def test_the_folder_of_the_plan_has_the_say(folder, name):
    assert not why_not_callable(str(folder), name, {}, PythonAction)
    assert load_action(str(folder), name).name == name


def test_a_function_of_an_event_obeys_the_same_rule(folder):
    (folder / "subprocess.py").unlink()
    events = {"go": {"function": "subprocess.getoutput", "settings": {"cmd": "true"}}}
    data = plan_of("actions.go", events=events)
    data["net"]["transitions"] = [{"name": "go", "timed": True, "rate": 1}]
    (folder / "plan.json").write_text(json.dumps(data))
    with pytest.raises(PlanError, match="the module 'subprocess' is not in the plan's folder"):
        EventFunctions(read_plan(str(folder)), None, topics=False)


def test_who_starts_the_run_allows_modules(tmp_path, capsys, monkeypatch):
    (tmp_path / "lib" / "mine").mkdir(parents=True)
    (tmp_path / "lib" / "mine" / "__init__.py").write_text("from os import getcwd\n")
    (tmp_path / "lib" / "mine" / "acts.py").write_text("def go():\n    pass\n")
    (tmp_path / "lib" / "mine_too.py").write_text("def go():\n    pass\n")
    monkeypatch.syspath_prepend(str(tmp_path / "lib"))
    file = tmp_path / "plan.json"
    for name, allowed, code in (
        ("mine.acts.go", [], 1),
        ("mine.acts.go", ["--modules=mine"], 0),
        ("mine.acts.go", ["--modules=other,mine.acts"], 0),
        ("mine.getcwd", ["--modules=mine"], 2),
        ("mine_too.go", ["--modules=mine"], 1),
        ("mine.acts.go", ["--modules=mine.ac"], 1),
    ):
        file.write_text(json.dumps(plan_of(name)))
        assert main(["run", str(file), *allowed, "--quiet"]) == code, (name, capsys.readouterr())
        assert main(["check", str(file), *allowed]) == (1 if code == 1 else 0)
    for name in [name for name in sys.modules if name.split(".")[0] in ("mine", "mine_too")]:
        del sys.modules[name]


def test_a_folder_is_allowed_by_its_path(folder, capsys):
    name = "../outside/evil.run"
    (folder / "plan.json").write_text(json.dumps(plan_of(name)))
    assert main(["run", str(folder), "--quiet", "--modules", str(folder.parent / "outside")]) == 0
    assert main(["run", str(folder), "--quiet", "--modules", "./none"]) == 2
    assert "there is no folder './none'" in capsys.readouterr().err
    with pytest.raises(UsageError, match="not a valid module name"):
        allow_modules(["not a module"])


def test_an_input_file_of_the_thesis_names_no_functions_of_python_itself(folder):
    data = {
        "project_path": STDLIB,
        "gspn": "net.xml",
        "place_to_function_mapping": "{'A': 'subprocess.getoutput'}",
        "places_tuple": "('A', 'B')",
        "policy_dictionary": "{}",
    }
    from gspn_framework_package.formats.net_json import net_from_json
    from gspn_framework_package.formats.registry import write_net

    write_net(net_from_json(plan_of("x.y")["net"]), folder / "net.xml")
    (folder / "input.json").write_text(json.dumps(data))
    plan = read_plan(str(folder / "input.json"))
    with pytest.raises(PlanError, match="outside the plan's folder"):
        load_action(plan.folder, plan.actions["A"].function)


def test_a_deployed_plan_cannot_take_any_folder_for_its_own(folder):
    plan = read_plan(str(folder))
    other = folder.parent / "other"
    other.mkdir()
    for place in (STDLIB, str(folder.parent / "outside"), str(other)):
        with pytest.raises(PlanError, match="does not contain a plan"):
            with_folder(plan, place, plan)
    (other / "better.json").write_text(json.dumps(plan_of("actions.go")))
    assert with_folder(plan, str(other), plan).folder == str(other)
    allow_modules([str(folder.parent / "outside")])
    assert with_folder(plan, str(folder.parent / "outside"), plan).file == plan.file
