"""A round of random faults: a robot is killed (at any time, or while it writes) and restarted with
or without its log; a robot is stopped briefly, or until after its eviction; the ROS master is
killed and restarted; a robot joins; a robot leaves."""

from __future__ import annotations

import random
import signal
import time
from collections import Counter
from typing import Callable, List

from benchmarks.faults import dying_node
from benchmarks.faults.team import FaultyTeam
from benchmarks.harness.master import Master
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Synchronisation

EVICT_AFTER = 3.0

JOINERS = 2
"""Most robots that join in a round."""


class Soak:
    """Injects faults into a team one at a time, and undoes each after some seconds.

    :ivar injected: how often each fault was injected.
    """

    def __init__(
        self, master: Master, robots: int, mode: Synchronisation, source: random.Random
    ) -> None:
        self._master, self._source = master, source
        self.injected: Counter[str] = Counter()
        self.team = FaultyTeam(robots, mode, EVICT_AFTER)
        self._joined = 0

    def run(self, seconds: float) -> None:
        """Inject faults for ``seconds``; then wait until the team is at rest."""
        self.team.wait(self.team.is_complete, "the start")
        deadline = time.monotonic() + seconds
        faults: List[Callable[[], bool]] = [
            self._kill,
            self._kill_in_write,
            self._kill_before_send,
            self._kill_without_log,
            self._stop_briefly,
            self._stop_long,
            self._kill_master,
            self._join,
            self._leave,
        ]
        while time.monotonic() < deadline:
            time.sleep(self._source.uniform(0.5, 3.0))
            fault = self._source.choice(faults)
            if fault():
                self.injected[fault.__name__.strip("_")] += 1
            for name in self.team.ended():  # those started while the master was away
                self.team.start(name)
        self.team.rest()

    def _victim(self) -> str:
        return self._source.choice(sorted(self.team.programs.alive()))

    def _kill(self) -> bool:
        name = self._victim()
        self.team.programs.kill(name)
        time.sleep(self._source.choice([0.0, 0.5, 2.0]))
        self.team.start(name)
        return True

    def _kill_in_write(self) -> bool:
        return self._kill_at_write(dying_node.CUT)

    def _kill_before_send(self) -> bool:
        return self._kill_at_write(dying_node.UNSENT)

    def _kill_at_write(self, told: int) -> bool:
        if not self._is_complete():  # a starting node does not handle the signal yet
            return False
        name = self._victim()
        self.team.programs.signal(name, told)
        time.sleep(self._source.choice([0.5, 2.0]))
        in_write = name not in self.team.programs.alive()
        if not in_write:  # nothing to write, e.g. the other one of two has left
            self.team.programs.kill(name)
            self.injected["kill"] += 1
        self.team.start(name)
        return in_write

    def _kill_without_log(self) -> bool:
        # only one robot at a time may have lost its log, and the others must be able to readmit it
        try:
            told = self.team.statuses()
        except ExecutionError:
            return False
        name = self._victim()
        members = told[name]["members"] if name in told else []
        others = [robot for robot in members if robot in told and robot != name]
        if not all(status["active"] for status in told.values()) or not is_quorum(others, members):
            return False
        self.team.programs.kill(name)
        self.team.lose_log(name)
        self.team.start(name)
        return True

    def _is_complete(self) -> bool:
        try:
            return self.team.is_complete()
        except ExecutionError:
            return False

    def _stop_briefly(self) -> bool:
        return self._stop(self._source.uniform(0.1, 1.5))

    def _stop_long(self) -> bool:
        return self._stop(EVICT_AFTER + self._source.uniform(1.0, 4.0))

    def _stop(self, seconds: float) -> bool:
        name = self._victim()
        self.team.programs.signal(name, signal.SIGSTOP)
        time.sleep(seconds)
        self.team.programs.signal(name, signal.SIGCONT)
        return True

    def _kill_master(self) -> bool:
        self._master.kill()
        time.sleep(self._source.uniform(0.5, 3.0))
        self._master.start()
        return True

    def _join(self) -> bool:
        if self._joined >= JOINERS:
            return False
        self._joined += 1
        self.team.start("joined_%d" % self._joined, "p1")
        return True

    def _leave(self) -> bool:
        leaver = "joined_%d" % self._joined
        if leaver not in self.team.programs.alive() or leaver in self.team.gone:
            return False
        self.team.gone.append(leaver)
        return not self.team.order("leave", leaver)
