"""What the page costs a team of robots at full speed (plans/tokens, actions that return at once).

One run; the page comes and goes in it, so that windows without it and windows with it alternate. Firings are counted
from the robots' logs afterwards, whose monotonic clock all processes of one host share. Processors are dealt out so
that the browser never takes one from the robots: it is another computer's. Beside that, firings per second of
processor time *of the robots* are told, a figure that does not depend on what else uses the processors.
"""

from __future__ import annotations

import contextlib
import glob
import os
import signal
import socket
import statistics
import subprocess
import sys
import time
from typing import Any, Callable, Dict, FrozenSet, Iterator, List, NamedTuple, Tuple

import psutil

from gspn_framework_package.benchmark.page.rendering import SCREEN, chromium
from gspn_framework_package.benchmark.plans import tokens_plan
from gspn_framework_package.benchmark.processes import cpu_seconds, descendants
from gspn_framework_package.benchmark.team_run import Master, TeamRun, need_ros
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.model.errors import ExecutionError, UsageError

ARRANGEMENTS = {
    "apart": "the page's server and the browser on another processor than the robots, as on the operator's computer",
    "beside": "the page's server on the robots' processor, the browser on another",
    "shared": "everything on all processors",
}

SETTLE = 3.0
"""Seconds after the page has come or gone, before a window begins."""

START = 60.0

COUNT = """() => {
  window.fired = window.marks = 0;
  window.gspn.model.addEventListener("events", ({ detail }) => {
    for (const e of detail.events) { if (e.k === "fire") window.fired += 1; if (e.k === "mark") window.marks += 1; }
  });
}"""


class Window(NamedTuple):
    """A stretch of the run: monotonic times, and processor seconds spent meanwhile."""

    began: float
    ended: float
    robots_cpu: float
    server_cpu: float = 0.0
    browser_cpu: float = 0.0
    seen: int = 0
    marks: int = 0


def measure_team(robots: int, where: str, rounds: int, seconds: float) -> Dict[str, Any]:
    """Firings a second without and with the page and a viewer, in turns.

    :param where: a key of :data:`ARRANGEMENTS`.
    :param rounds: windows with the page; there is one more without.
    :param seconds: length of a window.
    """
    need_ros()
    team_cpus, server_cpus, browser_cpus = _processors(where)
    plan = tokens_plan(instant=True).for_robots(robots)
    without: List[Window] = []
    with_page: List[Window] = []
    with _on(browser_cpus), chromium() as browser, _on(team_cpus), Master() as master, TeamRun(master, plan) as run:
        if not run.wait_all_fired(START):
            raise ExecutionError("not all robots fired within %g s" % START)
        others = {p.pid for p in descendants(master.pid)} | {master.pid} | _browser_pids()
        team = [p for p in descendants(os.getpid()) if p.pid not in others and "executor" in " ".join(p.cmdline())]
        for _ in range(rounds):
            without.append(_window(seconds, team))
            with _on(server_cpus):
                server = _Server(master, run.folder, robots)
            try:
                with_page.append(_watched(server, browser, team, seconds))
            finally:
                server.end()
        without.append(_window(seconds, team))
        faults = run.faults()
        goals = _goals(run.folder)
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
    """Processes that are started meanwhile run on these processors."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cpus)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


class _Server:
    """The node ``visualizer`` of the run."""

    def __init__(self, master: Master, plan: str, robots: int) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = int(probe.getsockname()[1])
        command = [sys.executable, "-m", "gspn_framework_package.visualizer.ros_node",
                   "_plan:=" + plan, "_robots:=%d" % robots, "_port:=%d" % self.port]  # fmt: skip
        self._process = subprocess.Popen(command, env=master.environment, stdin=subprocess.DEVNULL,
                                         stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)  # fmt: skip
        assert self._process.stdout
        if "The page is at" not in self._process.stdout.readline():
            self.end()
            raise ExecutionError("the page's node did not start")

    def cpu(self) -> float:
        """Processor seconds so far."""
        return sum(cpu_seconds([psutil.Process(self._process.pid)]).values())

    def end(self) -> None:
        """End it, and wait until it has gone."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(15)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def _watched(server: _Server, browser: Any, team: List[psutil.Process], seconds: float) -> Window:
    """A window with the page open."""
    page = browser.new_page(viewport=SCREEN)
    try:
        page.goto("http://127.0.0.1:%d/" % server.port)
        page.wait_for_selector("body[data-ready]", timeout=START * 1000)
        page.wait_for_function("() => window.gspn.model.board.n > 50", timeout=START * 1000)
        page.evaluate(COUNT)
        before: Dict[str, float] = {}

        def spent() -> Tuple[float, float, int, int]:
            fired, marks = page.evaluate("() => [window.fired, window.marks]")
            return server.cpu(), sum(cpu_seconds(_browser()).values()), fired, marks

        def begin() -> None:
            before.update(zip("sbfm", spent()))

        window = _window(seconds, team, begin)
        server_cpu, browser_cpu, fired, marks = spent()
        return window._replace(
            server_cpu=server_cpu - before["s"],
            browser_cpu=browser_cpu - before["b"],
            seen=int(fired - before["f"]),
            marks=int(marks - before["m"]),
        )
    finally:
        page.close()


