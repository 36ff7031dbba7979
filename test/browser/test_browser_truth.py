"""What the page shows is so, or is marked as not known."""

import shutil
import subprocess
import sys
import time

from page_reading import dots, marking, settle

from benchmarks.harness.ports import free_port
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Arc
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.board import Board

BUILT_IN = ["constructor", "__proto__", "hasOwnProperty", "toString"]
"""Names that every object of JavaScript has already."""


def test_names_of_the_language_are_names_and_reasons_are_those_of_the_rules(show_net, open_page):
    net = NetBuilder("built in").place("full", 1, capacity=1).place("one", 1)
    for name in BUILT_IN:
        net.place(name, 1)
    net.exponential("valueOf", 2.0, inputs=BUILT_IN, outputs=BUILT_IN)
    net.exponential("two", inputs="one", outputs="one").exponential(
        "loop", inputs={"full": 1, "one": 2}, outputs="full"
    )
    page = open_page(
        show_net(net.build().with_arc(Arc("one", "two", 1))).address, expect_errors=True
    )
    assert dots(page) == [1] * 6
    page.click("#list li[data-key='t1']")
    page.wait_for_function(
        "() => document.querySelector('#inspector .reasons')?.textContent === 'one has 1 of 2 tokens'"
    )
    page.click("#list li[data-key='t2']")
    page.wait_for_function(
        "() => document.querySelector('#inspector .reasons')?.textContent === 'one has 1 of 2 tokens'"
    )
    page.click("#list li[data-key='p3']")
    page.wait_for_selector("#inspector h2:has-text('__proto__')")
    page.click("#probabilities")
    page.fill("dialog input[aria-label='Firing probability of valueOf']", "0.5")
    page.fill("dialog input[aria-label='Firing probability of two']", "-1")
    page.click("dialog button.primary")
    page.wait_for_selector("dialog .wrong:has-text('two')")  # and what was typed stays
    assert page.input_value("dialog input[aria-label='Firing probability of valueOf']") == "0.5"
    page.fill("dialog input[aria-label='Firing probability of two']", "")
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
    page.click("summary:has-text('Is it reachable?')")
    page.fill("#an-cover", "__proto__ = 1, constructor = 1")
    page.click("button:has-text('Coverable?')")
    page.wait_for_selector("#answers .badge.good:has-text('yes')")


