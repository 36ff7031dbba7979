"""Two people edit one plan at the same time: they see each other, and nothing of either is lost."""

import json

import pytest
from page_reading import resize

READY = "body[data-mode=EDIT][data-ready]"
PLAN = {
    "plan": "round",
    "net": {
        "places": [
            {"name": "A", "tokens": 1, "position": [0, 0]},
            {"name": "B", "position": [200, 0]},
        ],
        "transitions": [
            {"name": "go", "position": [100, -60]},
            {"name": "back", "position": [100, 60]},
        ],
        "arcs": [
            {"from": "A", "to": "go"},
            {"from": "go", "to": "B"},
            {"from": "B", "to": "back"},
            {"from": "back", "to": "A"},
        ],
    },
    "actions": {"A": None, "B": None},
    "policy": {"places": ["A"], "rows": [{"marking": [1], "choose": {"go": 1}}]},
    "robots": {"r": "A"},
}
CHANGE = """([label, text]) => {
  const change = new Function("d", text);
  window.gspn.edit.document.edit(label, (state) => {
    const d = JSON.parse(JSON.stringify(state));
    change(d);
    return d;
  });
}"""
SAME = "(text) => JSON.stringify(window.gspn.edit.document.state) === text"
STATE = "() => JSON.stringify(window.gspn.edit.document.state)"


@pytest.fixture(name="people")
def _people(serve_folder, open_page, tmp_path):
    """Opens the plan for two people; the second may meet conflicts, which are error answers."""
    plan = tmp_path / "plans" / "round"
    plan.mkdir(parents=True)
    file = plan / "plan.json"
    file.write_text(json.dumps(PLAN))
    site = serve_folder(tmp_path / "plans", edits=True)
    pages = []
    for _ in range(2):
        address = site.address + "#file-round/plan.json&edit"
        page = open_page(address, ready=False, expect_errors=True)
        page.wait_for_selector(READY)
        pages.append(page)
    for page in pages:
        page.wait_for_selector("#ed-others:has-text('Editor')")
    return (*pages, file, site)


def change(page, text):
    page.evaluate(CHANGE, ["Change", text])


def state(page):
    return json.loads(page.evaluate(STATE))


def wait_until(page, condition):
    page.wait_for_function("() => { const d = window.gspn.edit.document; return %s; }" % condition)


def places(page):
    return {node["name"]: node for node in state(page)["net"]["places"]}


def test_two_people_see_each_others_work_and_lose_none(people, axe, picture):
    ann, ben, file, _ = people
    # at the same time: fields of one place, a new place of one name, rows and columns of the policy
    change(
        ann,
        "d.net.places[0].tokens = 3; d.net.places.push({name: 'C', position: [0, 200]});"
        "d.policy.rows.push({marking: [2], choose: {go: 1}}); d.plan.seed = 7;"
        "d.net.arcs[1].bends = [[200, -90]];",
    )
    change(
        ben,
        "d.net.places[0].position = [-50, 0]; d.net.places.push({name: 'C', tokens: 2, position: [200, 200]});"
        "d.net.arcs.push({from: 'C', to: 'back'}); d.policy.places.push('B');"
        "d.policy.rows[0].marking.push(0); d.plan.description = 'Ben';"
        "d.net.arcs[2].bends = [[220, 90], [160, 110]];",
    )
    for page in (ann, ben):
        wait_until(page, "d.plan.seed === 7 && d.plan.description === 'Ben'")
        found = places(page)
        assert found["A"] == {"name": "A", "tokens": 3, "position": [-50, 0]}
        assert set(found) == {"A", "B", "C", "C_2"}
        (arc,) = [a for a in state(page)["net"]["arcs"] if a["to"] == "back" and a["from"] != "B"]
        assert found[arc["from"]]["tokens"] == 2  # Ben's arc leads from Ben's place
        policy = state(page)["policy"]
        assert policy["places"] == ["A", "B"]
        assert [row["marking"] for row in policy["rows"]] == [[1, 0], [2, "-"]]
        bends = {arc["from"]: arc["bends"] for arc in state(page)["net"]["arcs"] if "bends" in arc}
        assert bends == {"go": [[200, -90]], "B": [[220, 90], [160, 110]]}

    # undo takes back the own edit, and nothing of the other's
    ann.click("#ed-undo")
    wait_until(ben, "d.plan.seed === undefined")
    assert places(ben)["A"] == {"name": "A", "tokens": 1, "position": [-50, 0]}
    assert state(ann)["plan"]["description"] == "Ben"

    # one saves, for both
    ben.keyboard.press("Control+s")
    for page in (ann, ben):
        wait_until(page, "!d.dirty")
    assert json.loads(file.read_text())["description"] == "Ben"

    # each sees what the other has selected
    ann.evaluate("() => window.gspn.edit.choose(['place:B'])")
    ben.wait_for_selector(".ed-others circle", state="attached")
    resize(ben, 1280, 720)
    picture(ben, "edit_together")
    axe(ben, "two people in one plan")


