"""Puts a built site beside those of other versions; ``docs/build --into SITE`` calls it."""

import json
import re
import shutil
import sys
from pathlib import Path
from typing import List, Tuple

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import gspn_framework_package  # noqa: E402

VERSION = re.compile(r"\d+(\.\d+)*")
INDEX = """<!doctype html>
<html lang="en">
<title>gspn_framework_package</title>
<meta http-equiv="refresh" content="0; url=%s/index.html">
<a href="%s/index.html">gspn_framework_package %s</a>
</html>
"""


def numbers(version: str) -> Tuple[int, ...]:
    """The parts of a version, to sort by."""
    return tuple(int(part) for part in version.split("."))


def add_version(built: Path, site: Path, version: str) -> List[str]:
    """Copy a site to ``site/version``, and list all versions there, the newest first.

    What ``site/version`` had before is replaced; other versions stay as they are.
    """
    target = site / version
    if target.exists():
        shutil.rmtree(target)
    shutil.copytree(built, target, ignore=shutil.ignore_patterns(".doctrees", ".buildinfo"))
    found = [path.name for path in site.iterdir() if VERSION.fullmatch(path.name)]
    versions = sorted(found, key=numbers, reverse=True)
    (site / "versions.js").write_text("window.GSPN_VERSIONS = %s;\n" % json.dumps(versions))
    (site / "index.html").write_text(INDEX % ((versions[0],) * 3))
    return versions


if __name__ == "__main__":
    place = Path(sys.argv[2])
    place.mkdir(parents=True, exist_ok=True)
    listed = add_version(Path(sys.argv[1]), place, gspn_framework_package.__version__)
    print("%s/index.html: %s" % (place, ", ".join(listed)))
