"""The mode EDIT from an empty drawing on: ways to begin, arcs from the rim, a quiet check, room for all of it."""

import json

import pytest
from page_reading import resize

READY = "body[data-mode=EDIT][data-ready]"
EMPTY = {"plan": "empty", "net": {"places": [], "transitions": [], "arcs": []}, "actions": {}}
OUTSIDE = """([selector, width]) => [...document.querySelectorAll(selector)].filter((e) => {
  const box = e.getBoundingClientRect();
  return box.width && (box.left < 0 || box.right > width || e.scrollWidth > e.clientWidth + 1);
}).map((e) => e.id || e.className)"""
ROWS = "(elements) => new Set(elements.map((e) => e.getBoundingClientRect().top)).size"
POINT = """([name, dx, dy]) => {
  const { canvas } = window.gspn.edit, node = canvas.nodes.find((n) => n.name === name);
  const box = canvas.container.getBoundingClientRect(), { k, x, y } = canvas.camera.now;
  return [(node.x + dx) * k + x + box.left, (node.y + dy) * k + y + box.top];
}"""


@pytest.fixture(name="empty")
def _empty(serve_folder, open_page, tmp_path):
    plan = tmp_path / "plans" / "empty"
    plan.mkdir(parents=True)
    (plan / "plan.json").write_text(json.dumps(EMPTY))
    site = serve_folder(tmp_path / "plans", edits=True)
    page = open_page(site.address + "#file-empty/plan.json&edit", ready=False)
    page.wait_for_selector(READY)
    return page


def point(page, name, dx=0, dy=0):
    return page.evaluate(POINT, [name, dx, dy])


def drag(page, start, end):
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=3)


def test_an_empty_drawing_says_how_to_begin_and_stays_quiet(empty, axe, picture):
    page = empty
    assert page.locator("#ed-beginning button").count() == 3
    picture(page, "edit_empty")
    axe(page, "an empty drawing")
    resize(page, 1280, 720)
    page.click("#ed-begin-template")
    page.wait_for_selector("dialog[open] #ed-new-template")
    page.keyboard.press("Escape")
    # a part, dragged from its picture
    at = {"x": 200, "y": 480}
    page.locator(".ed-palette button:has-text('Lane')").drag_to(
        page.locator("#ed-net"), target_position=at
    )
    found = page.evaluate("() => window.gspn.edit.document.state")
    assert found["plan"]["resource_places"] == ["Lane_Free"] and len(found["net"]["arcs"]) == 4
    x, y = point(page, "Lane")
    box = page.locator("#ed-net").bounding_box()
    assert abs(x - box["x"] - 200) < 10 and abs(y - box["y"] - 480) < 60
    page.click("#ed-undo")
    page.click("#ed-begin-draw")
    page.keyboard.type("Home")
    page.keyboard.press("Enter")
    assert page.is_hidden("#ed-beginning")

    # inside a node a drag moves it, from its rim it draws an arc
    x, y = point(page, "Home")
    drag(page, (x, y), (x - 60, y))
    page.mouse.up()
    assert page.evaluate("() => window.gspn.edit.document.net.arcs.length") == 0
    drag(page, point(page, "Home", 19), point(page, "Home", 130))
    page.mouse.up()
    page.keyboard.type("work")
    page.keyboard.press("Enter")
    drag(page, point(page, "work", -2, 21), point(page, "Home", 4))
    page.wait_for_selector(".ghost .goal")
    page.mouse.up()
    found = page.evaluate("() => window.gspn.edit.document.net.arcs")
    assert [(a["from"], a["to"]) for a in found] == [("Home", "work"), ("work", "Home")]
    page.keyboard.press("Control+z")
    assert page.evaluate("() => window.gspn.edit.document.net.arcs.length") == 1
    page.keyboard.press("Control+z")  # the name of "work"
    page.keyboard.press("Control+z")  # the transition, with its arc
    page.wait_for_function("() => window.gspn.edit.findings.length")
    page.wait_for_selector("#ed-verdict:not([data-state=checking])")
    assert page.locator(".ed-net .mark-error").count() == 0  # nothing is drawn that could be wrong


def test_the_tools_have_pictures_and_all_has_room(empty, picture):
    page = empty
    resize(page, 1280, 720)
    assert page.locator("#ed-tools .ed-group:not([hidden])").evaluate_all(ROWS) == 1
    without = (
        "() => [...document.querySelectorAll('#ed-tools button:not(:has(svg))')].map((b) => b.id)"
    )
    assert page.evaluate(without) == []
    for width in (1280, 1024):
        resize(page, width, 720)
        picture(page, "edit_%d" % width)
        assert page.locator("#ed-tabs button").evaluate_all(ROWS) == 1
        for part in ("#ed-tools button", "#ed-tabs button", "#ed-tabs", "#ed-right select"):
            assert page.evaluate(OUTSIDE, [part, width]) == [], (part, width)
