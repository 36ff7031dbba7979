"""Runs node scripts in processes forked from one that has imported what they need, as those of
``gspn_team`` are: the imports take half of the processor time of a node that lives for seconds."""

import ctypes
import gc
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback

import rosgraph
import rospy

from gspn_framework_package.ros import (  # noqa: F401
    event_sources,
    execution_node,
    node_main,
    place_servers,
    service_line,
)
from gspn_framework_package.ros.transport import master_watch  # noqa: F401

_BE_SUBREAPER = 36  # prctl(2)


class ForkedScript:
    """A script that runs as a child of this process; the usual part of ``subprocess.Popen``.

    :param words: the script and its arguments.
    :param output: the file to which it writes.
    """

    def __init__(self, words, output):
        self.returncode = None
        request = {"words": words, "output": output, "environment": dict(os.environ)}
        with _LOCK:
            _FORKS.write(json.dumps(request) + "\n")
            _FORKS.flush()
            self.pid = int(_FORKS.readline())

    def poll(self):
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                killed = os.WIFSIGNALED(status)
                self.returncode = -os.WTERMSIG(status) if killed else os.WEXITSTATUS(status)
        return self.returncode

    def wait(self, timeout=float("inf")):
        deadline = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired("process %d" % self.pid, timeout)
            time.sleep(0.01)
        return self.returncode

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        self.send_signal(signal.SIGKILL)


def _serve(requests):
    """Fork the scripts that are requested, until the process of the tests has ended. The process
    between them ends at once, so that each script becomes a child of the process of the tests."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # meant for the tests
    gc.freeze()
    for line in requests:
        read, write = os.pipe()
        if os.fork() == 0:
            script = os.fork()
            if script == 0:
                requests.close()
                os.close(read)
                os.close(write)
                _be(**json.loads(line))
            os.write(write, b"%d\n" % script)
            os._exit(0)
        os.wait()
        requests.write(os.read(read, 100).decode())
        requests.flush()
        os.close(read)
        os.close(write)
    os._exit(0)


def _be(words, output, environment):
    """Be the script; rospy has read the arguments and the environment of the tests."""
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, mode in ((0, os.O_RDONLY), (1, os.O_WRONLY | os.O_CREAT | os.O_APPEND)):
            file = os.open(output if number else os.devnull, mode, 0o644)
            os.dup2(file, number)
            os.close(file)
        os.dup2(1, 2)
        os.environ.clear()
        os.environ.update(environment)
        sys.argv = words
        rospy.names.reload_mappings(words)
        rospy.names._set_caller_id(rosgraph.names.get_ros_namespace() + "unnamed")
        runpy.run_path(words[0], run_name="__main__")
        code = 0
    except BaseException:  # no code of the tests may run here
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _begin():
    if threading.active_count() > 1:
        raise RuntimeError("cannot fork: there are %d threads" % threading.active_count())
    ctypes.CDLL(None).prctl(_BE_SUBREAPER, 1, 0, 0, 0)
    ours, theirs = socket.socketpair()
    if os.fork() == 0:
        ours.close()
        requests = theirs.makefile("rw")
        theirs.close()  # once the file is closed
        _serve(requests)
    theirs.close()
    return ours.makefile("rw")


_LOCK = threading.Lock()
_FORKS = _begin()
