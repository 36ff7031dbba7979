"""A loop runs functions on its own thread, and goes on elsewhere when one of them holds it up."""

import queue
import threading

import pytest
from waiting import PATIENCE, wait_for

from gspn_framework_package.team.relay import Relay


class Loop:
    """A loop that calls what it is given, in turn, and notes the threads on which it ran."""

    def __init__(self):
        self.tasks, self.threads = queue.Queue(), []
        self.relay = Relay(self.run, "loop")

    def run(self):
        while True:
            self.threads.append(threading.current_thread())
            if not self.relay.run_guests():
                return
            task = self.tasks.get()
            if task is None:
                self.relay.end()
                return
            task()

    def invite(self, guest):
        self.tasks.put(lambda: self.relay.invite(guest))

    def thread(self):
        """The thread of the loop now."""
        found = queue.Queue()
        self.tasks.put(lambda: found.put(threading.current_thread()))
        return found.get(timeout=20 * PATIENCE)


@pytest.fixture
def loop():
    loop = Loop()
    loop.relay.start()
    yield loop
    loop.tasks.put(None)
    loop.relay.join(20 * PATIENCE)


@pytest.fixture
def patient(monkeypatch):
    """On a busy machine, a quick function may take a while."""
    monkeypatch.setattr("gspn_framework_package.team.relay.PERIOD", 0.5 * PATIENCE)


def test_quick_functions_run_on_the_thread_of_the_loop(patient, loop):
    ran = []
    for _ in range(100):
        loop.invite(lambda: ran.append(threading.current_thread()))
    assert loop.thread() is loop.threads[0]
    assert len(ran) == 100 and set(ran) == {loop.threads[0]}


@pytest.mark.parametrize("times", [1, 3])
def test_a_function_that_blocks_loses_the_loop_and_ends_on_its_own_thread(loop, times):
    gate, ended, first = threading.Event(), [], loop.thread()

    def block():
        gate.wait(60 * PATIENCE)
        ended.append(threading.current_thread())

    for number in range(1, times + 1):
        loop.invite(block)
        assert loop.thread() not in (first, *ended)
        assert len({id(thread) for thread in loop.threads}) == number + 1
    assert not ended
    gate.set()
    wait_for(lambda: len(ended) == times and not any(t.is_alive() for t in ended), 20, "the end")
    assert loop.thread() not in ended


def test_functions_that_wait_behind_one_that_blocks_run_on_the_next_thread(loop):
    gate, ran = threading.Event(), queue.Queue()

    def invite_both():
        loop.relay.invite(lambda: gate.wait(60 * PATIENCE))
        loop.relay.invite(lambda: ran.put(threading.current_thread()))

    loop.tasks.put(invite_both)
    assert ran.get(timeout=20 * PATIENCE) is not loop.threads[0]
    gate.set()


def test_the_second_thread_sleeps_while_there_are_no_functions(loop, monkeypatch):
    monkeypatch.setattr("gspn_framework_package.team.relay._IDLE_CHECKS", 2)
    loop.invite(int)
    wait_for(lambda: not loop.relay._wanted.is_set(), 20, "sleep")
    gate = threading.Event()
    loop.invite(lambda: gate.wait(60 * PATIENCE))
    assert loop.thread() is not loop.threads[0]
    gate.set()


def test_a_loop_that_was_not_started_is_not_waited_for():
    Relay(int, "loop").join()


def test_a_function_is_not_taken_for_the_one_before_it(patient, loop):
    """Functions that together take longer than the second thread allows one of them."""
    for _ in range(8):
        loop.invite(lambda: threading.Event().wait(0.2 * PATIENCE))
    assert loop.thread() is loop.threads[0]
