"""The mode EDIT: a net drawn by pointer and by keys, its shell, its accessibility, large nets."""

import json

import pytest

from benchmarks.page.feed import workshop
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project

READY = "body[data-mode=EDIT][data-ready]"
WHERE = """(name) => {
  const { canvas } = window.gspn.edit;
  const node = canvas.nodes.find((n) => n.name === name);
  const box = canvas.container.getBoundingClientRect(), { k, x, y } = canvas.camera.now;
  return { x: node.x * k + x + box.left, y: node.y * k + y + box.top, k };
}"""
NET = "() => window.gspn.edit.document.net"


def net(page):
    return page.evaluate(NET)


def names(page, kind):
    return [node["name"] for node in net(page)[kind]]


def arcs(page):
    return {(a["from"], a["to"]) for a in net(page)["arcs"]}


def status(page, text):
    page.wait_for_selector("#ed-status:has-text(%s)" % json.dumps(text))


def where(page, name):
    found = page.evaluate(WHERE, name)
    return found["x"], found["y"], found["k"]


def drag(page, start, end):
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    page.mouse.move(*end)
    page.mouse.up()


def draw_arc(page, name, end):
    """From the right handle of a node to a point of the page."""
    x, y, k = where(page, name)
    page.mouse.move(x, y)
    page.wait_for_selector("[data-handle='0']")
    drag(page, (x + 36 * k, y), end)


def key(page, *keys):
    for each in keys:
        page.keyboard.press(each)


@pytest.fixture(name="edit")
def _edit(site, open_page, tmp_path):
    """Opens the editor with the plan of a folder that is made of ``plans``: name -> plan."""

    def make(plans, first, **options):
        folder = tmp_path / "plans"
        for name, plan in plans.items():
            (folder / name).mkdir(parents=True)
            (folder / name / "plan.json").write_text(json.dumps(plan))
        made = site(Project(Folder(str(folder)), edits=True))
        page = open_page(made.address, ready=False, **options)
        page.click("#opening button:has-text('%s')" % first)
        page.click("#ed-open")
        page.wait_for_selector(READY)
        return page

    return make


ONE = {
    "plan": "one",
    "net": {"places": [{"name": "Home", "position": [0, 0]}], "transitions": [], "arcs": []},
    "actions": {"Home": None},
}


