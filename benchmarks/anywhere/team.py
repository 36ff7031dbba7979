"""The team of the demonstration: its keys, its programs on three machines, and what they do."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import shutil
import sys
import time
from typing import Any, Callable, Dict, List, Sequence
from unittest import mock

from benchmarks.anywhere.attacks import ATTACKS, STOLEN, Found
from benchmarks.anywhere.machines import (
    HUB,
    OUTSIDE,
    THREE,
    Machine,
    Sites,
)
from benchmarks.log_tail import LogTail
from benchmarks.netns.logs import AgreedHistory, check_history
from benchmarks.netns.network import Network
from benchmarks.netns.programs import Programs, ros_environment
from benchmarks.netns.team import (
    GSPN,
    MASTER_PORT,
    OPERATOR,
    ROS_MASTER,
    ROUTER_PORT,
    RUN,
    node_words,
)
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.team import keys
from gspn_framework_package.team.keys import NewMember
from gspn_framework_package.team.router import REPLACED

SCREEN = "screen"
"""Who watches."""

PATIENCE = 60.0
"""Seconds within which an expected event must happen."""

_LATE = "robot_8"
"""A robot whose keys the router does not know."""


class AnywhereTeam:
    """The programs, which end with the ``with`` block, as does the network.

    :param folder: for keys, logs and output.
    :param machines: who is where.
    """

    def __init__(self, folder: str, machines: Sequence[Machine] = THREE) -> None:
        self.folder, self.machines = folder, machines
        self.layout = Sites.of(machines)
        self.robots = sorted(self.layout.place_of)
        self.network = Network(self.layout.nodes, gateways=self.layout.gateways)
        paths = {name: os.path.join(folder, RUN, name + ".jsonl") for name in self.robots}
        self.programs = Programs(self.network, folder, paths)
        self._plan = os.path.join(plans_folder(), "patrol")

    def __enter__(self) -> AnywhereTeam:
        self.network.__enter__()
        try:
            self.network.verify()
            self._make_keys()
            self.start_router()
            for machine in self.machines:
                if machine.has_master:
                    self.start_master(machine.name)
                if machine.page:
                    self.start_watch(machine.name)
            for robot in self.robots:
                self.start_robot(robot)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: Any) -> None:
        try:
            self.programs.end(self.robots, [self.master_of(m.name) for m in self.machines], [HUB])
        finally:
            self.network.__exit__()

    # -- keys --------------------------------------------------------------------------------------

    def _make_keys(self) -> None:
        """The team's keys, and those that an attacker may have."""
        members = [NewMember(robot, "robot") for robot in (*self.robots, STOLEN)]
        members += [NewMember(OPERATOR, "operator"), NewMember(SCREEN, "watcher")]
        members.append(NewMember(HUB, "router", (self.network.address(HUB),)))
        keys.make_team(self._path("keys"), members, 30)
        keys.make_team(self._path("others"), members, 30)
        shutil.copytree(self._path("keys"), self._path("expired"))
        yesterday = datetime.timedelta(days=3)
        now = keys._now()
        with mock.patch.object(keys, "_now", lambda: now - yesterday):
            keys.revoke(self._path("expired"), "robot_1")
            keys.add_members(self._path("expired"), [NewMember("robot_1", "robot")], 1)
        shutil.copytree(self._path("keys"), self._path("later"))
        keys.add_members(self._path("later"), [NewMember(_LATE, "robot")], 30)
        shutil.copytree(self._path("keys", STOLEN), self._path("revoked", STOLEN))

    def revoke(self) -> None:
        """Revoke the stolen keys; the router's folder is the one where that is done."""
        keys.revoke(self._path("keys"), STOLEN)
        self.wait(lambda: REPLACED in self.programs.output(HUB), "the router to notice")

    def _path(self, *names: str) -> str:
        return os.path.join(self.folder, *names)

    # -- programs ----------------------------------------------------------------------------------

    @property
    def endpoint(self) -> str:
        """Where the router listens."""
        return "tls/%s:%d" % (self.network.address(HUB), ROUTER_PORT)

    def way(self, member: str) -> List[str]:
        """The options with which a member reaches the team."""
        return ["--connect", self.endpoint, "--keys", self._path("keys", member)]

    def start_router(self) -> None:
        """Start the router, and wait until it listens."""
        listen = ["--listen", "tls/0.0.0.0:%d" % ROUTER_PORT, "--keys", self._path("keys", HUB)]
        self.programs.start(HUB, [*GSPN, "router", *listen])
        self.programs.await_port(HUB, ROUTER_PORT)

    @staticmethod
    def master_of(machine: str) -> str:
        """What the ROS master of a machine is called."""
        return machine + "_master"

    def start_master(self, machine: str) -> None:
        """Start the ROS master of a machine, and wait until it listens."""
        name = self.master_of(machine)
        self.programs.start(name, ROS_MASTER, machine, self._ros(machine))
        self.programs.await_port(name, MASTER_PORT, machine)

    def _ros(self, machine: str) -> Dict[str, str]:
        own = self.network.address(machine)
        return ros_environment(own, own, MASTER_PORT, self.folder)

    def start_robot(self, robot: str) -> None:
        """Start a robot on its machine."""
        machine = self.layout.place_of[robot]
        if self.layout.kind_of[robot] == "ros":
            told = {
                "plan": self._plan,
                "robot": robot,
                "run": RUN,
                "log_dir": self.folder,
                "transport": "zenoh",
                "router": self.endpoint,
                "keys": self._path("keys", robot),
            }
            self.programs.start(robot, node_words(robot, told), machine, self._ros(machine))
            return
        words = ["agent", self._plan, "--robot", robot, "--run", RUN, "--log"]
        words += [self.programs.logs[robot].path, *self.way(robot)]
        self.programs.start(robot, [*GSPN, *words], machine)

    def start_watch(self, machine: str) -> None:
        """Have somebody watch the team from a machine."""
        module = "benchmarks.anywhere.watcher"
        words = [sys.executable, "-m", module, "--run", RUN, *self.way(SCREEN)]
        self.programs.start(SCREEN, words, machine)

    def watched(self) -> int:
        """How many firings the one who watches has seen."""
        seen = self.programs.output(SCREEN).split()
        return int(seen[-1]) if seen and seen[-1].isdigit() else 0

    def order(self, command: str) -> str:
        """Give an order as the operator; returns "" if it was carried out, otherwise why not."""
        code, said = self.programs.ask(HUB, [*GSPN, command, *self.way(OPERATOR)])
        return "" if code == 0 else said or "it failed"

    def attack(self, name: str) -> Found:
        """Have the attacker try something; returns what it got.

        :raises ExecutionError: the attack could not even be tried.
        """
        attack = ATTACKS[name]
        words = [name, "--connect", self.endpoint, "--run", RUN]
        if attack.keys:
            words += ["--keys", self._path(*attack.keys.split("/"))]
            words += ["--name", attack.keys.rsplit("/", 1)[1]]
        else:
            words[2] = self.endpoint.replace("tls/", "tcp/")
        words += ["--operator", OPERATOR, "--victim-keys", self._path("keys", "robot_4")]
        words += ["--address", self.network.address(OUTSIDE)]
        module = "benchmarks.anywhere.attacks"
        code, said = self.programs.ask(
            OUTSIDE, [sys.executable, "-m", module, *words], seconds=PATIENCE
        )
        found: Found = {}
        with contextlib.suppress(ValueError, IndexError):
            found = json.loads(said.splitlines()[-1])
        if code != 0 or not isinstance(found, dict) or not found:
            raise ExecutionError("the attack '%s' could not be tried: %s" % (name, said[-300:]))
        return found

    # -- what happens ------------------------------------------------------------------------------

    def read(self) -> Dict[str, LogTail]:
        """The logs of the robots, as far as they were written."""
        return self.programs.read()

    def wait(self, condition: Callable[[], bool], what: str, seconds: float = PATIENCE) -> float:
        """Wait until a condition holds; returns when.

        :raises ExecutionError: it does not hold in time.
        """
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                raise ExecutionError("waited %g s in vain for %s" % (seconds, what))
            time.sleep(0.02)
        return time.monotonic()

    def goes_on(self, robots: Sequence[str] = (), number: int = 1) -> float:
        """Wait until each of these robots (all) has moved ``number`` times from now on; returns the
        seconds until then.

        :raises ExecutionError: they do not.
        """
        now = time.monotonic()

        def moved() -> bool:
            logs = self.read()
            return all(logs[robot].moves(now) >= number for robot in robots or self.robots)

        what = "%d moves of each of %s" % (number, ", ".join(robots or self.robots))
        return self.wait(moved, what) - now

    def speed(self, begin: float, end: float) -> float:
        """Slots that the team decided a second between two times."""
        return max(len(log.of("slot", begin, end)) for log in self.read().values()) / (end - begin)

    def rest(self) -> AgreedHistory:
        """Pause the team, end the robots, and check their logs.

        :raises GspnError: the logs do not end alike, or break a rule.
        """
        self.wait(lambda: not self.order("pause"), "the team to pause")

        def alike() -> bool:
            return len({(log.length, log.hash) for log in self.read().values()}) == 1

        self.wait(alike, "all logs to end alike")
        self.programs.end(self.robots, [HUB])
        return check_history([self.programs.logs[robot].path for robot in self.robots])
