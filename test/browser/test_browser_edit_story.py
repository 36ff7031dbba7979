"""The greenhouse of docs/first_plan.md, made in the page from nothing: drawn, completed, checked,
saved, analysed, run, and opened again. Only its actions are written elsewhere. With ``--film`` it is
the film of docs/five_minutes.md."""

import json
import re
from pathlib import Path

from story_film import HEIGHT, WIDTH

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json

READY = "body[data-mode=EDIT][data-ready]"
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

    def __init__(self, page, film):
        self.page = page
        self.film = film

    def keys(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)

    def name(self, name):
        """Name what is chosen."""
        self.keys("F2")
        self.page.keyboard.type(name)
        self.keys("Enter")
        self.page.wait_for_selector("#ed-list li[aria-selected=true]:has-text('%s')" % name)
        self.film.look()

    def choose(self, key):
        self.page.click("#ed-list li[data-key='%s']" % key)

    def arc(self, start, end):
        self.choose(start)
        self.keys("a")
        self.choose(end)
        self.keys("Enter")
        self.film.look()

    def after(self, node, key, name):
        """Add a node after another one, and the arc between them."""
        self.choose(node)
        self.keys("Shift+" + key)
        self.name(name)

    def control(self, key):
        return self.page.locator("#ed-right [data-key='%s']:visible" % key)

    def fit(self):
        """Bring the whole net into view, for the film."""
        if self.film.taking:
            self.keys("f")
            self.film.watch(1.0)

    def show(self, key):
        """Bring a control to the middle of its panel, for the film."""
        if self.film.taking:
            centre = "(control) => control.scrollIntoView({ block: 'center' })"
            self.control(key).evaluate(centre)

    def enter(self, key, text):
        self.show(key)
        self.control(key).fill(text)
        self.film.look()
        self.keys("Tab")

    def select(self, key, *value, **option):
        self.show(key)
        self.control(key).select_option(*value, **option)
        self.film.look()

    def press(self, key):
        self.show(key)
        self.control(key).click()

    def tab(self, name):
        self.page.click("#ed-tab-" + name)
        self.page.wait_for_selector("#ed-panel-%s .ed-form > *" % name)
        self.page.evaluate(
            """(name) => { for (const fold of document.querySelectorAll(`#ed-panel-${name} details`))
            fold.open = true; }""",
            name,
        )


def draw(editor):
    page, film = editor.page, editor.film
    film.say("A double-click makes a place", 1.5)
    page.dblclick("#ed-net", position={"x": 120, "y": 200})
    editor.name("Water")
    editor.keys("+", "+")
    film.say("+ puts robots there", 1.2)
    # node and arc in one gesture
    box = page.locator("#ed-net").bounding_box()
    at = page.evaluate(
        """() => { const { canvas } = window.gspn.edit; const [node] = canvas.nodes;
        const { k, x, y } = canvas.camera.now; return [node.x * k + x, node.y * k + y, k]; }"""
    )
    x, y = box["x"] + at[0], box["y"] + at[1]
    page.mouse.move(x, y)
    page.wait_for_selector("[data-handle='0']")
    film.say("Drag from its edge: an arc, with a transition at its end", 1.2)
    page.mouse.move(x + 36 * at[2], y)
    page.mouse.down()
    for way in (60, 80, 100, 120):
        page.mouse.move(x + way, y)
        film.look(0.15)
    page.mouse.up()
    editor.name("watered")
    page.mouse.move(5, 5)
    film.say("Keys do the same: P, T and I continue from what is chosen", 1.0)
    editor.after("transition:watered", "P", "Look")
    editor.after("transition:watered", "P", "Watered")
    editor.after("place:Look", "I", "again")
    editor.arc("transition:again", "place:Water")
    editor.after("place:Look", "I", "refill")
    editor.fit()
    editor.after("transition:refill", "P", "Refill")
    editor.after("place:Refill", "T", "refilled")
    editor.fit()
    editor.arc("transition:refilled", "place:Water")
    editor.after("transition:refilled", "P", "Tap")
    editor.fit()
    editor.keys("+")
    editor.arc("place:Tap", "transition:refill")
    editor.choose("transition:watered")
    editor.tab("properties")
    film.say("Rates, tokens and capacities are typed in the form", 0.6)
    editor.enter("net.transition:watered.rate", "2")