def test_a_net_is_drawn_by_pointer(edit, picture):
    page = edit({"one": ONE}, "one")
    assert page.text_content("#mode") == "EDIT" and "&edit" in page.url
    x, y, k = where(page, "Home")
    # node and arc in one gesture, twice; then back to the first
    draw_arc(page, "Home", (x + 120 * k, y))
    assert arcs(page) == {("Home", "T1")}
    assert net(page)["transitions"][0] == {
        "name": "T1",
        "timed": True,
        "rate": 1,
        "position": [120, 0],
    }
    draw_arc(page, "T1", (x + 120 * k, y + 150 * k))
    assert arcs(page) == {("Home", "T1"), ("T1", "P1")}
    home = where(page, "Home")
    draw_arc(page, "P1", home[:2])  # two places: refused, and the page says why
    status(page, "An arc joins a place and a transition; both of these are places.")
    assert len(arcs(page)) == 2
    page.dblclick("#ed-net", position={"x": 60, "y": 60})
    assert len(names(page, "places")) == 3
    key(page, "Control+z")
    # a dragged node snaps to the line of another; its arcs go with it, and look as before
    x, y, k = where(page, "P1")
    looks = """() => [...document.querySelectorAll("#ed-net .lines")].map((line) =>
        getComputedStyle(line).stroke)"""
    before = page.evaluate(looks)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 118 * k, y)
    assert page.evaluate(
        """() => { const { canvas } = window.gspn.edit, node = canvas.byKey.get("place:P1");
        return canvas.lifted.has(node) && [...node.arcs].every(({ element }) =>
          element.parentNode === canvas.layer.liftedArcs); }"""
    )
    assert page.evaluate(looks) == before and "none" not in before
    page.mouse.up()
    page.wait_for_function("() => !window.gspn.edit.canvas.lifted.size")
    assert page.evaluate("() => window.gspn.edit.canvas.layer.liftedNodes.childElementCount") == 0
    assert next(p for p in net(page)["places"] if p["name"] == "P1")["position"] == [0, 150]
    # renamed where it is drawn; a name that is taken is refused
    page.dblclick("#ed-net", position=_inside(page, "P1"))
    page.fill("#ed-name", "Home")
    key(page, "Enter")
    status(page, "there is a place 'Home' already".capitalize())
    page.fill("#ed-name", "Bed <b>1</b>")
    key(page, "Enter")
    assert arcs(page) == {("Home", "T1"), ("T1", "Bed <b>1</b>")}
    # the rubber band; aligned, copied and pasted
    box = page.locator("#ed-net").bounding_box()
    drag(page, (box["x"] + 10, box["y"] + 10), (box["x"] + box["width"] - 60, box["y"] + 700))
    assert page.evaluate("() => window.gspn.edit.selection.size") == 3
    key(page, "Control+c", "Control+v")
    assert names(page, "places") == ["Home", "Bed <b>1</b>", "Home_2", "Bed <b>1</b>_2"]
    assert page.evaluate("() => window.gspn.edit.document.plan.actions.Home_2") is None
    page.select_option("#ed-arrange", "left")
    drawn = page.evaluate(
        "() => window.gspn.edit.actions.chosenNodes().map((n) => Math.round(n.x))"
    )
    assert len(drawn) == 3 and len(set(drawn)) == 1
    picture(page, "edit")
    key(page, "Delete")
    assert names(page, "places") == ["Home", "Bed <b>1</b>"]
    # text on the clipboard that is no net, or half of one, changes nothing
    before = net(page)
    paste = """(text) => { const data = new DataTransfer(); data.setData("text/plain", text);
        document.dispatchEvent(new ClipboardEvent("paste", { clipboardData: data })); }"""
    for text in ("no net", '{"gspn-part": 1, "places": [{"name": "A"}]}'):
        page.evaluate(paste, text)
        status(page, "The clipboard does not contain a part of a net.")
    assert net(page) == before
    while page.is_enabled("#ed-undo"):
        page.click("#ed-undo")
    assert net(page) == ONE["net"] and not page.evaluate("() => window.gspn.edit.document.dirty")
    while page.is_enabled("#ed-redo"):
        page.click("#ed-redo")
    assert net(page) == before
    pasted = [
        {"name": "chosen", "timed": False, "weight": 0, "position": [0, 0]},
        {
            "name": "waits",
            "timed": True,
            "rate": "2 * #Home",
            "servers": None,
            "position": [0, 60],
        },
    ]
    part = {"gspn-part": 1, "places": [], "transitions": pasted, "arcs": []}
    page.evaluate(paste, json.dumps(part))
    assert [(t.get("weight"), t.get("rate")) for t in net(page)["transitions"][1:]] == [
        (0, None),
        (None, "2 * #Home"),
    ]
    key(page, "Control+d")
    assert [t.get("servers", 1) for t in net(page)["transitions"][1:]] == [1, None, 1, None]


def _inside(page, name):
    x, y, _ = where(page, name)
    box = page.locator("#ed-net").bounding_box()
    return {"x": x - box["x"], "y": y - box["y"]}


BENT = {
    "plan": "bent",
    "net": {
        "places": [
            {"name": "A", "tokens": 1, "position": [0, 0]},
            {"name": "B", "position": [0, -68]},  # so near that it is shown as large as it is
        ],
        "transitions": [{"name": "t", "timed": True, "position": [300, 0]}],
        "arcs": [{"from": "A", "to": "t"}, {"from": "t", "to": "A"}],
    },
    "actions": {"A": None, "B": None},
    "robots": [{"name": "r", "place": "A"}],
}
COURSE = "(arcs) => arcs.map(({ line }) => line.getAttribute?.('d') ?? line)"
BENDS = "() => window.gspn.edit.document.net.arcs.map((arc) => arc.bends ?? [])"