def serve(folder, port):
    """``gspn serve`` as a separate process, that can be killed."""
    command = [
        sys.executable,
        "-m",
        "gspn_framework_package",
        "serve",
        str(folder),
        "--port",
        str(port),
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert process.stdout.readline()
    return process


STANDS_STILL = """async () => {
  const { model } = window.gspn, seen = () => [model.now(), document.querySelector("#position").textContent].join();
  const before = seen();
  for (let i = 0; i < 30; i++) await new Promise(requestAnimationFrame);
  return before === seen();
}"""

# what was under way is drawn once more
COMES_TO_REST = (
    """async () => {
  const still = %s, deadline = performance.now() + 20000;
  while (performance.now() < deadline) if (await still()) return true;
  return false;
}"""
    % STANDS_STILL
)


def test_when_the_server_dies_in_mid_run_the_page_says_so_and_offers_the_log(
    open_page, tmp_path, picture
):
    folder = tmp_path / "plans"
    shutil.copytree("plans/patrol", folder / "patrol")
    port = free_port()
    server = serve(folder, port)
    try:
        page = open_page("http://127.0.0.1:%d/#file-patrol%%2Fplan.json" % port, expect_errors=True)
        page.click("#start")
        page.click("dialog button.primary")
        page.wait_for_function(
            "() => window.gspn.model.mode === 'LIVE' && window.gspn.model.board.n > 12"
        )
        assert not page.evaluate(STANDS_STILL)
        server.kill()
        server.wait()
        page.wait_for_selector("body[data-stale][data-mode='LIVE']")
        page.wait_for_selector("#connection:has-text('connection lost since')")
        page.wait_for_selector("#frame-name:has-text('no contact since')")
        assert page.evaluate(COMES_TO_REST)
        picture(page, "connection_lost")

        server = serve(folder, port)
        page.wait_for_selector("body[data-mode='SIMULATE']:not([data-stale])")
        page.wait_for_selector(
            "#notice:has-text('The server was restarted'):has-text('was cut off')"
        )
        picture(page, "cut_off")
        page.click("#notice button:has-text('Replay its log')")
        page.wait_for_selector("body[data-mode='REPLAY'][data-ready]")
        page.wait_for_function("() => window.gspn.model.head.n > 12")
        # what the server does not answer is reported to the person who asked for it
        page.route("**/api/state*", lambda route: route.abort())
        page.reload()
        page.wait_for_function(
            "() => window.gspn?.model?.head?.n > 12 && window.gspn.model.fetching === false"
        )
        for ask in (lambda: page.keyboard.press("ArrowLeft"), lambda: page.click("#view-back")):
            ask()
            page.wait_for_selector("#toast:has-text('the server does not answer')")
            page.evaluate("() => { document.querySelector('#toast').hidden = true; }")
    finally:
        server.kill()
        server.wait()


COURSE = "async () => { const { courseOf } = await import('/static/js/course.js'); return courseOf(window.gspn.model).map((e) => [e.k, e.t]); }"


def test_after_a_reset_the_time_line_begins_anew_and_the_reset_is_taken_back(show_net, open_page):
    net = NetBuilder("one").place("p", 1).exponential("t", 1.0, inputs="p", outputs="p")
    site = show_net(net.build())
    page = open_page(site.address)
    page.fill("#n-steps", "7")
    page.click("#steps")
    settle(page, 7)
    page.click("#reset")
    settle(page, 8)
    page.click("#step")
    settle(page, 9)
    course = page.evaluate(COURSE)
    assert [k for k, _ in course] == ["mark", "fire"] and [t for _, t in course] == sorted(
        t for _, t in course
    )
    page.wait_for_function("() => document.querySelectorAll('#log li.past').length === 7")
    page.keyboard.press("ArrowLeft")
    settle(page, 10)
    page.keyboard.press("ArrowLeft")
    settle(page, 11)
    assert site.board().counts == [7] == page.evaluate("() => window.gspn.model.board.counts")
    assert [k for k, _ in page.evaluate(COURSE)] == ["fire"] * 7
    page.wait_for_function("() => document.querySelectorAll('#log li').length === 7")
    page.click("#reset")  # a button that was clicked does not keep the keys
    page.keyboard.press(" ")
    page.wait_for_function("() => window.gspn.page.tools.running")
    page.keyboard.press(" ")
    page.wait_for_function("() => !window.gspn.page.tools.running")
    page.wait_for_function("() => document.querySelectorAll('#log li.fire.past').length === 7")
    assert [bool(e.get("restart")) for e in site.session("net").hub.events(11, 10**6)].count(
        True
    ) == 1


class Dense(Activity):
    """A recorded run with an event every 2 ms for 24 s: robot_1 goes to and fro, robot_2 waits from
    0.5 s on."""

    mode = "REPLAY"
    STEP = 0.002
    EVENTS = 12_000

    def begin(self, hub):
        board = Board(2, [2, 0])
        for name in ("robot_1", "robot_2"):
            board.robots[name] = {"name": name, "place": 0, "phase": "doing", "since": 0.0}
        hub.restart(self.mode, board, ring=100_000)
        hub.publish(*[self._event(i) for i in range(self.EVENTS)])

    def _event(self, i):
        t = round(self.STEP * (i + 1), 4)
        if i == 249:
            return {"k": "robots", "r": [{"name": "robot_2", "phase": "done"}], "gone": [], "t": t}
        there = i % 2 if i < 249 else (i + 1) % 2
        move = {"d": [[there, -1], [1 - there, 1]], "m": [["robot_1", there, 1 - there]]}
        return {"k": "fire", "tr": there, "who": "robot_1", **move, "en": [], "dis": [], "t": t}


def test_the_clock_of_a_dense_recording_is_that_of_the_board_and_no_lane_is_invented(
    show_net, open_page
):
    net = NetBuilder("there and back").place("here", 2).place("there")
    net = (
        net.immediate("go", inputs="here", outputs="there")
        .immediate("return", inputs="there", outputs="here")
        .build()
    )
    page = open_page(show_net(net, activity=Dense()).address)
    page.wait_for_function("(n) => window.gspn.model.head.n === n", arg=Dense.EVENTS)

    def late(route):  # a network that takes its time
        time.sleep(0.2)
        route.continue_()

    page.route("**/api/events*", late)
    page.select_option("#view-speed", "20")
    page.evaluate(
        """(step) => { window.ahead = []; const watch = () => { const { model } = window.gspn;
        if (model.playing && model.now() >= (model.board.n + 1) * step) window.ahead.push([model.now(), model.board.t]);
        requestAnimationFrame(watch); }; watch(); }""",
        Dense.STEP,
    )
    page.keyboard.press(" ")
    page.wait_for_function("(n) => window.gspn.model.board.n === n", arg=Dense.EVENTS)
    assert page.evaluate("() => window.ahead") == []
    assert page.evaluate("() => window.gspn.model.now()") == 24.0
    page.evaluate("() => window.gspn.model.show(9000)")
    page.wait_for_function(
        "() => window.gspn.model.board.n === 9000 && window.gspn.model.base?.n < 9000 && !window.gspn.model.fetching"
    )
    lanes = page.evaluate(
        "async () => { const { lanesOf } = await import('/static/js/course.js');"
        " return Object.fromEntries(lanesOf(window.gspn.model, 8, 18)); }"
    )
    assert lanes["robot_2"]["parts"] == [[8, 18, "here", "done"]]
    known = page.evaluate("() => window.gspn.model.base.t")
    first = lanes["robot_1"]["parts"][0]
    assert first[0] >= known - Dense.STEP and first[1] - first[0] <= 2 * Dense.STEP
