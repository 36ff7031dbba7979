"""Robots that execute a plan: nodes with a ROS master, agents with a router, or ``roslaunch``."""

from __future__ import annotations

import contextlib
import glob
import importlib.util
import json
import os
import shutil
import statistics
import sys
import tempfile
import time
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

import psutil

from benchmarks.harness.log_tail import LogTail
from benchmarks.harness.master import PACKAGE, master_words, ros_environment
from benchmarks.harness.network import Network
from benchmarks.harness.ports import free_port
from benchmarks.harness.processes import (
    MachineLoad,
    ProcessCost,
    cost_of,
    cpu_seconds,
    descendants,
    machine_load,
)
from benchmarks.harness.programs import Programs
from gspn_framework_package.execution.event_log import Record, read_log
from gspn_framework_package.execution.verifier import Verdict, verify
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import ExecutionError, GspnError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.keys import NewMember, make_team

RUN = "bench"

PATIENCE = 120.0
"""Seconds within which a team must do what is expected."""

SETTLE = 3.0
"""Seconds after the start in which robots make connections in the background."""

QUIET = 1.5
"""Seconds without any change after which a team counts as at rest."""

MASTER = "master"
"""The program in the middle, the ROS master or the router, and its place in a network."""

MASTER_PORT = 11311
ROUTER_PORT = 7447
OPERATOR = "ann"

GSPN = (sys.executable, "-m", PACKAGE)
"""The command ``gspn``."""

NODE = """
from gspn_framework_package.ros import node_main
from gspn_framework_package.ros.transport import node_process
node_process.exit_with(node_main.run_execution_node())
"""
"""A program for ``python3 -c``: a robot with ROS."""


def why_no_zenoh() -> str:
    """Why no team can run on Zenoh with keys here; "" if one can."""
    for module, package in (("zenoh", "eclipse-zenoh"), ("cryptography", "cryptography")):
        if importlib.util.find_spec(module) is None:
            return "there is no Python module %s (pip install %s)" % (module, package)
    return ""


class Measurement(NamedTuple):
    """What a team did during a window of time.

    :ivar seconds: length of the window.
    :ivar private: milliseconds from the end of each action to the begin of the next, for the moves
        that need no agreement.
    :ivar coordinated: the same, for those that the team agreed on.
    :ivar cpu: share of a core of the robots, by name "robots", and of other programs that were
        asked for.
    :ivar cost: of the robots' processes at the end.
    """

    seconds: float
    moves: int
    private: List[float]
    coordinated: List[float]
    cpu: Dict[str, float]
    cost: ProcessCost
    machine: MachineLoad

    @property
    def firings_per_s(self) -> float:
        """Firings of the team in a second: each moves one robot."""
        return self.moves / self.seconds

    def latencies(self) -> Dict[str, Any]:
        """Median, 99th percentile and number of both latencies."""
        found: Dict[str, Any] = {}
        for name, values in (("private", self.private), ("coordinated", self.coordinated)):
            if values:
                found[name + "_median_ms"] = round(statistics.median(values), 2)
                found[name + "_p99_ms"] = round(percentile_99(values), 2)
                found[name + "_count"] = len(values)
        return found


