"""Signals end a process, however they come."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from waiting import PATIENCE

from gspn_framework_package.ros.transport.ending import Ending

PROGRAM = """
import os, signal, socket, sys, threading
from gspn_framework_package.ros.transport.ending import Ending

def idle():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        server.accept()

def tick():
    event = threading.Event()
    while True:
        event.wait(0.005)

for what in 20 * [idle] + 8 * [tick]:
    threading.Thread(target=what, daemon=True).start()
ending = Ending()
ending.listen(signal.SIGINT, signal.SIGTERM)
print("ready", flush=True)
ending.wait()
sys.stdout.write(" ".join(map(str, sorted(ending.signals))))
sys.stdout.flush()
os._exit(0)
"""


def test_two_signals_at_once_end_a_process_of_many_threads():
    for _ in range(4):
        processes = [
            subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True)
            for _ in range(8)
        ]
        try:
            for process in processes:
                assert process.stdout.readline() == "ready\n"
            for process in processes:
                process.send_signal(signal.SIGINT)
                process.send_signal(signal.SIGTERM)
            for process in processes:
                said, _ = process.communicate(timeout=30 * PATIENCE)
                assert (
                    str(int(signal.SIGINT)) in said.split()
                    or str(int(signal.SIGTERM)) in said.split()
                )
                assert process.returncode == 0
        finally:
            for process in processes:
                process.kill()
                process.wait()


def test_a_thread_can_end_it_too():
    ending = Ending()
    threading.Timer(0.05, ending.set).start()
    assert ending.wait(30) and ending.is_set() and ending.wait() and ending.wait(0)
    assert ending.signals == []


def test_a_wait_has_an_end():
    ending = Ending()
    begin = time.monotonic()
    assert not ending.wait(0.05) and not ending.is_set()
    assert 0.05 <= time.monotonic() - begin < 20


def test_other_signals_wake_nobody_for_good():
    ending = Ending()
    before = signal.getsignal(signal.SIGUSR1)
    descriptor = signal.set_wakeup_fd(-1)
    try:
        ending.listen()
        signal.signal(signal.SIGUSR1, lambda *_: None)
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGUSR1)).start()
        assert not ending.wait(0.3)
    finally:
        signal.signal(signal.SIGUSR1, before)
        signal.set_wakeup_fd(descriptor)


@pytest.mark.parametrize("times", [1, 100_000])
def test_it_may_be_set_again_and_again(times):
    ending = Ending()
    for _ in range(times):  # more than a pipe holds
        ending.set()
    assert ending.wait(0)
