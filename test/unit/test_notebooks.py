"""The notebooks in docs/notebooks: every cell runs, and shows what is stored."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"

_spec = importlib.util.spec_from_file_location("notebook_pages", str(DOCS / "notebook_pages.py"))
pages = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(pages)


def without_times(text):
    """What differs from run to run, between solvers, and where numba is missing, left out."""
    text = re.sub(r"[\d.]+ s\)|\((numpy|numba|sparse)\)", "", text)
    return re.sub(r"\d+\.\d{7,}", lambda number: "%.6f" % float(number.group()), text)


@pytest.mark.long
@pytest.mark.parametrize("path", pages.notebooks(), ids=lambda path: path.stem)
def test_every_cell_runs_and_shows_what_is_stored(path):
    stored = pages.read(path)
    shown = pages.shown_texts(pages.execute(stored))
    assert shown
    assert list(map(without_times, shown)) == list(map(without_times, pages.shown_texts(stored))), (
        "python3 docs/notebook_pages.py stores what the cells show now"
    )


def test_what_differs_is_seen():
    notebook = {"cells": [{"cell_type": "code", "source": ["x = 2\n", "print('a')\n", "x + 1"]}]}
    assert pages.shown_texts(pages.execute(notebook)) == ["a\n", "3"]
    with pytest.raises(ZeroDivisionError):
        pages.execute({"cells": [{"cell_type": "code", "source": ["1 / 0"]}]})


def test_the_document_lists_the_notebooks():
    text = (DOCS / "notebooks.md").read_text("utf-8")
    names = [path.stem for path in pages.notebooks()]
    assert len(names) >= 6
    assert re.findall(r"\]\(notebooks/(\w+)\.ipynb\)", text) == names
    assert re.findall(r"^notebooks/(\w+)$", text, re.MULTILINE) == names


@pytest.mark.parametrize("path", pages.notebooks(), ids=lambda path: path.stem)
def test_a_notebook_is_one_that_jupyter_opens_and_its_page_has_its_pictures(path):
    notebook = json.loads(path.read_text("utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 4)
    assert notebook["cells"][0]["source"][0].startswith("# ")
    keys = {"cell_type", "metadata", "source"}
    for cell in notebook["cells"]:
        code = cell["cell_type"] == "code"
        assert cell.keys() == (keys | {"execution_count", "outputs"} if code else keys)
    page = pages.page_of(notebook)
    assert "<svg" in page
    assert "<table>" in page
    assert ".ipynb" not in page
