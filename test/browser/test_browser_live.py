"""LIVE and REPLAY in a browser, without ROS: start, watch, stop, replay; alarms; lost
connections."""

import json
import socket
import subprocess
import sys

import pytest
from page_reading import boxes, dots, marking, overlaps, settle
from reported_run import ReportedRun

from benchmarks.harness.ports import free_port
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.robot_colours import colour_of

PATROL = "patrol/plan.json"


def start(page, path=PATROL):
    page.evaluate("(key) => { location.hash = key; }", "file-" + path.replace("/", "%2F"))
    page.wait_for_selector("body[data-ready]")
    page.click("#start")
    page.click("dialog button.primary")
    page.wait_for_selector("body[data-mode='LIVE']")


def stop(page):
    page.click("#stop")
    page.click("dialog button.primary")


def test_a_plan_is_executed_recorded_and_replayed(serve_folder, open_page, picture, tmp_path):
    site = serve_folder()
    page = open_page(site.address, ready=False)
    page.click("#opening button:has-text('patrol/plan.json')")
    page.wait_for_selector("body[data-mode='SIMULATE'][data-ready]")
    page.click("#start")
    page.click("dialog button:has-text('Cancel')")
    assert page.get_attribute("body", "data-mode") == "SIMULATE"
    assert not site.session("file-" + PATROL).hub.board().status["running"]

    start(page)
    assert page.inner_text("#mode") == "LIVE"
    settle_n = (
        "() => window.gspn.model.board.n > 30 && document.querySelectorAll('.robot').length >= 2"
    )
    page.wait_for_function(settle_n)
    page.wait_for_selector("#robots .robot-card >> nth=3")
    picture(page, "live")

    late = open_page(site.address + "#file-patrol%2Fplan.json")
    late.wait_for_function("() => window.gspn.model.board.n > 30")
    assert sum(marking(late)) == 4
    stop(late)
    page.wait_for_selector(".alarm:has-text('stopped on the page')")
    for viewer in (page, late):
        settle(viewer, site.session("file-" + PATROL).hub.board().n)
        assert marking(viewer) == site.session("file-" + PATROL).hub.board().marking
        assert dots(viewer) == marking(viewer)
    ended = marking(page)

    log = next((tmp_path / "runs").iterdir())
    replay = open_page(serve_folder(tmp_path / "runs").address + "#file-" + log.name)
    replay.wait_for_selector("body[data-mode='REPLAY']")
    replay.wait_for_function("() => window.gspn.model.info.loading === false")
    assert replay.inner_text("#mode") == "REPLAY"
    total = replay.evaluate("() => window.gspn.model.head.n")
    replay.keyboard.press("ArrowRight")
    replay.wait_for_function("() => window.gspn.model.board.n >= 1")
    replay.select_option("#view-speed", "100")
    replay.keyboard.press(" ")
    settle(replay, total)
    assert marking(replay) == ended
    picture(replay, "replay")
    middle = total // 2
    replay.evaluate(
        "(n) => { const s = document.querySelector('#scrubber'); s.value = n; s.dispatchEvent(new Event('input')); }",
        middle,
    )
    replay.wait_for_function("(n) => window.gspn.model.board.n === n", arg=middle)
    assert sum(marking(replay)) == 4
    replay.keyboard.press("ArrowLeft")
    replay.wait_for_function("(n) => window.gspn.model.board.n < n", arg=middle)


def test_robots_are_drawn_with_colour_and_id(serve_folder, open_page):
    page = open_page(serve_folder().address, ready=False)
    start(page)
    page.wait_for_function("() => document.querySelectorAll('.robot').length >= 3")
    seen = page.evaluate(
        """() => [...document.querySelectorAll('.robot')].map((g) =>
        [g.dataset.robot, g.querySelector('text').textContent, getComputedStyle(g.querySelector('.disc')).fill])"""
    )
    for name, short, _ in seen:
        assert name == "robot_" + short
    assert len({colour for _, _, colour in seen}) == len(seen)
    # in films and in the window of the world they have the same ones
    names = [
        "robot_1",
        "robot_12",
        "robot_13",
        "r0",
        "scout",
        "\u00e9claireur \U0001f916",
        "99999999",
        "",
        "constructor",
    ]
    shown = page.evaluate(
        "async (names) => { const { colourOf } = await import('/static/js/colours.js'); return names.map(colourOf); }",
        names,
    )
    assert shown == [colour_of(name) for name in names]
    stop(page)
    page.wait_for_selector("#stop", state="hidden")


