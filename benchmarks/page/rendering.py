"""The page in a browser: first render, frames per second, firing to frame."""

from __future__ import annotations

import contextlib
import shutil
from typing import Any, Dict, Iterator, Sequence

import psutil

from benchmarks.page.feed import served

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "chromium-browser"))),
    None,
)
"""The program of the browser, None if there is none. The first is the same engine without windows,
which takes a third less of the processor."""

FLAGS = [
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-gpu",
    "--force-device-scale-factor=1",
]
SCREEN: Any = {"width": 1440, "height": 900}

RENDERS = 5
"""How often the page is opened; the median time to the first render is reported."""

MEASURE = """async (seconds) => {
  const { model, page } = window.gspn;
  const waiting = [], delays = [], frames = [];
  model.addEventListener("events", ({ detail }) => {
    for (const e of detail.events) if (e.w) waiting.push(e.w);
  });
  page.view.addEventListener("frame", () => {
    const now = performance.timeOrigin + performance.now();
    while (waiting.length) delays.push(now - waiting.pop());
  });
  const end = performance.now() + seconds * 1000;
  await new Promise((done) => {
    const tick = (t) => { frames.push(t); if (t < end) requestAnimationFrame(tick); else done(); };
    requestAnimationFrame(tick);
  });
  return { delays, frames };
}"""


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """A headless browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


def measure_page(nodes: int, rate: float, seconds: float) -> Dict[str, Any]:
    """First render (ms), frames per second, 95th percentile of firing to frame (ms).

    The first render is the time from the answer that describes the net to the first frame that
    shows its marking; the whole page load, from the click on a link, is reported as well."""
    with served(nodes, rate) as server, chromium() as browser:
        renders, loads = [], []
        for turn in range(RENDERS):
            page = browser.new_page(viewport=SCREEN)
            page.goto("http://127.0.0.1:%d/" % server.port)
            page.wait_for_selector("body[data-ready]", timeout=60_000)
            renders.append(float(page.evaluate("document.body.dataset.ready")))
            loads.append(float(page.evaluate("window.gspn.page.readyAt")))
            if turn + 1 < RENDERS:
                page.close()
        page.wait_for_timeout(2000)
        before = browser_seconds()
        found = page.evaluate(MEASURE, seconds)
        busy = browser_seconds() - before
    frames = found["frames"]
    return {
        "nodes": nodes,
        "first_render_ms": sorted(renders)[RENDERS // 2],
        "page_load_ms": round(sorted(loads)[RENDERS // 2], 1),
        "frames_per_second": round((len(frames) - 1) / (frames[-1] - frames[0]) * 1000, 1),
        "browser_cpu_per_frame_ms": round(1000 * busy / len(frames), 1),
        "longest_frame_ms": round(max(b - a for a, b in zip(frames, frames[1:])), 1),
        "firings": len(found["delays"]),
        "firing_to_frame_p50_ms": round(percentile(found["delays"], 50), 1),
        "firing_to_frame_p95_ms": round(percentile(found["delays"], 95), 1),
    }


def browser_seconds() -> float:
    """Processor time (s) of all of the browser's processes so far: unlike frames per second, it
    does not depend on what else the machine does."""
    total = 0.0
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if "chrom" in " ".join(process.cmdline()[:1]):
                times = process.cpu_times()
                total += times.user + times.system
    return total


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which ``share`` percent of ``values`` lie."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * share / 100))] if ordered else 0.0
