"""The Optimise tab: the form, the answer painted on the net, and the plan that is saved or not."""

import json

import pytest
from page_reading import resize, settle
from shop import write_shop

from gspn_framework_package.formats.plan_file import read_plan

VIEWER, OPERATOR = "v" * 16, "o" * 16

MARKS = """() => Object.fromEntries([...document.querySelectorAll("#net .transition, #net .place")].map((g) => [
  g.querySelector("title").textContent,
  [[...g.classList].filter((c) => c.startsWith("paint-")).join(), g.querySelector(".value")?.textContent || ""].join("|")])
  .filter(([, mark]) => mark !== "|"))"""


@pytest.fixture(name="shop")
def _shop(serve_folder, tmp_path):
    """The address of a server whose folder has a plan with a known best policy, and the folder."""
    folder = tmp_path / "shop"
    folder.mkdir()
    write_shop(folder)
    site = serve_folder(folder, token=OPERATOR, viewer_token=VIEWER)
    return site, folder


def open_shop(open_page, site, token, **options):
    page = open_page(
        "http://127.0.0.1:%d/#token=%s" % (site.server.port, token), ready=False, **options
    )
    page.wait_for_selector("#opening button")
    page.click("#opening button:has-text('plan.json')")
    page.wait_for_selector("body[data-ready]")
    return page


def optimised(page):
    # for less than 5 s
    page.evaluate("() => { document.querySelector('#op-simulated').value = '0.5'; }")
    page.click("#op-start")
    page.wait_for_selector("#optimise [data-state='done']")


def test_a_policy_is_computed_shown_and_saved(shop, open_page, axe, picture):
    site, folder = shop
    page = open_shop(open_page, site, OPERATOR, expect_errors=True, reduced_motion="reduce")
    page.keyboard.press("4")
    page.wait_for_selector("#tab-optimise[aria-selected='true']")
    # what is wrong is said at its field, and goes when the field is changed
    page.click("summary:has-text('Constraints')")
    page.click("#op-never")
    page.keyboard.type("Gone == 1")
    page.focus("#op-start")
    page.keyboard.press("Enter")
    wrong = page.locator("#optimise .entry [aria-invalid='true']")
    page.wait_for_selector("#op-never-0-wrong:has-text(\"no place 'Gone'\")")
    page.wait_for_selector("#op-rewards-0-name-wrong:has-text('choose a place or a transition')")
    assert wrong.count() == 2
    assert page.evaluate("() => document.activeElement.getAttribute('aria-label')") == "Rewarded 1"
    page.select_option("select[aria-label='Rewarded 1']", "fast_done")
    page.fill("input[aria-label='Condition 1']", "Fast + Slow >= 2")
    assert wrong.count() == 0
    page.click("#op-rewards")
    page.select_option("select[aria-label='Rewarded 2']", "slow_done")
    assert page.input_value("input[aria-label='Reward 2']") == "1"
    page.check("#op-may_wait input[value='Choose']")
    with page.expect_request("**/api/analysis?*") as sent:
        optimised(page)
    asked = json.loads(sent.value.post_data)["optimise"]
    assert asked["rewards"] == [
        {"name": "fast_done", "value": "1"},
        {"name": "slow_done", "value": "1"},
    ]
    assert float(asked["simulated"]) == 0.5
    assert asked["may_wait"] == ["Choose"] and asked["never"] == ["Fast + Slow >= 2"]
    text = page.inner_text("#optimised")
    for expected in (
        "1.3333 1/s",
        "2 1/s",
        "+50 %",
        "certified",
        "the policy decides in Choose",
        "Never Fast + Slow >= 2. Robots may wait in Choose. Time as the plan runs.",
    ):
        assert expected in page.locator("#optimised").text_content(), expected
    assert "take_slow" in text
    # a choice of the list, by keyboard: present and best differ in their lines and words
    page.focus("#op-choices")
    page.keyboard.press("ArrowDown")
    painted = {
        "Choose": "paint-mark|",
        "take_fast": "paint-both|present 50 %, best",
        "take_slow": "paint-present|present 50 %",
    }
    assert page.evaluate(MARKS) == painted
    assert page.inner_text("#legend strong") == "When Choose: 1"
    dashes = "(c) => getComputedStyle(document.querySelector(c + ' rect.body')).strokeDasharray"
    assert page.evaluate(dashes, ".paint-present") != "none"
    assert page.evaluate(dashes, ".paint-both") == "none"
    picture(page, "optimise")
    # the marking on display, as it changes
    page.click("#legend button")
    assert page.evaluate(MARKS) == {}
    page.click("#op-follow")
    page.wait_for_selector("#legend:has-text('The marking shown')")
    assert page.evaluate(MARKS) == painted
    page.click("#step")
    settle(page, 1)
    page.wait_for_selector("#optimised p:has-text('No robot has a choice in this marking.')")
    assert page.evaluate(MARKS) == {}
    page.click("#step")
    settle(page, 2)
    page.wait_for_selector("#optimised p:has-text('now take_fast 50 %, take_slow 50 %, best')")
    page.click("#op-follow")
    assert page.evaluate(MARKS) == {}
    page.click("summary:has-text('Policy')")
    page.wait_for_selector(".policy td:has-text('any marking') + td:has-text('take_fast')")
    page.click(".policy button")
    assert page.evaluate(MARKS)["take_fast"] == "paint-best|best"
    axe(page, "the computed policy", "right")
    resize(page, 1280, 720)
    # saved beside the present plan, which stays; another file is only replaced when confirmed
    present = (folder / "plan.json").read_bytes()
    assert page.input_value("#op-name") == "plan_optimised.json"
    page.fill("#op-name", "../plan.json")
    page.click("#op-save")
    page.wait_for_selector("#op-saving.wrong:has-text('not the name of a plan file')")
    page.fill("#op-name", "better.json")
    (folder / "better.json").write_bytes(present)
    page.click("#op-save")
    page.wait_for_selector("dialog[open]:has-text('exists already')")
    page.keyboard.press("Escape")
    page.wait_for_selector("#op-saving:has-text('Nothing was saved')")
    assert (folder / "better.json").read_bytes() == present
    page.click("#op-save")
    page.click("dialog button.danger")
    page.wait_for_selector("#op-saving:has-text('Saved as better.json')")
    assert read_plan(str(folder / "better.json")).policy.rows[0].choices == (("take_fast", 1.0),)
    assert (folder / "plan.json").read_bytes() == present
    # for those who may only look: the latest answer, to download
    viewer = open_shop(open_page, site, VIEWER)
    viewer.keyboard.press("4")
    viewer.wait_for_selector("#optimised:has-text('+50 %')")
    assert viewer.locator("#op-save, #op-start").count() == 0
    with viewer.expect_download() as download:
        viewer.click("#op-download")
    assert json.loads(download.value.path().read_text())["policy"]["rows"]
    page.click("#op-open")
    page.wait_for_selector("#subtitle:has-text('better.json')")


def test_an_answer_is_discarded_and_nothing_is_changed(shop, open_page):
    site, folder = shop
    before = sorted(folder.iterdir())
    page = open_shop(open_page, site, OPERATOR)
    page.keyboard.press("4")
    page.select_option("#op-aim", "time_to")
    assert page.is_hidden("#op-rewards") and page.is_hidden("#op-direction")
    page.fill("#op-goal", "Slow == 1")
    optimised(page)
    page.focus("#op-choices")
    page.keyboard.press("ArrowDown")
    page.click("#op-discard")
    assert page.locator("#optimised > *, .paint-both").count() == 0
    assert page.is_hidden("#legend")
    assert sorted(folder.iterdir()) == before
