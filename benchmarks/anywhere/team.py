"""The team of the demonstration: its keys, its programs on three machines, and what they do."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import shutil
import sys
import time
from typing import Dict, List, Optional, Sequence
from unittest import mock

from benchmarks.anywhere.attacks import ATTACKS, STOLEN, Found
from benchmarks.anywhere.machines import HUB, OUTSIDE, THREE, Machine, Sites
from benchmarks.harness.master import master_words, ros_environment
from benchmarks.harness.network import Network
from benchmarks.harness.team import MASTER_PORT, NODE, OPERATOR, RUN, AgentTeam, node_words
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
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


class AnywhereTeam(AgentTeam):
    """A team of which some robots have ROS, in a network of its own.

    :param machines: who is where.
    """

    hub = HUB
    network: Network

    def __init__(self, machines: Sequence[Machine] = THREE) -> None:
        self.machines = machines
        self.layout = Sites.of(machines)
        network = Network(self.layout.nodes, gateways=self.layout.gateways)
        super().__init__(read_plan(os.path.join(plans_folder(), "patrol")), network)
        self.patience = PATIENCE
        self._make_more_keys()

    # -- keys --------------------------------------------------------------------------------------

    def members(self) -> List[NewMember]:
        """See :class:`~benchmarks.harness.team.AgentTeam`."""
        return [*super().members(), NewMember(STOLEN, "robot"), NewMember(SCREEN, "watcher")]

    def _make_more_keys(self) -> None:
        """The keys that an attacker may have."""
        keys.make_team(self._path("others"), self.members(), 30)
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

    def start_middle(self) -> None:
        """See :class:`~benchmarks.harness.team.Team`: the router, and what each machine has."""
        self.start_router()
        for machine in self.machines:
            if machine.has_master:
                self.start_master(machine.name)
            if machine.page:
                module = "benchmarks.anywhere.watcher"
                words = [sys.executable, "-m", module, "--run", RUN, *self.way(SCREEN)]
                self.programs.start(SCREEN, words, machine.name)

    def middle(self) -> List[str]:
        """See :class:`~benchmarks.harness.team.Team`."""
        return [*(self.master_of(machine.name) for machine in self.machines), HUB]

    @staticmethod
    def master_of(machine: str) -> str:
        """What the ROS master of a machine is called."""
        return machine + "_master"

    def start_master(self, machine: str) -> None:
        """Start the ROS master of a machine, and wait until it listens."""
        name = self.master_of(machine)
        words = master_words(MASTER_PORT)
        self.programs.start(name, words, machine, self.environment(machine))
        self.programs.await_port(name, MASTER_PORT, machine)

    def environment(self, place: str) -> Dict[str, str]:
        """See :class:`~benchmarks.harness.team.Team`."""
        own = self.network.address(place)
        return ros_environment(own, "http://%s:%d" % (own, MASTER_PORT), self.folder)

    def start(self, robot: str, place: str = "") -> None:
        """Start a robot on its machine."""
        machine = self.layout.place_of[robot]
        if self.layout.kind_of[robot] != "ros":
            self.programs.start(robot, self.agent_words(robot), machine)
            return
        parameters = node_words(
            robot,
            plan=self.folder,
            robot=robot,
            run=RUN,
            log_dir=self.folder,
            transport="zenoh",
            router=self.way(robot)[1],
            keys=self._path("keys", robot),
        )
        words = [sys.executable, "-c", NODE, *parameters]
        self.programs.start(robot, words, machine, self.environment(machine))

    def watched(self) -> int:
        """How many firings the one who watches has seen."""
        seen = self.programs.output(SCREEN).split()
        return int(seen[-1]) if seen and seen[-1].isdigit() else 0

    def attack(self, name: str) -> Found:
        """Have the attacker try something; returns what it got.

        :raises ExecutionError: the attack could not even be tried.
        """
        attack = ATTACKS[name]
        endpoint = self.way(OPERATOR)[1]
        words = [name, "--connect", endpoint, "--run", RUN]
        if attack.keys:
            words += ["--keys", self._path(*attack.keys.split("/"))]
            words += ["--name", attack.keys.rsplit("/", 1)[1]]
        else:
            words[2] = endpoint.replace("tls/", "tcp/")
        words += ["--operator", OPERATOR, "--victim-keys", self._path("keys", "robot_4")]
        words += ["--address", self.network.address(OUTSIDE)]
        module = "benchmarks.anywhere.attacks"
        code, said = self.programs.ask(
            [sys.executable, "-m", module, *words], OUTSIDE, seconds=PATIENCE
        )
        found: Found = {}
        with contextlib.suppress(ValueError, IndexError):
            found = json.loads(said.splitlines()[-1])
        if code != 0 or not isinstance(found, dict) or not found:
            raise ExecutionError("the attack '%s' could not be tried: %s" % (name, said[-300:]))
        return found

    # -- what happens ------------------------------------------------------------------------------

    def goes_on(self, robots: Optional[Sequence[str]] = None, number: int = 1) -> float:
        """Wait until each of these robots (all) has moved ``number`` times from now on; returns the
        seconds until then.

        :raises ExecutionError: they do not.
        """
        now = time.monotonic()
        return self.wait_for_moves(robots, number, now) - now

    def speed(self, begin: float, end: float) -> float:
        """Slots that the team decided a second between two times."""
        return max(len(log.of("slot", begin, end)) for log in self.read().values()) / (end - begin)
