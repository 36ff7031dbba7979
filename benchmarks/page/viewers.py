"""Headless viewers: many at once, and one that stalls while the server's memory is measured."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import threading
import time
from typing import Any, Dict, Iterator, List, Tuple

import psutil

from benchmarks.page.feed import KEY, served
from benchmarks.page.rendering import percentile
from gspn_framework_package.visualizer.hub import RING

SAMPLE = 0.1
"""Seconds between two measurements of the memory."""


class Viewer:
    """Reads the stream, and counts what a browser would show.

    :ivar gaps: events that were missing without notice.
    :ivar snapshots: how often the server reported that the viewer fell behind.
    """

    def __init__(self, port: int) -> None:
        self.seen, self.gaps, self.snapshots = -1, 0, 0
        self.delays: List[float] = []
        self.stop = threading.Event()
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)

    def follow(self) -> None:
        """Read until stopped."""
        self._connection.request("GET", "/api/stream?id=" + KEY)
        stream = self._connection.getresponse()
        while not self.stop.is_set():
            line = stream.readline()
            if line.startswith(b"data: {"):
                self._take(json.loads(line[6:]), time.time() * 1000)
        self._connection.close()

    def _take(self, news: Dict[str, Any], now: float) -> None:
        if "snapshot" in news:
            self.snapshots += self.seen >= 0
            self.seen = news["snapshot"]["board"]["n"]
        for event in news.get("events", ()):
            self.gaps += event["n"] != self.seen + 1
            self.seen = event["n"]
            self.delays.append(now - event["w"])


@contextlib.contextmanager
def following(port: int, count: int) -> Iterator[List[Viewer]]:
    """``count`` viewers, each on a thread."""
    viewers = [Viewer(port) for _ in range(count)]
    threads = [threading.Thread(target=viewer.follow) for viewer in viewers]
    for thread in threads:
        thread.start()
    try:
        yield viewers
    finally:
        for viewer in viewers:
            viewer.stop.set()
        for thread in threads:
            thread.join()


def measure_viewers(viewers: int, rate: float, seconds: float) -> Dict[str, Any]:
    """Many viewers at once: gaps, and the 95th percentile of firing to arrival (ms)."""
    with served(1000, rate) as server, following(server.port, viewers) as found:
        time.sleep(seconds)
    delays = [d for viewer in found for d in viewer.delays]
    return {
        "viewers": len(found),
        "events_per_second": rate,
        "events_received": len(delays),
        "gaps": sum(viewer.gaps + viewer.snapshots for viewer in found),
        "arrival_p50_ms": round(percentile(delays, 50), 1),
        "arrival_p95_ms": round(percentile(delays, 95), 1),
    }


def measure_memory(events: int, nodes: int = 100) -> Dict[str, Any]:
    """Resident memory of the server (MB) over many events, sent as fast as it accepts them, while
    one viewer reads and one has stalled.

    :returns: ``curve``: pairs (events so far, MB), evenly spaced; ``grown_mb``: the difference
        between the means over the last quarter and over the first quarter after the ring of recent
        events was full.
    """
    samples: List[Tuple[int, float]] = []
    with served(nodes, 0) as server, socket.socket() as stalled, following(server.port, 1) as found:
        stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stalled.connect(("127.0.0.1", server.port))
        request = "GET /api/stream?id=%s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n"
        stalled.sendall((request % (KEY, server.port)).encode())
        process, begin = psutil.Process(server.pid), time.monotonic()
        while not samples or samples[-1][0] < events:
            time.sleep(SAMPLE)
            samples.append((_events_so_far(server.port), process.memory_info().rss / 1e6))
        seconds = time.monotonic() - begin
    full = [(n, mb) for n, mb in samples if n > 1.2 * RING]
    quarter = max(1, len(full) // 4)
    step = max(1, len(samples) // 20)
    return {
        "events": samples[-1][0],
        "events_per_second": round(samples[-1][0] / seconds),
        "curve": [[n, round(mb, 1)] for n, mb in samples[::step]],
        "grown_mb": round(_mean(full[-quarter:]) - _mean(full[:quarter]), 1) if full else None,
        "reader_gaps": found[0].gaps,
        "reader_snapshots": found[0].snapshots,
    }


def _events_so_far(port: int) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", "/api/state?id=%s&at=999999999" % KEY)
    n = json.loads(connection.getresponse().read())["board"]["n"]
    connection.close()
    return int(n)


def _mean(samples: List[Tuple[int, float]]) -> float:
    return sum(mb for _, mb in samples) / len(samples)