def test_arcs_are_bent_by_hand(edit, tmp_path):
    page = edit({"bent": BENT}, "bent")
    x, y, k = where(page, "A")
    at = lambda dx, dy: (x + dx * k, y + dy * k)  # noqa: E731
    bends = lambda: page.evaluate(BENDS)  # noqa: E731
    # dragged, and the bend dragged on; a second one between it and the end
    drag(page, at(150, 10), at(100, 120))
    assert bends() == [[[100, 120]], []] or bends() == [[], [[100, 120]]]
    bent = bends().index([[100, 120]])
    drag(page, at(100, 120), at(60, 150))
    drag(page, at(180, 75), at(240, 150))
    assert bends()[bent] == [[60, 150], [240, 150]]
    page.keyboard.press("Escape")
    page.mouse.dblclick(*at(60, 150))
    assert bends()[bent] == [[240, 150]]
    # by keys: the next bend, or another one; both ends move, and the bends with them
    key(page, "b", "ArrowDown", "Shift+ArrowRight")
    assert bends()[bent] == [[290, 160]]
    key(page, "b")
    assert len(bends()[bent]) == 2
    key(page, "Shift+B", "Control+z", "Control+z", "Control+z")
    assert bends()[bent] == [[240, 150]]
    field = page.locator("#ed-properties input[data-key$='.bends']")
    shown = "() => document.querySelector(\"#ed-properties [data-key$='.bends']\").value"
    page.wait_for_function(shown + " === '240 150'")
    field.fill("240 150 7")  # not pairs
    field.press("Enter")
    page.wait_for_selector("#ed-properties .wrong:has-text('x y x y')")
    assert bends()[bent] == [[240, 150]]
    field.fill("")
    field.press("Enter")
    assert bends() == [[], []]
    page.focus("#ed-net")
    key(page, "Control+z", "Control+a", "ArrowDown", "Escape")
    assert bends()[bent] == [[240, 160]]
    # as it is drawn, so it is saved, and shown where tokens run along it
    drawn = page.evaluate("(c) => eval(c)(window.gspn.edit.canvas.arcs.all)", COURSE)
    assert page.evaluate("() => window.gspn.edit.canvas.bounds()[3]") > 160  # all is in sight
    key(page, "Control+s")
    page.wait_for_function("() => !window.gspn.edit.document.dirty")
    saved = json.loads((tmp_path / "plans" / "bent" / "plan.json").read_text())
    assert [arc.get("bends", []) for arc in saved["net"]["arcs"]] == bends()
    page.click("#ed-close")
    page.wait_for_selector("body[data-mode=SIMULATE][data-ready]")
    # the page may show the session as it was, until it has read what was saved
    page.wait_for_function(
        "([c, drawn]) => JSON.stringify(eval(c)(window.gspn.page.view.arcs.all)) === JSON.stringify(drawn)",
        arg=[COURSE, drawn],
    )
    assert page.evaluate("() => window.gspn.page.view.bounds()[3]") > 160
    legs = page.evaluate(
        """() => { const { travel, places, transitions } = window.gspn.page.view;
        return [[places[0], transitions[0]], [transitions[0], places[0]]]
          .map((ends) => travel.leg(...ends, 0, 1).map(({ transform }) => transform)); }"""
    )
    assert len(legs[bent]) > 4 and len(legs[1 - bent]) >= 4


