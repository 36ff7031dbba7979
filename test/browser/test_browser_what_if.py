"""What if, in a browser: sliders move the predicted band, and the page says what it shows."""

from dataclasses import replace

from page_reading import resize

from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.duration import Duration, Evidence
from gspn_framework_package.visualizer import app
from gspn_framework_package.visualizer.what_if import action_means


def _drag(page, name, value):
    page.locator("#wi-" + name).evaluate(
        "(input, value) => { input.value = value; input.dispatchEvent(new Event('input')); }", value
    )


def _pace(page):
    return page.evaluate("() => gspn.page.analysis.whatIf.found.growth['all transitions'][0]")


def test_sliders_move_the_band_and_a_simulation_follows(show_net, open_page, axe, monkeypatch):
    monkeypatch.setattr(app, "EXACT_SECONDS", 60.0)  # however busy the machine is
    monkeypatch.setattr(app, "WHAT_IF_LIMIT", 120.0)
    plan = read_plan(plans_folder() + "/patrol")
    page = open_page(show_net(plan.net, plan).address + "#net")
    page.click("#tab-analysis")
    page.click("summary:has-text('What if?')")
    page.wait_for_selector("details[data-shows='first look'] .plot path.band")
    before = _pace(page)
    assert page.locator("#analysis .plot path.what-if").count() == 0
    for exponent in (0.1, 0.3, 0.5):
        _drag(page, "slower", exponent)
    page.wait_for_selector("#analysis .plot path.what-if")
    assert page.get_attribute("#wi-slower", "aria-valuetext") == "× 3.2"
    page.wait_for_function(
        "(before) => gspn.page.analysis.whatIf.found.growth['all transitions'][0] < 0.5 * before",
        arg=before,
    )
    page.wait_for_selector("details[data-shows='simulated']:has-text('Simulated: ')")
    page.wait_for_selector("details:has-text('Exactly ')")
    assert _pace(page) < 0.5 * before
    _drag(page, "robots", 8)
    page.wait_for_selector("details[data-shows='first look']:has-text('First look: ')")
    page.wait_for_selector("details[data-shows='simulated']")
    page.select_option("#wi-curve", index=1)
    page.wait_for_selector("details:has-text('with the change')")
    axe(page, "what if", "right")
    resize(page, 1440, 900)


def test_the_exact_mean_of_a_learned_plan_is_not_called_exact(show_net, open_page, monkeypatch):
    monkeypatch.setattr(app, "EXACT_SECONDS", 60.0)
    monkeypatch.setattr(app, "WHAT_IF_LIMIT", 120.0)
    plan = read_plan(plans_folder() + "/patrol").for_robots(1)
    times = {place: Duration.exponential(mean) for place, mean in action_means(plan).items()}
    of = {("durations", place): Evidence(40, ("a.jsonl",)) for place in times}
    learned = replace(plan, durations=times, evidence=of)
    page = open_page(show_net(learned.net, learned).address + "#net")
    page.click("#tab-analysis")
    page.click("summary:has-text('What if?')")
    page.wait_for_selector("details[data-shows='first look'] .plot path.band")
    _drag(page, "slower", 0.1)
    page.wait_for_selector("details:has-text('About '):has-text(' ± '):has-text('logs')")
    assert "Exactly" not in page.inner_text("details:has-text('About ')")


def test_a_net_alone_has_no_sliders(show_net, open_page):
    plan = read_plan(plans_folder() + "/patrol")
    page = open_page(show_net(plan.net).address + "#net")
    page.click("#tab-analysis")
    page.wait_for_selector("summary:has-text('Sweep')")
    assert page.locator("summary:has-text('What if?')").count() == 0
