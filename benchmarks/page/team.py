"""The cost of the page to a team of robots at full speed (plans/tokens, actions that return at
once).

The page is opened and closed repeatedly during one run, so that windows without it and windows with
it alternate. Firings are counted afterwards from the robots' logs, whose monotonic clock all
processes of one host share.

The browser is not measured, since it would run on another computer. So it has its own processor,
and its share is excluded: in the windows *without* the page the same browser shows another page, of
a feed that fires as often as the team does. The benchmark also reports firings per second of
processor time *of the robots*, a figure that does not depend on what else uses their processor.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import sys
import time
from typing import Any, Callable, Dict, FrozenSet, Iterator, List, NamedTuple, Optional, Tuple

import psutil

from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.ports import free_port
from benchmarks.harness.processes import cpu_seconds, descendants
from benchmarks.harness.team import LaunchedTeam
from benchmarks.page.feed import served
from benchmarks.page.rendering import SCREEN, chromium
from benchmarks.plans import INSTANT, tokens_plan
from gspn_framework_package.model.errors import UsageError

ARRANGEMENTS = {
    "apart": "the page's server and the browser on another processor than the robots, as on the "
    "operator's computer",
    "beside": "the page's server on the robots' processor, the browser on another",
    "shared": "everything on all processors",
}

SETTLE = 2.0
"""Seconds between opening a page and the start of a window."""

NODES = 17
"""Size of the net that the browser shows instead, equal to that of plans/tokens."""

START = 60.0

COUNT = """() => {
  window.fired = window.marks = 0;
  window.gspn.model.addEventListener("events", ({ detail }) => {
    for (const e of detail.events) {
      if (e.k === "fire") window.fired += 1;
      if (e.k === "mark") window.marks += 1;
    }
  });
}"""


class Window(NamedTuple):
    """A stretch of the run: monotonic times, and processor seconds spent meanwhile."""

    began: float
    ended: float
    robots_cpu: float
    server_cpu: float
    browser_cpu: float
    seen: int
    marks: int


def measure_team(robots: int, where: str, rounds: int, seconds: float) -> Dict[str, Any]:
    """Firings per second without and with the page and a viewer, alternately.

    :param where: a key of :data:`ARRANGEMENTS`.
    :param rounds: windows with the page; there is one more without.
    :param seconds: length of a window.
    """
    need_ros()
    team_cpus, server_cpus, browser_cpus = _processors(where)
    plan = tokens_plan(INSTANT).for_robots(robots)
    without: List[Window] = []
    with_page: List[Window] = []
    run = LaunchedTeam(plan)
    with _on(browser_cpus), chromium() as browser, _on(team_cpus), Master(), run:
        run.await_steady(START)
        team = run.processes()
        rate = run.measure(seconds).firings_per_s
        with _on(browser_cpus), served(NODES, rate) as feed:
            for _ in range(rounds):
                without.append(_watched(feed.port, None, browser, team, seconds))
                with _on(server_cpus):
                    port = _start_page(run)
                server = psutil.Process(run.programs.pid(PAGE))
                with_page.append(_watched(port, server, browser, team, seconds))
                run.programs.stop(PAGE)
            without.append(_watched(feed.port, None, browser, team, seconds))
        faults = run.programs.errors("launch")
        goals = [goal["mono"] for log in run.read().values() for goal in log.of("goal")]
    return {
        "robots": robots,
        "where": where,
        "means": ARRANGEMENTS[where],
        "seconds": seconds,
        **_compared(goals, without, with_page),
        "faults": len(faults),
    }


def _processors(where: str) -> Tuple[FrozenSet[int], FrozenSet[int], FrozenSet[int]]:
    """Processors of the team, of the page's server, and of the browser."""
    mine = sorted(os.sched_getaffinity(0))
    if where == "shared":
        return (frozenset(mine),) * 3
    if len(mine) < 2:
        raise UsageError("a single processor cannot be dealt out", hint="--where shared")
    team, other = frozenset(mine[:-1]), frozenset(mine[-1:])
    return team, other if where == "apart" else team, other


