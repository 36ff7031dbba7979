"""SIMULATE in a browser: every tool, every key, two viewers, and what is drawn is what is so."""

import pytest
from page_reading import boxes, dots, enabled, marking, overlaps, resize, settle

from benchmarks.page.feed import workshop
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.builder import NetBuilder


def cycle(tokens=3):
    return (
        NetBuilder("cycle")
        .place("a", tokens)
        .place("b")
        .place("c", 12)
        .exponential("t", 1.0, inputs="a", outputs="b")
        .exponential("s", 2.0, inputs={"a": 2}, outputs={"c": 2})
        .immediate("u", inputs="b", outputs="a", inhibitors={"c": 30})
        .build()
    )


def agree(page, site):
    """The page, its drawing and the server are of one mind."""
    settle(page, site.board().n)
    assert marking(page) == site.board().marking
    assert dots(page) == site.board().marking
    assert enabled(page) == sorted(site.board().enabled)


def test_each_tool(show_net, open_page):
    site = show_net(cycle())
    page = open_page(site.address)
    agree(page, site)
    page.click("#step")
    settle(page, 1)
    agree(page, site)
    assert site.board().n == 1
    page.fill("#n-steps", "7")
    page.click("#steps")
    settle(page, 8)
    agree(page, site)
    page.click("#back")
    settle(page, 9)
    assert sum(site.board().counts) == 7
    agree(page, site)
    page.click("#clear")
    settle(page, 10)
    assert dots(page) == [0, 0, 0]
    assert enabled(page) == []
    page.click("#reset")
    settle(page, 11)
    assert dots(page) == [3, 0, 12]
    page.fill("#list-search", "s")
    page.click("#list li[data-key='t1']")
    page.click("#fire-chosen")
    settle(page, 12)
    assert site.board().counts == [0, 1, 0]
    agree(page, site)
    page.click("#reset")
    settle(page, 13)
    page.click("text=Probabilities")
    page.fill("dialog input[aria-label='Firing probability of t']", "0")
    page.click("dialog button.primary")
    page.wait_for_function("() => window.gspn.model.info.probabilities['0'] === 0")
    page.click("#step")
    settle(page, 14)
    assert site.board().counts == [0, 1, 0]


def test_the_run_button_goes_on_until_it_is_stopped(show_net, open_page):
    site = show_net(cycle())
    page = open_page(site.address)
    page.select_option("#speed", "30")
    page.click("#run")
    settled = "() => window.gspn.model.board.n >= 8"
    page.wait_for_function(settled)
    page.click("#run")
    page.wait_for_function("() => document.querySelector('#run').textContent.includes('Run')")
    agree(page, site)


def test_a_dead_end_is_reported(show_net, open_page):
    site = show_net(NetBuilder("end").place("p", 1).exponential("t", inputs="p").build())
    page = open_page(site.address)
    page.click("#steps")
    page.wait_for_selector("#toast:has-text('then nothing is enabled')")
    assert site.board().n == 1


def test_each_key(show_net, open_page):
    site = show_net(cycle())
    page = open_page(site.address)
    page.keyboard.press("ArrowRight")
    settle(page, 1)
    page.keyboard.press("Shift+ArrowRight")
    settle(page, 11)
    page.keyboard.press("ArrowLeft")
    settle(page, 12)
    assert sum(site.board().counts) == 10
    page.keyboard.press("r")
    settle(page, 13)
    assert site.board().marking == [3, 0, 12]
    page.keyboard.press("/")
    assert page.evaluate("() => document.activeElement.id") == "list-search"
    page.keyboard.type("t")
    page.keyboard.press("Enter")
    page.keyboard.press("x")
    settle(page, 14)
    assert site.board().counts == [1, 0, 0]
    page.keyboard.press("e")
    assert page.locator("#net.no-enabled").count() == 1
    page.keyboard.press("e")
    assert page.locator("#net.no-enabled").count() == 0
    page.keyboard.press("+")
    page.wait_for_function("() => !window.gspn.page.view.camera.fitted")
    page.keyboard.press("f")
    page.wait_for_function("() => window.gspn.page.view.camera.fitted")
    page.keyboard.press("3")
    assert page.get_attribute("#tab-analysis", "aria-selected") == "true"
    page.keyboard.press(" ")
    page.wait_for_function("() => window.gspn.model.board.n >= 16")
    page.keyboard.press(" ")
    page.wait_for_function("() => !window.gspn.page.tools.running")
    page.keyboard.press("?")
    page.wait_for_selector("dialog[open] h2:has-text('Keys')")
    page.keyboard.press("Escape")
    page.wait_for_selector("dialog:not([open])", state="attached")


