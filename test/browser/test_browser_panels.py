"""The analysis panel, the input screen, and the page by keyboard alone."""

import csv
import re
from dataclasses import replace

import pytest
from page_reading import settle

from benchmarks.nets import kanban, philosophers
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.formats.registry import write_net
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.visualizer import analysis_jobs


def flawed():
    """A net with a transition that never fires, a deadlock and a trap."""
    return (
        NetBuilder("flawed")
        .place("a", 2)
        .place("b")
        .place("sink")
        .exponential("go", 2.0, inputs="a", outputs="b")
        .exponential("back", 1.0, inputs="b", outputs="a")
        .exponential("fall", 0.1, inputs="b", outputs="sink")
        .exponential("never", 1.0, inputs={"b": 5}, outputs="sink")
        .build()
    )


def machine():
    return (
        NetBuilder("machine")
        .place("up", 1)
        .place("down")
        .exponential("fail", 1.0, inputs="up", outputs="down")
        .exponential("repair", 3.0, inputs="down", outputs="up")
        .build()
    )


def analysed(page):
    page.wait_for_selector("[data-state='done']")


def test_everything_is_analysed_and_painted(show_net, open_page, picture):
    page = open_page(show_net(flawed()).address)
    page.keyboard.press("3")
    page.click("#an-all")
    analysed(page)
    text = page.inner_text("#analysis")
    for expected in (
        "Conservative",
        "Siphons",
        "P-invariants",
        "Deadlocks",
        "Live",
        "Mean",
        "Throughput",
    ):
        assert expected.lower() in text.lower()
    assert "never" in text
    page.click("text=Show the dead transitions")
    assert page.evaluate(
        "() => [...document.querySelectorAll('.paint-bad')].map((g) => g.dataset.transition)"
    ) == ["3"]
    assert "never fire" in page.inner_text("#legend")
    page.click("text=Show mean tokens")
    assert page.evaluate(
        "() => [...document.querySelectorAll('.value')].map((v) => v.textContent)"
    ) == ["0", "0", "2"]
    picture(page, "analysis")
    page.click("#legend button")
    assert page.locator(".value, .paint-bad").count() == 0


def test_a_plan_is_analysed_as_it_runs_or_as_its_net(show_net, open_page):
    plan = read_plan("plans/rendezvous")
    page = open_page(show_net(plan.net, plan).address)
    page.keyboard.press("3")
    page.click("text=State space")
    analysed(page)
    text = page.inner_text("#answers")
    assert "as the plan runs" in text and "At_Dock, Docked" in text
    page.click("summary:has-text('Settings')")
    page.select_option("#an-reading", "net")
    page.click("text=State space")
    page.wait_for_selector("#answers:has-text('as in its net alone')")
    analysed(page)
    page.uncheck("#an-policy")
    assert page.locator("#an-reading").is_disabled()


def test_durations_with_too_many_phases_have_answers_with_intervals(show_net, open_page):
    plan = read_plan("plans/rendezvous")
    plan = replace(plan, durations={"Docked": Duration.deterministic(2.0)}).validate()
    page = open_page(show_net(plan.net, plan).address)
    page.keyboard.press("3")
    page.click("summary:has-text('How long until?')")
    page.fill("#an-passage", "Docked >= 1")
    for question, title, where in (
        ("Steady state", "Steady state", "In brackets"),
        ("Mean time", "How long until?", "In brackets, and as a band"),
    ):
        page.click("#analysis button:text-is('%s')" % question)
        page.wait_for_selector("#answers details:has-text('%s')" % title)
        analysed(page)
        text = page.inner_text("#answers")
        why = "the intervals of the answers, since durations are replaced."
        assert "%s: %s" % (where, why) in text
        assert re.search(r"\d\s\(\d[^)]*(–| to )\d", text)
        assert "was replaced by phases of the same mean: Erlang" in text
    assert page.locator("#answers path.interval").count() == 1


