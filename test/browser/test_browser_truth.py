"""What the page shows is so, or is marked as not known."""

from page_reading import dots, marking, settle

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