def test_two_viewers_agree(show_net, open_page):
    site = show_net(cycle())
    one, two = open_page(site.address), open_page(site.address)
    one.click("#steps")
    two.click("#step")
    for page in (one, two):
        settle(page, 11)
        agree(page, site)
    late = open_page(site.address)
    agree(late, site)
    assert site.board().n == 11


def test_dots_up_to_nine_then_a_number(show_net, open_page):
    net = NetBuilder("counts")
    for count in (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 123, 45678):
        net.place("p%d" % count, count)
    page = open_page(show_net(net.immediate("t", inputs="p1").build()).address)
    assert dots(page) == [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 123, 45678]
    assert page.locator("path.dots").count() == 9
    assert page.locator("text.count").count() == 3
    for count in range(2, 10):
        centres = page.evaluate(
            """(n) => {
              const dots = document.querySelector(`path.dots[data-count="${n}"]`);
              const circle = dots.parentNode.querySelector("circle");
              const [cx, cy] = ["cx", "cy"].map((name) => Number(circle.getAttribute(name)));
              return dots.getAttribute("d").split("M").slice(1)
                .map((dot) => dot.split(/[ a]/).slice(0, 2).map(Number))
                .map(([x, y]) => [x + 3.4 - cx, y - cy]); }""",
            count,
        )
        for x, y in centres:
            assert (x * x + y * y) ** 0.5 + 3.4 < 20
        assert all(
            ((a - x) ** 2 + (b - y) ** 2) ** 0.5 > 6.8
            for a, b in centres
            for x, y in centres
            if (a, b) != (x, y)
        )


@pytest.mark.parametrize("folder", ["fork_join", "patrol", "measure", "rendezvous", "tokens"])
def test_every_node_has_its_name_and_nothing_overlaps(show_net, open_page, folder):
    net = read_plan("plans/" + folder).net
    page = open_page(show_net(net).address)
    count = len(net.places) + len(net.transitions)
    for width, height in ((1440, 900), (1280, 720)):
        resize(page, width, height)
        settle(page)
        page.wait_for_function("(n) => document.querySelectorAll('.label').length === n", arg=count)
        nodes = boxes(page, "#net .place > circle, #net .transition > rect.body")
        assert len(nodes) == count
        assert not overlaps(nodes + boxes(page, ".label"), slack=2.5)
    if folder == "patrol":
        for transition in ("1", "21"):
            page.click("#list li[data-key='t%s']" % transition)
            page.wait_for_selector(
                "[data-transition='%s'].selected > .label" % transition, state="attached"
            )
            settle(page)
            assert (
                page.locator("[data-transition='%s'].selected > .label" % transition).count() == 1
            )


