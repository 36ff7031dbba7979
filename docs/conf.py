"""Settings of Sphinx; ``docs/build`` makes the pages."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(HERE)]

import notebook_pages  # noqa: E402

import gspn_framework_package  # noqa: E402

project = "gspn_framework_package"
author = "gspn_framework_package developers"
copyright = author
release = version = gspn_framework_package.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "_templates"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = "gspn_framework_package " + release
html_copy_source = False
templates_path = ["_templates"]
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "sidebar/search.html",
        "versions.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
# What is promised stable, and what tests of plans import.
STABLE = ("gspn", "gspn_framework_package.testing")


def write_api_pages() -> None:
    """One page for each of the packages that users import."""
    folder = HERE / "api"
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.rst"):
        if old.stem not in STABLE:
            old.unlink()
    for name in STABLE:
        lines = [name, "=" * len(name), "", ".. automodule:: " + name]
        lines += ["   :members:", "   :imported-members:", "   :show-inheritance:", ""]
        text = "\n".join(lines)
        page = folder / (name + ".rst")
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


write_api_pages()
notebook_pages.write_pages()