def percentile_99(values: Iterable[float]) -> float:
    """The value that 99 % of the values do not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * 0.99))]


def latencies(records: Sequence[Record], since: float) -> Tuple[List[float], List[float]]:
    """The (private, coordinated) latencies (ms) in the records of one robot's log after the
    monotonic time ``since``."""
    private: List[float] = []
    coordinated: List[float] = []
    done: Optional[Tuple[int, float, bool]] = None
    for record in records:
        kind = record["kind"]
        if kind in ("invoked", "private") and record["entry"]["entry"] == "done":
            done = record["entry"]["visit"], record["mono"], kind == "private"
        elif kind == "goal" and done is not None and record["visit"] == done[0] + 1:
            if done[1] >= since:
                (private if done[2] else coordinated).append((record["mono"] - done[1]) * 1000)
            done = None
    return private, coordinated


def needs_of(plan: Plan) -> Tuple[List[str], List[str]]:
    """Where a plan's functions are: files of the plan's folder, and modules that robots have to
    allow."""
    functions = [a.function for a in plan.actions.values() if isinstance(a, FunctionAction)]
    files: List[str] = []
    modules: List[str] = []
    for module in sorted({function.rpartition(".")[0] for function in functions}):
        file = os.path.join(plan.folder or "", *module.split(".")) + ".py"
        if plan.folder and os.path.exists(file):
            files.append(file)
        else:
            modules.append(module)
    return files, modules


class Team:
    """The robots of a team, from the begin of the ``with`` block to its end. Their files stay if
    the block ends with an error.

    :param plan: of all robots. What its functions need is copied, or allowed.
    :param network: has a place for each robot and each program, and ends with the team; None: all
        are on this machine.

    :ivar folder: has the plan, the logs, and the output of the programs.
    :ivar logs: the logs of the robots, as far as they were read.
    :ivar gone: robots that have left.
    :ivar began: when the start began.
    :ivar patience: how long (s) to wait for anything that is expected.
    :ivar keep: whether the files stay in any case.
    """

    def __init__(self, plan: Plan, network: Optional[Network] = None) -> None:
        self.plan, self.network = plan, network
        self.robots = [robot.name for robot in plan.robots]
        self.gone: List[str] = []
        self.began = 0.0
        self.patience = PATIENCE
        self.keep = False
        self.folder = tempfile.mkdtemp(prefix="gspn_team_")
        self.programs = Programs(self.folder, network)
        self.logs = {name: LogTail(self.log_file(name)) for name in self.robots}
        files, self.modules = needs_of(plan)
        for file in files:
            shutil.copy(file, self.folder)
        with open(os.path.join(self.folder, "plan.json"), "w", encoding="utf-8") as target:
            json.dump(plan_to_json(plan), target)

    def __enter__(self) -> Any:
        try:
            if self.network is not None:
                self.network.__enter__()
                self.network.verify()
            self.began = time.monotonic()
            self.start_all()
        except BaseException as error:
            self.__exit__(type(error))
            raise
        return self

    def __exit__(self, kind: Any = None, *_: Any) -> None:
        try:
            self.end()
        finally:
            if self.network is not None:
                self.network.__exit__()
        if self.keep or (kind is not None and issubclass(kind, GspnError)):
            print("logs and output are in %s" % self.folder, file=sys.stderr)
        else:
            shutil.rmtree(self.folder, ignore_errors=True)

    def end(self) -> None:
        """End the other programs, then the robots, then what is in the middle."""
        self.programs.end(self.robots, self.middle())

    def start_all(self) -> None:
        """Start what the robots meet at, and the robots."""
        self.start_middle()
        for robot in self.robots:
            self.start(robot)

    def middle(self) -> List[str]:
        """The programs that the robots meet at."""
        return []

    def start_middle(self) -> None:
        """Start what the robots meet at, and wait until it is there."""

    def start(self, robot: str, place: str = "") -> None:
        """Start a robot, or start it again.

        :param place: the place that it enters when it joins.
        """
        raise NotImplementedError

    def order(self, command: str, robot: str = "", at: str = "", argument: str = "") -> str:
        """Give the team an operator's order; returns "" if it was carried out, otherwise why not.

        :param at: the robot that receives it; "": any.
        """
        raise NotImplementedError

    def environment(self, place: str) -> Dict[str, str]:
        """What the environment of the programs at a place of the network needs."""
        return {}

    def log_file(self, robot: str) -> str:
        """The path of a robot's log."""
        return os.path.join(self.folder, RUN, robot + ".jsonl")

    # -- waiting -----------------------------------------------------------------------------------

    def check(self) -> None:
        """:raises ExecutionError: a program has ended by itself."""
        self.programs.check()

    def read(self) -> Dict[str, LogTail]:
        """The robots' logs by name, as far as they have been written.

        :raises ExecutionError: a program has ended by itself.
        """
        self.check()
        for log in self.logs.values():
            log.read()
        return self.logs

    def wait(self, condition: Callable[[], bool], what: str, seconds: float = 0.0) -> float:
        """Wait for a condition; returns when it became true.

        :param seconds: longest wait; 0: :attr:`patience`.
        :raises ExecutionError: it did not become true in time.
        """
        seconds = seconds or self.patience
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                raise ExecutionError(
                    "waited %g s in vain for %s" % (seconds, what), file=self.folder
                )
            time.sleep(0.02)
        return time.monotonic()

    def wait_for_moves(
        self,
        robots: Optional[Sequence[str]] = None,
        number: int = 1,
        since: Optional[float] = None,
        seconds: float = 0.0,
    ) -> float:
        """Wait until each of these robots (all that are there) has moved ``number`` times after
        ``since`` (from now on); returns when."""
        names = self.present() if robots is None else robots
        begin = time.monotonic() if since is None else since

        def moved() -> bool:
            logs = self.read()
            return all(logs[name].moves(begin) >= number for name in names)

        return self.wait(moved, "%d moves of %s" % (number, ", ".join(names)), seconds)

    def await_steady(self, seconds: float = 0.0) -> None:
        """Wait until every robot has moved to a second place, and then for :data:`SETTLE`.

        :param seconds: longest wait for the moves.
        """
        self.wait_for_moves(number=2, since=0.0, seconds=seconds)
        self.pass_time(SETTLE)

    def pass_time(self, seconds: float, since: float = 0.0) -> Tuple[float, float]:
        """Let time pass while watching the programs; returns (begin, end).

        :param since: the begin; 0: now.
        """
        begin = since or time.monotonic()

        def passed() -> bool:
            self.check()
            return time.monotonic() >= begin + seconds

        self.wait(passed, "the time to pass", seconds + 60)
        return begin, begin + seconds

    def present(self) -> List[str]:
        """The robots that have a log and have not left."""
        return [name for name in self.logs if name not in self.gone]

    def alike(self) -> bool:
        """Whether all logs end at the same slot and the same hash."""
        logs = self.read()
        return len({(logs[name].length, logs[name].hash) for name in self.present()}) == 1

    def rest(self) -> None:
        """Pause the team, and wait until all logs end alike and nothing changes."""
        problem = ""

        def paused() -> bool:
            nonlocal problem
            problem = self.order("pause")
            return not problem

        try:
            self.wait(paused, "a pause of the team")
        except ExecutionError as error:
            error.hint = error.hint or problem
            raise
        last: Tuple[Any, float] = ((), 0.0)

        def at_rest() -> bool:
            nonlocal last
            alike = self.alike()
            written = [len(log.records) for log in self.logs.values()]
            if not alike or written != last[0]:
                last = (written, time.monotonic())
            return alike and time.monotonic() - last[1] >= QUIET

        self.wait(at_rest, "all replicas to rest at one position")

    # -- figures -----------------------------------------------------------------------------------

    def processes(self) -> List[psutil.Process]:
        """The robots' processes."""
        alive = set(self.programs.alive())
        return [psutil.Process(self.programs.pid(name)) for name in self.robots if name in alive]

    def measure(self, window: float, others: Sequence[str] = ()) -> Measurement:
        """Measure for ``window`` seconds, then read the logs.

        :param others: programs whose use of the processor is wanted too.
        """
        parts = {"robots": self.processes()}
        parts.update({name: [psutil.Process(self.programs.pid(name))] for name in others})
        before = {name: sum(cpu_seconds(found).values()) for name, found in parts.items()}
        begin = time.monotonic()
        machine = machine_load(window)
        end = time.monotonic()
        after = {name: sum(cpu_seconds(found).values()) for name, found in parts.items()}
        cost = cost_of(parts["robots"])
        private: List[float] = []
        coordinated: List[float] = []
        moves = 0
        for log in self.read().values():
            moves += log.moves(begin, end)
            mine, agreed = latencies([r for r in log.records if r.get("mono", 0.0) < end], begin)
            private += mine
            coordinated += agreed
        cpu = {name: (after[name] - before[name]) / (end - begin) for name in parts}
        return Measurement(end - begin, moves, private, coordinated, cpu, cost, machine)

    def verdict(self, settled: bool = False) -> Verdict:
        """The verdict of the history checker on all logs.

        :param settled: whether the team was at rest, and its robots have ended since.
        """
        paths = sorted(glob.glob(os.path.join(self.folder, RUN, "*.jsonl")))
        return verify([read_log(path) for path in paths], settled=settled)

    def finish(self) -> Verdict:
        """:meth:`rest`, end the team, and check the logs.

        :raises GspnError: the logs do not end alike, or break a rule.
        """
        self.rest()
        self.end()
        verdict = self.verdict(settled=True)
        if verdict.violation is not None:
            raise ExecutionError("rule %d: %s" % verdict.violation, file=self.folder)
        return verdict