def test_a_large_net_has_the_names_that_there_is_room_for(show_net, open_page):
    site = show_net(workshop(600))
    page = open_page(site.address)
    page.wait_for_function("() => document.querySelectorAll('.label').length > 20")
    named = """() => { const { view } = window.gspn.page;
      return [view.nodes.filter((n) => n.label).length, view.nodes.filter((n) => n.label && !(n.count > 0 || n.enabled)).length, view.camera.now.k]; }"""
    few, idle, zoom = page.evaluate(named)
    assert zoom < 0.28 and idle == 0  # from afar only what holds tokens or is enabled
    named_now = "() => window.gspn.page.view.nodes.filter((n) => n.label).map((n) => n.name)"
    before = page.evaluate(named_now)
    page.fill("#n-steps", "300")
    page.click("#steps")
    settle(page, 300)
    assert page.evaluate(named_now) != before  # the names go with the tokens
    assert page.evaluate(named)[1] == 0
    few = page.evaluate(named)[0]
    page.evaluate("() => window.gspn.page.choose({ kind: 'place', index: 3 })")
    page.wait_for_selector("[data-place='3'] > .label", state="attached")
    page.keyboard.press("+")
    page.keyboard.press("+")
    page.wait_for_function("(few) => document.querySelectorAll('.label').length > 2 * few", arg=few)
    settle(page)
    nodes = boxes(page, "#net .place > circle, #net .transition > rect.body")
    assert not overlaps(boxes(page, ".label"), slack=1)
    assert len(nodes) >= 590


def test_what_is_drawn_can_be_made_out(show_net, open_page):
    net = NetBuilder("names").place("p10", 1).place("p2").place("p1")
    for name, source, target in (("t10", "p10", "p2"), ("t9", "p2", "p1"), ("t1", "p1", "p10")):
        net.exponential(name, 1.0, inputs=source, outputs=target)
    page = open_page(show_net(net.build()).address)
    settle(page)
    listed = page.evaluate(
        "() => [...document.querySelectorAll('#list li .name')].map((e) => e.textContent)"
    )
    # the enabled, the marked, and then in natural order
    assert listed == ["t10", "p10", "p1", "p2", "t1", "t9"]
    page.fill("#n-steps", "10000")
    assert page.evaluate(
        "() => { const e = document.querySelector('#n-steps'); return e.scrollWidth <= e.clientWidth; }"
    )
    sizes = """async (count) => { const { drawPlace } = await import("/static/js/net_nodes.js");
      const { places } = window.gspn.page.view;
      drawPlace(places[1], count, Array.from({ length: count }, (_, i) => ({ name: `robot_${i + 8}`, phase: "doing", place: 1 })));
      return [...places[1].robots.querySelectorAll("text")].map((t) => [parseFloat(t.style.fontSize), t.textContent]); }"""
    for count in range(1, 10):
        drawn = page.evaluate(sizes, count)
        assert [name for _, name in drawn] == [str(i + 8) for i in range(count)]
        assert min(size for size, _ in drawn) >= 8, count
    heads = """(k) => { const { view } = window.gspn.page; view.camera.set(k, 100, 100); view.camera.draw();
      return view.arcs.path.heads.getAttribute("d").split("M").slice(1).map((head) => {
        const [x, y, ax, ay, bx, by] = head.match(/-?[0-9.]+/g).map(Number);
        return k * Math.hypot(x - (ax + bx) / 2, y - (ay + by) / 2); }); }"""
    for zoom in (1.0, 0.5, 0.3, 0.2):
        assert min(page.evaluate(heads, zoom)) >= 4, zoom


def test_the_panels_do_not_overlap(show_net, open_page):
    page = open_page(show_net(cycle()).address)
    assert not overlaps(boxes(page, "header, .left, .centre, .right, .timeline, .log"))
    assert not overlaps(
        boxes(page, "header > button, header .what, header .state > *, header .group button"),
        slack=2,
    )
    assert not overlaps(boxes(page, "#tools > *"))
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate(
        "() => document.querySelector('#tools').scrollWidth <= document.querySelector('#tools').clientWidth"
    )


def test_tokens_travel_unless_motion_is_reduced(show_net, open_page):
    site = show_net(cycle())
    moving = open_page(site.address)
    still = open_page(site.address, reduced_motion="reduce")
    watch = """() => { window.seen = 0; new MutationObserver((all) => { for (const m of all) window.seen += m.addedNodes.length; })
      .observe(window.gspn.page.view.layer.travel, { childList: true }); }"""
    for page in (moving, still):
        page.evaluate(watch)
    moving.click("#step")
    for page in (moving, still):
        settle(page, 1)
    assert moving.evaluate("() => window.seen") > 0
    assert still.evaluate("() => window.seen") == 0
    agree(moving, site)
    agree(still, site)


