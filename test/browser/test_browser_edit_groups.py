"""Groups of the mode EDIT: nodes that are drawn, selected and moved together."""

import json

import pytest
from page_reading import resize
from test_browser_edit_together import PLAN

READY = "body[data-mode=EDIT][data-ready]"
GROUPS = "() => window.gspn.edit.document.plan.groups"
CHOSEN = "() => [...window.gspn.edit.selection].sort()"
SPOT = """(what) => {
  const { canvas } = window.gspn.edit;
  const node = canvas.nodes.find((n) => n.name === what);
  const box = canvas.container.getBoundingClientRect(), { k, x, y } = canvas.camera.now;
  const rect = document.querySelector(`#ed-net [data-box="${what}"] rect`);
  const at = node ? [node.x, node.y] : [Number(rect.getAttribute("x")) + 8, Number(rect.getAttribute("y")) + 8];
  return [at[0] * k + x + box.left, at[1] * k + y + box.top];
}"""


@pytest.fixture(name="edit")
def _edit(serve_folder, open_page, tmp_path):
    """Opens the editor with a plan of two places, two transitions, and says where its file is."""
    for name in ("round", "other"):
        folder = tmp_path / "plans" / name
        folder.mkdir(parents=True)
        (folder / "plan.json").write_text(json.dumps({**PLAN, "plan": name}, indent=2))
    site = serve_folder(tmp_path / "plans", edits=True)
    page = open_page(site.address + "#file-round/plan.json&edit", ready=False)
    page.wait_for_selector(READY)
    return page, tmp_path / "plans"


def spot(page, what):
    return page.evaluate(SPOT, what)


def click(page, what, twice=False):
    (page.mouse.dblclick if twice else page.mouse.click)(*spot(page, what))


def key(page, *keys):
    for each in keys:
        page.keyboard.press(each)


def make_group(page, title, *keys):
    page.evaluate("(keys) => window.gspn.edit.choose(keys)", list(keys))
    key(page, "Control+g")
    page.wait_for_selector("#ed-name")
    page.keyboard.type(title)
    key(page, "Enter")
    page.wait_for_selector('#ed-net [data-box="%s"]' % title)


def test_a_group_is_made_moved_renamed_copied_and_dissolved(edit, axe, picture):
    page, folder = edit
    make_group(page, "Way there", "place:A", "transition:go")
    assert page.evaluate(GROUPS) == {"Way there": ["A", "go"]}
    both = ["place:A", "transition:go"]

    # a click on a node or on the box selects the group, a double click the node
    click(page, "B")
    assert page.evaluate(CHOSEN) == ["place:B"]
    click(page, "A")
    assert page.evaluate(CHOSEN) == both
    key(page, "Escape")
    click(page, "Way there")
    assert page.evaluate(CHOSEN) == both
    page.wait_for_selector("#ed-net .box.selected")
    axe(page, "edit_group")
    resize(page, 1280, 800)
    key(page, "f")
    picture(page, "edit_group")
    click(page, "A", twice=True)
    assert page.evaluate(CHOSEN) == ["place:A"]
    click(page, "B")

    # chosen with another node, a group takes it in
    page.evaluate("() => window.gspn.edit.choose(['place:A', 'transition:go', 'place:B'])")
    key(page, "Control+g", "Escape")
    assert page.evaluate(GROUPS) == {"Way there": ["A", "go", "B"]}
    key(page, "Control+z")
    page.evaluate("() => window.gspn.edit.choose([])")

    # a drag of the box moves all, and nothing else
    before = {
        n["name"]: n["position"]
        for n in page.evaluate("() => window.gspn.edit.document.net.places")
    }
    x, y = spot(page, "Way there")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 40, y - 30)
    page.mouse.move(x - 80, y - 60)
    page.mouse.up()
    net = page.evaluate("() => window.gspn.edit.document.net")
    after = {n["name"]: n["position"] for n in net["places"] + net["transitions"]}
    way = [after["A"][i] - before["A"][i] for i in (0, 1)]
    assert all(value < 0 for value in way) and after["B"] == before["B"]
    assert [after["go"][i] - value for i, value in enumerate((100, -60))] == pytest.approx(way)

    # a title typed in place, by a double click or F2; a node renamed or deleted
    click(page, "Way there", twice=True)
    page.wait_for_selector("#ed-name[aria-label='Title of the group Way there']")
    page.keyboard.type("Out")
    key(page, "Enter")
    assert page.evaluate(GROUPS) == {"Out": ["A", "go"]}
    page.evaluate("() => window.gspn.edit.actions.rename('place:A', 'Home')")
    assert page.evaluate(GROUPS) == {"Out": ["Home", "go"]}
    key(page, "Control+z", "Control+z")
    assert page.evaluate(GROUPS) == {"Way there": ["A", "go"]}
    key(page, "Control+y", "Control+y")

    # by keys alone: the list has the group, and F2 changes its title
    page.wait_for_selector("#ed-list li:has-text('Out')")
    page.focus("#ed-list")
    key(page, "Home")
    assert page.text_content("#ed-list .at, #ed-list [aria-selected=true]").startswith("Out")
    assert page.evaluate(CHOSEN) == ["place:Home", "transition:go"]
    key(page, "F2")
    page.wait_for_selector("#ed-name")
    page.keyboard.type("Leave")
    key(page, "Enter")
    assert page.evaluate(GROUPS) == {"Leave": ["Home", "go"]}

    # saved as one line, and there after a reload
    key(page, "Control+s")
    page.wait_for_function("() => !window.gspn.edit.document.dirty")
    text = (folder / "round" / "plan.json").read_text()
    assert '  "groups": {"Leave": ["Home", "go"]}' in text, text
    page.reload()
    page.wait_for_selector(READY)
    page.wait_for_selector('#ed-net [data-box="Leave"]')

    # duplicated here, and pasted into another plan
    click(page, "Leave")
    key(page, "Control+d")
    assert page.evaluate(GROUPS) == {"Leave": ["Home", "go"], "Leave_2": ["Home_2", "go_2"]}
    key(page, "Control+z")
    text = page.evaluate(
        "() => { window.gspn.edit.choose(['place:Home', 'transition:go']); return window.gspn.edit.actions.copy(); }"
    )
    page.click("#ed-close")
    page.goto(page.url.split("#")[0] + "#file-other/plan.json&edit")
    page.wait_for_function("() => window.gspn.edit?.opened.path === 'other/plan.json'")
    page.evaluate("(text) => window.gspn.edit.actions.paste(text)", text)
    assert page.evaluate(GROUPS) == {"Leave": ["Home", "go_2"]}
    page.evaluate("() => window.gspn.edit.choose(['transition:go_2'])")
    key(page, "Delete")
    assert page.evaluate(GROUPS) == {"Leave": ["Home"]}
    click(page, "Leave")
    key(page, "Control+Shift+g")
    assert page.evaluate(GROUPS) is None
