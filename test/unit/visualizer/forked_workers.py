"""The page's checks and analyses in processes that are forked from one that has imported what they
need: the imports take most of the processor time of a process that answers one small request."""

from __future__ import annotations

import array
import atexit
import contextlib
import ctypes
import functools
import gc
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import traceback
from types import SimpleNamespace
from unittest import mock

from gspn_framework_package.visualizer import analysis_jobs
from gspn_framework_package.visualizer.editing import check_workers

NEEDED = (
    "gspn_framework_package.visualizer.analysis_worker",
    "gspn_framework_package.visualizer.editing.check_worker",
    "gspn_framework_package.analysis.decisions.optimise",
    "gspn_framework_package.analysis.monitoring.prediction",
    "gspn_framework_package.analysis.preflight",
    "gspn_framework_package.analysis.proofs.ladder",
    "gspn_framework_package.analysis.simulation",
)
IF_THERE = (
    "gspn_framework_package.ros.action_kinds",
    "gspn_framework_package.ros.event_sources",
)

_BE_SUBREAPER = 36  # prctl(2): orphans become children of this process


class ForkedProcess(subprocess.Popen):
    """``python -m MODULE WORD...`` as a fork. All but its start is that of :mod:`subprocess`."""

    def _execute_child(self, args, *rest):
        cwd, env = rest[4], rest[5]
        stdin, stdin_kept, stdout_kept, stdout, stderr_kept, stderr = rest[9:15]
        assert args[1] == "-m" and cwd is None
        request = {"words": args[2:], "folder": os.getcwd(), "environment": env}
        files = [own if own != -1 else i for i, own in enumerate((stdin, stdout, stderr))]
        self.pid = _fork(request, files)
        self._child_created = True
        self._closed_child_pipe_fds = True
        for own, kept in ((stdin, stdin_kept), (stdout, stdout_kept), (stderr, stderr_kept)):
            if own != -1 and kept != -1:
                os.close(own)


@contextlib.contextmanager
def forked_workers():
    """The processes of pages are forked meanwhile."""
    forking = SimpleNamespace(Popen=ForkedProcess, PIPE=subprocess.PIPE)
    with mock.patch.object(analysis_jobs, "subprocess", forking), mock.patch.object(
        check_workers, "subprocess", forking
    ):
        yield


_LOCK = threading.Lock()


def _fork(request, files):
    with _LOCK:
        forks = _server()
        told = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", files))]
        forks.sendmsg([json.dumps(request).encode()], told)
        return int(forks.recv(100))


@functools.lru_cache(maxsize=None)
def _server():
    """The connection to the process that forks, which ends with this one."""
    ctypes.CDLL(None).prctl(_BE_SUBREAPER, 1, 0, 0, 0)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        process = subprocess.Popen(
            [sys.executable, __file__, str(theirs.fileno())],
            env=analysis_jobs.worker_environment(),
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
        )
    atexit.register(lambda: (ours.close(), process.wait()))
    return ours


def _serve(requests):
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # meant for the tests
    for name in NEEDED:
        importlib.import_module(name)
    for name in IF_THERE:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    if len(os.listdir("/proc/self/task")) > 1:
        raise RuntimeError("cannot fork: there are several threads")
    gc.collect()
    gc.freeze()
    while True:
        text, told, _, _ = requests.recvmsg(1 << 20, socket.CMSG_SPACE(3 * 4))
        if not text:
            return
        files = array.array("i")
        files.frombytes(told[0][2])
        read, write = os.pipe()
        # the process between ends at once, so that the other becomes a child of that of the tests
        if os.fork() == 0:
            forked = os.fork()
            if forked == 0:
                for number, file in enumerate(files):
                    os.dup2(file, number)
                os.closerange(3, max(*files, read, write, requests.fileno()) + 1)
                _be(**json.loads(text))
            os.write(write, b"%d" % forked)
            os._exit(0)
        os.wait()
        requests.send(os.read(read, 100))
        for file in (*files, read, write):
            os.close(file)


def _be(words, folder, environment):
    """Be what Python would be with these words, and end."""
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        paths = environment.get("PYTHONPATH", "").split(os.pathsep)
        sys.path[:] = [folder, *paths, *(path for path in sys.path[1:] if path not in paths)]
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        sys.argv = list(words)
        code = sys.modules[words[0]].main() or 0
    except BaseException:  # no code of the server of forks may run here
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    _serve(socket.socket(fileno=int(sys.argv[1])))