def test_a_net_is_drawn_by_keys_alone(edit, axe):
    page = edit({"one": ONE}, "one")
    page.focus("#ed-list")
    key(page, "ArrowDown")
    assert page.get_attribute("#ed-list li[aria-selected=true]", "data-key") == "place:Home"
    key(page, "Shift+T", "Shift+P", "F2")
    page.keyboard.type("Bed")
    key(page, "Enter", "+", "+", "-")
    assert arcs(page) == {("Home", "T1"), ("T1", "Bed")}
    # an arc: its end is chosen by arrow keys; an inhibitor arc, its end in the list
    key(page, "i", "a", "ArrowRight")
    status(page, "An arc from t1 to Bed: press Enter to add it.")
    key(page, "ArrowRight", "Enter")
    page.click("#ed-list li[data-key='place:Bed']")
    key(page, "a")
    page.focus("#ed-list")
    key(page, "End")
    status(page, "Select a place or a transition.")
    page.fill("#ed-search", "t1")
    page.focus("#ed-list")
    key(page, "Home")
    status(page, "An arc from Bed to t1: press Enter to add it.")
    key(page, "Enter", "h", "+", "F2")
    page.keyboard.type("3")
    key(page, "Enter")
    page.fill("#ed-search", "")
    assert net(page)["arcs"] == [
        {"from": "Home", "to": "T1"},
        {"from": "T1", "to": "Bed"},
        {"from": "t1", "to": "Home"},
        {"from": "Bed", "to": "t1", "inhibitor": True, "weight": 3},
    ]
    assert net(page)["places"][1]["tokens"] == 1
    page.click("#ed-list li[data-key='transition:T1']")
    key(page, "x")
    assert "rate" not in net(page)["transitions"][0]
    before = next(t for t in net(page)["transitions"] if t["name"] == "T1")["position"]
    page.focus("#ed-net")
    key(page, "ArrowUp", "Shift+ArrowLeft", "Control+ArrowLeft")
    after = next(t for t in net(page)["transitions"] if t["name"] == "T1")["position"]
    assert after == [before[0] - 50, before[1] - 10]
    assert page.evaluate("() => [...window.gspn.edit.selection]") == ["place:Home"]
    # a witness is played on the drawing; an edit ends it
    page.evaluate("() => window.gspn.edit.play(['t1', 'T1'], [{ Bed: 1 }, {}, { Bed: 2 }])")
    page.wait_for_selector("#ed-witness:has-text('2 of 2 fired')")
    assert page.evaluate("() => window.gspn.edit.canvas.counts.get('Bed')") == 2
    # the check has marked the places without an action
    page.wait_for_function(
        """() => [...document.querySelectorAll(".mark-error title")].some((title) =>
        title.textContent.startsWith("Bed: no action is mapped to Bed"))"""
    )
    axe(page, "the editor")
    key(page, "+")
    page.wait_for_selector("#ed-witness", state="detached")
    assert page.evaluate("() => window.gspn.edit.canvas.counts") is None
    key(page, "?")
    page.wait_for_selector("dialog[open]:has-text('select the next node in that direction')")


def touch(page, start, end):
    """Put fingers down at points of the page, move them, and lift them."""
    session = page.context.new_cdp_session(page)
    for kind, points in (("Start", start), ("Move", end), ("End", [])):
        fingers = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": "touch" + kind, "touchPoints": fingers})
    session.detach()


def chosen(page):
    return page.evaluate("() => [...window.gspn.edit.selection]")


def test_several_are_chosen_arranged_and_copied_by_keys(edit, axe):
    page = edit({"one": ONE, "home": SUB}, "home")
    dirty = "() => window.gspn.edit.document.dirty"
    page.focus("#ed-list")
    key(page, "Home", "Control+ArrowDown", "Control+ArrowDown")
    assert chosen(page) == ["place:Dock"]
    at = page.get_attribute("#ed-list", "aria-activedescendant")
    assert page.get_attribute("#%s" % at, "data-key") == "transition:go"
    key(page, "Space", "Control+ArrowDown", "Space", "Space")
    assert chosen(page) == ["place:Dock", "transition:go"]
    # arrow keys and letters look for an entry of the menu, Enter takes it
    page.focus("#ed-arrange")
    key(page, "ArrowDown", "ArrowDown", "a")
    assert page.input_value("#ed-arrange") == "left" and not page.evaluate(dirty)
    key(page, "Enter")
    assert page.input_value("#ed-arrange") == ""
    across = "(names) => names.map((name) => window.gspn.edit.canvas.byKey.get(name).x)"
    left = page.evaluate(across, ["place:Dock", "transition:go"])
    assert left[0] == left[1] and page.evaluate(dirty)
    # from one net into another
    page.focus("#ed-net")
    key(page, "Control+c")
    page.focus("#ed-list")
    key(page, "Home", "Control+Enter")
    page.wait_for_selector("#ed-crumbs:has-text('one/plan.json')")
    page.focus("#ed-net")
    key(page, "Control+v")
    assert names(page, "places") == ["Home", "Dock"] and names(page, "transitions") == ["go"]
    assert arcs(page) == {("go", "Dock")}
    # the next node in a direction too; without a choice the arrows move the view
    page.focus("#ed-list")
    key(page, "Home")
    page.focus("#ed-net")
    key(page, *("Control+Shift+Arrow" + way for way in ("Up", "Down", "Left", "Right")))
    assert len(chosen(page)) > 1
    key(page, "Escape")
    page.wait_for_function("() => !window.gspn.edit.canvas.camera.flight")
    before = page.evaluate("() => window.gspn.edit.canvas.camera.now.x")
    key(page, "ArrowRight", "Shift+ArrowRight")
    assert page.evaluate("() => window.gspn.edit.canvas.camera.now.x") == before - 360
    key(page, "Control+a")
    axe(page, "the properties of several")


