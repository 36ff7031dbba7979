"""The page is of use at every width, by keyboard, and with a screen reader."""

from page_reading import boxes, overlaps, resize, settle
from reported_run import ReportedRun

from gspn_framework_package.formats.plan_file import read_plan

FORMS = {390: 844, 800: 1000, 1280: 720, 1440: 900, 3840: 2160}
CONTROLS = "#open-screen, #start, #theme, #help, #folds button, #tools button, .zoom button, #play, #scrubber"


def test_axe_finds_nothing_while_a_net_is_simulated(serve_folder, open_page, axe):
    site = serve_folder()
    page = open_page(site.address, ready=False, reduced_motion="reduce")
    page.wait_for_selector("#opening button")
    axe(page, "the opening page")
    page.click("#opening button:has-text('patrol/plan.json')")
    page.wait_for_selector("body[data-mode='SIMULATE'][data-ready]")
    page.click("#steps")
    settle(page, 10)
    axe(page, "SIMULATE, the time line", "bottom")
    axe(page, "SIMULATE, the list", "left")
    resize(page, 1280, 720)
    page.click("#list li[data-key='t0']")
    page.wait_for_selector("#inspector h2:has-text('t1')")
    axe(page, "SIMULATE, the inspector", "right")
    for key in ("#help", "#start", "#probabilities"):
        resize(page, 1280, 720)
        page.click(key)
        page.wait_for_selector("dialog[open]")
        axe(page, "the dialog of " + key)
        page.keyboard.press("Escape")
        page.wait_for_selector("dialog:not([open])", state="attached")
    page.keyboard.press("3")
    page.click("#an-all")
    page.wait_for_selector("[data-state='done']")
    page.evaluate(
        "() => document.querySelectorAll('#analysis details').forEach((d) => { d.open = true; })"
    )
    axe(page, "SIMULATE, the analysis", "right")


def test_axe_finds_nothing_in_a_run_and_its_replay(serve_folder, open_page, axe, tmp_path):
    page = open_page(serve_folder().address, ready=False, reduced_motion="reduce")
    page.click("#opening button:has-text('patrol/plan.json')")
    page.wait_for_selector("body[data-mode='SIMULATE'][data-ready]")
    resize(page, 1280, 720)
    page.click("#start")
    page.click("dialog button.primary")
    page.wait_for_selector("body[data-mode='LIVE'] #robots .robot-card >> nth=3")
    page.wait_for_function("() => window.gspn.model.board.n > 10")
    axe(page, "LIVE, the robots", "right")
    axe(page, "LIVE, the log", "bottom")
    resize(page, 1280, 720)
    page.click("#stop")
    axe(page, "the dialog of #stop")
    page.click("dialog button.danger")
    page.wait_for_selector(".alarm:has-text('stopped on the page')")
    axe(page, "LIVE, at the end", "left")

    log = next((tmp_path / "runs").iterdir())
    replay = open_page(
        serve_folder(tmp_path / "runs").address + "#file-" + log.name, reduced_motion="reduce"
    )
    replay.wait_for_function("() => window.gspn.model.info.loading === false")
    replay.keyboard.press("End")
    replay.wait_for_selector("body[data-mode='REPLAY']")
    axe(replay, "REPLAY", "bottom")


def hidden_controls(page):
    """Controls that cannot be got at: of no size, or outside of the page when they are scrolled
    to."""
    return page.evaluate(
        """(selector) => [...document.querySelectorAll(selector)].filter((e) => {
          e.scrollIntoView({ block: "nearest", inline: "nearest" });
          const b = e.getBoundingClientRect();
          return !b.width || !b.height || b.left < 0 || b.top < 0 || b.right > innerWidth + .5 || b.bottom > innerHeight + .5;
        }).map((e) => e.id || e.outerHTML.slice(0, 60))""",
        CONTROLS,
    )


def size(page, selector):
    x0, y0, x1, y1 = boxes(page, selector)[0]
    return x1 - x0, y1 - y0


def off_the_page(page):
    """The panels that reach beyond the page, and whether the page itself scrolls."""
    return page.evaluate(
        """() => [...document.querySelectorAll("#left, #right, #bottom, .centre, .top")].filter((e) => {
          const b = e.getBoundingClientRect();
          return b.width && (b.left < -.5 || b.right > innerWidth + .5 || b.bottom > innerHeight + .5); }).map((e) => e.id)
          .concat(document.documentElement.scrollWidth > innerWidth || document.documentElement.scrollHeight > innerHeight ? ["scrolls"] : [])"""
    )


