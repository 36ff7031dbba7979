"""``gspn new``: every template is a plan without warnings, whose own tests pass."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from lxml import etree
from waiting import PATIENCE

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making import templates
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.testing import Scenario

ROOT = Path(__file__).parents[2]
PLACES = ["Room 1", "Küche", "B-2", "yard"]


@pytest.fixture(scope="module", name="made")
def _made(tmp_path_factory):
    """A folder with a plan from each template, and a larger one of each."""
    folder = tmp_path_factory.mktemp("made")
    for name in templates.templates_by_name():
        templates.write(name, str(folder / name))
        places = PLACES if templates.takes_places(name) else None
        templates.write(name, str(folder / ("large-" + name)), robots=5, places=places)
    return folder


@pytest.mark.parametrize("size", ["", "large-"])
@pytest.mark.parametrize("name", templates.templates_by_name())
def test_a_new_plan_has_no_warnings_and_runs(made, capsys, name, size):
    folder = str(made / (size + name))
    assert main(["check", folder, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["notes"] == []
    assert {item["severity"] for item in report["items"]} == {"ok"}
    plan = read_plan(folder)
    assert plan.name == size + name and len(plan.robots) == (5 if size else len(plan.robots))
    assert all(node.position for node in (*plan.net.places, *plan.net.transitions))
    run = Scenario(plan, functions=True, drawn=True)
    run.advance(120.0)
    run.check_no_faults()
    assert run.fired


@pytest.mark.parametrize("name", templates.templates_by_name())
def test_a_new_plan_is_analysed(made, capsys, name):
    assert main(["analyse", str(made / name), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["steady_state"]


def test_the_tests_of_the_new_plans_pass(made):
    folders = [str(made / name) for name in (*templates.templates_by_name(), "large-patrol")]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *folders],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd=str(made),
        capture_output=True,
        text=True,
        timeout=250 * PATIENCE,
    )
    assert done.returncode == 0, done.stdout
    assert "skipped" not in done.stdout


@pytest.mark.parametrize("size", ["", "large-"])
@pytest.mark.parametrize("name", templates.templates_by_name())
def test_the_test_on_ros_names_what_the_new_plan_has(made, name, size):
    """It runs in test/rostest/new."""
    folder = made / (size + name)
    module = (size + name).replace("-", "_")
    text = (folder / ("rostest_%s.py" % module)).read_text(encoding="utf-8")
    found = {
        target.id: ast.literal_eval(node.value)
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign)
        for target in node.targets
    }
    plan = read_plan(str(folder))
    assert found["ROBOTS"] == len(plan.robots)
    nodes = {node.name for node in (*plan.net.places, *plan.net.transitions)}
    assert found["PROMISED"] and found["PROMISED"] <= nodes
    run = Scenario(plan)
    for _ in range(found["BUSY"] if name == "deliver" else 0):
        run.submit("order", {"address": "door 1"})
    run.advance(10.0)
    assert len({move.robot for firing in run.firings for move in firing.moves}) >= found["BUSY"]
    launch = etree.fromstring((folder / (module + ".test")).read_bytes())
    given = {arg.get("name"): arg.get("value") for arg in launch.find("include")}
    assert given == {"plan": "$(dirname)", "robots": str(len(plan.robots))}
    assert "/rostest_%s.py'" % module in launch.find("test").get("launch-prefix")


def test_it_refuses_a_folder_that_exists_and_leaves_it(tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    assert main(["new", "patrol", str(tmp_path / "mine")]) == 2
    assert "the folder exists already" in capsys.readouterr().err
    assert list((tmp_path / "mine").iterdir()) == []


@pytest.mark.parametrize(
    "options, said",
    [
        (["tango"], "there is no template 'tango'"),
        (["patrol", "--places", "A"], "takes 2 to 50 places"),
        (["patrol", "--places", "A", "A"], "named twice"),
        (["patrol", "--places", "A", "../B"], "cannot be the name"),
        (["charge", "--places", "A", "B"], "has no places to choose"),
        (["rendezvous", "--robots", "1"], "supports 2 to 1000 robots"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_written(tmp_path, capsys, options, said):
    folder = tmp_path / "new"
    assert main(["new", options[0], str(folder), *options[1:]]) == 2
    assert said in capsys.readouterr().err
    assert not folder.exists()


def test_a_folder_that_cannot_be_written_is_not_left_half_made(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gspn_framework_package.making.plan_folder.open", full, raising=False)
    with pytest.raises(Exception, match="No space left"):
        templates.write("patrol", str(tmp_path / "new"))
    assert list(tmp_path.iterdir()) == []


def test_it_lists_templates_and_tells_what_it_wrote(tmp_path, capsys):
    assert main(["new", "--list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == templates.templates_by_name()
    folder = tmp_path / "with space"
    assert main(["new", "patrol", str(folder), "--json"]) == 0
    written = json.loads(capsys.readouterr().out)
    assert sorted(written["files"]) == sorted(path.name for path in folder.iterdir())
    assert "test_with_space.py" in written["files"]


def test_python_may_name_the_plan(tmp_path):
    templates.write("deliver", str(tmp_path / "folder"), plan="Post of today")
    assert read_plan(str(tmp_path / "folder")).name == "Post of today"
    with pytest.raises(UsageError):
        templates.write("deliver", str(tmp_path / "folder"))
