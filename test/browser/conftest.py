"""A real browser (Debian's Chromium; one test has a Firefox of its own) on a real server. Whatever
a page logs as an error, or asks for elsewhere, fails its test."""

import json
import os
import sys
from pathlib import Path

import pytest
from page_reading import resize
from story_film import NoFilm, StoryFilm

from benchmarks.page.rendering import CHROMIUM, FLAGS
from gspn_framework_package.visualizer.documents import Document, Folder
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.serving import WebServer
from gspn_framework_package.visualizer.session import Session
from gspn_framework_package.visualizer.standalone_run import StandaloneRun

sys.path.append(str(Path(__file__).parents[1] / "rostest" / "support"))
sys.path.append(str(Path(__file__).parents[1] / "unit"))
sys.path.append(str(Path(__file__).parents[1] / "unit" / "visualizer"))

from forked_workers import forked_workers

sync_api = pytest.importorskip("playwright.sync_api")

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / ".workspace" / "screenshots"
# ms that any condition may take: other jobs of run_tests run beside these, before the analyses,
# which run at a low priority
DEADLINE = int(120_000 * float(os.environ.get("GSPN_PATIENCE", "1")))

LOOKS = [  # width and height, theme, and what is looked for: no width changes a colour
    ((1280, 720), "light", {"label-content-name-mismatch": {"enabled": True}}),
    ((1280, 720), "dark", ["color-contrast"]),
    ((390, 844), "dark", {"label-content-name-mismatch": {"enabled": True}}),
]
AXE = """async (rules) => {
  const options = { preload: false, resultTypes: ["violations"], ...(Array.isArray(rules) ? { runOnly: rules } : { rules }) };
  const { violations } = await axe.run(document, options);
  const where = (nodes) => nodes.slice(0, 3).map((n) => `${n.failureSummary} ${n.html.slice(0, 160)}`);
  return violations.map((v) => ({ rule: v.id, help: v.help, where: where(v.nodes) }));
}"""


def pytest_addoption(parser):
    parser.addoption("--film", metavar="FILE.webp", help="film the test of the editor's story")


@pytest.fixture(name="film")
def _film(request):
    """Films the page of a test if the option ``--film`` says where to."""
    path = request.config.getoption("--film")
    return NoFilm() if path is None else StoryFilm(path)


@pytest.fixture(scope="session", name="browser")
def _browser():
    if CHROMIUM is None:
        pytest.fail("these tests need Chromium: apt install chromium-headless-shell")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="session", autouse=True, name="workers_are_forked")
def _workers_are_forked():
    with forked_workers():
        yield


class Site:
    """A server with something open, and its address."""

    def __init__(self, project, **options):
        self.server = WebServer(project, port=0, **options)
        self.project = project
        self.server.start()

    @property
    def address(self):
        return self.server.invitations["operator"]

    def session(self, key="net"):
        return self.project.sessions.get(key)

    def board(self, key="net"):
        return self.session(key).hub.board()


@pytest.fixture(name="site")
def _site():
    """Makes sites; they end with the test."""
    made = []

    def make(project, **options):
        made.append(Site(project, **options))
        return made[-1]

    yield make
    for site in made:
        site.server.stop()


@pytest.fixture(name="show_net")
def _show_net(site):
    def make(net, plan=None, activity=None, **options):
        project = Project()
        document = Document(net.name or "net", net, plan)
        project.show(Session("net", document, activity))
        return site(project, **options)

    return make


@pytest.fixture(name="serve_folder")
def _serve_folder(site, tmp_path):
    def make(folder=None, edits=False, **options):
        folder = folder or ROOT / "plans"
        runs = str(tmp_path / "runs")
        start = lambda document: StandaloneRun(document, runs)  # noqa: E731
        return site(Project(Folder(str(folder)), start, runs=runs, edits=edits), **options)

    return make


@pytest.fixture(name="open_page")
def _open_page(browser):
    """Opens pages, each in a context of its own: ``open_page(address, **context options)``."""
    contexts, faults = [], []

    def make(address, ready=True, expect_errors=False, **options):
        options.setdefault("viewport", {"width": 1440, "height": 900})
        options.setdefault("color_scheme", "light")
        context = browser.new_context(**options)
        contexts.append(context)
        context.set_default_timeout(DEADLINE)
        page = context.new_page()
        origin = "/".join(address.split("/")[:3])
        page.on("pageerror", lambda error: faults.append("uncaught: %s" % error))
        page.on("dialog", lambda dialog: faults.append("a dialog: %s" % dialog.message))
        page.on(
            "request",
            lambda request: (
                request.url.startswith((origin, "blob:", "data:"))
                or faults.append("asked for %s" % request.url)
            ),
        )
        if not expect_errors:
            page.on(
                "console", lambda m: m.type == "error" and faults.append("console: %s" % m.text)
            )
        page.goto(address)
        if ready:
            page.wait_for_selector("body[data-ready]")
        return page

    yield make
    for context in contexts:
        context.close()
    assert not faults, faults


@pytest.fixture(name="picture")
def _picture():
    """Keeps a picture of a page, for people to look at."""

    def take(page, name):
        os.makedirs(PICTURES, exist_ok=True)
        page.screenshot(path=str(PICTURES / (name + ".png")))

    return take


@pytest.fixture(scope="session", name="axe")
def _axe():
    """Looks for violations with axe-core, in both themes, at 1280 and 390 pixels."""
    package = pytest.importorskip("axe_playwright_python")
    source = (Path(package.__file__).parent / "axe.min.js").read_text()

    def check(page, state, panel=None):
        for (width, height), theme, rules in LOOKS:
            resize(page, width, height)
            if panel is not None:
                page.wait_for_selector(
                    "body[data-form='%s']" % ("narrow" if width < 640 else "wide")
                )
            page.evaluate("(theme) => { document.documentElement.dataset.theme = theme; }", theme)
            if (
                panel is not None
                and page.get_attribute("#fold-" + panel, "aria-expanded") == "false"
            ):
                page.click("#fold-" + panel)
            if not page.evaluate("() => Boolean(window.axe)"):
                page.evaluate(source)
            found = page.evaluate(AXE, rules)
            assert not found, "%s, %d px, %s: %s" % (
                state,
                width,
                theme,
                json.dumps(found, indent=1),
            )

    return check
