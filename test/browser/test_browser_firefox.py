"""The page in Firefox: a node is drawn and saved, the plan simulated, a live run followed. Firefox
is driven by its own protocol, Marionette; Playwright needs a Firefox of its own."""

import json
import shutil

import pytest
from reported_run import ReportedRun

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project

marionette = pytest.importorskip("marionette_driver.marionette")
from marionette_driver import Wait  # noqa: E402

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
DEADLINE = 60.0
ERRORS = """const faults = (window.faults = []);
window.addEventListener("error", ({ message }) => faults.push(message));
window.addEventListener("unhandledrejection", ({ reason }) => faults.push(String(reason)));"""
PLAN = {
    "plan": "one",
    "net": {
        "places": [
            {"name": "Home", "tokens": 1, "position": [0, 0]},
            {"name": "Dock", "position": [200, 0]},
        ],
        "transitions": [
            {"name": "go", "timed": True, "position": [100, 0]},
            {"name": "back", "timed": True, "position": [100, 100]},
        ],
        "arcs": [
            {"from": "Home", "to": "go"},
            {"from": "go", "to": "Dock", "bends": [[150, -60]]},
            {"from": "Dock", "to": "back"},
            {"from": "back", "to": "Home"},
        ],
    },
    "actions": {"Home": None, "Dock": None},
    "robots": [{"name": "r1", "place": "Home"}],
}


class Window:
    """A window of Firefox."""

    def __init__(self, client):
        self.client = client

    def open(self, address):
        self.client.navigate(address)
        self.run(ERRORS)

    def run(self, script, *args):
        return self.client.execute_script(script, script_args=args, sandbox=None)

    def until(self, condition):
        Wait(self.client, timeout=DEADLINE, interval=0.05).until(
            lambda _: self.run("return Boolean(%s)" % condition), message=condition
        )

    def click(self, selector):
        self.until("document.querySelector(%s)?.offsetParent" % json.dumps(selector))
        self.client.find_element("css selector", selector).click()

    def mouse(self, *moves):
        """Press the button at the first point, let go at the last."""
        pointer = self.client.actions.sequence("pointer", "mouse", {"pointerType": "mouse"})
        pointer.pointer_move(*moves[0]).pointer_down()
        for move in moves[1:]:
            pointer.pointer_move(*move)
        pointer.pointer_up().perform()

    def keys(self, text):
        self.client.find_element("css selector", "body").send_keys(text)


@pytest.fixture(name="window")
def _window(tmp_path):
    if FIREFOX is None:
        pytest.fail("these tests need Firefox: apt install firefox-esr")
    client = marionette.Marionette(
        bin=FIREFOX, headless=True, gecko_log=str(tmp_path / "firefox.log")
    )
    client.start_session()
    try:
        client.set_window_rect(width=1280, height=800)
        yield Window(client)
    finally:
        client.delete_session()
        client.cleanup()


def test_a_node_is_drawn_simulated_and_followed_live(window, site, show_net, tmp_path):
    folder = tmp_path / "plans"
    folder.mkdir()
    (folder / "one.json").write_text(json.dumps(PLAN))
    window.open(site(Project(Folder(str(folder)), edits=True)).address)
    window.click("#opening button")
    window.until("document.body.dataset.mode === 'SIMULATE' && 'ready' in document.body.dataset")
    window.click("#tab-optimise")
    window.click("#ed-open")
    window.until("document.body.dataset.mode === 'EDIT' && 'ready' in document.body.dataset")
    # an arc, and the node at its end, from the rim of a place
    x, y, k = window.run(
        """const { canvas } = window.gspn.edit, node = canvas.byKey.get("place:Dock");
        const box = canvas.container.getBoundingClientRect(), { k, x, y } = canvas.camera.now;
        return [Math.round(node.x * k + x + box.left), Math.round(node.y * k + y + box.top), k];"""
    )
    edge = round(19 * k)
    window.mouse((x, y - edge), (x, y - edge - 20), (x, y - edge - 60))
    window.until("window.gspn.edit.document.net.transitions.length === 3")
    window.keys("\ue009z")  # Control
    window.until("window.gspn.edit.document.net.transitions.length === 2")
    window.keys("p")
    window.until("window.gspn.edit.document.net.places.length === 3")
    window.keys("\ue009s")
    window.until("!window.gspn.edit.document.dirty")
    saved = json.loads((folder / "one.json").read_text())
    assert [p["name"] for p in saved["net"]["places"]] == ["Home", "Dock", "P1"]
    assert saved["net"]["arcs"] == PLAN["net"]["arcs"]
    window.click("#ed-close")
    window.until("document.body.dataset.mode === 'SIMULATE' && 'ready' in document.body.dataset")
    window.until("document.querySelector('#op-start')")  # the tab that was open has its content
    window.keys("\ue014")  # an arrow to the right: a step
    window.until("window.gspn.model.board.n === 1 && !window.gspn.page.view.travel.inFlight.size")
    assert window.run("return window.gspn.model.board.marking") == [0, 1, 0]
    course = "return window.gspn.page.view.arcs.all[1].line"
    simulated = window.run(course)
    assert window.run("return window.faults") == []

    plan = read_plan(str(folder / "one.json"))
    run = ReportedRun(plan)
    window.open(show_net(plan.net, plan, run).address)
    window.until("document.body.dataset.mode === 'LIVE' && 'ready' in document.body.dataset")
    fire = {"k": "fire", "tr": 0, "who": "r1", "d": [[0, -1], [1, 1]], "m": [["r1", 0, 1]]}
    run.hub.publish({**fire, "en": [1], "dis": [0]})
    window.until(
        "window.gspn.model.board.n === 1 && !window.gspn.page.view.pendingRobots.size"
        " && document.querySelector('#net .place:nth-of-type(2) .robot')"
    )
    assert window.run(course) == simulated and "Q" in simulated  # through its bend
    assert window.run("return window.faults") == []