def test_curves_and_bars_show_their_intervals(show_net, open_page):
    plan = read_plan("plans/rendezvous")
    plan = replace(plan, durations={"Docked": Duration.deterministic(2.0)}).validate()
    page = open_page(show_net(plan.net, plan).address)
    page.keyboard.press("3")
    page.click("summary:has-text('How does it evolve?')")
    page.click("button:has-text('Tokens over time')")
    analysed(page)
    answers = page.locator("#answers")
    answers.get_by_text("Bands: the intervals of the answers, since durations").first.wait_for()
    for title in ("Mean tokens over time", "Distribution of tokens over time"):
        chart = page.locator("#answers details:has(summary:text-is('%s')) .chart" % title)
        chart.locator("path.interval").first.wait_for(state="attached")
        chart.locator("svg.plot").focus()
        for _ in range(10):
            page.keyboard.press("ArrowRight")
        assert re.search(r": \d\S* \(\d\S* to \d\S*\)", chart.locator(".chart-values").inner_text())
        with page.expect_download() as saved:
            chart.locator("button:text-is('CSV')").click()
        with open(saved.value.path(), encoding="utf-8") as file:
            heads = next(csv.reader(file))
        assert heads[2:4] == [heads[1] + ", low", heads[1] + ", high"]
    page.click("#analysis button:text-is('Steady state')")
    page.wait_for_selector("#answers details:has-text('Steady state')")
    analysed(page)
    page.wait_for_selector("#answers svg.plot line.interval", state="attached")


def test_the_run_net_of_a_plan_is_shown_with_what_its_nodes_stand_for(show_net, open_page):
    plan = read_plan("plans/rendezvous")
    page = open_page(show_net(plan.net, plan).address)
    page.click("#show-run-net")
    page.wait_for_selector("#subtitle:has-text('its run net')")
    page.wait_for_selector("#inspector:has-text('take exponential times')")
    assert page.locator("#show-run-net").count() == 0
    page.click("#left >> text=Docked_done_wants_Hand_Over")
    page.wait_for_selector("#inspector:has-text('robots: Docked (done, wants Hand_Over)')")


def test_questions_about_all_markings_are_decided(show_net, open_page):
    plan = read_plan("plans/rendezvous")
    place = plan.net.places[0].name
    page = open_page(show_net(plan.net, plan).address)
    page.keyboard.press("3")
    page.click("summary:has-text('Is it so in all markings?')")
    assert page.is_disabled("#an-decide")
    page.select_option("#an-kind", "moves")
    page.click("button:has-text('Decide')")
    analysed(page)
    page.wait_for_selector("#answers .badge.good:has-text('proven')")
    page.select_option("#an-kind", "always")
    page.fill("#an-decide", "'%s' >= 1" % place)
    page.click("button:has-text('Decide')")
    analysed(page)
    page.wait_for_selector("#answers .badge.bad:has-text('violated')")
    page.wait_for_selector("#answers .asked:has-text(\"always holds: '%s' >= 1\")" % place)
    page.click("#answers button:has-text('Play')")
    page.wait_for_function("() => window.gspn.model.board.marking[0] === 0")


