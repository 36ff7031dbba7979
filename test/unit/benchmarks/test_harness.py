"""The harness that starts real teams: what a team needs is derived from its plan."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.harness.team import LaunchedTeam, Measurement, NodeTeam, needs_of, percentile_99
from benchmarks.plans import INSTANT, ring_plan, tokens_plan
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import ExecutionError


@pytest.fixture
def started(monkeypatch):
    """The command lines of the programs that are started, by name."""
    words = {}
    monkeypatch.setattr(
        "benchmarks.harness.programs.Programs.start",
        lambda self, name, command, *more: words.update({name: command}),
    )
    return words


@pytest.mark.parametrize("team", [NodeTeam, LaunchedTeam])
def test_a_robot_is_allowed_the_modules_of_its_plan(started, team):
    plan = ring_plan(2, 1, INSTANT)
    elsewhere = {"p1": FunctionAction("other.actions.go", "p1")}
    with team(replace(plan, actions={**plan.actions, **elsewhere})):
        allowed = [
            word.split(":=")[1].strip('"')
            for words in started.values()
            for word in words
            if word.split(":=")[0].strip("_") == "modules"
        ]
    assert allowed == ["benchmarks.load,other.actions"]


def test_functions_in_the_folder_of_a_plan_are_copied(started):
    plan = read_plan(plans_folder() + "/inspection")
    files, modules = needs_of(plan)
    assert [file.rsplit("/", 1)[1] for file in files] == ["actions.py"] and modules == []
    with NodeTeam(plan) as team:
        assert read_plan(team.folder).actions == plan.actions
        assert Path(team.folder, "actions.py").read_text() == Path(files[0]).read_text()


def test_a_module_of_the_checkout_is_no_file_of_the_plan():
    assert needs_of(tokens_plan()) == ([], ["benchmarks.load"])


def test_the_files_of_a_team_stay_only_where_it_failed(started, capsys):
    with NodeTeam(ring_plan(2, 1)) as team:
        folder = Path(team.folder)
    assert not folder.exists()
    with pytest.raises(ExecutionError), NodeTeam(ring_plan(2, 1)) as team:
        folder = Path(team.folder)
        raise ExecutionError("it did not go on")
    assert folder.exists() and str(folder) in capsys.readouterr().err
    shutil.rmtree(str(folder))


def test_a_measurement_is_summed_up():
    found = Measurement(2.0, 6, [], [3.0, 1.0, 2.0], {}, None, None)
    assert found.firings_per_s == 3.0
    assert found.latencies() == {
        "coordinated_median_ms": 2.0,
        "coordinated_p99_ms": 3.0,
        "coordinated_count": 3,
    }
    assert percentile_99(range(1000)) == 990