def test_pausing_the_view_never_pauses_the_robots(serve_folder, open_page):
    site = serve_folder()
    page = open_page(site.address, ready=False)
    start(page)
    page.wait_for_function("() => window.gspn.model.board.n > 12")
    page.keyboard.press(" ")
    page.wait_for_function("() => !window.gspn.model.following")
    shown = page.evaluate("() => window.gspn.model.board.n")
    page.wait_for_function("(n) => window.gspn.model.head.n > n + 8", arg=shown)
    assert page.evaluate("() => window.gspn.model.board.n") == shown
    assert page.is_visible("#back-to-live")
    page.click("#back-to-live")
    page.wait_for_function(
        "() => window.gspn.model.following && window.gspn.model.board.n === window.gspn.model.head.n"
    )
    stop(page)
    page.wait_for_selector("#stop", state="hidden")
    settle(page, site.session("file-" + PATROL).hub.board().n)
    assert marking(page) == site.session("file-" + PATROL).hub.board().marking


@pytest.fixture(name="told")
def _told(show_net):
    plan = read_plan("plans/patrol")
    activity = ReportedRun(plan)
    site = show_net(plan.net, plan, activity)
    site.told = activity
    return site


def test_a_lost_robot_and_a_stalled_plan_are_seen_at_a_glance(told, open_page, picture):
    page = open_page(told.address)
    assert page.locator(".alarm").count() == 0
    lost = {"name": "robot_2", "phase": "lost"}
    waits = {"name": "robot_1", "phase": "done", "why": "wants t6:Go_Check_L2: needs a robot in p5"}
    told.told.hub.publish(
        {"k": "robots", "r": [lost, waits], "gone": []},
        {"k": "status", "status": {"stalled": "robot_1 wants t6:Go_Check_L2: needs a robot in p5"}},
    )
    page.wait_for_selector(".alarm:has-text('Lost: robot_2')")
    page.wait_for_selector(".alarm:has-text('Stalled')")
    page.wait_for_selector(".robot-card:has-text('needs a robot in p5')")
    page.wait_for_selector(".robot.waiting[data-robot='robot_1']")
    assert page.locator("#net .robot[data-robot='robot_2']").count() == 0
    picture(page, "lost_and_stalled")
    # who looks back also sees what is the matter now
    page.keyboard.press(" ")
    page.wait_for_function("() => !window.gspn.model.following")
    told.told.hub.publish({"k": "robots", "r": [{"name": "robot_3", "phase": "lost"}], "gone": []})
    page.wait_for_selector(".alarm:has-text('Lost: robot_2, robot_3')")
    assert page.locator("#net .robot[data-robot='robot_3']").count() == 1
    page.keyboard.press("l")
    page.wait_for_selector("#net .lost-mark[data-lost='robot_3']")
    # a long reason crowds nothing out
    title = boxes(page, "#title")
    told.told.hub.publish(
        {"k": "status", "status": {"stalled": "the gripper of robot_1 says: " + "no " * 400}}
    )
    page.wait_for_selector(".alarm:has-text('the gripper')")
    assert boxes(page, "#title") == title
    assert not overlaps(boxes(page, "#title, #subtitle, #mode, #connection, #alarms, #frame"))
    _, top, _, bottom = boxes(page, ".alarm")[-1]
    assert bottom - top < 60
    picture(page, "long_reason")
    page.click(".alarm:has-text('the gripper')")
    assert page.inner_text("dialog .whole").count("no ") > 390


