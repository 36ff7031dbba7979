"""The notebooks in docs/notebooks: runs them, and makes a page of each.

python3 docs/notebook_pages.py    runs them and stores what they show
"""

import ast
import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List

FOLDER = Path(__file__).parent / "notebooks"

Notebook = Dict[str, Any]
"""A notebook as its file has it (nbformat 4)."""

SHOWS_ITSELF = {"text/html": "_repr_html_", "image/svg+xml": "_repr_svg_"}
"""Kind of output -> the method that Jupyter asks for it."""


STYLE = "<style>.output svg { max-width: 100%; height: auto; }</style>"


def notebooks() -> List[Path]:
    """Return the files, in reading order."""
    return sorted(FOLDER.glob("*.ipynb"))


def read(path: Path) -> Notebook:
    """Read a notebook."""
    return json.loads(path.read_text("utf-8"))


def execute(notebook: Notebook) -> Notebook:
    """Run the cells in an empty folder, and return the notebook with what they show. An error ends
    it."""
    names: Dict[str, Any] = {"__name__": "__main__"}
    cells, number, before = [], 0, os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for cell in notebook["cells"]:
                if cell["cell_type"] == "code":
                    number += 1
                    outputs = list(_outputs("".join(cell["source"]), names, number))
                    cell = {**cell, "execution_count": number, "outputs": outputs}
                cells.append(cell)
        finally:
            os.chdir(before)
    return {**notebook, "cells": cells}


def _outputs(source: str, names: Dict[str, Any], number: int) -> Iterator[Dict[str, Any]]:
    """Run a cell, and yield what it prints and the value of its last line."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    value, printed = None, io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell %d" % number, "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), "cell %d" % number, "eval"), names)
    if printed.getvalue():
        yield {"name": "stdout", "output_type": "stream", "text": _lines(printed.getvalue())}
    if value is not None:
        data = {"text/plain": _lines(repr(value))}
        for kind, method in SHOWS_ITSELF.items():
            if hasattr(value, method):
                data[kind] = _lines(getattr(value, method)())
        yield {
            "data": data,
            "execution_count": number,
            "metadata": {},
            "output_type": "execute_result",
        }


def _lines(text: str) -> List[str]:
    return text.splitlines(keepends=True)


def shown_texts(notebook: Notebook) -> List[str]:
    """Return what the cells show, as text."""
    found = []
    for cell in notebook["cells"]:
        for output in cell.get("outputs", ()):
            found.append("".join(output.get("text") or output["data"]["text/plain"]))
    return found


def page_of(notebook: Notebook) -> str:
    """Return the notebook as Markdown, with its tables and pictures inside."""
    parts = [_fenced("{raw} html", STYLE)]
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source.replace(".ipynb)", ".md)"))  # links to others
        else:
            parts.append(_fenced("python", source))
        parts += map(_page_of_output, cell.get("outputs", ()))
    return "\n\n".join(parts) + "\n"


def _page_of_output(output: Dict[str, Any]) -> str:
    data = output.get("data", {})
    for kind in ("image/svg+xml", "text/html"):
        if kind in data:
            return _fenced("{raw} html", '<div class="output">%s</div>' % "".join(data[kind]))
    return _fenced("text", "".join(output.get("text") or data["text/plain"]))


def _fenced(language: str, text: str) -> str:
    return "````%s\n%s\n````" % (language, text.rstrip("\n"))


def write_pages() -> None:
    """Write a page beside each notebook, unless it is there as it should be."""
    for path in notebooks():
        page, text = path.with_suffix(".md"), page_of(read(path))
        if not page.exists() or page.read_text("utf-8") != text:
            page.write_text(text, "utf-8")


def main() -> None:
    """Run all notebooks and store what they show."""
    sys.path.insert(0, str(FOLDER.parents[1]))
    for path in notebooks():
        text = json.dumps(execute(read(path)), indent=1, ensure_ascii=False, sort_keys=True)
        path.write_text(text + "\n", "utf-8")
        print(path.name)


if __name__ == "__main__":
    main()
