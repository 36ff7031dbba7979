"""What a benchmark starts ends with it."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

PARENT = """
import time
from benchmarks.processes import child, end_cleanly_on_signal

end_cleanly_on_signal()
started = child(time.sleep, 600)
started.start()
print(started.pid, flush=True)
try:
    time.sleep(600)
except KeyboardInterrupt:
    started.kill()
    print("ends cleanly", flush=True)
"""


def is_running(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_child_ends_with_its_benchmark_however_that_ends(number):
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True
    ) as parent:
        pid = int(parent.stdout.readline())
        os.kill(parent.pid, number)
        deadline = time.monotonic() + 60
        while is_running(pid):
            assert time.monotonic() < deadline, "the child runs on"
            time.sleep(0.02)
        assert parent.stdout.read() == ("ends cleanly\n" if number == signal.SIGTERM else "")