def test_feedback_what_was_refused_and_the_room_are_shown(told, open_page, picture):
    page = open_page(told.address)
    told.told.hub.set_latest("feedback", {"robot_1": "feedback: 7"})
    page.wait_for_selector(".robot-card:has-text('feedback: 7')")
    refused = [{"robot": "robot_4", "why": "too large", "times": 3}]
    told.told.hub.publish(
        {"k": "robots", "r": [{"name": "robot_1", "refused": refused}], "gone": []}
    )
    page.wait_for_selector(".robot-card:has-text('refused: 3 of robot_4 (too large)')")
    assert page.is_hidden("#room")
    locations = {"L1": {"area": [[1, 1], [3, 3]], "entry": [1, 1, 0], "sweep": [], "bay": []}}
    room = {
        "bounds": [[0, 0], [10, 8]],
        "boxes": [{"at": [5, 0], "size": [10, 0.2], "yaw": 0}],
        "cylinders": [],
    }
    told.told.hub.set_latest("room", {**room, "locations": locations, "robot_radius": 0.3})
    told.told.hub.set_latest(
        "world",
        {
            "time": 1.0,
            "robots": {"robot_1": {"pose": [4, 4, 0.5], "path": [[4, 4], [6, 6]]}},
            "people": [{"at": [7, 2], "radius": 0.2, "color": "#0af00b"}],
        },
    )
    page.wait_for_selector("#room canvas")
    inked = """() => { const c = document.querySelector('#room canvas'); const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
      let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n; }"""
    page.wait_for_function(
        "(script) => eval(script)() > 500".replace("eval(script)", "(%s)" % inked), arg=0
    )
    coloured = """() => { const c = document.querySelector('#room canvas'); const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
      for (let i = 0; i < d.length; i += 4) if (d[i] === 10 && d[i + 1] === 240 && d[i + 2] === 11) return true; return false; }"""
    page.wait_for_function(coloured)  # the person
    picture(page, "room")
    page.click("#room-close")
    assert page.is_hidden("#room")


def test_the_age_of_the_last_event_is_reported_and_the_end_of_all_events(told, open_page):
    page = open_page(told.address)
    told.told.hub.publish(
        {"k": "note", "level": "fault", "robot": "robot_1", "text": "its action failed"}
    )
    page.wait_for_selector("#connection:has-text('last event')")
    page.wait_for_selector("#log li.fault:has-text('its action failed')")
    # before a robot was heard, nothing is known
    silent = [{"name": "robot_%d" % i, "phase": ""} for i in (1, 2, 3, 4)]
    told.told.hub.publish(
        {"k": "status", "status": {"running": False, "ended": None}}, {"k": "robots", "r": silent}
    )
    page.wait_for_selector(
        "body[data-stale] #frame-name:has-text('no robot of the team has been heard from yet')"
    )
    page.wait_for_selector(".robot-card[data-robot='robot_1'] .badge:has-text('not heard yet')")
    assert page.inner_text(".robot-card[data-robot='robot_1'] .since") == ""
    lanes = (
        "async () => { const { lanesOf } = await import('/static/js/course.js'); const { model } = window.gspn;"
        " return lanesOf(model, model.board.t, model.board.t + 9).get('robot_1').parts; }"
    )
    assert page.evaluate(lanes) == []
    told.told.hub.publish(
        {"k": "status", "status": {"running": True}},
        {"k": "robots", "r": [{"name": "robot_1", "phase": "doing"}]},
    )
    page.wait_for_selector(
        "body:not([data-stale]) .robot-card[data-robot='robot_1'] .badge:has-text('acts')"
    )
    assert page.evaluate(lanes)
    told.told.hub.publish({"k": "robots", "r": [{"name": "robot_1", "phase": "left"}], "gone": []})
    page.wait_for_selector(".robot-card[data-robot='robot_1'] .badge:has-text('has left')")
    assert page.evaluate(lanes) == []
    # a net that the server has closed is shown as it was, and said to be so
    told.session().close()
    page.wait_for_selector("body[data-stale] #notice:has-text('no longer open on the server')")
    page.wait_for_selector("#connection:has-text('no longer open on the server')")


