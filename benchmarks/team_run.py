"""Runs a team on ROS for a benchmark, with its own master and ``roslaunch``, and reads the robots'
logs.

Nothing subscribes to topics: the times of the firings are read from the event logs, whose monotonic
clock all processes of one host share. So the measurement adds no connections and no messages.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xmlrpc.client
from typing import IO, Any, Dict, List, NamedTuple, Optional, Sequence

from benchmarks.ports import free_port
from benchmarks.processes import (
    MachineLoad,
    ProcessCost,
    cost_of,
    cpu_seconds,
    descendants,
    machine_load,
)
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.model.plan import Plan

LAUNCH_FILES = {"process": "team.launch", "hosted": "hosted.launch"}
"""Mode -> launch file: one process per robot, or all robots hosted in one process."""


class Measurement(NamedTuple):
    """The measurements of one run. Times are in seconds from the start of ``roslaunch``; costs are
    those of the robots' processes over ``window`` seconds, without ``roslaunch`` and the master;
    ``firings`` are per second, of the whole team."""

    started: float
    first_goals: float
    all_fired: Optional[float]
    firings: float
    window: float
    cpu_of_core: float
    master_cpu_of_core: float
    cost: ProcessCost
    machine: MachineLoad


def need_ros() -> None:
    """Check that ROS and the package are available.

    :raises UsageError: they are not.
    """
    if shutil.which("roslaunch") is None or shutil.which("roscore") is None:
        raise UsageError(
            "ROS is not sourced", hint="source the setup.bash of a workspace that has this package"
        )
    found = subprocess.run(
        ["rospack", "find", "gspn_framework_package"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    if found.returncode != 0:
        raise UsageError(
            "ROS does not know gspn_framework_package", hint="build and source the workspace"
        )


class Master:
    """A ROS master on a free port, with a folder for everything that nodes write; it ends with the
    ``with`` block."""

    def __enter__(self) -> Master:
        self.folder = tempfile.mkdtemp(prefix="gspn_bench_")
        port = free_port()
        self.uri = "http://localhost:%d" % port
        self.environment = dict(
            os.environ,
            ROS_MASTER_URI=self.uri,
            ROS_HOSTNAME="localhost",
            ROS_HOME=self.folder,
            ROS_LOG_DIR=os.path.join(self.folder, "log"),
        )
        self.environment.pop("ROS_IP", None)
        self.environment.pop("ROS_NAMESPACE", None)
        self._process = _start(
            ["roscore", "-p", str(port)], self.environment, os.path.join(self.folder, "roscore.txt")
        )
        deadline = time.monotonic() + 30
        while not self._answers():
            if time.monotonic() > deadline or self._process.poll() is not None:
                _end(self._process)
                raise ExecutionError(
                    "the ROS master did not start", file=os.path.join(self.folder, "roscore.txt")
                )
            time.sleep(0.05)
        return self

    def __exit__(self, *_: Any) -> None:
        _end(self._process)
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def pid(self) -> int:
        """Process id of ``roscore``."""
        return self._process.pid

    def process_of(self, node: str) -> int:
        """Process id of a node."""
        address: Any = xmlrpc.client.ServerProxy(self.uri).lookupNode("/bench", node)
        answer: Any = xmlrpc.client.ServerProxy(address[2]).getPid("/bench")
        return int(answer[2])

    def _answers(self) -> bool:
        try:
            answer: Any = xmlrpc.client.ServerProxy(self.uri).getPid("/bench")
            return bool(answer[0] == 1)
        except (OSError, xmlrpc.client.Error):
            return False


def _run_name(number: int) -> str:
    return "bench_%d" % number


class TeamRun:
    """One run of a plan, from the start of ``roslaunch`` to its end; it ends with the ``with``
    block.

    :param mode: a key of :data:`LAUNCH_FILES`.
    :param arguments: further arguments of the launch file.
    """

    _count = 0

    def __init__(
        self, master: Master, plan: Plan, mode: str = "process", arguments: Sequence[str] = ()
    ) -> None:
        TeamRun._count += 1
        self.robots = [robot.name for robot in plan.robots]
        self.folder = os.path.join(master.folder, "run_%d" % TeamRun._count)
        os.makedirs(self.folder)
        with open(os.path.join(self.folder, "plan.json"), "w", encoding="utf-8") as file:
            json.dump(plan_to_json(plan), file)
        self._master = master
        self._run = _run_name(TeamRun._count)
        self._output = os.path.join(self.folder, "roslaunch.txt")
        self._command = [
            "roslaunch",
            "gspn_framework_package",
            LAUNCH_FILES[mode],
            "plan:=" + self.folder,
            "robots:=%d" % len(self.robots),
            "run:=" + self._run,
            "log_dir:=" + self.folder,
            "modules:=benchmarks.load",
            *arguments,
        ]
        self._tails = [
            _Tail(os.path.join(self.folder, self._run, name + ".jsonl")) for name in self.robots
        ]

    @classmethod
    def next_run(cls) -> str:
        """The name that the next run will have."""
        return _run_name(cls._count + 1)

    def __enter__(self) -> TeamRun:
        self.begin = time.monotonic()
        self._process = _start(self._command, self._master.environment, self._output)
        return self

    def __exit__(self, *_: Any) -> None:
        _end(self._process)

    def wait_all_fired(self, timeout: float) -> bool:
        """Wait until every robot has moved; returns whether all did within ``timeout`` seconds of
        the start."""
        waiting = list(self._tails)
        while waiting:
            waiting = [tail for tail in waiting if len(tail.read()) < 2]
            if self._process.poll() is not None:
                raise ExecutionError(
                    "roslaunch ended by itself", file=self._output, hint=_last_lines(self._output)
                )
            if waiting and time.monotonic() - self.begin > timeout:
                return False
            time.sleep(0.05)
        return True

    def measure(self, window: float, timeout: float) -> Measurement:
        """Wait for the first firing of every robot, then measure for ``window`` seconds.

        :raises ExecutionError: the team did not start at all.
        """
        all_fired = self.wait_all_fired(timeout)
        robots, masters = descendants(self._process.pid), descendants(self._master.pid)
        if not robots:
            raise ExecutionError(
                "no robot is running", file=self._output, hint=_last_lines(self._output)
            )
        # exclude what a node does once after its start (it makes connections in the background)
        time.sleep(min(2.0, window / 2))
        before, masters_before, began = cpu_seconds(robots), cpu_seconds(masters), time.monotonic()
        machine = machine_load(window)
        ended = time.monotonic()
        after, masters_after = cpu_seconds(robots), cpu_seconds(masters)
        cost = cost_of(robots)
        for tail in self._tails:
            tail.read()
        moves = sum(1 for tail in self._tails for at in tail.visits[1:] if began <= at < ended)
        elapsed = ended - began
        # a robot's first visit begins with its first goal, its second with its first firing
        firsts = [tail.visits for tail in self._tails]
        headers = [tail.opened for tail in self._tails if tail.opened is not None]
        return Measurement(
            max(headers, default=ended) - self.begin,
            max((visits[0] for visits in firsts if visits), default=ended) - self.begin,
            max(visits[1] for visits in firsts) - self.begin if all_fired else None,
            moves / elapsed,
            elapsed,
            _spent(before, after) / elapsed,
            _spent(masters_before, masters_after) / elapsed,
            cost,
            machine,
        )

    @property
    def logs(self) -> List[str]:
        """The robots' event logs, as far as there are any."""
        return [tail.path for tail in self._tails if os.path.exists(tail.path)]

    def faults(self) -> List[str]:
        """Errors and tracebacks that the nodes have printed."""
        with open(self._output, encoding="utf-8", errors="replace") as file:
            return [
                line.rstrip()
                for line in file
                if "[ERROR]" in line or "[FATAL]" in line or "Traceback" in line
            ]

    def violation(self) -> str:
        """The violation that the history checker finds in the robots' logs after they have ended;
        "" if there is none."""
        found = verify([read_log(path) for path in self.logs]).violation
        return "" if found is None else str(found)


