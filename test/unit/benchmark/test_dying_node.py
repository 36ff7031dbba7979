"""A process that dies while it writes its log leaves what a crash leaves, and the log can be taken
up again."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from gspn_framework_package.execution.agreement_simulation.plans import make_plan
from gspn_framework_package.execution.event_log import EventLogWriter, header, read_log

PLAN = make_plan(2, 2, False, 0.0, 0.0, False)

WRITE = """
import os, signal, sys
from gspn_framework_package.benchmark.faults import dying_node
from gspn_framework_package.execution.event_log import EventLogWriter, read_log

dying_node.die_when_told()
first = read_log(sys.argv[1]).header
log = EventLogWriter(sys.argv[1], first)
log.append({"kind": "life", "incarnation": 1})
os.kill(os.getpid(), getattr(signal, sys.argv[2]))
log.append({"kind": "active"})
print("sent")
"""


@pytest.mark.parametrize("told, kinds", [("SIGUSR1", ["life"]), ("SIGUSR2", ["life", "active"])])
def test_a_node_that_is_told_dies_in_its_next_write_or_right_after_it(
    tmp_path, told, kinds
) -> None:
    path = str(tmp_path / "r1.jsonl")
    EventLogWriter(path, header(PLAN, "run", "r1", "log1")).close()
    done = subprocess.run(
        [sys.executable, "-c", WRITE, path, told], stdout=subprocess.PIPE, timeout=60
    )
    assert (done.returncode, done.stdout) == (-signal.SIGKILL, b"")
    left = read_log(path)
    assert ([r["kind"] for r in left.records], left.cut) == (kinds, told == "SIGUSR1")
    EventLogWriter(path, left.header).append({"kind": "life", "incarnation": 2})
    again = read_log(path)
    assert ([r["kind"] for r in again.records], again.cut) == ([*kinds, "life"], False)