def test_a_dragged_node_stays_where_it_was_put(show_net, open_page):
    page = open_page(show_net(cycle()).address)
    settle(page)
    x0, y0, x1, y1 = boxes(page, "[data-place='0'] > circle")[0]
    page.mouse.move((x0 + x1) / 2, (y0 + y1) / 2)
    page.mouse.down()
    page.mouse.move((x0 + x1) / 2 + 40, (y0 + y1) / 2 + 55, steps=4)
    page.mouse.up()
    where = "() => { const n = window.gspn.page.view.places[0]; return [Math.round(n.x), Math.round(n.y)]; }"
    put = page.evaluate(where)
    page.reload()
    page.wait_for_selector("body[data-ready]")
    assert page.evaluate(where) == put
    page.click("#relayout")
    page.wait_for_function("(put) => window.gspn.page.view.places[0].x !== put[0]", arg=put)


def test_the_inspector_says_why_a_transition_is_not_enabled(show_net, open_page):
    page = open_page(show_net(cycle(tokens=0)).address)
    page.click("#list li[data-key='t0']")
    page.wait_for_selector("#inspector:has-text('a has 0 of 1 token')")
    page.click("#list li[data-key='p2']")
    page.wait_for_selector("#inspector:has-text('12')")


def test_looking_back_and_back_to_now(show_net, open_page):
    site = show_net(cycle())
    page = open_page(site.address)
    page.click("#steps")
    settle(page, 10)
    page.click("#log li:last-child")
    page.wait_for_function("() => window.gspn.model.board.n === 1 && !window.gspn.model.following")
    settle(page)
    assert dots(page) == site.session().hub.board_at(1).marking
    page.keyboard.press("l")
    settle(page, 10)
    agree(page, site)


def test_the_log_is_filtered(show_net, open_page):
    site = show_net(cycle())
    page = open_page(site.address)
    page.click("#steps")
    settle(page, 10)
    page.fill("#log-filter", "u")
    page.wait_for_function(
        "(n) => document.querySelectorAll('#log li.fire').length === n", arg=site.board().counts[2]
    )


def test_names_are_text_only(show_net, open_page):
    hostile = "<img src=x onerror=alert(1)>"
    net = (
        NetBuilder("<script>alert(2)</script>")
        .place(hostile, 1)
        .place("'\"><svg onload=alert(3)>")
        .exponential(
            "</text><script>alert(4)</script>", inputs=hostile, outputs="'\"><svg onload=alert(3)>"
        )
        .build()
    )
    page = open_page(show_net(net).address)
    page.click("#step")
    settle(page, 1)
    page.click("#list li[data-key='p0']")
    page.wait_for_function(
        "(name) => document.querySelector('#inspector h2').textContent === name", arg=hostile
    )
    page.keyboard.press("3")
    page.click("#an-all")
    page.wait_for_selector("[data-state='done']")
    assert page.locator("img[src='x'], main script, main svg svg svg").count() == 0


def test_pictures_of_the_simulation(show_net, open_page, picture):
    patrol = show_net(read_plan("plans/patrol").net)
    page = open_page(patrol.address)
    page.click("#steps")
    settle(page, 10)
    picture(page, "simulate")
    dark = open_page(patrol.address, color_scheme="dark")
    settle(dark)
    picture(dark, "simulate_dark")
    large = open_page(show_net(workshop(1000)).address)
    large.click("#steps")
    settle(large, 10)
    picture(large, "net_of_1000_nodes")
    assert (
        large.evaluate("() => document.querySelectorAll('#net .place, #net .transition').length")
        >= 980
    )