def test_what_both_changed_is_shown_element_by_element(people, picture, axe):
    ann, ben, file, _ = people
    for page in (ann, ben):  # neither hears of the other for a while
        page.context.set_offline(True)
    change(ann, "d.net.places[0].tokens = 3; d.net.places[1].tokens = 4;")
    change(
        ben,
        "d.net.places[0].tokens = 5; d.net.arcs = d.net.arcs.filter(a => a.to !== 'B' && a.from !== 'B');"
        "d.net.places.splice(1, 1); delete d.plan.actions.B;",
    )
    ann.context.set_offline(False)
    ann.wait_for_selector("#ed-draft-state:has-text('Draft stored')")
    ben.context.set_offline(False)
    ben.wait_for_selector("#ed-both li:has-text('place A, tokens: yours is 5, theirs 3')")
    ben.wait_for_selector("#ed-both li:has-text('place B')")
    assert ben.locator("#ed-both li button").count() == 1  # what one removed stays
    assert ben.evaluate(
        "(tabs) => { const t = document.querySelector(tabs); return t.scrollWidth <= t.clientWidth; }",
        "#ed-tabs",
    )
    picture(ben, "edit_conflicts")
    axe(ben, "what both changed")
    assert places(ben)["B"]["tokens"] == 4  # changed by the one, so it stays
    wait_until(ann, "d.net.places.find((p) => p.name === 'A').tokens === 5")
    ben.click("#ed-both button[aria-label*='place A, tokens']")
    wait_until(ann, "d.net.places.find((p) => p.name === 'A').tokens === 3")
    ben.click("#ed-undo")
    wait_until(ann, "d.net.places.find((p) => p.name === 'A').tokens === 5")

    # leaving without saving takes nothing from the other
    ann.click("#ed-close")
    ann.click("#dialog button:has-text('Leave without saving')")
    ben.wait_for_selector("#ed-others:has-text('Editor')", state="hidden")
    change(ben, "d.plan.seed = 1;")
    ben.keyboard.press("Control+s")
    wait_until(ben, "!d.dirty")
    assert json.loads(file.read_text())["net"]["places"][0]["tokens"] == 5


def test_two_people_group_the_same_plan(people):
    ann, ben, _, _ = people
    change(ann, "d.plan.groups = {Out: ['A', 'go']};")
    for page in (ann, ben):
        wait_until(page, "d.plan.groups?.Out?.length === 2")
    # at the same time: a node more each, the same new title for other nodes
    change(ann, "d.plan.groups.Out.push('B');")
    change(ben, "d.plan.groups.Out.push('back'); d.plan.description = 'Ben';")
    for page in (ann, ben):
        wait_until(page, "d.plan.groups.Out.length === 4")
    # another title from one, while the other takes a node out; and back
    change(ann, "d.plan.groups = {Way: d.plan.groups.Out};")
    change(
        ben,
        "const [title] = Object.keys(d.plan.groups);"
        "d.plan.groups[title] = d.plan.groups[title].filter((name) => name !== 'go');",
    )
    for page in (ann, ben):
        wait_until(page, "d.plan.groups.Way?.length === 3")
        assert set(state(page)["plan"]["groups"]) == {"Way"}
    change(ben, "d.plan.groups = {Out: [...d.plan.groups.Way, 'go']};")
    for page in (ann, ben):
        wait_until(page, "d.plan.groups.Out?.length === 4")
    # one dissolves it in part, the other deletes a node of it
    change(ann, "d.plan.groups.Out = ['A', 'B', 'back'];")
    ben.evaluate(
        "() => { const m = window.gspn.edit; m.choose(['transition:back']); m.actions.remove(); }"
    )
    for page in (ann, ben):
        wait_until(page, "d.plan.groups.Out.length === 2 && d.net.transitions.length === 1")
        assert state(page)["plan"]["groups"] == {"Out": ["A", "B"]}