class NodeTeam(Team):
    """Robots with ROS. In a network they have one master, which is in the middle; otherwise that of
    this process (see :class:`~benchmarks.harness.master.Master`)."""

    def middle(self) -> List[str]:
        """See :class:`Team`."""
        return [MASTER] if self.network is not None else []

    def start_middle(self) -> None:
        """See :class:`Team`."""
        for name in self.middle():
            self.programs.start(name, master_words(MASTER_PORT), "", self.environment(name))
            self.programs.await_port(name, MASTER_PORT)

    def start(self, robot: str, place: str = "", *words: str) -> None:
        """See :class:`Team`. :param words: more words of the node's command line."""
        program = node_words(
            robot,
            plan=self.folder,
            robot=robot,
            run=RUN,
            log_dir=self.folder,
            modules=",".join(self.modules),
            place=place,
        )
        self.logs.setdefault(robot, LogTail(self.log_file(robot)))
        self.programs.start(
            robot, [*self.node_program(), *program, *words], "", self.environment(robot)
        )

    def node_program(self) -> Sequence[str]:
        """What runs the node of a robot."""
        return [sys.executable, "-c", NODE]

    def environment(self, place: str) -> Dict[str, str]:
        """See :class:`Team`."""
        if self.network is None:
            return {}
        own, master = self.network.address(place), self.network.address(MASTER)
        return ros_environment(own, "http://%s:%d" % (master, MASTER_PORT), self.folder)

    def order(self, command: str, robot: str = "", at: str = "", argument: str = "") -> str:
        """See :class:`Team`."""
        if self.network is not None:
            where = at or self.robots[0]
            code, said = self.programs.ask([*GSPN, command], where, self.environment(where))
            return "" if code == 0 else said or "it failed"
        from gspn_framework_package.ros.service_line import ServiceLine, client_on_ros

        try:
            with contextlib.closing(client_on_ros()) as client:
                line = client.line
                assert isinstance(line, ServiceLine)
                line.nodes = [name for name in line.nodes if at in ("", name.strip("/"))]
                done, said = client.order(command, robot, argument, RUN)
                return "" if done else said or "it failed"
        except ExecutionError as error:
            return str(error)

    def statuses(self) -> Dict[str, Dict[str, Any]]:
        """The status of each robot that answers."""
        from gspn_framework_package.ros.service_line import client_on_ros

        with contextlib.closing(client_on_ros()) as client:
            return {s["robot"]: s for s in client.statuses().values() if s and s["run"] == RUN}


