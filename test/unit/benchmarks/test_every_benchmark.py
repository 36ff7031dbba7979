"""Every benchmark can be imported and started, and the functions that its plans name exist."""

import importlib
import sys
from pathlib import Path

import pytest

from benchmarks import first_ten_minutes, plans
from gspn_framework_package.cli.main import VERBS

FOLDER = Path(__file__).parents[3] / "benchmarks"
PROGRAMS = sorted(
    ".".join(path.relative_to(FOLDER.parent).with_suffix("").parts)
    for path in FOLDER.rglob("*.py")
    if "def main(" in path.read_text("utf-8") and "argparse" in path.read_text("utf-8")
)


@pytest.mark.parametrize("name", PROGRAMS)
def test_it_explains_itself(name, monkeypatch, capsys):
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] in (
            "agreement",
            "benchmarks",
            "gspn_framework_package",
        ):
            raise
        pytest.skip("%s is not here" % error.name)
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as ended:
        module.main()
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("usage: ")


@pytest.mark.parametrize("function", [plans.LOOP, plans.BRIEF, plans.SHORT, plans.INSTANT])
def test_the_actions_of_the_plans_exist(function):
    module, _, name = function.rpartition(".")
    assert callable(getattr(importlib.import_module(module), name))


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_files_that_it_names_are_there(name):
    try:
        values = vars(importlib.import_module(name)).values()
    except ModuleNotFoundError:
        pytest.skip("see above")
    for path in values:
        if isinstance(path, Path):
            assert path.exists()


@pytest.mark.parametrize("name", [n for n, who in first_ten_minutes.PEOPLE.items() if who.page])
def test_the_page_that_somebody_reads_first_has_commands(name, tmp_path):
    person = first_ten_minutes.PEOPLE[name]
    steps = first_ten_minutes.steps_of(person, tmp_path)
    verbs = [line.split()[1] for line, _ in steps if line.startswith("gspn ")]
    assert len(verbs) >= 3 and set(verbs) <= set(VERBS)
    assert {v for v in verbs if v not in ("draw", "convert")} <= set(first_ten_minutes.EXPECTED)