SUB = {
    "plan": "home",
    "net": {
        "places": [{"name": "Work", "tokens": 1}, {"name": "Dock"}],
        "transitions": [{"name": "go", "timed": True}, {"name": "leave", "timed": True}],
        "arcs": [
            {"from": "Work", "to": "go"},
            {"from": "go", "to": "Dock"},
            {"from": "Dock", "to": "leave"},
            {"from": "leave", "to": "Work"},
        ],
    },
    "actions": {
        "Work": "a.b",
        "Dock": {"plan": "../one/plan.json", "entry": "Home", "exit": "Home"},
    },
    "robots": {"r1": "Work"},
}


def test_subnets_reloads_and_unsaved_work(edit):
    page = edit({"one": ONE, "home": SUB}, "home", has_touch=True)
    page.wait_for_selector(".place.subnet-box")
    page.click("#ed-list li[data-key='place:Work']")
    key(page, "+")
    page.click("#ed-list li[data-key='place:Dock']")
    page.wait_for_function("() => !window.gspn.edit.canvas.camera.flight")
    page.dblclick("#ed-net", position=_inside(page, "Dock"))
    page.wait_for_selector("#ed-crumbs:has-text('one/plan.json')")
    assert names(page, "places") == ["Home"]
    page.click("#ed-crumbs button")
    page.wait_for_selector(".place.subnet-box")
    assert net(page)["places"][0]["tokens"] == 2  # what was not saved is still there
    key(page, "Control+z")
    page.reload()
    page.wait_for_selector(READY)
    assert page.text_content("#title") == "home"
    # two fingers zoom, one moves the view, and nothing is edited
    before = page.evaluate("() => ({ ...window.gspn.edit.canvas.camera.now })")
    touch(page, [(500, 400), (600, 400)], [(500, 400), (700, 400)])
    touch(page, [(500, 400)], [(530, 440)])
    after = page.evaluate("() => window.gspn.edit.canvas.camera.now")
    assert after["k"] == pytest.approx(2 * before["k"])
    assert not page.evaluate("() => window.gspn.edit.document.dirty")
    # a click in the small picture moves the view there, here to the middle of the net
    page.click(".minimap")
    middle = page.evaluate(
        """() => { const { camera } = window.gspn.edit.canvas, { k, x, y } = camera.now;
        const [x0, y0, x1, y1] = window.gspn.edit.canvas.bounds(), { width, height } = camera.size;
        return [(k * (x0 + x1)) / 2 + x - width / 2, (k * (y0 + y1)) / 2 + y - height / 2]; }"""
    )
    assert max(map(abs, middle)) < 20 * after["k"]
    # a tap chooses a node, which a finger then moves
    page.click("#ed-fit")
    page.wait_for_function("() => !window.gspn.edit.canvas.frame")
    assert page.is_hidden(".minimap")
    x, y, k = where(page, "Work")
    touch(page, [(x, y)], [(x + 40, y)])
    assert not page.evaluate("() => window.gspn.edit.document.dirty")
    x, y, k = where(page, "Work")
    page.touchscreen.tap(x, y)
    page.wait_for_function("() => window.gspn.edit.selection.has('place:Work')")
    touch(page, [(x, y)], [(x, y - 60 * k)])
    moved = where(page, "Work")
    assert moved[0] == pytest.approx(x, abs=7) and moved[1] == pytest.approx(y - 60 * k, abs=7)
    key(page, "Control+z")
    assert not page.evaluate("() => window.gspn.edit.document.dirty")
    # leaving with unsaved work asks
    page.click("#ed-list li[data-key='place:Work']")
    key(page, "+")
    page.wait_for_selector("#subtitle:has-text('not saved')")
    assert page.evaluate(
        """() => !dispatchEvent(new Event("beforeunload", { cancelable: true }))"""
    )
    page.click("#ed-close")
    page.click("dialog button:has-text('Stay')")
    assert "&edit" in page.url and net(page)["places"][0]["tokens"] == 2
    page.click("#ed-close")
    page.click("dialog button:has-text('Leave without saving')")
    page.wait_for_selector("body[data-mode=SIMULATE]")
    assert "&edit" not in page.url


