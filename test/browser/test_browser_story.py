"""The story of a run in a browser: its tab, the moments that it leads to, and its report."""

import json
from pathlib import Path

import pytest
from page_reading import resize, settle

from gspn_framework_package.cli.main import main
from gspn_framework_package.formats.example_plans import plans_folder


@pytest.fixture(name="folder")
def _folder(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    arguments = ["--time", "60", "--seed", "7", "--log", str(folder / "run.jsonl")]
    assert main(["simulate", plans_folder() + "/warehouse", *arguments]) == 0
    return folder


def _read(page):
    page.wait_for_selector("#position:not(:has-text('reading the log:'))")


def test_a_story_leads_to_its_moments(serve_folder, open_page, folder, axe, capsys):
    capsys.readouterr()
    assert main(["report", str(folder / "run.jsonl"), "--json", "--most", "200"]) == 0
    story = json.loads(capsys.readouterr().out)
    site = serve_folder(folder)
    page = open_page(site.address + "#file-run.jsonl")
    _read(page)
    page.keyboard.press("5")
    page.wait_for_selector(".story-list li.wait")
    assert page.locator(".story-awaited tbody tr").count() == len(story["waited_for"])
    assert page.locator(".story-list li").count() == len(story["waits"]) + len(story["moments"])
    axe(page, "story", "right")
    resize(page, 1440, 900)
    page.click("[data-kind='wait']")
    longest = max(story["waits"], key=lambda wait: wait["seconds"])
    row = page.locator(".story-list li", has_text="%s %s" % (longest["robot"], longest["text"]))
    assert page.locator(".story-list li").count() == len(story["waits"])
    row.locator("button").click()
    page.wait_for_function("(t) => Math.abs(gspn.model.board.t - t) < 0.01", arg=longest["t"])
    robot = page.evaluate("(name) => gspn.model.board.robots.get(name)", longest["robot"])
    assert robot["phase"] == "done" and robot["why"]
    place = page.evaluate("(robot) => gspn.model.scene.places[robot.place].name", robot)
    assert place == longest["place"]
    assert page.get_attribute("#tab-story", "aria-selected") == "true"
    page.wait_for_selector("#list li[aria-selected='true']:has-text('%s')" % place)


def test_one_address_shows_a_moment(serve_folder, open_page, folder):
    site = serve_folder(folder)
    page = open_page(site.address + "#file-run.jsonl")
    _read(page)
    page.evaluate("() => gspn.model.show(250)")
    settle(page, 250)
    page.click("#link-moment")
    page.wait_for_function("() => /&t=[0-9.]+$/.test(location.hash)")
    last = page.evaluate(
        "() => Math.max(...gspn.model.events.filter(({ t }) => t <= gspn.model.board.t).map(({ n }) => n))"
    )
    again = open_page(page.url)
    settle(again, last)
    page.evaluate("() => gspn.model.show(0)")
    settle(page, 0)
    page.evaluate(
        "(hash) => { location.hash = hash; }", again.evaluate("() => location.hash") + "0"
    )
    settle(page, last)


def test_the_report_is_sent_as_one_file(serve_folder, open_page, folder, tmp_path):
    site = serve_folder(folder)
    page = open_page(site.address + "#file-run.jsonl")
    page.click("#tab-story")
    with page.expect_download() as download:
        page.click(".story-head a:has-text('Report')")
    path = tmp_path / "report.html"
    download.value.save_as(path)
    alone = open_page(Path(path).as_uri(), ready=False)
    assert alone.inner_text("h1") == "Run warehouse"
    assert alone.locator("rect.waiting").count() > 0
    assert site.address in alone.locator("a").first.get_attribute("href")


def test_a_net_without_a_run_says_that_it_has_no_story(serve_folder, open_page):
    page = open_page(serve_folder().address + "#file-tokens/instant.json", expect_errors=True)
    page.click("#tab-story")
    page.wait_for_selector("#story:has-text('no log of a run')")


def test_the_tabs_stay_in_one_line(serve_folder, open_page, folder):
    page = open_page(serve_folder(folder).address + "#file-run.jsonl")
    for width in (1920, 1440, 1280, 1024):
        resize(page, width, 800)
        tops = page.eval_on_selector_all(
            ".right [role=tab]", "(tabs) => tabs.map((tab) => tab.getBoundingClientRect().top)"
        )
        assert len(set(tops)) == 1, (width, tops)
        hidden = page.evaluate(
            "() => { const tabs = document.querySelector('.right .tablist'); "
            "return tabs.scrollWidth - tabs.clientWidth; }"
        )
        assert hidden <= 0, width


def test_the_story_of_a_run_that_goes_on_is_read_on(serve_folder, open_page):
    page = open_page(serve_folder().address + "#file-tokens/instant.json")
    page.click("#start")
    page.click("#dialog button:has-text('Start')")
    page.wait_for_function("() => gspn.model.mode === 'LIVE' && gspn.model.board.n > 50")
    page.click("#tab-story")
    page.wait_for_selector(".story-head button:has-text('Read on')")
    before = page.evaluate("() => gspn.page.story.story.firings")
    page.click(".story-head button:has-text('Read on')")
    page.wait_for_function("(before) => gspn.page.story.story.firings > before", arg=before)
    page.click("#stop")
    page.click("#dialog button.danger, #dialog button:has-text('Stop')")