def test_questions_are_answered(show_net, open_page):
    page = open_page(show_net(flawed()).address)
    page.keyboard.press("3")
    page.click("summary:has-text('Is it reachable?')")
    page.fill("#an-reach", "sink == 2")
    page.click("button:has-text('Reachable?')")
    analysed(page)
    page.wait_for_selector("#answers:has-text('By firing')")
    # the way there plays in the simulation: two tokens go to the sink, in four firings
    sink = "(tokens) => window.gspn.model.board.marking[2] === tokens"
    page.click("#answers button[aria-label='Next step']")
    page.wait_for_selector("#answers .sequence:has-text('1 of 4 fired')")
    page.click("#answers button:has-text('Play')")
    page.wait_for_selector("#answers .sequence:has-text('4 of 4 fired')")
    page.wait_for_function(sink, arg=2)
    page.click("#answers button[aria-label='Previous step']")
    page.wait_for_selector("#answers .sequence:has-text('3 of 4 fired, next fall')")
    page.wait_for_function(sink, arg=1)
    # from the marking on display, where one more firing is enough, also after the simulation went on
    page.click("summary:has-text('Settings')")
    page.select_option("#an-from", "marking")
    page.click("button:has-text('Reachable?')")
    analysed(page)
    page.wait_for_selector("#answers .sequence:has-text('0 of 1 fired, next fall')")
    page.click("#reset")
    page.wait_for_function(sink, arg=0)
    page.click("#answers button[aria-label='Next step']")
    page.wait_for_selector("#answers .sequence:has-text('1 of 1 fired')")
    page.wait_for_function(sink, arg=2)
    page.select_option("#an-from", "initial")
    page.fill("#an-cover", "sink = 3")
    page.click("button:has-text('Coverable?')")
    page.wait_for_selector("#answers .badge.bad:has-text('no')")
    analysed(page)
    page.click("summary:has-text('How long until?')")
    page.fill("#an-passage", "sink == 1")
    page.click("button:has-text('Mean time')")
    page.wait_for_selector("#answers:has-text('Mean time') svg.plot")
    analysed(page)
    page.click("summary:has-text('How does it evolve?')")
    page.click("button:has-text('Tokens over time')")
    page.wait_for_selector("#answers:has-text('Mean tokens over time') svg.plot path")
    analysed(page)
    page.fill("#an-reach", "nonsense == 2")
    page.click("button:has-text('Reachable?')")
    page.wait_for_selector("[data-state='failed']:has-text(\"no place 'nonsense'\")")
    # what was answered before is gone: an answer stands below its own question
    assert "nonsense == 2" in page.inner_text("#answers .asked")
    assert page.locator("#answers .badge:has-text('yes'), #answers svg").count() == 0
    assert page.inner_text("#answers .badge") == "no answer"
    page.click("summary:has-text('What is it worth?')")
    page.fill("#an-rewards", "a = 1e-3, b = 2.5E2x")
    page.click("button:has-text('Reward per second')")
    page.wait_for_selector("#answers:has-text(\"'b = 2.5E2x' is not of the form\")")
    page.fill("#an-rewards", "a = 1e-3, b = 2.5E2")
    page.click("button:has-text('Reward per second')")
    page.wait_for_selector(
        "#answers .asked:has-text('a = 0.001, b = 250 · from the initial marking')"
    )
    page.wait_for_selector("#answers dt:has-text('Reward')")


def test_runs_are_simulated_with_confidence_intervals(show_net, open_page):
    page = open_page(show_net(machine()).address)
    page.keyboard.press("3")
    page.click("summary:has-text('Simulated runs')")
    page.fill("#an-sim-runs", "60")  # robots and viewers take precedence, and it has 60 s
    page.click("button:has-text('Simulate runs')")
    analysed(page)
    cell = page.inner_text("#answers tr:has-text('up') td.number")
    mean, half_width = (float(part) for part in cell.split("±"))
    assert abs(mean - 0.75) < 0.02 and 0 < half_width < 0.02
    page.click("text=Show mean tokens")
    assert page.locator(".value").count() == 2
    page.fill("#an-sim-until", "down == 1")
    page.click("button:has-text('Simulate runs')")
    page.wait_for_selector("#answers:has-text('Reached the condition')")
    analysed(page)
    page.fill("#an-sim-warmup", "1000")
    page.click("button:has-text('Simulate runs')")
    page.wait_for_selector("[data-state='failed']:has-text('warm-up of 1000 s does not fit')")


def test_a_sweep_shows_its_points_and_a_plot_of_each_measure(show_net, open_page):
    page = open_page(show_net(machine()).address)
    page.keyboard.press("3")
    page.click("summary:has-text('Simulated runs')")
    page.fill("#an-sim-runs", "100")
    page.click("summary:text-is('Sweep')")
    page.fill("#an-sweep-vary", "tokens:up=1..3")
    page.fill("#an-sweep-also", "rate:nothing=1")
    page.fill("#an-sweep-measure", "fail, down")
    page.click("button:text-is('Sweep')")
    page.wait_for_selector(
        "[data-state='failed']:has-text(\"no exponential transition 'nothing'\")"
    )
    page.fill("#an-sweep-also", "rate:repair=3,6")
    page.click("button:text-is('Sweep')")
    page.wait_for_selector("#answers:has-text('6 of 6 points')")
    analysed(page)
    rows = [row.split("\t") for row in page.inner_text("#sweep-points tbody").splitlines()]
    assert [row[:2] for row in rows] == [[n, r] for n in "123" for r in "36"]
    means = [float(row[2].split("±")[0]) for row in rows]
    assert abs(means[0] - 0.75) < 0.05 and means[0] < means[1] < means[2]
    assert page.locator("#answers svg.plot").count() == 2
    for kind in ("path:not(.interval)", "path.interval"):
        assert page.locator("#answers svg.plot >> nth=0 >> " + kind).count() == 2
    assert page.inner_text("#answers .key >> nth=0").split("●")[1].strip() == "rate:repair=3"


