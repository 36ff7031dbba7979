"""A plan that is written somewhere else takes what it needs along, or says what it needs."""

import json
import os

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.plan_file import read_plan

FILES = {
    "actions.py": "import os\nimport helpers\nfrom parts.arm import grip\ndef act(): pass\n",
    "helpers.py": "",
    "parts/__init__.py": "",
    "parts/arm/__init__.py": "",
    "parts/arm/grip.py": "from .. import hand\n",
    "parts/hand.py": "",
    "photo.sh": "",
    "seen.py": "def seen(): return False\n",
    "unused.py": "",
}
NEEDED = sorted(set(FILES) - {"unused.py"})


@pytest.fixture(name="plan")
def plan_file(tmp_path):
    places = [{"name": "Hub", "tokens": 1}, {"name": "Walk"}, {"name": "Goal"}]
    arcs = [("Hub", "go"), ("go", "Goal"), ("Hub", "stroll"), ("stroll", "Walk")]
    arcs += [("Walk", "walked"), ("walked", "Hub"), ("Walk", "called"), ("called", "Hub")]
    plan = {
        "plan": "elsewhere",
        "net": {
            "places": places,
            "transitions": [
                {"name": "go"},
                {"name": "stroll"},
                {"name": "walked", "timed": True},
                {"name": "called", "timed": True},
            ],
            "arcs": [{"from": source, "to": target} for source, target in arcs],
        },
        "actions": {"Hub": None, "Walk": "actions.act", "Goal": {"command": ["sh", "photo.sh"]}},
        "events": {"called": {"function": "seen.seen"}},
        "robots": {"r": "Hub"},
    }
    for name, text in FILES.items():
        path = tmp_path / "old" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "old" / "plan.json").write_text(json.dumps(plan))
    return str(tmp_path / "old")


def optimise(plan, output):
    words = ["--timing", "net", "--reach", "Goal >= 1", "--simulate", "0", "--force"]
    return main(["optimise", plan, *words, "-o", str(output)])


def test_a_folder_gets_all_that_the_plan_needs(plan, tmp_path, capsys):
    assert optimise(plan, tmp_path / "new") == 0
    there = [
        os.path.relpath(os.path.join(folder, name), tmp_path / "new")
        for folder, _, names in os.walk(tmp_path / "new")
        for name in names
    ]
    assert sorted(there) == sorted([*NEEDED, "plan.json"])
    assert "note" not in capsys.readouterr().err
    assert read_plan(str(tmp_path / "new")).policy.rows
    assert main(["check", str(tmp_path / "new")]) == 0
    capsys.readouterr()
    (tmp_path / "new" / "helpers.py").write_text("other = 1")
    assert optimise(plan, tmp_path / "new") == 0
    said = capsys.readouterr().err
    assert "helpers.py differs from the file in %s" % plan in said
    assert (tmp_path / "new" / "helpers.py").read_text() == "other = 1"


def test_beside_a_file_it_says_what_is_needed(plan, tmp_path, capsys):
    assert optimise(plan, tmp_path / "new.json") == 0
    said = capsys.readouterr().err
    assert "%s belong beside the plan, in %s" % (", ".join(NEEDED), tmp_path) in said
    assert optimise(plan, os.path.join(plan, "new.json")) == 0
    assert "belong" not in capsys.readouterr().err
