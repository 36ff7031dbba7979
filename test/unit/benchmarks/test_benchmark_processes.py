"""What a benchmark starts ends with it."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
from waiting import PATIENCE, wait_for

from benchmarks.harness.programs import Programs
from gspn_framework_package.model.errors import ExecutionError

PARENT = """
import sys, time
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.harness.programs import Programs

end_cleanly_on_signal()
programs = Programs(sys.argv[1])
programs.start("sleeps", ["sh", "-c", "sleep 600 & wait"])
try:
    print(programs.pid("sleeps"), flush=True)  # from here on the signal may come
    time.sleep(600)
except KeyboardInterrupt:
    programs.end()
    print("ends cleanly", flush=True)
"""


def test_programs_end_with_what_they_started_when_a_benchmark_is_ended(tmp_path):
    words = [sys.executable, "-c", PARENT, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as parent:
        shell = psutil.Process(int(parent.stdout.readline()))
        wait_for(shell.children, 60, "the program that the shell starts")
        family = [shell, *shell.children()]
        os.kill(parent.pid, signal.SIGTERM)
        assert parent.stdout.read() == "ends cleanly\n"
    _, alive = psutil.wait_procs(family, timeout=60 * PATIENCE)
    assert not alive


def test_a_program_that_ends_by_itself_is_noticed_and_what_it_said_is_reported(tmp_path):
    programs = Programs(str(tmp_path))
    programs.start("one", ["sh", "-c", "echo '[ERROR] no fuel'; exit 3"])
    programs.start("two", ["sleep", "600"])
    deadline = time.monotonic() + 60
    while programs.ended() != ["one"]:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    with pytest.raises(ExecutionError, match=r"one ended with 3: \[ERROR\] no fuel"):
        programs.check()
    assert programs.errors("one") == ["[ERROR] no fuel"] and programs.errors("two") == []
    assert programs.await_end("one", 60) == 3
    assert programs.alive() == ["two"] and programs.ended() == []
    programs.signal("two", signal.SIGSTOP)
    programs.end()  # a stopped program too
    assert programs.alive() == []


def test_a_program_that_does_not_end_in_time_is_reported(tmp_path):
    programs = Programs(str(tmp_path))
    programs.start("long", ["sleep", "600"])
    with pytest.raises(ExecutionError, match="waited 0.1 s for the end of long"):
        programs.await_end("long", 0.1)
    programs.kill("long")
    assert programs.alive() == []