def test_a_net_of_1000_nodes_and_1000_edits_undone(edit):
    plan = {"plan": "large", "net": net_to_json(workshop(1000)), "actions": {}}
    page = edit({"large": plan}, "large")
    before = net(page)
    # a menu of all places is made when somebody turns to it
    page.evaluate("() => window.gspn.edit.choose(['place:r0_p0'])")
    page.click("summary:has-text('Robots that start here')")
    menu = page.locator("select[data-key='plan.robots.0.place']")
    menu.locator("option").first.wait_for(state="attached")  # an unfolded form is filled soon after
    assert menu.locator("option").all_text_contents() == ["r0_p0"]
    menu.focus()
    menu.locator("option").nth(len(before["places"]) - 1).wait_for(state="attached")
    assert menu.locator("option").count() == len(before["places"])
    assert menu.locator("option:checked").text_content() == "r0_p0"
    key(page, "ArrowDown")
    page.wait_for_function("() => window.gspn.edit.document.plan.robots?.robot_1 === 'r0_p1'")
    page.click("#ed-undo")
    # what an edit does not change is not drawn again
    page.evaluate(
        """() => { const { canvas, document: edited } = window.gspn.edit;
        window.drawn = 0;
        new MutationObserver((all) => { window.drawn += all.filter((m) =>
          !m.target.closest(".label") && ![...m.addedNodes, ...m.removedNodes].some((n) => n.classList?.contains("label"))).length; })
          .observe(canvas.container, { subtree: true, childList: true, attributes: true, attributeFilter: ["d", "transform", "class"] });
        window.gspn.edit.choose(["place:r0_p0"]);
        window.gspn.edit.actions.nudge(1, 0); }"""
    )
    page.wait_for_function("() => window.drawn > 0 && !window.gspn.edit.canvas.frame")
    assert page.evaluate("() => window.drawn") < 30
    page.evaluate(
        """() => { window.row = document.querySelector("#ed-list li[data-key='place:r0_p1']");
        window.gspn.edit.actions.count(1); }"""
    )
    page.wait_for_selector("#ed-list li[data-key='place:r0_p0'] .tokens:text-is('3')")
    assert page.evaluate("() => window.row.isConnected")
    page.evaluate("() => window.gspn.edit.undo()")
    # a view that moves is not drawn again until it rests, and nodes are where they belong before and after
    off, waits = page.evaluate(
        """async () => { const { canvas } = window.gspn.edit, { camera } = canvas;
        const frame = () => new Promise(requestAnimationFrame);
        const off = () => { const box = canvas.container.getBoundingClientRect(), { k, x, y } = camera.now;
          return Math.max(...canvas.nodes.filter((n) => n.type === "place" && !n.hidden).map((n) => {
            const at = n.element.querySelector("circle").getBoundingClientRect();
            return Math.hypot((at.left + at.right) / 2 - box.left - n.x * k - x, (at.top + at.bottom) / 2 - box.top - n.y * k - y); })); };
        camera.zoom(2.5);
        while (camera.drawn !== camera.now) await frame();
        camera.pan(70.5, -90);
        await frame();
        camera.zoom(0.9);
        await frame();
        const moving = off(), waits = camera.drawn !== camera.now;
        while (camera.drawn !== camera.now) await frame();
        return [[moving, off()], waits]; }"""
    )
    assert waits and max(off) < 1, off
    # of the list's rows those are drawn that the keys have come to
    page.focus("#ed-list")
    key(page, "End", "ArrowUp")
    at = page.get_attribute("#ed-list", "aria-activedescendant")
    assert page.get_attribute("#%s" % at, "aria-selected") == "true"
    assert page.locator("#ed-list li").count() < 170
    page.evaluate(
        "() => { for (let i = 0; i < 999; i++) window.gspn.edit.actions.add(i % 2 ? 'place' : 'timed', 50 * i, -500); }"
    )
    assert page.evaluate("() => window.gspn.edit.document.done.length") == 1000
    drawn = "() => document.querySelectorAll('#ed-net :is(.place, .transition)').length"
    assert page.evaluate(drawn) == len(before["places"] + before["transitions"]) + 999
    page.evaluate("() => { while (window.gspn.edit.document.undo()); }")
    assert net(page) == before
    assert page.evaluate(drawn) == len(before["places"] + before["transitions"])