def test_everything_is_reached_at_every_width(serve_folder, open_page, picture):
    address = serve_folder().address + "#file-patrol%2Fplan.json"
    page = open_page(address)
    for width, height in FORMS.items():
        resize(page, width, height)
        page.wait_for_function("() => window.gspn.page.view.camera.now")
        page.wait_for_selector(
            "body[data-form='%s']"
            % ("narrow" if width < 640 else "medium" if width < 1000 else "wide")
        )
        page.wait_for_function("() => document.querySelectorAll('.label').length > 0")
        settle(page)
        assert not hidden_controls(page), width
        assert not off_the_page(page), width
        assert not overlaps(
            boxes(page, "header > button, .what, .state > *, header .group button, #tools"), slack=1
        ), width
        assert size(page, "#net")[1] >= 0.5 * height, width
        picture(page, "width_%d" % width)
    # every panel can be had there, and leaves room for the net
    for width, form in ((390, "narrow"), (800, "medium")):
        resize(page, width, FORMS[width])
        page.wait_for_selector("body[data-form='%s']" % form)
        for panel in ("left", "right", "bottom"):
            if page.get_attribute("#fold-" + panel, "aria-expanded") == "false":
                page.click("#fold-" + panel)
            page.wait_for_selector("#fold-%s[aria-expanded='true']" % panel)
            assert min(size(page, "#" + panel)) >= 110, (width, panel)
            assert min(size(page, "#net")) >= 200, (width, panel)
            assert not off_the_page(page), (width, panel)
            page.click("#fold-" + panel)
            page.wait_for_selector("#fold-%s[aria-expanded='false']" % panel)


def test_panels_are_folded_and_resized_and_stay_so(show_net, open_page):
    page = open_page(show_net(read_plan("plans/patrol").net).address)

    def now(separator):
        return int(page.get_attribute(separator, "aria-valuenow"))

    for separator, panel, side, grow, shrink in (
        ("#split-left", "#left", 0, "ArrowRight", "ArrowLeft"),
        ("#split-right", "#right", 0, "ArrowLeft", "ArrowRight"),
        ("#split-bottom", "#bottom", 1, "ArrowUp", "ArrowDown"),
        ("#split-log", "#firings", 0, "ArrowLeft", "ArrowRight"),
    ):
        assert page.get_attribute(separator, "role") == "separator"
        before = now(separator)
        assert abs(size(page, panel)[side] - before) <= 1
        page.focus(separator)
        page.keyboard.press(grow)
        assert now(separator) > before
        assert abs(size(page, panel)[side] - now(separator)) <= 1
        page.keyboard.press(shrink)
        assert now(separator) == before
        x0, y0, x1, y1 = boxes(page, separator)[0]
        page.mouse.move((x0 + x1) / 2, (y0 + y1) / 2)
        page.mouse.down()
        dx, dy = (-40 if separator != "#split-left" else 40, 0) if side == 0 else (0, -40)
        page.mouse.move((x0 + x1) / 2 + dx, (y0 + y1) / 2 + dy, steps=3)
        page.mouse.up()
        assert now(separator) == before + 40
        for key, bound in (("End", "aria-valuemax"), ("Home", "aria-valuemin")):
            page.keyboard.press(key)
            assert now(separator) == int(page.get_attribute(separator, bound))
            assert not off_the_page(page)
            assert size(page, "#net")[0] >= 270 and size(page, "#net")[1] >= 200
    page.focus("#split-left")
    page.keyboard.press("Enter")
    assert page.is_hidden("#left")
    page.focus("#split-right")
    for _ in range(4):
        page.keyboard.press("ArrowLeft")
    wide = now("#split-right")
    page.reload()
    page.wait_for_selector("body[data-ready]")
    assert page.is_hidden("#left")
    assert now("#split-right") == wide
    page.keyboard.press("/")  # unfolds what is searched
    assert page.evaluate("() => document.activeElement.id") == "list-search"
    page.focus("#tab-analysis")
    page.keyboard.press("w")
    assert size(page, "#right")[0] >= 700
    resize(page, 1010, 500)
    page.wait_for_selector("body[data-form='wide']")
    assert not off_the_page(page)
    page.evaluate(
        '() => localStorage.setItem(\'gspn-panels\', \'{"wide": {"open": [7, "left", "right"], "sizes": {"left": "x", "right": 1e9}}}\')'
    )
    page.reload()
    page.wait_for_selector("body[data-ready]")
    assert not off_the_page(page)
    assert size(page, "#net")[0] >= 270


