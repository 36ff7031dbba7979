"""The page under load: first render, frames per second, firing to frame; many viewers; memory.

    python3 -m gspn_framework_package.benchmark.page [--nodes 100 1000 5000] [--json]

One process serves a net whose transitions fire at a steady rate; Chromium (headless) shows it, and
tells when each firing was on the screen. Then viewers without a screen follow the same server, and
one of them stops reading.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import math
import random
import socket
import subprocess
import sys
import threading
import time
from typing import Any, Dict, Iterator, List, Sequence, Tuple

from gspn_framework_package.benchmark.machine import describe_machine
from gspn_framework_package.execution.simulator import Simulator
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Net
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.board import Board
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.serving import WebServer
from gspn_framework_package.visualizer.session import Session

CHROMIUM = "/usr/bin/chromium"
FLAGS = [
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-gpu",
    "--force-device-scale-factor=1",
]
SCREEN: Any = {"width": 1440, "height": 900}

MEASURE = """async (seconds) => {
  const { model, page } = window.gspn;
  const waiting = [], delays = [], frames = [];
  model.addEventListener("events", ({ detail }) => { for (const e of detail.events) if (e.w) waiting.push(e.w); });
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


def workshop(nodes: int) -> Net:
    """A net of about ``nodes`` nodes: rings of eight places and eight transitions with two tokens
    each, neighbours joined by a shared place. The rings are drawn as rings, side by side."""
    net = NetBuilder("workshop_%d" % nodes)
    rings = max(1, nodes // 17)
    columns = math.ceil(math.sqrt(1.6 * rings))

    def at(ring: int, step: float, radius: float = 190.0) -> Tuple[float, float]:
        angle = 2 * math.pi * step / 8
        row, column = divmod(ring, columns)
        return (
            round(480 * column + radius * math.cos(angle), 1),
            round(480 * row + radius * math.sin(angle), 1),
        )

    for r in range(rings):
        for i in range(8):
            net.place("r%d_p%d" % (r, i), tokens=2 if i == 0 else 0, position=at(r, i))
        net.place("r%d_tool" % r, tokens=1, position=at(r, 0, 0.0))
    for r in range(rings):
        for i in range(8):
            where = at(r, i + 0.5)
            inputs, outputs = ["r%d_p%d" % (r, i)], ["r%d_p%d" % (r, (i + 1) % 8)]
            if i == 2:
                inputs.append("r%d_tool" % r)
            if i == 4:
                outputs.append("r%d_tool" % ((r + 1) % rings))
            if i == 6:
                net.immediate("r%d_t%d" % (r, i), inputs=inputs, outputs=outputs, position=where)
            else:
                net.exponential(
                    "r%d_t%d" % (r, i), inputs=inputs, outputs=outputs, position=where
                )
    return net.build()


class Feed(Activity):
    """Fires at a steady rate; each firing carries the wall clock (ms) as ``w``."""

    mode = "LIVE"

    def __init__(self, net: Net, rate: float) -> None:
        super().__init__()
        self._simulator = Simulator(net, source=random.Random(1))
        self._net, self._rate = net, rate
        self._stop = threading.Event()

    def begin(self, hub: Hub) -> None:
        """Start firing."""
        board = Board(
            len(self._net.transitions),
            self._simulator.marking,
            self._simulator.enabled.now,
            {"running": True},
        )
        hub.restart(self.mode, board, {"says": "a benchmark"})
        threading.Thread(target=self._fire, args=(hub,), daemon=True).start()

    def end(self) -> None:
        """Stop firing."""
        self._stop.set()

    def _fire(self, hub: Hub) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            firing = self._simulator.step()
            if firing is None:
                return
            change = self._simulator.change
            hub.publish(
                {
                    "k": "fire",
                    "tr": firing.transition,
                    "who": "",
                    "d": [list(pair) for pair in self._net.effect(firing.transition)],
                    "m": [],
                    "en": list(change.added),
                    "dis": list(change.removed),
                    "w": round(time.time() * 1000, 1),
                }
            )
            due += 1 / self._rate
            time.sleep(max(0.0, due - time.monotonic()))


def serve(nodes: int, rate: float, port: int) -> None:
    """Serve the feed until the parent closes this process's stdin."""
    net = workshop(nodes)
    project = Project()
    project.show(Session("feed", Document("feed", net), Feed(net, rate)))
    server = WebServer(project, port=port, viewers=40)
    server.start()
    print("ready", flush=True)
    sys.stdin.read()


@contextlib.contextmanager
def served(nodes: int, rate: float) -> Iterator[Tuple[int, int]]:
    """A server in a process of its own: (port, process id)."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    command = [sys.executable, "-m", __spec__.name, "--feed", str(nodes), str(rate), str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin and process.stdout
        try:
            process.stdout.readline()
            yield port, process.pid
        finally:
            process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(5)
            process.kill()


def measure_page(nodes: int, rate: float, seconds: float) -> Dict[str, Any]:
    """First render (ms), frames per second, 95th percentile of firing to frame (ms)."""
    from playwright.sync_api import sync_playwright

    with served(nodes, rate) as (port, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        address = "http://127.0.0.1:%d/" % port
        renders = []
        for _ in range(3):
            page = browser.new_page(viewport=SCREEN)
            page.goto(address)
            page.wait_for_selector("body[data-ready]", timeout=60_000)
            renders.append(float(page.evaluate("document.body.dataset.ready")))
            if len(renders) < 3:
                page.close()
        page.wait_for_timeout(2000)
        before = _browser_seconds()
        found = page.evaluate(MEASURE, seconds)
        busy = _browser_seconds() - before
        browser.close()
    frames = found["frames"]
    return {
        "nodes": nodes,
        "first_render_ms": sorted(renders)[1],
        "frames_per_second": round((len(frames) - 1) / (frames[-1] - frames[0]) * 1000, 1),
        "browser_cpu_per_frame_ms": round(1000 * busy / len(frames), 1),
        "longest_frame_ms": round(max(b - a for a, b in zip(frames, frames[1:])), 1),
        "firings": len(found["delays"]),
        "firing_to_frame_p50_ms": round(percentile(found["delays"], 50), 1),
        "firing_to_frame_p95_ms": round(percentile(found["delays"], 95), 1),
    }


def _browser_seconds() -> float:
    """Processor time of all of the browser's processes so far: unlike frames per second, it does not depend on
    what else the machine does."""
    import psutil

    total = 0.0
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if "chrom" in " ".join(process.cmdline()[:1]):
                times = process.cpu_times()
                total += times.user + times.system
    return total


def follow(port: int, seconds: float, out: List[Dict[str, Any]]) -> None:
    """A viewer without a screen: reads the stream, counts gaps and delays."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", "/api/stream?id=feed")
    stream = connection.getresponse()
    seen, gaps, delays = -1, 0, []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        line = stream.readline()
        if not line.startswith(b"data: {"):
            continue
        news = json.loads(line[6:])
        now = time.time() * 1000
        if "snapshot" in news:
            gaps += seen >= 0
            seen = news["snapshot"]["board"]["n"]
        for event in news.get("events", ()):
            gaps += event["n"] != seen + 1
            seen = event["n"]
            delays.append(now - event["w"])
    connection.close()
    out.append({"gaps": gaps, "delays": delays})


def measure_viewers(viewers: int, rate: float, seconds: float) -> Dict[str, Any]:
    """Many viewers at once: gaps, and the 95th percentile of firing to arrival (ms)."""
    found: List[Dict[str, Any]] = []
    with served(1000, rate) as (port, _):
        threads = [
            threading.Thread(target=follow, args=(port, seconds, found)) for _ in range(viewers)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    delays = [d for viewer in found for d in viewer["delays"]]
    return {
        "viewers": len(found),
        "events_per_second": rate,
        "events_received": len(delays),
        "gaps": sum(viewer["gaps"] for viewer in found),
        "arrival_p50_ms": round(percentile(delays, 50), 1),
        "arrival_p95_ms": round(percentile(delays, 95), 1),
    }


def measure_memory(events: int, rate: float) -> Dict[str, Any]:
    """Resident memory of the server (MB) over many events, with a viewer that does not read."""
    import psutil

    with served(1000, rate) as (port, pid), socket.socket() as stalled:
        stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stalled.connect(("127.0.0.1", port))
        request = "GET /api/stream?id=feed HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % port
        stalled.sendall(request.encode())
        samples: List[Tuple[int, float]] = []
        while not samples or samples[-1][0] < events:
            time.sleep(1.0)
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
            connection.request("GET", "/api/state?id=feed&at=999999999")
            n = json.loads(connection.getresponse().read())["board"]["n"]
            connection.close()
            samples.append((n, psutil.Process(pid).memory_info().rss / 1e6))
    marks = [next(s for s in samples if s[0] >= events * share) for share in (0.25, 0.5, 0.75, 1)]
    return {"events": samples[-1][0], "memory_mb": [[n, round(mb, 1)] for n, mb in marks]}


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which ``share`` percent of ``values`` are."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * share / 100))] if ordered else 0.0


def main() -> int:
    """Measure, and print what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nodes", type=int, nargs="+", default=[100, 1000, 5000])
    parser.add_argument("--rate", type=float, default=100.0, help="firings a second")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--events", type=int, default=100_000, help="0: memory is not measured")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--feed", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.feed:
        serve(int(args.feed[0]), float(args.feed[1]), int(args.feed[2]))
        return 0
    result: Dict[str, Any] = {"machine": describe_machine(("flask", "waitress", "playwright")), "page": []}
    for nodes in args.nodes:
        result["page"].append(measure_page(nodes, args.rate, args.seconds))
        if not args.json:
            print(json.dumps(result["page"][-1]), flush=True)
    if args.viewers:
        result["viewers"] = measure_viewers(args.viewers, args.rate, args.seconds)
        if not args.json:
            print(json.dumps(result["viewers"]), flush=True)
    if args.events:
        result["memory"] = measure_memory(args.events, 2000.0)
        if not args.json:
            print(json.dumps(result["memory"]), flush=True)
    print(json.dumps(result if args.json else result["machine"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
