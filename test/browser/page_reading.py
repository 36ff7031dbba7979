"""What is to be seen on the page, read from its elements."""

SETTLED = """() => {
  const { page, model } = window.gspn;
  return model.board && page.view.travel.inFlight.size === 0 && page.view.travel.waiting.length === 0
    && !page.view.frame && !page.view.dirty.places.size && !page.view.pending.size && !page.view.labels.timer;
}"""

DOTS = """() => [...document.querySelectorAll("#net .place")].map((g) => {
  const path = g.querySelector("path.dots"), count = g.querySelector("text.count");
  const robots = g.querySelectorAll(".robot").length;
  if (path) return path.getAttribute("d").split("M").length - 1;
  return count ? Number(count.textContent) : robots;
})"""

MARKING = "() => window.gspn.model.board.marking"


def settle(page, n=None):
    """Wait until the page shows event ``n`` (or whatever is the latest) and nothing moves."""
    if n is not None:
        page.wait_for_function(
            "(n) => window.gspn.model.board && window.gspn.model.board.n >= n", arg=n
        )
    page.wait_for_function(SETTLED)


def resize(page, width, height):
    """Give the page a size, and wait until it has taken note: its observers of sizes are called
    between two frames."""
    page.set_viewport_size({"width": width, "height": height})
    page.wait_for_function(
        "([width, height]) => innerWidth === width && innerHeight === height", arg=[width, height]
    )
    page.evaluate(
        "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(null))))"
    )


def dots(page):
    """Tokens drawn in each place."""
    settle(page)
    return page.evaluate(DOTS)


def marking(page):
    """The marking the page knows."""
    return page.evaluate(MARKING)


def enabled(page):
    """Transitions drawn as enabled, by index."""
    settle(page)
    return sorted(
        page.evaluate(
            "() => [...document.querySelectorAll('.transition.enabled')].map((g) => Number(g.dataset.transition))"
        )
    )


def boxes(page, selector):
    """Boxes [x0, y0, x1, y1] of elements, in pixels."""
    return page.evaluate(
        """(selector) => [...document.querySelectorAll(selector)].map((e) => {
          const b = e.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]; })""",
        selector,
    )


def overlaps(found, slack=1.0):
    """Pairs of boxes that lie over each other by more than ``slack`` pixels."""
    pairs = []
    for i, a in enumerate(found):
        for b in found[i + 1 :]:
            if (
                min(a[2], b[2]) - max(a[0], b[0]) > slack
                and min(a[3], b[3]) - max(a[1], b[1]) > slack
            ):
                pairs.append((a, b))
    return pairs
