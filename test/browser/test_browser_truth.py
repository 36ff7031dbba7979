"""What the page shows is so, or is marked as not known."""

import shutil
import subprocess
import sys

from page_reading import dots, marking, settle

from gspn_framework_package.benchmark.ports import free_port
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Arc

BUILT_IN = ["constructor", "__proto__", "hasOwnProperty", "toString"]
"""Names that every object of JavaScript has already."""


def test_names_of_the_language_are_names_and_reasons_are_those_of_the_rules(show_net, open_page):
    net = NetBuilder("built in").place("full", 1, capacity=1).place("one", 1)
    for name in BUILT_IN:
        net.place(name, 1)
    net.exponential("valueOf", 2.0, inputs=BUILT_IN, outputs=BUILT_IN)
    net.exponential("two", inputs="one", outputs="one").exponential("loop", inputs={"full": 1, "one": 2}, outputs="full")
    page = open_page(show_net(net.build().with_arc(Arc("one", "two", 1))).address)
    assert dots(page) == [1] * 6
    page.click("#list li[aria-label^='two']")
    page.wait_for_function("() => document.querySelector('#inspector .reasons')?.textContent === 'one has 1 of 2 tokens'")
    page.click("#list li[aria-label^='loop']")
    page.wait_for_function("() => document.querySelector('#inspector .reasons')?.textContent === 'one has 1 of 2 tokens'")
    page.click("#list li[aria-label^='__proto__']")
    page.wait_for_selector("#inspector h2:has-text('__proto__')")
    page.click("#probabilities")
    page.fill("dialog input[aria-label='Firing probability of valueOf']", "0.5")
    page.click("dialog button.primary")
    page.wait_for_function("() => window.gspn.model.info.probabilities['0'] === 0.5")
    page.click("#step")
    settle(page, 1)
    assert marking(page) == [1] * 6
    page.keyboard.press("3")
    page.click("#an-all")
    page.wait_for_selector("[data-state='done']")
    page.wait_for_selector("#answers td:has-text('hasOwnProperty')")
    assert "native code" not in page.inner_text("body")
    page.click("summary:has-text('Can it come to this?')")
    page.fill("#an-cover", "__proto__ = 1, constructor = 1")
    page.click("button:has-text('Coverable?')")
    page.wait_for_selector("#answers .badge.good:has-text('yes')")


def serve(folder, port):
    """``gspn serve`` as a process of its own, that can be killed."""
    command = [sys.executable, "-m", "gspn_framework_package", "serve", str(folder), "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert process.stdout.readline()
    return process


STANDS_STILL = """async () => {
  const { model } = window.gspn, seen = () => [model.now(), document.querySelector("#position").textContent].join();
  const before = seen();
  for (let i = 0; i < 30; i++) await new Promise(requestAnimationFrame);
  return before === seen();
}"""


def test_when_the_server_dies_in_mid_run_the_page_says_so_and_offers_the_log(open_page, tmp_path, picture):
    folder = tmp_path / "plans"
    shutil.copytree("plans/patrol", folder / "patrol")
    port = free_port()
    server = serve(folder, port)
    try:
        page = open_page("http://127.0.0.1:%d/#file-patrol%%2Fplan.json" % port, expect_errors=True)
        page.click("#start")
        page.click("dialog button.primary")
        page.wait_for_function("() => window.gspn.model.mode === 'LIVE' && window.gspn.model.board.n > 12")
        assert not page.evaluate(STANDS_STILL)
        server.kill()
        server.wait()
        page.wait_for_selector("body[data-stale][data-mode='LIVE']")
        page.wait_for_selector("#connection:has-text('connection lost since')")
        page.wait_for_selector("#frame-name:has-text('nothing has been heard since')")
        assert page.evaluate(STANDS_STILL)
        picture(page, "connection_lost")

        server = serve(folder, port)
        page.wait_for_selector("body[data-mode='SIMULATE']:not([data-stale])")
        page.wait_for_selector("#notice:has-text('The server was started again'):has-text('was cut off')")
        picture(page, "cut_off")
    finally:
        server.kill()
        server.wait()