def test_every_property_of_the_thesis_is_answered(show_net, open_page):
    """Thesis 2.4: reachability and coverability have a test of their own."""
    page = open_page(show_net(philosophers(2)).address)
    page.keyboard.press("3")
    page.click("#an-all")
    analysed(page)
    page.wait_for_selector("#answers:has-text('mean stay (s)')")
    text = page.inner_text("#answers").lower()
    for expected in (
        "bounded",
        "k-safe",
        "deadlocks",
        "live",
        "reversible",
        "mean",
        "throughput",
        "distribution of tokens",
    ):
        assert expected in text
    page.click("summary:has-text('How does it evolve?')")
    page.click("button:has-text('Tokens over time')")
    page.wait_for_selector(
        "#answers:has-text('Distribution of tokens over time') svg.plot >> nth=1"
    )
    analysed(page)
    page.click("button:has-text('Time to steady state')")
    page.wait_for_selector("#answers:has-text('Time to steady state')")
    analysed(page)
    page.click("summary:has-text('What is it worth?')")
    transition = page.evaluate("() => window.gspn.model.scene.transitions[0].name")
    page.fill("#an-rewards", "'%s' = 2" % transition)
    page.click("button:has-text('Reward per second')")
    page.wait_for_selector("#answers dt:has-text('Reward')")


def test_home_states_say_which_counters_they_are_told_without(show_net, open_page):
    net = (
        NetBuilder("counting")
        .place("up", tokens=1)
        .place("down")
        .place("failures")
        .exponential("fail", inputs="up", outputs=["down", "failures"])
        .exponential("repair", inputs="down", outputs="up")
        .build()
    )
    page = open_page(show_net(net).address)
    page.keyboard.press("3")
    page.click("summary:has-text('Settings')")
    page.fill("#an-limit", "2000")  # the counter has no bound
    page.click("button:has-text('State space')")
    analysed(page)
    page.wait_for_selector("dt:has-text('Reversible') + dd:has-text('no (without failures: yes)')")
    page.wait_for_selector("dt:has-text('Home states') + dd:has-text('2 (without failures)')")


@pytest.fixture(name="open_long_analysis")
def _open_long_analysis(show_net, open_page, monkeypatch):
    """A site, and a page whose state space takes most of a minute."""
    # the limit that ships is reached in two seconds
    monkeypatch.setattr(analysis_jobs, "MOST_STATES", 10**9)
    site = show_net(kanban(7))
    page = open_page(site.address)
    page.keyboard.press("3")
    page.click("summary:has-text('Settings')")
    page.fill("#an-limit", str(10**9))
    yield site, page
    site.server._app.extensions["gspn_jobs"].close()


def test_a_long_analysis_shows_progress_and_is_cancelled(open_long_analysis):
    site, page = open_long_analysis
    page.click("button:has-text('State space')")
    page.wait_for_selector("#an-cancel")
    page.wait_for_selector("#analysis:has-text(' states')")
    page.click("#an-cancel")
    page.wait_for_selector("[data-state='cancelled']")
    jobs = site.server._app.extensions["gspn_jobs"]
    assert not any(job.running for job in jobs._jobs.values()) or _ends(jobs)


def _ends(jobs):
    for job in jobs._jobs.values():
        job._process.wait(5)
    return True


def test_an_analysis_is_cancelled_before_it_has_begun(open_long_analysis):
    _, page = open_long_analysis

    def cancel_first(route):
        page.click("#an-cancel")
        route.continue_()

    page.route("**/api/analysis?*", cancel_first)
    page.click("button:has-text('State space')")
    page.wait_for_selector("[data-state='cancelled']")


