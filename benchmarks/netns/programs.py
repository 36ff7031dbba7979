"""Programs in the namespaces of a network, and the logs of the robots among them."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import time
from typing import Any, Dict, List, Mapping, Sequence, Tuple

from benchmarks.log_tail import LogTail
from benchmarks.netns.network import Network, inside
from gspn_framework_package.model.errors import ExecutionError

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))

LAST_WORDS = 5.0
"""Seconds that a program has to end when it is asked to."""

_START = 20.0


class Programs:
    """Runs programs, each in the namespace of a node or host, until :meth:`end`.

    :param network: has the places of the programs.
    :param folder: their working directory, and where their output goes.
    :param logs: where the log of each robot is.
    """

    def __init__(self, network: Network, folder: str, logs: Mapping[str, str]) -> None:
        self.network, self.folder = network, folder
        self.logs = {robot: LogTail(path) for robot, path in logs.items()}
        self._processes: Dict[str, Any] = {}

    def start(
        self,
        name: str,
        words: Sequence[str],
        place: str = "",
        environment: Mapping[str, str] = {},
    ) -> None:
        """Start a program; it must run until it is killed or all end.

        :param name: what to call it.
        :param place: the node or host; "": that of the same name.
        :param environment: what differs from the environment of this process.
        """
        with open(self._output_file(name), "ab") as output:
            self._processes[name] = subprocess.Popen(
                self.network.command(place or name, words),
                env=_environment(environment),
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def ask(
        self,
        place: str,
        words: Sequence[str],
        environment: Mapping[str, str] = {},
        seconds: float = 20.0,
    ) -> Tuple[int, str]:
        """Run a short program in a namespace; returns its exit code and all that it printed, -1
        and "no answer" if it takes too long."""
        try:
            done = subprocess.run(
                self.network.command(place, words),
                env=_environment(environment),
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=seconds,
            )
        except subprocess.TimeoutExpired:
            return -1, "no answer"
        return done.returncode, done.stdout.strip()

    def kill(self, name: str) -> None:
        """Kill a program with all that it started, as a power cut would; it may be started
        again."""
        process = self._processes.pop(name)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def read(self) -> Dict[str, LogTail]:
        """All logs, as far as they have been written.

        :raises ExecutionError: a program has ended.
        """
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise ExecutionError(
                    "%s ended with %s: %s" % (name, process.returncode, self.said(name))
                )
        for log in self.logs.values():
            log.read()
        return self.logs

    def end(self, *groups: Sequence[str]) -> None:
        """End all programs, one group after the other; kill those that do not end within
        :data:`LAST_WORDS`.

        :param groups: what ends after the rest, in this order.
        """
        late = {name for group in groups for name in group}
        for names in ([n for n in self._processes if n not in late], *groups):
            running = [self._processes[name] for name in names if name in self._processes]
            for process in running:
                if process.poll() is None:
                    process.send_signal(signal.SIGTERM)
            deadline = time.monotonic() + LAST_WORDS
            for process in running:
                try:
                    process.wait(max(0.1, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
        for log in self.logs.values():
            log.read()

    def await_port(self, name: str, port: int, place: str = "") -> None:
        """Wait until a program listens on a TCP port.

        :raises ExecutionError: it ended, or takes too long.
        """
        place = place or name
        deadline = time.monotonic() + _START
        while True:
            with inside(self.network.namespace(place)), socket.socket() as probe:
                if probe.connect_ex((self.network.address(place), port)) == 0:
                    return
            if time.monotonic() > deadline or self._processes[name].poll() is not None:
                raise ExecutionError("%s did not start: %s" % (name, self.said(name)))
            time.sleep(0.05)

    def output(self, name: str) -> str:
        """What a program has printed."""
        with open(self._output_file(name), encoding="utf-8", errors="replace") as file:
            return file.read()

    def said(self, name: str) -> str:
        """The last lines that a program printed, in one."""
        return " / ".join(line.strip() for line in self.output(name).splitlines()[-3:])

    def _output_file(self, name: str) -> str:
        return os.path.join(self.folder, name + ".txt")


def _environment(more: Mapping[str, str]) -> Dict[str, str]:
    environment = dict(os.environ)
    for name in ("ROS_HOSTNAME", "ROS_NAMESPACE"):
        environment.pop(name, None)
    paths: List[str] = [ROOT, environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    return {**environment, **more}


def ros_environment(address: str, master: str, port: int, folder: str) -> Dict[str, str]:
    """The environment of a ROS program.

    :param address: its own.
    :param master: address of its master, which listens at ``port``.
    :param folder: for what ROS writes.
    """
    return {
        "ROS_IP": address,
        "ROS_MASTER_URI": "http://%s:%d" % (master, port),
        "ROS_HOME": folder,
        "ROS_LOG_DIR": os.path.join(folder, "log"),
    }
