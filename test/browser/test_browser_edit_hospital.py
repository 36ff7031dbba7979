"""A hospital whose robots carry for five wards, from nothing to a run: 28 nodes in at most 200
gestures (it takes 155). A gesture is a click, a choice in a menu, a key, or a text that is typed."""

from page_reading import resize

READY = "body[data-mode=EDIT][data-ready]"
WARDS = ("pharmacy", "lab", "kitchen", "laundry", "surgery")
MOST = 200
ACTIONS = "def carry():\n    pass\n\n\ndef drive():\n    pass\n"
KINDS = {
    "function": "a function of the plan",
    "resource": "resource place (counters)",
}


class Hand:
    """What a person does with mouse and keyboard, counted."""

    def __init__(self, page):
        self.page = page
        self.gestures = 0

    def key(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)
            self.gestures += 1

    def type(self, text):
        self.page.keyboard.type(text)
        self.gestures += 1

    def click(self, selector):
        self.page.click(selector)
        self.gestures += 1

    def choose(self, key):
        self.click("#ed-list li[data-key='%s']" % key)

    def control(self, key):
        return self.page.locator("#ed-right [data-key='%s']:visible" % key)

    def press(self, key):
        self.control(key).click()
        self.gestures += 1

    def select(self, key, label):
        self.control(key).select_option(label=label)
        self.gestures += 1

    def fill(self, key, text):
        self.control(key).fill(text)
        self.gestures += 1

    def add(self, key, name):
        """Add a node by a key, and name it as one types."""
        self.key(key)
        self.type(name)
        self.key("Enter")
        self.page.wait_for_selector("#ed-list li[aria-selected=true]:has-text('%s')" % name)

    def arc(self, end):
        """An arc from what is selected."""
        self.key("a")
        self.choose(end)
        self.key("Enter")


def draw(hand):
    hand.add("p", "Dock")
    hand.key("+", "+", "+")
    for ward in WARDS:
        hand.choose("place:Dock")
        hand.add("Shift+I", "call_" + ward)
        hand.add("Shift+P", "Carry_" + ward)
        hand.add("Shift+T", "brought_" + ward)
        hand.add("Shift+P", "Return_" + ward)
        hand.add("Shift+T", "back_" + ward)
        hand.arc("place:Dock")
    # two wards share a lift, and what the pharmacy gets is counted
    hand.choose("transition:brought_lab")
    hand.add("Shift+P", "Lift")
    hand.key("+")
    hand.arc("transition:call_lab")
    hand.choose("transition:brought_pharmacy")
    hand.add("Shift+P", "Delivered")


def complete(hand):
    page = hand.page
    for place in ("Lift", "Delivered"):
        hand.choose("place:" + place)
        hand.select("kind." + place, KINDS["resource"])
    for ward in WARDS:
        place = "Carry_" + ward
        hand.choose("place:" + place)
        hand.press("plan.actions.%s add" % place)
        hand.select("plan.actions.%s.kind" % place, KINDS["function"])
        hand.fill("plan.actions.%s.function" % place, "actions.carry")
        hand.key("Tab")
    hand.click("#ed-tab-plan")
    hand.fill("plan.until", "Delivered >= 2")
    hand.key("Tab")
    hand.click("#ed-tab-checks")
    # robots do nothing where no action is mapped: in the dock, and on their way back
    hand.click("#ed-findings button:has-text('Fix it: no action there')")
    page.wait_for_selector("#ed-verdict[data-state='checked']")


def test_a_hospital_is_drawn_checked_and_run_in_few_gestures(
    serve_folder, open_page, tmp_path, picture
):
    folder = tmp_path / "plans"
    folder.mkdir()
    site = serve_folder(folder, edits=True)
    page = open_page(site.address, ready=False)
    hand = Hand(page)
    hand.click("#ed-new")
    hand.type("hospital")
    hand.click("dialog button:has-text('Make it')")
    page.wait_for_selector(READY)
    (folder / "hospital" / "actions.py").write_text(ACTIONS)
    draw(hand)
    complete(hand)
    hand.key("f")
    for width, theme in ((1280, "light"), (1024, "dark")):
        resize(page, width, 720)
        page.evaluate("(theme) => { document.documentElement.dataset.theme = theme; }", theme)
        picture(page, "edit_hospital_%d" % width)
    net = page.evaluate("() => window.gspn.edit.document.net")
    assert len(net["places"]) + len(net["transitions"]) == 28
    hand.key("Control+s")
    page.wait_for_function("() => !window.gspn.edit.document.dirty")
    hand.click("#ed-close")
    hand.click("#start")
    hand.click("dialog button.primary")
    page.wait_for_function("() => window.gspn.model?.mode === 'LIVE'")
    page.wait_for_function("() => Boolean(window.gspn.model.head.status.ended)")
    assert page.evaluate("() => window.gspn.model.head.status.finished")
    assert hand.gestures <= MOST, hand.gestures
