"""A process that dies while it writes its log leaves what a crash leaves, and the log can be taken
up again."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from waiting import PATIENCE

from agreement.plans import make_plan
from benchmarks.faults.dying_node import Death
from gspn_framework_package.execution.event_log import header, read_log
from gspn_framework_package.execution.log_writer import EventLogWriter

PLAN = make_plan(2, 2, False, 0.0, 0.0, False)

WRITE = """
import os, signal, sys
from benchmarks.faults import dying_node
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.log_writer import EventLogWriter

dying_node.die_on_signal()
first = read_log(sys.argv[1]).header
log = EventLogWriter(sys.argv[1], first)
log.append({"kind": "life", "incarnation": 1})
os.kill(os.getpid(), getattr(signal, sys.argv[2]))
log.append({"kind": "active"})
print("sent")
"""


@pytest.mark.parametrize("told, kinds", [("SIGUSR1", ["life"]), ("SIGUSR2", ["life", "active"])])
def test_a_node_that_is_reported_dies_in_its_next_write_or_right_after_it(
    tmp_path, told, kinds
) -> None:
    path = str(tmp_path / "r1.jsonl")
    EventLogWriter(path, header(PLAN, "run", "r1", "log1")).close()
    done = subprocess.run(
        [sys.executable, "-c", WRITE, path, told], stdout=subprocess.PIPE, timeout=60 * PATIENCE
    )
    assert (done.returncode, done.stdout) == (-signal.SIGKILL, b"")
    left = read_log(path)
    assert ([r["kind"] for r in left.records], left.cut) == (kinds, told == "SIGUSR1")
    EventLogWriter(path, left.header).append({"kind": "life", "incarnation": 2})
    again = read_log(path)
    assert ([r["kind"] for r in again.records], again.cut) == ([*kinds, "life"], False)


ORDERED = """
import sys
from benchmarks.faults.dying_node import Death, die_on_signal
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.log_writer import EventLogWriter

die_on_signal(death=Death(sys.argv[2]))
log = EventLogWriter(sys.argv[1], read_log(sys.argv[1]).header)
log.append({"kind": "invoked", "entry": {"entry": "adopt"}})
log.append({"kind": "accepted", "batch": [[{"entry": "done"}, []], [{"entry": "staged"}, []]]})
log.append({"kind": "slot", "entries": [{"entry": "stage"}, {"entry": "adopt"}]})
print("sent")
"""


@pytest.mark.parametrize(
    "order, kinds",
    [
        (("slot", "adopt", True), ["invoked", "accepted"]),
        (("accepted", "staged", False), ["invoked", "accepted"]),
        (("invoked", "adopt", False), ["invoked"]),
    ],
)
def test_a_node_dies_at_the_record_at_which_it_has_to(tmp_path, order, kinds) -> None:
    path, death = str(tmp_path / "r1.jsonl"), Death(str(tmp_path / "death"))
    EventLogWriter(path, header(PLAN, "run", "r1", "log1")).close()
    death.order(*order)
    words = [sys.executable, "-c", ORDERED, path, str(tmp_path / "death")]
    done = subprocess.run(words, stdout=subprocess.PIPE, timeout=60 * PATIENCE)
    assert (done.returncode, done.stdout) == (-signal.SIGKILL, b"")
    left = read_log(path)
    assert ([r["kind"] for r in left.records], left.cut) == (kinds, order[2])
    assert not (tmp_path / "death").exists()  # the next life goes on
