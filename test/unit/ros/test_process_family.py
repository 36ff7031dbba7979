"""Processes that are forked from one parent live and die with it."""

import gc
import os
import signal
import subprocess
import sys
import textwrap
import threading
import weakref

import pytest
from waiting import wait_for

from gspn_framework_package.ros.transport import process_family
from gspn_framework_package.ros.transport.process_family import FamilyMember, run_family

PROGRAM = """
import os, signal, sys, time
from gspn_framework_package.ros.transport import process_family
from gspn_framework_package.ros.transport.process_family import FamilyMember, run_family

process_family.RESPAWN_DELAY = 0.05
folder = sys.argv[1]

def note(name):
    with open(os.path.join(folder, name), "a") as file:
        file.write("%d\\n" % os.getpid())

def waits():
    signal.signal(signal.SIGTERM, lambda *_: (note("told"), os._exit(7)))
    note("waits")
    time.sleep(60)

def stubborn():
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    note("stubborn")
    time.sleep(60)

def ends():
    note("ends")
    return 3

"""


@pytest.fixture
def start(tmp_path):
    """Start a family in a separate process: the process, and a way to wait for the notes of its
    members."""
    parents = []

    def start_it(line):
        program = PROGRAM + textwrap.dedent(line)
        parents.append(
            subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], start_new_session=True)
        )
        return parents[-1]

    yield start_it
    for parent in parents:
        try:
            os.killpg(parent.pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
        finally:
            parent.wait()


def notes(folder, name, number):
    """Wait until so many processes have left that note: their ids."""
    path = folder / name
    wait_for(
        lambda: path.exists() and len(path.read_text().split("\n")) > number,
        seconds=30,
        what="%d notes '%s'" % (number, name),
    )
    return [int(word) for word in path.read_text().split()]


def is_alive(pid):
    try:
        with open("/proc/%d/stat" % pid) as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_the_largest_exit_code_counts(start, tmp_path):
    parent = start(
        'sys.exit(run_family([FamilyMember("a", ends), FamilyMember("b", lambda: 0), FamilyMember("c", lambda: 1 / 0)]))'
    )
    assert parent.wait(30) == 3


def test_a_parent_that_only_waits_has_no_libraries(start, tmp_path):
    """It would keep its own copy of all memory that its processes have changed."""
    parent = start("import ctypes; run_family([FamilyMember('a', waits)])")
    (child,) = notes(tmp_path, "waits", 1)

    def libraries(pid):
        with open("/proc/%d/maps" % pid) as file:
            return "ctypes" in file.read()

    assert libraries(child)
    wait_for(lambda: not libraries(parent.pid), seconds=30, what="the parent that only waits")
    assert is_alive(child)


def test_a_signal_ends_all_and_nothing_is_left(start, tmp_path):
    parent = start('sys.exit(run_family([FamilyMember("a", waits), FamilyMember("b", waits)]))')
    children = notes(tmp_path, "waits", 2)
    parent.send_signal(signal.SIGINT)
    assert parent.wait(30) == 128 + signal.SIGINT
    assert sorted(notes(tmp_path, "told", 2)) == sorted(children)
    assert not any(is_alive(child) for child in children)


def test_who_does_not_end_in_time_is_killed(start, tmp_path):
    parent = start(
        """
        process_family.ENDING_PATIENCE = 0.2
        sys.exit(run_family([FamilyMember("a", stubborn)]))
        """
    )
    (child,) = notes(tmp_path, "stubborn", 1)
    parent.send_signal(signal.SIGINT)
    assert parent.wait(30) == 128 + signal.SIGINT
    assert not is_alive(child)


def test_a_parent_that_is_killed_takes_its_processes_along(start, tmp_path):
    parent = start('run_family([FamilyMember("a", waits), FamilyMember("b", waits)])')
    children = notes(tmp_path, "waits", 2)
    parent.kill()
    assert sorted(notes(tmp_path, "told", 2)) == sorted(children)
    wait_for(
        lambda: not any(is_alive(child) for child in children),
        seconds=30,
        what="the end of the children",
    )


def test_a_process_that_dies_is_started_again_and_the_others_go_on(start, tmp_path):
    start('run_family([FamilyMember("a", waits), FamilyMember("b", ends)], respawn=True)')
    first = notes(tmp_path, "waits", 1)[0]
    assert len(set(notes(tmp_path, "ends", 3))) >= 3
    assert is_alive(first)
    os.kill(first, signal.SIGKILL)
    assert notes(tmp_path, "waits", 2)[1] != first


def test_threads_are_in_the_way():
    release = threading.Event()
    thread = threading.Thread(target=release.wait)
    thread.start()
    try:
        with pytest.raises(RuntimeError, match="threads"):
            run_family([FamilyMember("a", lambda: 0)])
    finally:
        release.set()
        thread.join()


def test_python_has_numbered_every_class_before_the_fork():
    class New:
        """It has what is looked up first in a class elsewhere."""

    has_number = 1 << 19  # Py_TPFLAGS_VALID_VERSION_TAG
    assert not New.__flags__ & has_number
    proxy = weakref.proxy(New)  # says that it is a class, which it is not
    assert isinstance(proxy, type) and any(found is proxy for found in gc.get_objects())
    process_family._look_up_in_all_classes()
    assert New.__flags__ & has_number
