"""What helps in the mode EDIT: the check after each edit, witnesses, the difference, the export;
saving, drafts, and two people on one file."""

import json

import pytest

from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project

READY = "body[data-mode=EDIT][data-ready]"
NET = {
    "name": "round",
    "places": [
        {"name": "A", "tokens": 1, "position": [0, 0]},
        {"name": "B", "position": [200, 0]},
        {"name": "Fuel", "tokens": 5, "position": [100, 120]},
    ],
    "transitions": [
        {"name": "go", "timed": True, "rate": 1.0, "position": [100, -60]},
        {"name": "back", "timed": True, "rate": 1.0, "position": [100, 60]},
    ],
    "arcs": [
        {"from": "A", "to": "go"},
        {"from": "go", "to": "B"},
        {"from": "B", "to": "back"},
        {"from": "back", "to": "A"},
    ],
}
PLAN = {
    "plan": "round",
    "net": NET,
    "actions": {"A": None, "B": "actions.work"},
    "resource_places": ["Fuel"],
    "robots": {"r": "A"},
    "description": "Kept as it is.",
}


@pytest.fixture(name="folder")
def _folder(tmp_path):
    plan = tmp_path / "served" / "round"
    plan.mkdir(parents=True)
    (plan / "plan.json").write_text(json.dumps(PLAN, indent=2))
    (plan / "actions.py").write_text("def work():\n    pass\n")
    return plan


@pytest.fixture(name="open_editor")
def _open_editor(site, folder, open_page):
    sites = []

    def make(**options):
        if not sites:
            sites.append(site(Project(Folder(str(folder.parent)), edits=True)))
        address = sites[0].address + "#file-round/plan.json&edit"
        page = open_page(address, ready=False, **options)
        page.wait_for_selector(READY)
        return page

    return make


def edit(page, label, change):
    """Make an edit: ``change`` lists paths in the state with their new values; None removes, "+"
    appends."""
    page.evaluate(
        """([label, change]) => window.gspn.edit.document.edit(label, (state) => {
          const d = JSON.parse(JSON.stringify(state));
          for (const [path, value] of change) {
            let inside = d;
            for (const step of path.slice(0, -1)) inside = inside[step];
            const last = path[path.length - 1];
            if (last === "+") inside.push(value);
            else if (value === null) delete inside[last];
            else inside[last] = value;
          }
          return d;
        })""",
        [label, change],
    )


def state_of_check(page, state):
    page.wait_for_selector("#ed-verdict[data-state=%s]" % state)


def test_each_edit_is_checked_and_the_witness_plays(open_editor, axe, tmp_path):
    page = open_editor(accept_downloads=True)
    state_of_check(page, "checked")
    page.click("#ed-verdict")
    assert page.text_content("#ed-check-state") == "May run, 1 warning."  # Fuel has no arc
    assert page.locator(".ed-net [class~=mark-warning]").count() == 1

    # a half-drawn net: the error is at its element, and says so at once
    edit(page, "Draw half", [[["net", "transitions", 1, "rate"], 0]])
    state_of_check(page, "invalid")
    page.wait_for_selector(".ed-net .mark-error")
    page.click("#ed-findings .error button.link")
    assert page.evaluate("() => [...window.gspn.edit.selection]") == ["transition:back"]
    page.evaluate("() => window.gspn.edit.document.undo()")
    state_of_check(page, "checked")
    assert page.locator(".ed-net .mark-error").count() == 0

    # fuel runs out: the way there plays on the drawing
    edit(page, "Burn fuel", [[["net", "arcs", "+"], {"from": "Fuel", "to": "go", "weight": 5}]])
    page.click("#ed-findings button:has-text('Play 2 steps')")
    page.wait_for_function("() => window.gspn.edit.canvas.counts?.get('B') === 1")
    page.wait_for_function(
        "() => window.gspn.edit.canvas.counts?.get('A') === 1"
        " && window.gspn.edit.canvas.counts.get('Fuel') === 0"
    )

    # what would happen at the marking that is shown: nothing can fire
    page.click("#ed-here-open")
    page.wait_for_selector("#ed-here:has-text('No transition is enabled')")
    edit(page, "Give fuel", [[["net", "places", 2, "tokens"], 9]])
    assert page.text_content("#ed-here") == "", "an answer about an older document is not shown"
    page.click("#ed-here-ask")
    page.wait_for_selector("#ed-here:has-text('Enabled: go')")

    # the difference: green, amber, a red ghost
    edit(
        page,
        "Change much",
        [
            [["net", "places", "+"], {"name": "New", "position": [300, 100]}],
            [["net", "arcs"], [NET["arcs"][0], {"from": "back", "to": "B"}]],
        ],
    )
    page.click("#ed-diff")
    page.wait_for_selector("#ed-diff-title:has-text('Not saved: ')")
    page.wait_for_selector("[data-arc='back>B'].diff-added, .ed-net .diff-added")
    page.wait_for_selector("#ed-changes .diff-removed:has-text('arc go → B')")
    page.wait_for_selector("#ed-changes .diff-changed:has-text('place Fuel, tokens: 5 → 9')")
    assert page.locator(".ed-net .place.diff-added, .ed-net .diff-added").count() >= 2
    assert page.locator(".ed-net .diff-changed").count() == 1
    assert page.locator(".diff-ghosts line").count() == 3
    axe(page, "the editor with changes")
    page.click("#ed-tab-checks")
    axe(page, "the editor with findings")
    page.click("#ed-tab-here")
    axe(page, "the editor with what happens")
