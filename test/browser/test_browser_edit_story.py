"""The greenhouse of docs/first_plan.md, made in the page from nothing: drawn, completed, saved, run,
and opened again. Only its actions are written elsewhere."""

import json
import re
from pathlib import Path

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json

READY = "body[data-mode=EDIT][data-ready]"
SAVE = """async () => {
  const { post } = await import("/static/js/api.js");
  const { id, opened, document: edited } = window.gspn.edit;
  const { etag } = await post("edit/save", { etag: opened.etag, document: edited.state }, { id });
  opened.etag = etag;
  edited.markSaved();
}"""
TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "first_plan.md"


def block(caption):
    """The last block of the tutorial with this caption: a file of the plan."""
    text = TUTORIAL.read_text(encoding="utf-8")
    found = re.findall(r":caption: %s\n\n(.*?)```" % re.escape(caption), text, re.DOTALL)
    return found[-1]


def tutorial_plan():
    first = re.search(
        r":caption: greenhouse/plan.json\n\n(.*?)```", TUTORIAL.read_text(), re.DOTALL
    )
    data = json.loads(first.group(1))
    policies = re.findall(
        r":caption: greenhouse/policy.json\n\n(.*?)```", TUTORIAL.read_text(), re.DOTALL
    )
    data["policy"] = json.loads(policies[1])
    return data


class Editor:
    """The editor as a person uses it."""

    def __init__(self, page):
        self.page = page

    def keys(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)

    def name(self, name):
        """Name what is chosen."""
        self.keys("F2")
        self.page.keyboard.type(name)
        self.keys("Enter")
        self.page.wait_for_selector("#ed-list li[aria-selected=true]:has-text('%s')" % name)

    def choose(self, key):
        self.page.click("#ed-list li[data-key='%s']" % key)

    def arc(self, start, end):
        self.choose(start)
        self.keys("a")
        self.choose(end)
        self.keys("Enter")

    def after(self, node, key, name):
        """Add a node after another one, and the arc between them."""
        self.choose(node)
        self.keys("Shift+" + key)
        self.name(name)

    def control(self, key):
        return self.page.locator("#ed-right [data-key='%s']:visible" % key)

    def enter(self, key, text):
        self.control(key).fill(text)
        self.keys("Tab")

    def tab(self, name):
        self.page.click("#ed-tab-" + name)
        self.page.wait_for_selector("#ed-panel-%s .ed-form > *" % name)
        self.page.evaluate(
            """(name) => { for (const fold of document.querySelectorAll(`#ed-panel-${name} details`))
            fold.open = true; }""",
            name,
        )


def draw(editor):
    page = editor.page
    page.dblclick("#ed-net", position={"x": 120, "y": 200})
    editor.name("Water")
    editor.keys("+", "+")
    # node and arc in one gesture
    box = page.locator("#ed-net").bounding_box()
    at = page.evaluate(
        """() => { const { canvas } = window.gspn.edit; const [node] = canvas.nodes;
        const { k, x, y } = canvas.camera.now; return [node.x * k + x, node.y * k + y, k]; }"""
    )
    x, y = box["x"] + at[0], box["y"] + at[1]
    page.mouse.move(x, y)
    page.wait_for_selector("[data-handle='0']")
    page.mouse.move(x + 36 * at[2], y)
    page.mouse.down()
    page.mouse.move(x + 100, y)
    page.mouse.move(x + 120, y)
    page.mouse.up()
    editor.name("watered")
    page.mouse.move(5, 5)
    # the rest by keys
    editor.after("transition:watered", "P", "Look")
    editor.after("transition:watered", "P", "Watered")
    editor.after("place:Look", "I", "again")
    editor.arc("transition:again", "place:Water")
    editor.after("place:Look", "I", "refill")
    editor.after("transition:refill", "P", "Refill")
    editor.after("place:Refill", "T", "refilled")
    editor.arc("transition:refilled", "place:Water")
    editor.after("transition:refilled", "P", "Tap")
    editor.keys("+")
    editor.arc("place:Tap", "transition:refill")
    editor.choose("transition:watered")
    editor.tab("properties")
    editor.enter("net.transition:watered.rate", "2")


def complete(editor):
    for place in ("Tap", "Watered"):
        editor.choose("place:" + place)
        editor.control("kind." + place).select_option(
            label="resource place: its tokens are counters"
        )
    for place, action in (("Water", "actions.Watering"), ("Refill", "actions.refill")):
        editor.choose("place:" + place)
        editor.tab("properties")
        editor.control("plan.actions.%s add" % place).click()
        editor.control("plan.actions.%s.kind" % place).select_option(
            label="a function of the plan's folder"
        )
        editor.enter("plan.actions.%s.function" % place, action)
    editor.choose("place:Look")
    editor.tab("properties")
    editor.control("plan.actions.Look add").click()
    editor.control("plan.actions.Look.kind").select_option(label="nothing: done at once")
    editor.tab("plan")
    editor.enter("plan.until", "Watered >= 12")
    editor.control("plan.spawn add").select_option("Water")
    editor.tab("policy")
    editor.control("policy.places add").select_option("Water")
    editor.control("policy.rows add").click()
    editor.enter("policy.rows.0.marking.0", "1")
    editor.enter("policy.rows.0.choose.again", "0.7")
    editor.control("policy.rows.0.choose add").select_option("refill")
    editor.enter("policy.rows.0.choose.refill", "0.3")
    editor.control("policy.rows add").click()


def same_plan(made, wanted):
    """The plan of the tutorial, whatever the order of its nodes and wherever they are drawn."""
    for plan in (made, wanted):
        assert plan.name == "greenhouse"
    assert {(p.name, p.tokens) for p in made.net.places} == {
        (p.name, p.tokens) for p in wanted.net.places
    }
    assert {t._replace(position=None) for t in made.net.transitions} == {
        t._replace(position=None) for t in wanted.net.transitions
    }
    assert set(made.net.arcs) == set(wanted.net.arcs)
    made, wanted = (plan_to_json(plan) for plan in (made, wanted))
    for key in ("actions", "resource_places", "spawn", "until", "policy"):
        assert made[key] == wanted[key], key


def test_the_greenhouse_is_made_in_the_page(serve_folder, open_page, tmp_path, picture):
    folder = tmp_path / "plans"
    folder.mkdir()
    site = serve_folder(folder, edits=True)
    page = open_page(site.address, ready=False, expect_errors=True)
    page.click("#ed-new")
    page.fill("#ed-new-name", "greenhouse")
    page.click("dialog button:has-text('Make it')")
    page.wait_for_selector(READY)
    (folder / "greenhouse" / "actions.py").write_text(block("greenhouse/actions.py"))
    editor = Editor(page)
    draw(editor)
    complete(editor)
    picture(page, "edit_story")
    made = page.evaluate("() => window.gspn.edit.document.state")
    wanted = plan_from_json(tutorial_plan())
    same_plan(
        plan_from_json({**made["plan"], "net": made["net"], "policy": made["policy"]}), wanted
    )

    # saved, run to its end on this server, and opened again without loss
    page.evaluate(SAVE)
    same_plan(read_plan(str(folder / "greenhouse")), wanted)
    page.click("#ed-close")
    page.click("#start")
    page.click("dialog button.primary")
    page.wait_for_function(
        "() => window.gspn.model?.mode === 'LIVE' && window.gspn.model.head.status.ended"
    )
    assert page.evaluate("() => window.gspn.model.head.status.finished")
    page.click("#ed-open")
    page.wait_for_selector(READY)
    assert page.evaluate("() => window.gspn.edit.document.state") == made