@contextlib.contextmanager
def _on(cpus: FrozenSet[int]) -> Iterator[None]:
    """Run the processes started during the ``with`` block on these processors."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cpus)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


PAGE = "page"


def _start_page(team: LaunchedTeam) -> int:
    """Start the node ``visualizer`` of the run; returns its port."""
    port = free_port()
    module = "gspn_framework_package.visualizer.ros_node"
    words = ["_plan:=" + team.folder, "_robots:=%d" % len(team.robots), "_port:=%d" % port]
    team.programs.start(PAGE, [sys.executable, "-m", module, *words])
    team.programs.await_port(PAGE, port)
    return port


def _watched(
    port: int,
    server: Optional[psutil.Process],
    browser: Any,
    team: List[psutil.Process],
    seconds: float,
) -> Window:
    """A window in which the browser shows a page: that of the team, or another one (``server`` is
    None)."""
    page = browser.new_page(viewport=SCREEN)
    try:
        page.goto("http://127.0.0.1:%d/" % port)
        page.wait_for_selector("body[data-ready]", timeout=START * 1000)
        page.wait_for_function("() => window.gspn.model.board.n > 50", timeout=START * 1000)
        page.evaluate(COUNT)
        time.sleep(SETTLE)

        def spent() -> List[float]:
            return [
                time.monotonic(),
                sum(cpu_seconds(team).values()),
                sum(cpu_seconds([server] if server else []).values()),
                sum(cpu_seconds(_browser()).values()),
                *page.evaluate("() => [window.fired, window.marks]"),
            ]

        before = spent()
        time.sleep(seconds)
        after = spent()
    finally:
        page.close()
    _, robots_cpu, server_cpu, browser_cpu, seen, marks = (b - a for a, b in zip(before, after))
    return Window(before[0], after[0], robots_cpu, server_cpu, browser_cpu, int(seen), int(marks))


def _browser() -> List[psutil.Process]:
    found = []
    for process in descendants(os.getpid()):
        with contextlib.suppress(psutil.Error):
            if "chrom" in " ".join(process.cmdline()[:1]) or "playwright" in " ".join(
                process.cmdline()[:1]
            ):
                found.append(process)
    return found


def _compared(goals: List[float], without: List[Window], with_page: List[Window]) -> Dict[str, Any]:
    def firings(window: Window) -> int:
        return sum(1 for at in goals if window.began <= at < window.ended)

    def per_second(window: Window) -> float:
        return firings(window) / (window.ended - window.began)

    def per_cpu(window: Window) -> float:
        return firings(window) / max(window.robots_cpu, 1e-9)

    def slower(rate: Callable[[Window], float]) -> List[float]:
        """The slowdown (%) of each window with the page against the mean of the windows before and
        after it."""
        return [
            100 * (1 - rate(window) / ((rate(before) + rate(after)) / 2))
            for before, window, after in zip(without, with_page, without[1:])
        ]

    def told(values: List[float]) -> Dict[str, float]:
        error = statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else float("nan")
        return {"mean": round(statistics.mean(values), 2), "standard_error": round(error, 2)}

    def of_core(cpu: Callable[[Window], float], windows: List[Window]) -> float:
        return round(100 * sum(map(cpu, windows)) / sum(w.ended - w.began for w in windows), 1)

    length = sum(w.ended - w.began for w in with_page)
    return {
        "firings_per_s_without": [round(per_second(w), 1) for w in without],
        "firings_per_s_with": [round(per_second(w), 1) for w in with_page],
        "slower_percent": told(slower(per_second)),
        "firings_per_robot_cpu_s_without": [round(per_cpu(w), 1) for w in without],
        "firings_per_robot_cpu_s_with": [round(per_cpu(w), 1) for w in with_page],
        "slower_per_robot_cpu_percent": told(slower(per_cpu)),
        "server_cpu_of_core_percent": of_core(lambda w: w.server_cpu, with_page),
        "browser_cpu_of_core_percent_without": of_core(lambda w: w.browser_cpu, without),
        "browser_cpu_of_core_percent_with": of_core(lambda w: w.browser_cpu, with_page),
        "seen_on_the_page_per_s": round(sum(w.seen for w in with_page) / length, 1),
        "resynchronised": sum(w.marks for w in with_page),
    }