class _Tail:
    """Reads from a robot's log, as far as it has been written, the times at which its visits
    began."""

    def __init__(self, path: str) -> None:
        self.visits: List[float] = []
        self.opened: Optional[float] = None
        self.path = path
        self._file: Optional[IO[str]] = None
        self._rest = ""
        self._visit = -1

    def read(self) -> List[float]:
        if self._file is None:
            if not os.path.exists(self.path):
                return self.visits
            self._file = open(self.path, encoding="utf-8")  # noqa: SIM115
        lines = (self._rest + self._file.read()).split("\n")
        self._rest = lines.pop()
        for line in lines:
            if self.opened is None:
                self.opened = float(json.loads(line)["mono"])
            elif '"kind":"goal"' in line:
                record = json.loads(line)
                if record["visit"] > self._visit:
                    self._visit = record["visit"]
                    self.visits.append(float(record["mono"]))
        return self.visits


def _spent(before: Dict[int, float], after: Dict[int, float]) -> float:
    return sum(seconds - before.get(pid, 0.0) for pid, seconds in after.items())


def _start(command: Sequence[str], environment: Dict[str, str], output: str) -> Any:
    with open(output, "wb") as file:
        return subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def _end(process: Any) -> None:
    """End a process cleanly; after half a minute, end whatever is left of its children."""
    children = descendants(process.pid)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    for child in children:
        if child.is_running():
            try:
                child.kill()
            except Exception as error:  # it has just gone
                print("bench: %s" % error, file=sys.stderr)


def _last_lines(path: str, count: int = 3) -> str:
    with open(path, encoding="utf-8", errors="replace") as file:
        return " / ".join(line.strip() for line in file.readlines()[-count:])
