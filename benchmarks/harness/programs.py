"""Programs that a benchmark starts: on this machine, or each in a namespace of a network."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import time
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import psutil

from benchmarks.harness.network import Network, inside
from benchmarks.harness.processes import descendants
from gspn_framework_package.model.errors import ExecutionError

LAST_WORDS = 20.0
"""Seconds that programs have to end when they are asked to: ``roslaunch`` gives its nodes 15."""

START = 30.0
"""Seconds within which a program must listen."""


class Programs:
    """Runs programs until :meth:`end`.

    :param folder: where their output goes.
    :param network: has the place of each program; None: they all run on this machine.
    """

    def __init__(self, folder: str, network: Optional[Network] = None) -> None:
        self.folder, self.network = folder, network
        self._processes: Dict[str, subprocess.Popen[bytes]] = {}

    def start(
        self,
        name: str,
        words: Sequence[str],
        place: str = "",
        environment: Mapping[str, str] = {},
    ) -> None:
        """Start a program.

        :param name: what to call it.
        :param place: the node or host of the network; "": that of the same name.
        :param environment: what differs from the environment of this process.
        """
        with open(self._output_file(name), "ab") as output:
            self._processes[name] = subprocess.Popen(
                self._command(place or name, words),
                env=self._environment(environment),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def ask(
        self,
        words: Sequence[str],
        place: str = "",
        environment: Mapping[str, str] = {},
        seconds: float = 20.0,
    ) -> Tuple[int, str]:
        """Run a short program; returns its exit code and all that it printed, -1 and "no answer" if
        it takes too long."""
        try:
            done = subprocess.run(
                self._command(place, words),
                env=self._environment(environment),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=seconds,
            )
        except subprocess.TimeoutExpired:
            return -1, "no answer"
        return done.returncode, done.stdout.strip()

    def _command(self, place: str, words: Sequence[str]) -> List[str]:
        return self.network.command(place, words) if self.network is not None else list(words)

    def _environment(self, more: Mapping[str, str]) -> Dict[str, str]:
        environment = {**os.environ, **more}
        if self.network is not None:  # where a name of this machine means nothing
            environment.pop("ROS_HOSTNAME", None)
        return environment

    # -- one program -------------------------------------------------------------------------------

    def pid(self, name: str) -> int:
        """Process id of a program."""
        return self._processes[name].pid

    def alive(self) -> List[str]:
        """The programs that run, or are stopped."""
        return [name for name, process in self._processes.items() if process.poll() is None]

    def ended(self) -> List[str]:
        """The programs that have ended by themselves, unless :meth:`await_end` waited for that."""
        return [name for name, process in self._processes.items() if process.poll() is not None]

    def check(self) -> None:
        """:raises ExecutionError: a program has ended by itself."""
        for name in self.ended():
            code = self._processes[name].returncode
            raise ExecutionError(
                "%s ended with %s: %s" % (name, code, self.said(name)), file=self._output_file(name)
            )

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a program."""
        self._processes[name].send_signal(number)

    def await_end(self, name: str, seconds: float) -> int:
        """Wait until a program has ended; returns its exit code.

        :raises ExecutionError: it still runs after ``seconds``.
        """
        try:
            code = self._processes[name].wait(seconds)
        except subprocess.TimeoutExpired:
            raise ExecutionError("waited %g s for the end of %s" % (seconds, name)) from None
        del self._processes[name]
        return code

    def kill(self, name: str) -> None:
        """Kill a program with all that it started, as a power cut would."""
        process = self._processes.pop(name)
        family = self._family(process)
        process.kill()
        _kill(family)
        process.wait()

    def end(self, *groups: Sequence[str]) -> None:
        """End all programs, one group after the other; kill what does not end within
        :data:`LAST_WORDS`.

        :param groups: what ends after the rest, in this order.
        """
        late = {name for group in groups for name in group}
        for names in ([n for n in self._processes if n not in late], *groups):
            self.stop(*names)

    def stop(self, *names: str) -> None:
        """End these programs, as far as they run, with all that they started."""
        running = [self._processes.pop(name) for name in names if name in self._processes]
        family = [child for process in running for child in self._family(process)]
        for process in running:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                process.send_signal(signal.SIGCONT)
        deadline = time.monotonic() + LAST_WORDS
        for process in running:
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        _kill(family)

    @staticmethod
    def _family(process: Any) -> List[psutil.Process]:
        return descendants(process.pid) if process.poll() is None else []

    def await_port(self, name: str, port: int, place: str = "") -> None:
        """Wait until a program listens on a TCP port.

        :raises ExecutionError: it ended, or takes too long.
        """
        deadline = time.monotonic() + START
        while not self._listens(port, place or name):
            if time.monotonic() > deadline or self._processes[name].poll() is not None:
                raise ExecutionError("%s did not start: %s" % (name, self.said(name)))
            time.sleep(0.05)

    def _listens(self, port: int, place: str) -> bool:
        network = self.network
        if network is None:
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", port)) == 0
        with inside(network.namespace(place)), socket.socket() as probe:
            return probe.connect_ex((network.address(place), port)) == 0

    # -- what they printed -------------------------------------------------------------------------

    def output(self, name: str) -> str:
        """What a program has printed."""
        with open(self._output_file(name), encoding="utf-8", errors="replace") as file:
            return file.read()

    def said(self, name: str) -> str:
        """The last lines that a program printed, in one."""
        return " / ".join(line.strip() for line in self.output(name).strip().splitlines()[-3:])

    def errors(self, name: str) -> List[str]:
        """The errors and tracebacks that a program printed."""
        marks = ("[ERROR]", "[FATAL]", "Traceback")
        lines = self.output(name).splitlines()
        return [line.rstrip() for line in lines if any(mark in line for mark in marks)]

    def _output_file(self, name: str) -> str:
        return os.path.join(self.folder, name + ".txt")


def _kill(processes: Sequence[psutil.Process]) -> None:
    for process in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()