def complete(editor):
    film = editor.film
    film.say("Resource places count: a tap, the beds that are watered", 0.6)
    for place in ("Tap", "Watered"):
        editor.choose("place:" + place)
        editor.select("kind." + place, label="resource place (counters)")
    film.say("What a robot does in a place: a Python function, or any action of ROS", 0.6)
    for place, action in (("Water", "actions.Watering"), ("Refill", "actions.refill")):
        editor.choose("place:" + place)
        editor.tab("properties")
        editor.press("plan.actions.%s add" % place)
        editor.select("plan.actions.%s.kind" % place, label="a function of the plan")
        editor.enter("plan.actions.%s.function" % place, action)
    editor.choose("place:Look")
    editor.tab("properties")
    editor.press("plan.actions.Look add")
    editor.select("plan.actions.Look.kind", label="nothing: done at once")
    editor.tab("plan")
    film.say("The run ends when twelve beds are watered", 0.6)
    editor.enter("plan.until", "Watered >= 12")
    editor.select("plan.spawn add", "Water")


def choose_policy(editor):
    """The policy of the tutorial, and the check, which sees that its first row does not suffice."""
    page, film = editor.page, editor.film
    editor.tab("policy")
    film.say("The policy: what a robot chooses, and how often", 0.6)
    editor.select("policy.places add", "Water")
    editor.press("policy.rows add")
    editor.enter("policy.rows.0.marking.0", "1")
    editor.enter("policy.rows.0.choose.again", "0.7")
    editor.select("policy.rows.0.choose add", "refill")
    editor.enter("policy.rows.0.choose.refill", "0.3")
    page.wait_for_selector("#ed-verdict[data-state='checked']")
    page.click("#ed-tab-checks")
    page.wait_for_selector("#ed-findings:has-text('no row')")
    film.say("The check runs after every edit: no row says what both robots do in Look", 3.0)
    editor.tab("policy")
    editor.press("policy.rows add")
    page.wait_for_selector("#ed-verdict[data-state='checked']")
    page.click("#ed-tab-checks")
    page.wait_for_selector("#ed-findings:has-text('every marking that needs a decision has a row')")
    film.say("Now every decision has a row: the plan may run", 2.0)


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


def test_the_greenhouse_is_made_in_the_page(serve_folder, open_page, tmp_path, picture, film):
    folder = tmp_path / "plans"
    folder.mkdir()
    site = serve_folder(folder, edits=True)
    size = {"viewport": {"width": WIDTH, "height": HEIGHT}} if film.taking else {}
    page = open_page(site.address, ready=False, expect_errors=True, **size)
    page.wait_for_selector("#ed-new")
    film.begin(page)
    film.say("gspn serve FOLDER --edit", 1.5)
    page.click("#ed-new")
    page.fill("#ed-new-name", "greenhouse")
    film.say("A new plan", 1.2)
    page.click("dialog button:has-text('Make it')")
    page.wait_for_selector(READY)
    (folder / "greenhouse" / "actions.py").write_text(block("greenhouse/actions.py"))
    editor = Editor(page, film)
    draw(editor)
    complete(editor)
    choose_policy(editor)
    picture(page, "edit_story")
    made = page.evaluate("() => window.gspn.edit.document.state")
    wanted = plan_from_json(tutorial_plan())
    same_plan(
        plan_from_json({**made["plan"], "net": made["net"], "policy": made["policy"]}), wanted
    )

    # saved without loss
    editor.keys("Control+s")
    page.wait_for_function("() => !window.gspn.edit.document.dirty")
    film.say("Ctrl+S saves it: a folder with plan.json, for git", 2.0)
    same_plan(read_plan(str(folder / "greenhouse")), wanted)

    # analysed: the number of the tutorial
    page.click("#ed-close")
    page.click("#tab-analysis")
    page.click("#analysis summary:has-text('How long until?')")
    page.fill("#an-passage", "Watered >= 12")
    page.click("#analysis button:has-text('Mean time')")
    page.wait_for_selector("[data-state='done']")
    film.say("Analysed exactly: how long until twelve beds are watered?", 3.0)
    assert "3.9492 s" in page.inner_text("#analysis")

    # run to its end on this server
    page.click("#start")
    page.click("dialog button.primary")
    page.wait_for_function("() => window.gspn.model?.mode === 'LIVE'")
    film.say("Run, with the functions of its folder", 0.3)
    ended = "() => Boolean(window.gspn.model.head.status.ended)"
    while film.taking and not page.evaluate(ended):
        film.look(0.25)
    page.wait_for_function(ended)
    assert page.evaluate("() => window.gspn.model.head.status.finished")
    film.watch(2.0)
    film.say("Twelve beds are watered", 2.5)

    # and opened again without loss
    page.reload()
    page.wait_for_selector("body[data-ready]")
    page.click("#ed-open")
    page.wait_for_selector(READY)
    assert page.evaluate("() => window.gspn.edit.document.state") == made
    film.close()
