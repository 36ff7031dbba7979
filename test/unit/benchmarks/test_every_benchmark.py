"""Every benchmark can be imported and started, and the functions that its plans name exist."""

import importlib
import sys
from pathlib import Path

import pytest

from benchmarks import plans

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