class OwnMastersTeam(NodeTeam):
    """Robots with ROS in a network, each with a master of its own; programs like those of
    ``fkie_multimaster`` synchronise the masters."""

    def start_middle(self) -> None:
        """See :class:`Team`: here, every robot's master."""
        for robot in self.robots:
            words = master_words(MASTER_PORT)
            self.programs.start(robot + "_master", words, robot, self.environment(robot))
        for robot in self.robots:
            self.programs.await_port(robot + "_master", MASTER_PORT, robot)
            others = [self._master(other) for other in self.robots if other != robot]
            module = "benchmarks.harness.master_sync"
            words = (sys.executable, "-m", module, self._master(robot), *others)
            self.programs.start(robot + "_sync", words, robot)

    def middle(self) -> List[str]:
        """See :class:`Team`."""
        return [robot + kind for kind in ("_sync", "_master") for robot in self.robots]

    def environment(self, place: str) -> Dict[str, str]:
        """See :class:`Team`."""
        assert self.network is not None
        own = self.network.address(place)
        return ros_environment(own, "http://%s:%d" % (own, MASTER_PORT), self.folder)

    def _master(self, robot: str) -> str:
        return self.environment(robot)["ROS_MASTER_URI"]


class AgentTeam(Team):
    """Robots without ROS, and one router.

    :param keys: whether everybody has keys, so that connections are encrypted (mutual TLS).
    """

    hub = MASTER
    """The router, and its place in a network."""

    def __init__(self, plan: Plan, network: Optional[Network] = None, keys: bool = True) -> None:
        super().__init__(plan, network)
        self.has_keys = keys
        self.address = network.address(self.hub) if network is not None else "127.0.0.1"
        self.port = ROUTER_PORT if network is not None else free_port()
        if keys:
            make_team(os.path.join(self.folder, "keys"), self.members(), 1)

    def members(self) -> List[NewMember]:
        """Who gets keys."""
        members = [NewMember(robot, "robot") for robot in self.robots]
        members.append(NewMember(OPERATOR, "operator"))
        return [*members, NewMember(self.hub, "router", (self.address,))]

    def middle(self) -> List[str]:
        """See :class:`Team`."""
        return [self.hub]

    def start_middle(self) -> None:
        """See :class:`Team`."""
        self.start_router()

    def start_router(self) -> None:
        """Start the router, or start it again, and wait until it listens."""
        _, listen, *keys = self.way(self.hub)
        listen = listen.replace(self.address, "0.0.0.0")
        self.programs.start(self.hub, [*GSPN, "router", "--listen", listen, *keys])
        self.programs.await_port(self.hub, self.port)

    def start(self, robot: str, place: str = "") -> None:
        """See :class:`Team`."""
        self.programs.start(robot, self.agent_words(robot))

    def agent_words(self, robot: str) -> List[str]:
        """The command line of a robot."""
        words = [*GSPN, "agent", self.folder, "--robot", robot, "--run", RUN]
        words += ["--log", self.log_file(robot), *self.way(robot)]
        return [*words, "--modules", ",".join(self.modules)] if self.modules else words

    def order(self, command: str, robot: str = "", at: str = "", argument: str = "") -> str:
        """See :class:`Team`; the operator is where the router is."""
        code, said = self.programs.ask([*GSPN, command, *self.way(OPERATOR)], self.hub)
        return "" if code == 0 else said or "it failed"

    def way(self, member: str) -> List[str]:
        """The options with which a member reaches the team."""
        transport = "tls" if self.has_keys else "tcp"
        words = ["--connect", "%s/%s:%d" % (transport, self.address, self.port)]
        keys = ["--keys", os.path.join(self.folder, "keys", member)]
        return words + keys if self.has_keys else words