def test_the_log_and_the_time_line_are_used_by_keyboard(show_net, open_page):
    page = open_page(show_net(read_plan("plans/patrol").net).address)
    page.click("#steps")
    settle(page, 10)
    page.wait_for_selector("#log-10")

    def reach(element):
        for _ in range(60):
            if page.evaluate("() => document.activeElement.id") == element:
                return
            page.keyboard.press("Tab")
        raise AssertionError("#%s is not reached by Tab" % element)

    def at(n):
        page.wait_for_function(
            "(n) => window.gspn.model.board.n === n && !window.gspn.model.following", arg=n
        )
        settle(page)

    reach("log")
    page.keyboard.press("ArrowDown")
    assert page.get_attribute("#log", "aria-activedescendant") == "log-10"
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    assert page.get_attribute("#log-8", "aria-selected") == "true"
    page.keyboard.press("Enter")
    at(8)
    assert page.evaluate("() => document.activeElement.id") == "log"
    page.keyboard.press("l")
    page.wait_for_function("() => window.gspn.model.following && window.gspn.model.board.n === 10")
    page.keyboard.press("1")
    page.focus("#open-screen")
    reach("lanes")
    for key, n in (
        ("ArrowLeft", 9),
        ("ArrowLeft", 8),
        ("ArrowRight", 9),
        ("Home", 0),
        ("End", 10),
        ("PageDown", None),
    ):
        page.keyboard.press(key)
        if n is not None:
            at(n)
            page.wait_for_selector(
                "#lanes[aria-valuenow='%d'][aria-valuetext*='event %d of 10']" % (n, n)
            )
    page.wait_for_function("() => window.gspn.model.board.n < 10")
    page.keyboard.press("+")
    chosen = page.input_value("#span")
    page.keyboard.press("-")
    assert page.input_value("#span") != chosen


def told_model(alarm, size="", follows=()):
    """What the server says of a run beside its prediction; ``alarm``: of a slower robot, or ""."""
    streams = [
        {"kind": "place", "name": "p4:Wait_L1", "level": 0.3, "on": False, "says": ""},
        {
            "kind": "robot",
            "name": "robot_2",
            "level": 1.0 if alarm else 0.6,
            "on": bool(alarm),
            "says": alarm,
        },
    ]
    points = [[float(k), 7 * k] for k in range(1, 31)]
    slow = [[at, count // 2] for at, count in points]
    return {
        "state": "watching",
        "says": "1 alarm" if alarm else "the run matches the prediction",
        "seconds": 30.0,
        "streams": streams,
        "alarms": [alarm] if alarm else [],
        "causes": [{"text": alarm, "size": size, "follows": list(follows)}] if alarm else [],
        "curves": [
            {"name": "all transitions", "growth": [7.0, 0.5, 0.001], "points": points},
            {"name": "t1", "growth": [7.0, 0.5, 0.001], "points": slow},
        ],
        "false_alarm_every": 30 * 86400,
    }


def test_a_run_is_shown_beside_its_prediction(show_net, open_page, axe, picture):
    plan = read_plan("plans/patrol")
    told = ReportedRun(plan)
    page = open_page(show_net(plan.net, plan, told).address, reduced_motion="reduce")
    page.wait_for_selector("#robots .robot-card >> nth=3")
    assert page.locator(".model-run").count() == 0
    told.hub.set_latest("model", {"state": "none", "says": "the plan gives no durations"})
    page.wait_for_selector(".model-run:has-text('The plan gives no durations.')")
    assert page.locator(".model-run meter:visible").count() == 0
    told.hub.set_latest("model", told_model(""))
    page.wait_for_selector(".model-run .plot path.band")
    assert page.inner_text(".model-run .numbers").startswith("210 observed, 202 to 218 predicted")
    assert page.locator(".alarm").count() == 0
    meter = page.locator(".strips meter >> nth=1")
    assert meter.get_attribute("aria-label") == "robot_2: 60 % of the way to the alarm"
    # another count, by keyboard; it is kept, and so is the focus, when news arrive
    page.focus(".model-run select")
    page.keyboard.press("ArrowDown")
    page.wait_for_selector(".model-run .numbers:has-text('105 observed')")
    assert page.inner_text(".model-run .numbers").endswith("fewer than predicted")
    alarm = "robot_2: slower than planned: 1.3 s instead of 1 s (+30 %)"
    told.hub.set_latest("model", told_model(alarm))
    page.wait_for_selector(".alarm:has-text('robot_2: slower than planned')")
    page.wait_for_selector(".strips li.on:has-text('1.3 s instead of 1 s')")
    assert page.evaluate("() => document.activeElement.tagName") == "SELECT"
    assert page.locator(".model-run select").input_value() == "t1"
    page.locator(".model-run").scroll_into_view_if_needed()
    picture(page, "prediction")
    axe(page, "LIVE, beside its prediction", "right")
    # what follows from the same cause is one alarm with it
    follows = ["all robots together: slower than planned: 1.1 s instead of 1 s (+10 %)"]
    told.hub.set_latest("model", told_model(alarm, "+20 to +41 % (95 %)", follows))
    page.wait_for_selector(".alarm:has-text('1 other from it – by now +20 to +41 % (95 %)')")
    assert page.locator(".alarm").count() == 1
    page.click(".alarm")
    page.wait_for_selector("#dialog[open]:has-text('all robots together: slower')")
    page.wait_for_selector("#dialog:has-text('Estimated change since then: +20 to +41 %')")
    page.keyboard.press("Escape")
