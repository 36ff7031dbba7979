"""What tests of several layers begin with."""

import sys
import threading
from pathlib import Path

import pytest

from gspn_framework_package.execution.event_log import header, read_log
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor

sys.path.append(str(Path(__file__).parent))
# "meeting", "waiting" and "reported_run", which need no ROS
sys.path.append(str(Path(__file__).parents[1] / "rostest" / "support"))


class _Slots(Listener):
    """Says when a run has filled so many slots of its log."""

    def __init__(self, slots):
        self._slots = slots
        self.filled = threading.Event()

    def on_step(self, slot, entries, firings, state):
        if slot > self._slots:
            self.filled.set()


def _record_run(plan, path, slots):
    listener = _Slots(slots)
    executor = StandaloneExecutor(
        plan, listener, EventLogWriter(path, header(plan, "run", "", "log", agents=True))
    )
    executor.start()
    assert listener.filled.wait(30)
    executor.stop()
    assert executor.wait(30) is not None
    return list(replay(read_log(path)))


@pytest.fixture(scope="session", name="record_run")
def _recorder():
    """``record_run(plan, path, slots)``: run a plan on threads until its event log at ``path`` has
    more than so many slots; the replayed steps."""
    return _record_run
