"""The examples of docs/analysis.md, and of the docstrings, run and give what they say."""

import doctest
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import gspn_framework_package.analysis
from gspn_framework_package.model import condition

ROOT = Path(__file__).parents[3]


def test_the_examples_of_the_page(monkeypatch):
    monkeypatch.chdir(ROOT)
    text = (ROOT / "docs" / "analysis.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 4
    test = doctest.DocTestParser().get_doctest("\n".join(blocks), {}, "analysis.md", None, 0)
    assert doctest.DocTestRunner().run(test).failed == 0


PREFIX = "gspn_framework_package.analysis."
MODULES = [
    found.name[len(PREFIX) :]
    for found in pkgutil.walk_packages(gspn_framework_package.analysis.__path__, PREFIX)
]


@pytest.mark.long
@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_the_docstrings(name):
    try:
        module = importlib.import_module(PREFIX + name)
    except ImportError as error:
        assert "numba" in str(error)
        pytest.skip("numba is missing")
    assert doctest.testmod(module).failed == 0


def test_the_examples_of_conditions():
    result = doctest.testmod(condition)
    assert result.failed == 0 and result.attempted
