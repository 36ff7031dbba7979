"""The documents as a site: a search, and a menu of its versions."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

import gspn_framework_package

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module", name="built")
def _built(tmp_path_factory):
    """Two small pages, built with the settings of the documents."""
    pytest.importorskip("furo")
    folder = tmp_path_factory.mktemp("pages")
    (folder / "index.md").write_text("# First\n\n```{toctree}\nparts/second\n```\n")
    (folder / "parts").mkdir()
    (folder / "parts" / "second.md").write_text("# Second\n\nA rare word.\n")
    command = [sys.executable, "-m", "sphinx", "-q", "-c", str(DOCS), str(folder)]
    subprocess.run(
        [*command, str(folder / "html")], check=True, timeout=250 * PATIENCE, cwd=str(folder)
    )
    return folder / "html"


def test_a_page_has_the_menu_of_versions_and_its_own_version(built):
    for page, up in (("index.html", "../"), ("parts/second.html", "../../")):
        text = (built / page).read_text()
        assert 'src="%sversions.js"' % up in text
        assert gspn_framework_package.__version__ in text
    assert "rare" in (built / "searchindex.js").read_text()


def test_versions_stand_side_by_side_and_the_newest_is_shown_first(tmp_path):
    add_version = runpy.run_path(str(DOCS / "versions.py"))["add_version"]
    built, site = tmp_path / "html", tmp_path / "site"
    built.mkdir()
    site.mkdir()
    for version in ("0.9", "0.10.0", "0.2.1", "0.9"):
        (built / "index.html").write_text("this is " + version)
        listed = add_version(built, site, version)
    assert listed == ["0.10.0", "0.9", "0.2.1"]
    assert '["0.10.0", "0.9", "0.2.1"]' in (site / "versions.js").read_text()
    assert 'url=0.10.0/index.html"' in (site / "index.html").read_text()
    assert {(site / v / "index.html").read_text() for v in listed} == {
        "this is " + v for v in listed
    }