def test_what_is_typed_after_a_node_was_added_is_its_name(edit):
    page = edit({"one": ONE}, "one")
    titles = [page.get_attribute("#ed-add-" + what, "title") for what in ("timed", "immediate")]
    assert titles == ["Add a timed transition (T)", "Add an immediate transition (I)"]

    def name(text, whole=None):
        page.keyboard.type(text)
        key(page, "Enter")
        status(page, "to %s" % (whole or text))

    page.dblclick("#ed-net", position={"x": 60, "y": 60})
    name("Depot hall")
    page.click("#ed-add-place")
    page.click("#ed-net", position={"x": 60, "y": 300})
    name("Attic")
    x, y, k = where(page, "Attic")
    draw_arc(page, "Attic", (x + 120 * k, y))
    name("fix it")
    # after a key that adds, in the drawing and in the list
    page.mouse.move(300, 5)
    page.focus("#ed-net")
    key(page, "Escape", "p")
    name("Depot yard")
    page.focus("#ed-list")
    key(page, "i")
    # a name may begin with the letter of a tool: a second letter comes at once
    page.evaluate(
        """() => { for (const key of "pa") document.activeElement.dispatchEvent(
        new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true })); }"""
    )
    page.wait_for_selector("#ed-name")
    name("int it", "paint it")
    assert names(page, "places") == ["Home", "Depot hall", "Attic", "Depot yard"]
    assert names(page, "transitions") == ["fix it", "paint it"]
    assert arcs(page) == {("Attic", "fix it")}
    # a tool's letter alone is that tool, and undo means the node while nothing is typed
    key(page, "Escape", "p", "t", "Escape")
    assert names(page, "places")[-1] == "P1" and names(page, "transitions")[-1] == "T1"
    page.dblclick("#ed-net", position={"x": 60, "y": 460})
    assert names(page, "places")[-1] == "P2"
    key(page, "Control+z")
    assert names(page, "places")[-1] == "P1"


def test_an_edit_is_undone_after_the_editor_was_left(edit):
    page = edit({"one": ONE}, "one")
    page.click("#ed-list li[data-key='place:Home']")
    key(page, "+", "Control+s")
    status(page, "Saved.")
    for left in ("saved", "unsaved"):
        if left == "unsaved":
            page.click("#ed-list li[data-key='place:Home']")
            key(page, "+")
        page.click("#ed-close")
        if left == "unsaved":
            page.click("dialog button:has-text('Leave without saving')")
        page.wait_for_selector("body[data-mode=SIMULATE]")
        page.click("#ed-open")
        page.wait_for_selector(READY)
        before = net(page)["places"][0].get("tokens", 0)
        assert before == 1
        page.click("#ed-undo")
        assert net(page)["places"][0].get("tokens", 0) == (2 if left == "unsaved" else 0)
        page.click("#ed-redo")


def test_choosing_in_the_list_leaves_the_view_where_it_is(edit):
    page = edit({"one": ONE, "home": SUB}, "home")
    page.wait_for_function("() => window.gspn.edit.canvas.camera.now")
    page.click("#ed-fit")
    camera = "() => window.gspn.edit.canvas.camera.flight || window.gspn.edit.canvas.camera.now"
    before = page.evaluate(camera)
    for each in ("place:Work", "place:Dock", "transition:go", "transition:leave"):
        page.click("#ed-list li[data-key='%s']" % each)
        assert page.evaluate(camera) == before, each
    # what is out of sight comes into sight, no nearer
    page.evaluate("() => window.gspn.edit.canvas.camera.pan(-2000, 0)")
    page.click("#ed-list li[data-key='place:Work']")
    page.wait_for_function("() => !window.gspn.edit.canvas.camera.flight")
    x, y, k = where(page, "Work")
    box = page.locator("#ed-net").bounding_box()
    assert k == before["k"] and box["x"] < x < box["x"] + box["width"] / 2