class LaunchedTeam(NodeTeam):
    """Robots that ``roslaunch`` starts on this machine.

    :param mode: a key of :data:`LAUNCH_FILES`.
    :param arguments: further arguments of the launch file.
    """

    def __init__(self, plan: Plan, mode: str = "process", arguments: Sequence[str] = ()) -> None:
        super().__init__(plan)
        self._file, self._arguments = LAUNCH_FILES[mode], arguments

    def start_all(self) -> None:
        """See :class:`Team`."""
        arguments = {
            "plan": self.folder,
            "robots": len(self.robots),
            "run": RUN,
            "log_dir": self.folder,
            "modules": ",".join(self.modules),
        }
        words = launch_words(self._file, **arguments)
        self.programs.start("launch", [*words, *self._arguments])

    def processes(self) -> List[psutil.Process]:
        """See :class:`Team`: what ``roslaunch`` started, but for the node that collects messages of
        the log."""
        return [p for p in descendants(self.programs.pid("launch")) if p.name() != "rosout"]


LAUNCH_FILES = {"process": "team.launch", "hosted": "hosted.launch"}
"""Mode -> launch file: one process per robot, or all robots hosted in one process."""


def launch_words(file: str, **arguments: Any) -> List[str]:
    """The command line of a ``roslaunch`` of this package."""
    return ["roslaunch", PACKAGE, file, *("%s:=%s" % pair for pair in arguments.items())]


def node_words(namespace: str, **parameters: Any) -> List[str]:
    """The arguments of a robot's node.

    :param parameters: its private parameters.
    """
    words = ["_%s:=%s" % (key, json.dumps(value)) for key, value in parameters.items()]
    return ["__ns:=/" + namespace, "__name:=executor", *words]