def _window(seconds: float, team: List[psutil.Process], begin: Callable[[], None] = lambda: None) -> Window:
    time.sleep(SETTLE)
    begin()
    began, before = time.monotonic(), sum(cpu_seconds(team).values())
    time.sleep(seconds)
    ended, after = time.monotonic(), sum(cpu_seconds(team).values())
    return Window(began, ended, after - before)


def _browser() -> List[psutil.Process]:
    found = []
    for process in descendants(os.getpid()):
        with contextlib.suppress(psutil.Error):
            if "chrom" in " ".join(process.cmdline()[:1]) or "playwright" in " ".join(process.cmdline()[:1]):
                found.append(process)
    return found


def _browser_pids() -> set[int]:
    return {process.pid for process in _browser()}


def _goals(folder: str) -> List[float]:
    """Monotonic times at which robots entered places: a firing of this plan moves one robot."""
    times = []
    for path in glob.glob(os.path.join(folder, "*", "*.jsonl")):
        times += [float(r["mono"]) for r in read_log(path, os.path.getsize(path)).records if r["kind"] == "goal"]
    return times


def _compared(goals: List[float], without: List[Window], with_page: List[Window]) -> Dict[str, Any]:
    def firings(window: Window) -> int:
        return sum(1 for at in goals if window.began <= at < window.ended)

    def per_second(window: Window) -> float:
        return firings(window) / (window.ended - window.began)

    def per_cpu(window: Window) -> float:
        return firings(window) / max(window.robots_cpu, 1e-9)

    def slower(rate: Callable[[Window], float]) -> List[float]:
        """Percent, for each window with the page, against the mean of the windows before and after it."""
        return [
            100 * (1 - rate(window) / ((rate(before) + rate(after)) / 2))
            for before, window, after in zip(without, with_page, without[1:])
        ]

    def told(values: List[float]) -> Dict[str, float]:
        error = statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else float("nan")
        return {"mean": round(statistics.mean(values), 2), "standard_error": round(error, 2)}

    length = sum(w.ended - w.began for w in with_page)
    return {
        "firings_per_s_without": [round(per_second(w), 1) for w in without],
        "firings_per_s_with": [round(per_second(w), 1) for w in with_page],
        "slower_percent": told(slower(per_second)),
        "firings_per_robot_cpu_s_without": [round(per_cpu(w), 1) for w in without],
        "firings_per_robot_cpu_s_with": [round(per_cpu(w), 1) for w in with_page],
        "slower_per_robot_cpu_percent": told(slower(per_cpu)),
        "server_cpu_of_core_percent": round(100 * sum(w.server_cpu for w in with_page) / length, 1),
        "browser_cpu_of_core_percent": round(100 * sum(w.browser_cpu for w in with_page) / length, 1),
        "seen_on_the_page_per_s": round(sum(w.seen for w in with_page) / length, 1),
        "resynchronised": sum(w.marks for w in with_page),
    }
