"""A ROS master and a team of real nodes, each a process that can be killed, stopped and
restarted."""

from __future__ import annotations

import contextlib
import glob
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from typing import Any, Callable, Dict, Iterable, List, Optional

from benchmarks.faults import dying_node
from benchmarks.log_tail import LogTail
from benchmarks.plans import tokens_plan
from benchmarks.ports import free_port
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.verifier import Verdict, verify
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import (
    FailureKind,
    FailureRule,
    Plan,
    Synchronisation,
    Timing,
)

RUN = "faults"
BRIEF = "benchmarks.load.brief"

PATIENCE = 120.0
"""Seconds within which the team must do what is expected."""

QUIET = 1.5
"""Seconds without any change after which a team counts as at rest."""


class RestartableMaster:
    """A ROS master that can be killed and restarted on the same port."""

    def __init__(self) -> None:
        self._port = free_port()
        os.environ["ROS_MASTER_URI"] = "http://localhost:%d" % self._port
        os.environ["ROS_HOSTNAME"] = "localhost"
        os.environ.pop("ROS_IP", None)
        self._process: Any = None

    def start(self) -> None:
        """Start it, and wait until it answers."""
        import rosgraph

        self._process = subprocess.Popen(
            ["rosmaster", "--core", "-p", str(self._port)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        deadline = time.monotonic() + 30
        while not rosgraph.is_master_online():
            if time.monotonic() > deadline:
                raise ExecutionError("the ROS master did not start")
            time.sleep(0.05)

    def kill(self) -> None:
        """Kill it (SIGKILL)."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()


class LaunchedTeam:
    """The nodes of a team that executes ``plans/tokens`` with actions of a tenth of a second, or
    another plan.

    :param robots: initial number of robots: ``robot_1`` and so on.
    :param evict_after: see :class:`~gspn_framework_package.model.plan.Timing`.
    :param plan: the other plan, with its own actions.

    :ivar plan: the plan that the team begins with.
    :ivar gone: robots that have left, and must not be restarted.
    """

    def __init__(
        self,
        robots: int,
        mode: Synchronisation,
        evict_after: float,
        plan: Optional[Plan] = None,
    ) -> None:
        self.folder = tempfile.mkdtemp(prefix="gspn_faults_")
        if plan is None:
            plan = tokens_plan()
            plan = replace(plan, actions={p: FunctionAction(BRIEF, p) for p in plan.actions})
        plan = plan.for_robots(robots)
        # on a busy machine an action server may be slow to accept a goal; by default its robot
        # would wait for the operator
        again = FailureRule(FailureKind.RETRY, 1000)
        plan = replace(
            plan,
            on_failure={"*": again},
            synchronisation=mode,
            timing=Timing(evict_after=evict_after),
        )
        self.plan = plan
        with open(os.path.join(self.folder, "plan.json"), "w", encoding="utf-8") as file:
            json.dump(plan_to_json(plan), file)
        self.first = [robot.name for robot in plan.robots]
        self.gone: List[str] = []
        self.logs: Dict[str, LogTail] = {}
        self._processes: Dict[str, Any] = {}
        for name in self.first:
            self.start(name)

    # -- processes ---------------------------------------------------------------------------------

    def start(self, name: str, place: str = "", *arguments: str) -> None:
        """Start or restart a robot's node.

        :param place: the place that the robot enters when it joins.
        """
        words = [
            "_plan:=" + self.folder,
            "_robot:=" + name,
            "_run:=" + RUN,
            "_log_dir:=" + self.folder,
            "_modules:=" + BRIEF.rpartition(".")[0],
        ]
        words += ["__ns:=/" + name, "__name:=executor", "_place:=" + place, *arguments]
        words.append(dying_node.DEATH + self.death_file(name))
        with open(os.path.join(self.folder, name + ".txt"), "ab") as output:
            self._processes[name] = subprocess.Popen(
                [sys.executable, "-m", dying_node.__name__, *words],
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        self.logs.setdefault(name, LogTail(self.log_file(name)))

    def alive(self) -> List[str]:
        """The robots whose processes run (or are stopped)."""
        return [name for name, process in self._processes.items() if process.poll() is None]

    def ended(self) -> List[str]:
        """The robots whose processes have ended although they have not left."""
        return [
            n
            for n, process in self._processes.items()
            if process.poll() is not None and n not in self.gone
        ]

    def pid(self, name: str) -> int:
        """Process id of a robot's node."""
        return int(self._processes[name].pid)

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a robot's process."""
        self._processes[name].send_signal(number)

    def kill(self, name: str) -> None:
        """Send SIGKILL to a robot's process, whatever it is doing."""
        self._processes[name].kill()
        self._processes[name].wait()

    def kill_at_write(self, name: str, told: int) -> str:
        """Make a robot's process die in the middle of a log write, or right after one; returns the
        kind of the record that it wrote.

        :param told: see :mod:`.dying_node`.
        :raises ExecutionError: it wrote nothing for a long time.
        """
        self.signal(name, told)
        self.await_death(name)
        return self.last_written(name)

    def await_death(self, name: str, seconds: float = PATIENCE) -> int:
        """Wait until a robot's process has ended; returns its exit code.

        :raises ExecutionError: it is still running after ``seconds``.
        """
        try:
            return int(self._processes[name].wait(seconds))
        except subprocess.TimeoutExpired:
            raise ExecutionError("waited %g s for the end of %s" % (seconds, name)) from None

    def death_file(self, name: str) -> str:
        """The file of a robot's :class:`~.dying_node.Death`."""
        return os.path.join(self.folder, name + ".death")

    def log_file(self, name: str) -> str:
        """The path of a robot's log."""
        return os.path.join(self.folder, RUN, name + ".jsonl")

    def lose_log(self, name: str) -> None:
        """Move away the log of a robot that is not running; it is kept for the history checker."""
        log = self.log_file(name)
        if os.path.exists(log):
            os.replace(log, "%s.%d.jsonl" % (log[: -len(".jsonl")], time.monotonic_ns()))

    def last_written(self, name: str) -> str:
        """The kind of the last record of a robot's log; the record may be cut."""
        with open(self.log_file(name), "rb") as file:
            line = file.read().splitlines()[-1]
        found = re.match(rb'\{"kind":"(\w+)"', line)
        return found.group(1).decode() if found else "a first few bytes"

    def end(self) -> None:
        """End every node."""
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(signal.SIGTERM)
        for process in self._processes.values():
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def discard(self) -> None:
        """Remove everything that the nodes have written."""
        shutil.rmtree(self.folder, ignore_errors=True)

    # -- questions and orders ----------------------------------------------------------------------

    def order(self, command: str, robot: str, at: str = "", argument: str = "") -> bool:
        """Give the team an order; returns whether it was carried out.

        :param at: the robot whose node receives it; "" for any.
        """
        from gspn_framework_package.ros.operator_client import OperatorClient

        try:
            with contextlib.closing(OperatorClient()) as client:
                client.nodes = [
                    node for node in client.nodes if at in ("", node.namespace.strip("/"))
                ]
                return client.order(command, robot, argument, RUN)[0]
        except ExecutionError:
            return False

    def statuses(self) -> Dict[str, Dict[str, Any]]:
        """The status of every living node.

        :raises ExecutionError: one of them does not answer.
        """
        from gspn_framework_package.ros.operator_client import OperatorClient

        with contextlib.closing(OperatorClient()) as client:
            known = {n.namespace: s for n, s in client.statuses().items() if s and s["run"] == RUN}
        missing = [name for name in self.alive() if "/" + name not in known]
        if missing:
            raise ExecutionError("no answer of %s" % ", ".join(missing))
        return {name: known["/" + name] for name in self.alive()}

    def is_complete(self) -> bool:
        """Whether every living node is active in the team."""
        return all(status["active"] for status in self.statuses().values())

    def read(self, name: str) -> LogTail:
        """A robot's log, as far as it has been written."""
        return self.logs[name].read()

    def wait_until(
        self, condition: Callable[[], bool], what: str, seconds: float = PATIENCE
    ) -> None:
        """Wait for a condition on the team.

        :raises ExecutionError: it did not hold in time.
        """
        deadline = time.monotonic() + seconds
        last = ""
        while time.monotonic() < deadline:
            try:
                if condition():
                    return
            except ExecutionError as error:
                last = str(error)
            time.sleep(0.05)
        raise ExecutionError("waited %g s for %s" % (seconds, what), hint=last or None)

    def present(self) -> List[str]:
        """The robots that have a log and have not left."""
        return [name for name in self.logs if name not in self.gone]

    def wait_for_moves(self, names: Iterable[str], number: int, since: float = 0.0) -> None:
        """Wait until each of these robots has moved ``number`` times after the time ``since`` (0:
        from now on)."""
        begin = since or time.monotonic()
        for name in names:
            self.wait_until(
                lambda name=name: self.read(name).moves(begin) >= number,  # type: ignore[misc]
                "%d moves of %s" % (number, name),
            )

    def entries(self, kind: str, robot: str, since: float) -> List[Dict[str, Any]]:
        """The entries of a kind about a robot that any log has received after time ``since``."""
        return [
            entry
            for log in self.present()
            for entry in self.read(log).entries(kind, since)
            if entry["robot"] == robot
        ]

    def rest(self) -> None:
        """Pause the team, and wait until nothing changes."""
        self.wait_until(lambda: self.order("pause", ""), "a pause of the team")
        last: List[Any] = [None, 0.0]

        def quiet() -> bool:
            told = self.statuses().values()
            now = {(s["log_length"], s["hash"]) for s in told}
            busy = any(s["pending"] or not s["active"] for s in told)
            if busy or len(now) > 1 or now != last[0]:
                last[:] = [now, time.monotonic()]
            return time.monotonic() - last[1] >= QUIET

        self.wait_until(quiet, "all replicas to rest at one position")

    def tracebacks(self) -> List[str]:
        """The robots whose nodes have printed a traceback."""
        found = []
        for name in self.logs:
            with open(os.path.join(self.folder, name + ".txt"), "rb") as file:
                if b"Traceback" in file.read():
                    found.append(name)
        return found

    def verdict(self) -> Verdict:
        """The verdict of the history checker on all logs; call it once the team is at rest and its
        nodes have ended."""
        logs = [
            read_log(path) for path in sorted(glob.glob(os.path.join(self.folder, RUN, "*.jsonl")))
        ]
        return verify(logs, settled=True)


def require(holds: bool, otherwise: str) -> None:
    """Check that something holds.

    :raises ExecutionError: it does not.
    """
    if not holds:
        raise ExecutionError(otherwise)