def test_an_analysis_has_limits_on_states_and_time(open_long_analysis):
    _, page = open_long_analysis
    page.fill("#an-limit", "500")
    page.click("button:has-text('State space')")
    analysed(page)
    page.wait_for_selector("#answers:has-text('not decided within')")
    page.fill("#an-limit", str(10**9))
    page.fill("#an-seconds", "1")
    page.click("button:has-text('State space')")
    page.wait_for_selector("[data-state='failed']:has-text('not decided within 1 s')")


def test_a_net_is_uploaded_simulated_and_never_executed(serve_folder, open_page, tmp_path):
    write_net(flawed(), tmp_path / "mine.xml")
    (tmp_path / "empty").mkdir()
    page = open_page(serve_folder(tmp_path / "empty").address, ready=False)
    page.wait_for_selector("#opening:has-text('There is no net')")
    page.set_input_files("#chooser", str(tmp_path / "mine.xml"))
    page.wait_for_selector("body[data-mode='SIMULATE'][data-ready]")
    assert page.inner_text("#title") == "flawed" or page.inner_text("#subtitle") == "mine.xml"
    assert page.is_hidden("#start")
    page.click("#step")
    settle(page, 1)


def test_a_broken_upload_says_what_is_wrong_and_is_chosen_again_when_mended(
    serve_folder, open_page, tmp_path
):
    file = tmp_path / "mine.xml"
    file.write_text("<pnml><net>")
    page = open_page(serve_folder().address, ready=False, expect_errors=True)
    page.wait_for_selector("#chooser", state="attached")
    page.set_input_files("#chooser", str(file))
    page.wait_for_selector("#opening-wrong:has-text('mine.xml')")
    # or the browser would report no change
    page.wait_for_function("() => document.querySelector('#chooser').value === ''")
    write_net(flawed(), file)
    page.set_input_files("#chooser", str(file))
    page.wait_for_selector("body[data-ready]")
    # another one is looked for, and back is the way back
    key = page.evaluate("() => location.hash")
    page.keyboard.press("o")
    page.wait_for_selector("#opening button")
    page.go_back()
    page.wait_for_selector("body[data-ready]")
    assert page.evaluate("() => location.hash") == key


def test_by_keyboard_alone(serve_folder, open_page):
    site = serve_folder()
    page = open_page(site.address, ready=False)
    page.wait_for_selector("#opening button")
    for _ in range(40):
        if page.evaluate("() => document.activeElement.textContent.includes('measure/plan.json')"):
            break
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_selector("body[data-ready]")
    page.keyboard.press("/")
    page.keyboard.type("T1")
    page.keyboard.press("ArrowDown")
    assert page.evaluate("() => document.activeElement.id") == "list"
    page.keyboard.press("ArrowDown")
    page.wait_for_selector("#inspector h2:has-text('T1')")
    page.keyboard.press("Shift+Enter")
    settle(page, 1)
    assert site.session("file-measure/plan.json").hub.board().counts[0] == 1
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Escape")
    page.keyboard.press("3")
    page.focus("#tab-analysis")
    page.keyboard.press("ArrowLeft")
    assert page.get_attribute("#tab-robots", "aria-selected") == "true"
    page.focus("#start")
    page.keyboard.press("Enter")
    page.wait_for_selector("dialog[open]")
    page.keyboard.press("Escape")
    page.wait_for_selector("dialog:not([open])", state="attached")
    assert page.get_attribute("body", "data-mode") == "SIMULATE"


def test_everything_has_a_name_for_a_screen_reader(serve_folder, open_page):
    page = open_page(serve_folder().address + "#file-measure%2Fplan.json")
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, canvas, [role]")].filter((e) => {
        if (e.closest("[hidden]") || e.getAttribute("role") === "presentation") return false;
        const label = e.labels && e.labels.length;
        return !(e.getAttribute("aria-label") || e.getAttribute("aria-labelledby") || e.textContent.trim() || label
          || e.getAttribute("title")); }).map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert nameless == []


def test_a_theme_is_chosen_and_kept(show_net, open_page):
    page = open_page(show_net(flawed()).address)
    assert page.get_attribute("html", "data-theme") == "light"
    page.click("#theme")
    assert page.get_attribute("html", "data-theme") == "dark"
    page.reload()
    page.wait_for_selector("body[data-ready]")
    assert page.get_attribute("html", "data-theme") == "dark"