def test_functions_that_are_written_meanwhile_are_offered(edit, tmp_path):
    page = edit({"one": ONE}, "one")
    page.click("#ed-list li[data-key='place:Home']")
    page.wait_for_selector("#ed-properties")
    (tmp_path / "plans" / "one" / "actions.py").write_text("def sweep(is_cancelled):\n    pass\n")
    page.wait_for_selector("#ed-right option:has-text('actions.sweep')", state="attached")


# T stands between S and B, far from its own places; R1 and R2 stand in the way of two arcs
ROW = {
    "places": [
        {"name": "A", "position": [0, 0]},
        {"name": "R1", "position": [200, 0]},
        {"name": "R2", "position": [300, 0]},
        {"name": "B", "position": [500, 0]},
    ],
    "transitions": [
        {"name": "T", "position": [100, 0], "timed": True},
        {"name": "back", "position": [400, 0], "timed": True},
        {"name": "up", "position": [250, 140], "timed": False},
    ],
    "arcs": [
        {"from": "A", "to": "T"},
        {"from": "T", "to": "B", "weight": 2},
        {"from": "B", "to": "back"},
        {"from": "back", "to": "A"},
        {"from": "R1", "to": "up"},
        {"from": "up", "to": "R1"},
        {"from": "R2", "to": "up", "inhibitor": True},
    ],
}
LINES = """(net) => [...document.querySelectorAll(`${net} .arcs .lines:not(.near)`)].flatMap((path) =>
  path.getAttribute("d").split(/(?=M)/)).filter(Boolean).sort()"""
THROUGH = """() => {
  const { nodes, arcs } = window.gspn.edit.canvas;
  const through = [];
  for (const arc of arcs.all) {
    const length = arc.line.getTotalLength();
    for (let s = 0; s <= length; s += 2) {
      const { x, y } = arc.line.getPointAtLength(s);
      for (const node of nodes)
        if (node !== arc.from && node !== arc.to && Math.hypot(node.x - x, node.y - y) < 20)
          through.push(`${arc.key} through ${node.name}`);
    }
  }
  return [...new Set(through)];
}"""


def test_arcs_avoid_nodes_and_are_drawn_alike_in_all_modes(edit, picture, tmp_path):
    page = edit({"row": {"plan": "row", "net": ROW, "actions": {}}}, "row")
    assert page.evaluate(THROUGH) == []
    drawn = page.evaluate(LINES, "#ed-net")
    assert len(drawn) == len(ROW["arcs"])
    picture(page, "arcs-around-nodes")
    page.click("#ed-export")
    page.select_option("#ed-export-format", "svg")
    with page.expect_download() as file:
        page.click("#dialog .primary")
    file.value.save_as(tmp_path / "row.svg")
    saved = (tmp_path / "row.svg").read_text()
    assert all('d="%s"' % line in saved for line in drawn)
    # a node that comes into the way of an arc, and goes again
    page.evaluate("""() => { const { canvas, actions } = window.gspn.edit;
        const [x, y] = canvas.arcsByKey.get("arc:T>B")[0].shape.middle;
        actions.add("place", x, y); }""")
    page.wait_for_function("() => !window.gspn.edit.canvas.frame")
    assert len(net(page)["places"]) == 5 and page.evaluate(THROUGH) == []
    assert page.evaluate(LINES, "#ed-net") != drawn
    page.click("#ed-undo")
    page.wait_for_function("() => !window.gspn.edit.canvas.frame")
    assert page.evaluate(LINES, "#ed-net") == drawn
    # the board draws them so, too
    page.click("#ed-close")
    page.wait_for_selector("body[data-mode=SIMULATE][data-ready]")
    assert page.evaluate(LINES, "#net") == drawn
    picture(page, "arcs-around-nodes-simulated")
