"""Charts in a browser: values under the pointer and at the keyboard's cursor, zoom, and what is saved."""

import csv

import pytest

from gspn_framework_package.model.builder import NetBuilder


@pytest.fixture(name="chart")
def _chart(show_net, open_page):
    """A page with the tokens of a net over time; the chart."""
    net = (
        NetBuilder("decay")
        .place("Full", tokens=1)
        .place("Empty")
        .exponential("drain", rate=0.5, inputs="Full", outputs="Empty")
        .build()
    )
    page = open_page(show_net(net).address + "#net")
    page.click("#tab-analysis")
    page.click("summary:has-text('How does it evolve?')")
    page.click("button:has-text('Tokens over time')")
    page.wait_for_selector("#answers .chart svg.plot path")
    return page.locator("#answers .chart").first


def _drag(page, box, begin, end):
    y = box["y"] + box["height"] / 3
    page.mouse.move(box["x"] + begin * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + end * box["width"], y, steps=4)
    page.mouse.up()


def _label(chart):
    return chart.locator("svg.plot").get_attribute("aria-label")


def test_the_pointer_reads_values_and_a_drag_zooms(chart):
    page, plot = chart.page, chart.locator("svg.plot")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 40)
    says = chart.locator(".chart-values")
    page.wait_for_function(
        "(says) => says.textContent.includes('Full: ')", arg=says.element_handle()
    )
    values = dict(part.split(": ") for part in says.inner_text().split(" · ")[1:])
    assert float(values["Full"]) + float(values["Empty"]) == pytest.approx(1.0, abs=2e-3)
    assert plot.locator(".cursor").count() == 1
    whole = _label(chart)
    _drag(page, box, 0.3, 0.6)
    assert _label(chart).startswith(whole + ", from ")
    plot.dblclick(position={"x": 100, "y": 40})
    assert _label(chart) == whole


def test_the_keyboard_does_the_same(chart):
    page = chart.page
    chart.locator("svg.plot").focus()
    whole = _label(chart)
    for _ in range(10):
        page.keyboard.press("ArrowRight")
    assert chart.locator(".chart-values").inner_text().startswith("time (s) 4 · ")
    page.wait_for_selector("#announce:has-text('time (s) 4')", state="attached")
    page.keyboard.press("+")
    assert ", from 0 to 9" in _label(chart)
    page.keyboard.press("Escape")
    assert _label(chart) == whole


def test_values_and_the_picture_are_saved(chart, tmp_path):
    page = chart.page
    with page.expect_download() as table:
        chart.locator("button:has-text('CSV')").click()
    table.value.save_as(tmp_path / "chart.csv")
    heads, *rows = csv.reader((tmp_path / "chart.csv").read_text().splitlines())
    assert heads[0] == "time (s)" and set(heads[1:]) == {"Full", "Empty"} and len(rows) == 60
    assert float(rows[0][1 + heads[1:].index("Full")]) == 1.0
    with page.expect_download() as picture:
        chart.locator("button:has-text('SVG')").click()
    picture.value.save_as(tmp_path / "chart.svg")
    text = (tmp_path / "chart.svg").read_text()
    assert text.startswith("<svg") and text.count("<path") == 2 and "rgb(" in text
