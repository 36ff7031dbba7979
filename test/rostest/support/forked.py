"""Processes that are forked from one that has imported what they need, as those of ``gspn_team``
are: the imports take most of the processor time of a process that lives for a few seconds."""

import array
import atexit
import ctypes
import gc
import importlib
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time

_BE_SUBREAPER = 36  # prctl(2): orphans become children of this process


class ForkServer:
    """A process that forks others. It starts with the first of them and ends with this process.

    :param modules: what it imports.
    """

    def __init__(self, *modules):
        self._modules = modules
        self._connection = None
        self._lock = threading.Lock()

    def start(self, words, files):
        """Start ``python WORDS...`` as a child of this process.

        :param words: ``-m``, a module with a function ``main`` and its arguments; or a script and
            its arguments.
        :param files: the numbers of the files that are its input, output and complaints.
        """
        request = {"words": words, "folder": os.getcwd(), "environment": dict(os.environ)}
        told = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", files))]
        with self._lock:
            if self._connection is None:
                self._connection = self._begin()
            self._connection.sendmsg([json.dumps(request).encode()], told)
            return ForkedProcess(int(self._connection.recv(100)))

    def _begin(self):
        ctypes.CDLL(None).prctl(_BE_SUBREAPER, 1, 0, 0, 0)
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for each in (ours, theirs):
            each.settimeout(None)  # rospy gives all new sockets a timeout
        paths = {"PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
        with theirs:
            process = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno()), *self._modules],
                env={**os.environ, **paths},
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
            )
        atexit.register(lambda: (ours.close(), process.wait()))
        return ours


class ForkedProcess:
    """The usual part of ``subprocess.Popen``."""

    def __init__(self, pid):
        self.pid, self.returncode = pid, None
        self._lock = threading.Lock()

    def poll(self):
        with self._lock:
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


def _serve(requests, modules):
    """Fork until the process of the tests has ended; returns the request to each forked process."""
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # meant for the tests
    for name in modules:
        importlib.import_module(name)
    if len(os.listdir("/proc/self/task")) > 1:
        raise RuntimeError("cannot fork: there are several threads")
    gc.collect()
    gc.freeze()
    read, write = os.pipe()
    while True:
        text, told, _, _ = requests.recvmsg(1 << 20, socket.CMSG_SPACE(3 * 4))
        if not text:
            os._exit(0)
        files = array.array("i", told[0][2])
        # the process between ends at once, so that the other becomes a child of that of the tests
        if os.fork() == 0:
            forked = os.fork()
            if forked == 0:
                for number, file in enumerate(files):
                    os.dup2(file, number)
                os.closerange(3, max(*files, read, write, requests.fileno()) + 1)
                return json.loads(text)
            os.write(write, b"%d" % forked)
            os._exit(0)
        os.wait()
        requests.send(os.read(read, 100))
        for file in files:
            os.close(file)


def _be(words, folder, environment):
    """Be what Python would be with these words."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    module = words[0] == "-m"
    sys.argv = words[module:]
    if "rospy" in sys.modules:  # it has read the arguments and the environment of the server
        importlib.reload(sys.modules["rospy.names"])
    if module:
        code = sys.modules[words[1]].main() or 0
        sys.stdout.flush()
        os._exit(code)  # Python's own end would look at all that is shared
    runpy.run_path(words[0], run_name="__main__")


if __name__ == "__main__":
    _be(**_serve(socket.socket(fileno=int(sys.argv[1])), sys.argv[2:]))