def test_more_viewers_than_streams_poll_and_agree(show_net, open_page):
    plan = read_plan("plans/patrol")
    activity = ReportedRun(plan)
    site = show_net(plan.net, plan, activity, viewers=1)
    one = open_page(site.address)
    two = open_page(site.address, expect_errors=True)
    two.wait_for_selector("#connection[data-state='polling']")
    t = plan.net.transition_index["t1:Temperature_High_L1"]
    p = [p for p, _ in plan.net.effect(t)]
    fire = {"k": "fire", "tr": t, "who": "robot_1", "d": [list(x) for x in plan.net.effect(t)]}
    activity.hub.publish({**fire, "m": [["robot_1", p[0], p[1]]], "en": [], "dis": []})
    for page in (one, two):
        settle(page, 1)
        assert marking(page) == site.board().marking


def feed(port):
    command = [
        sys.executable,
        "-m",
        "benchmarks.page.feed",
        "100",
        "100",
        str(port),
    ]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline().strip() == b"ready"
    return process


def test_a_server_that_is_killed_and_started_again_is_followed_with_no_gap(open_page):
    port = free_port()
    server = feed(port)
    try:
        page = open_page("http://127.0.0.1:%d/" % port, expect_errors=True)
        page.evaluate(
            """() => { const { model } = window.gspn; window.gaps = 0; let last = model.board.n, epoch = model.epoch;
            model.addEventListener("reset", () => { last = model.board.n; epoch = model.epoch; });
            model.addEventListener("events", ({ detail }) => { for (const e of detail.events) { if (e.n !== last + 1) window.gaps += 1; last = e.n; } }); }"""
        )
        page.wait_for_function("() => window.gspn.model.board.n > 50")
        first = page.evaluate("() => window.gspn.model.epoch")
        server.kill()
        server.wait()
        page.wait_for_selector("#connection[data-state='lost']")
        page.wait_for_selector(
            "#announce-now[aria-live='assertive']:has-text('connection lost')", state="attached"
        )
        server = feed(port)
        page.wait_for_function(
            "(epoch) => window.gspn.model.epoch !== epoch && window.gspn.model.board.n > 100",
            arg=first,
        )
        page.wait_for_selector("#connection[data-state='open']")
        page.wait_for_selector("#announce-now:has-text('connected')", state="attached")
        assert page.evaluate("() => window.gaps") == 0
        shown = page.evaluate(
            """async () => { const { model } = window.gspn; const n = model.board.n, marking = model.board.marking.slice();
            const answer = await (await fetch(`/api/state?id=feed&at=${n}`)).json();
            return [marking, answer.board.marking, answer.board.n === n]; }"""
        )
        assert shown[2] and shown[0] == shown[1]
    finally:
        server.kill()
        server.wait()


def test_a_viewer_that_stalls_holds_up_nobody(open_page):
    port = free_port()
    server = feed(port)
    try:
        with socket.socket() as stalled:
            stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            stalled.connect(("127.0.0.1", port))
            stalled.sendall(
                b"GET /api/stream?id=feed HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % port
            )
            # the server ends before the page
            page = open_page("http://127.0.0.1:%d/" % port, expect_errors=True)
            begin = page.evaluate("() => window.gspn.model.board.n")
            page.wait_for_function("(n) => window.gspn.model.board.n > n + 300", arg=begin)
    finally:
        server.kill()
        server.wait()


def test_beyond_loopback_the_page_logs_in_with_its_token(show_net, open_page):
    plan = read_plan("plans/patrol")
    site = show_net(plan.net, token="a-long-secret-token")
    assert site.address.endswith("#token=a-long-secret-token")
    page = open_page(site.address)
    assert "token" not in page.url
    assert json.dumps(marking(page)) == json.dumps(site.board().marking)
    stranger = open_page(site.address.split("#")[0], ready=False, expect_errors=True)
    stranger.wait_for_selector("dialog[open]:has-text('needs a token')")
    stranger.fill("dialog input", "a-long-secret-token")
    stranger.keyboard.press("Enter")
    stranger.wait_for_selector("body[data-ready]")
