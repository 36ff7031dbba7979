"""Opening a long event log on the page: time to the first picture, time to read it all, memory of
the server."""

from __future__ import annotations

import http.client
import json
import os
import random
import re
import subprocess
import sys
import time
from typing import Any, Dict, List, Optional

import psutil

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import Record, header
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.log_writer import record_line
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError

PLAN = "plans/patrol"
ENTRY_SECONDS = 0.05
"""Time between two entries of a written log."""


def write_log(path: str, entries: int, plan_path: str = PLAN, seed: int = 1) -> None:
    """Write the event log of a run with this many entries, in which robots finish in random order,
    and an action occasionally fails and is retried."""
    plan = read_plan(plan_path)
    game, source = TokenGame(plan, agents=True), random.Random(seed)
    ledger = Ledger(game)
    doing: Dict[str, StartAction] = {}
    with open(path, "w", encoding="utf-8") as file:
        chain = ""

        def write(number: int, record: Record) -> None:
            nonlocal chain
            clocks = {"wall": 1.7e9 + number * ENTRY_SECONDS, "mono": 1000 + number * ENTRY_SECONDS}
            line, chain = record_line({**record, **clocks}, chain)
            file.write(line)

        write(0, header(plan, "long", "", "long", agents=True))
        batch: List[log_entries.Entry] = [game.start_entry()]
        for number in range(entries):
            slot = ledger.length
            step = game.reduce(ledger.state, slot, batch)
            write(number, ledger.record(slot, batch, [], step))
            for command in step.commands:
                if isinstance(command, StartAction):
                    doing[command.robot] = command
            failed = [r.name for r in ledger.state.robots.values() if r.phase.report.failed]
            if not doing and not failed:
                raise ExecutionError("the run of the log came to its end after %d entries" % number)
            batch = [
                log_entries.Retry(failed[0])
                if failed
                else _result(game, doing.pop(source.choice(list(doing))), source)
            ]


def _result(game: TokenGame, action: StartAction, source: random.Random) -> log_entries.Entry:
    if source.random() < 0.001:
        return log_entries.Failed(
            action.robot, action.incarnation, action.visit, action.attempt, "aborted", "it slipped"
        )
    net = game.net
    timed = [t for t in net.consumers[net.place_number(action.place)] if net.transitions[t].timed]
    result = net.transitions[source.choice(timed)].name if timed else ""
    return log_entries.Done(action.robot, action.incarnation, action.visit, result)


def measure_log(entries: int, path: str) -> Dict[str, Any]:
    """Open a log with this many entries in a separate server. The log is written to ``path`` if
    there is none.

    :returns: ``first_picture`` (s, from the start of the server to the marking and the first
        events), ``read`` (s, until all of it has been read), both also in processor time of the
        server (``..._cpu``); ``state`` (s, the slowest of some markings requested while the log was
        read, ``state_after`` after that), ``server_mb`` (peak memory of the server).
    """
    if not os.path.exists(path):
        write_log(path, entries)
    command = [sys.executable, "-m", "gspn_framework_package", "replay", path, "--port", "0"]
    begun = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            found = re.search(r"127\.0\.0\.1:(\d+)", server.stdout.readline())
            if found is None:
                raise ExecutionError("the server did not start")
            page = _Page(int(found.group(1)))
            up = time.monotonic() - begun
            page.get("session?id=replay")
            page.get("poll?id=replay")
            page.get("state?id=replay&at=0")
            page.get("events?id=replay&after=0&to=2000")
            first = time.monotonic() - begun
            process = psutil.Process(server.pid)
            first_cpu = _cpu(process)
            most, slowest = 0.0, 0.0
            info: Dict[str, Any] = {"loading": True}
            source = random.Random(1)
            while info["loading"]:
                news = page.get("poll?id=replay")
                info, n = news["snapshot"]["info"], news["snapshot"]["board"]["n"]
                slowest = max(slowest, page.timed("state?id=replay&at=%d" % source.randint(0, n)))
                most = max(most, process.memory_info().rss / 1e6)
                time.sleep(0.2)
            read, read_cpu = time.monotonic() - begun, _cpu(process)
            n = page.get("poll?id=replay")["snapshot"]["board"]["n"]
            after = [page.timed("state?id=replay&at=%d" % source.randint(0, n)) for _ in range(20)]
            page.get("events?id=replay&after=%d&to=%d" % (n // 2, n // 2 + 5000))
            most = max(most, process.memory_info().rss / 1e6)
        finally:
            server.terminate()
            server.wait(20)
    return {
        "entries": _lines(path),
        "megabytes": round(os.path.getsize(path) / 1e6, 1),
        "events": n,
        "server_up": round(up, 2),
        "first_picture": round(first, 2),
        "first_picture_cpu": round(first_cpu, 2),
        "read": round(read, 1),
        "read_cpu": round(read_cpu, 1),
        "state": round(slowest, 3),
        "state_after": round(sorted(after)[len(after) // 2], 3),
        "server_mb": round(most, 1),
    }


def _cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _lines(path: str) -> int:
    """The number of entries of a log: its lines without the header."""
    with open(path, "rb") as file:
        return sum(block.count(b"\n") for block in iter(lambda: file.read(1 << 20), b"")) - 1


class _Page:
    def __init__(self, port: int) -> None:
        self._port = port
        self._connection: Optional[http.client.HTTPConnection] = None

    def get(self, path: str) -> Any:
        if self._connection is None:
            self._connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=120)
        self._connection.request("GET", "/api/" + path)
        answer = self._connection.getresponse()
        data = json.loads(answer.read())
        if answer.status != 200:
            raise ExecutionError("the server answered %d: %s" % (answer.status, data.get("error")))
        return data

    def timed(self, path: str) -> float:
        begun = time.monotonic()
        self.get(path)
        return time.monotonic() - begun
