"""The feed that the page shows while it is measured: a net of any size whose transitions fire at a
steady rate, served by a separate process."""

from __future__ import annotations

import contextlib
import math
import random
import subprocess
import sys
import threading
import time
from typing import Iterator, NamedTuple, Tuple

from benchmarks.harness.ports import free_port
from gspn_framework_package.execution.simulator import Simulator
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.net import Net
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.board import Board, fire_event
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.serving import WebServer
from gspn_framework_package.visualizer.session import Session

KEY = "feed"
"""The key of the net in addresses."""


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
                net.exponential("r%d_t%d" % (r, i), inputs=inputs, outputs=outputs, position=where)
    return net.build()


class Feed(Activity):
    """Fires at a steady rate; each firing carries the wall clock (ms) as ``w``.

    :param rate: firings per second; 0 for as many as the hub accepts.
    """

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
            fired = fire_event(self._net, firing.transition, self._simulator.change)
            hub.publish({**fired, "w": round(time.time() * 1000, 1)})
            if self._rate:
                due += 1 / self._rate
                time.sleep(max(0.0, due - time.monotonic()))


def serve(nodes: int, rate: float, port: int) -> None:
    """Serve the feed until the parent closes this process's stdin."""
    net = workshop(nodes)
    project = Project()
    project.show(Session(KEY, Document(KEY, net), Feed(net, rate)))
    server = WebServer(project, port=port, viewers=40)
    server.start()
    print("ready", flush=True)
    sys.stdin.read()


class Served(NamedTuple):
    """A feed that is being served."""

    port: int
    pid: int


@contextlib.contextmanager
def served(nodes: int, rate: float) -> Iterator[Served]:
    """A server in a separate process.

    :raises ExecutionError: it did not start.
    """
    port = free_port()
    command = [sys.executable, "-m", __name__, str(nodes), str(rate), str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin and process.stdout
        try:
            said = process.stdout.readline().strip()
            if said != b"ready":
                raise ExecutionError(
                    "the server of the benchmark did not start; it said: '%s'" % said.decode()
                )
            yield Served(port, process.pid)
        finally:
            process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(5)
            process.kill()


if __name__ == "__main__":
    serve(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
