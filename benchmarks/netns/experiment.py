"""One team in one network: the building block of every scenario."""

from __future__ import annotations

import shutil
import tempfile
import time
from dataclasses import replace
from typing import Any, Callable, Dict, Mapping, Optional, Sequence, Tuple

from benchmarks.log_tail import LogTail
from benchmarks.netns.gateways import Gateways
from benchmarks.netns.logs import AgreedHistory, check_history
from benchmarks.netns.network import Network
from benchmarks.netns.rules import Cuts, one_way, partition
from benchmarks.netns.team import MASTER, TEAMS, WORK_MODULE, NamespaceTeam
from benchmarks.plans import tokens_plan
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Plan, Synchronisation, Timing

WORK = WORK_MODULE + ".work"

SETTLE = 0.5
"""Seconds after a cut in which pending records may still be written."""

PATIENCE = 40.0
"""Seconds within which an expected event must happen."""


def tokens_work() -> Plan:
    """The net of thesis Figure 6.1 with three robots and short actions. In partial synchronisation,
    the places before a resource or a choice of the policy need the team's agreement; the others are
    private."""
    plan = tokens_plan().for_robots(3)
    return replace(
        plan,
        actions={
            p: None if a is None else FunctionAction(WORK, p) for p, a in plan.actions.items()
        },
    )


class PartitionExperiment:
    """A working team in a network that can be cut. It ends with the ``with`` block, which keeps the
    logs of a failed experiment.

    :param mode: ``full`` or ``partial``.
    :param evict_after: see :class:`~gspn_framework_package.model.plan.Timing`.
    :param delay: one-way delay (s) from any node to any other.
    :param plan: what the team executes; by default three robots execute the net of thesis
        Figure 6.1.
    :param others: more nodes of the network, for programs that are no robots.
    :param transport: ``ros`` or ``zenoh``.
    :param loss: share of the packets that are lost.
    :param behind: robots that are behind a gateway, for each gateway.
    """

    def __init__(
        self,
        mode: str,
        *,
        evict_after: float = 15.0,
        delay: float = 0.0,
        plan: Optional[Plan] = None,
        others: Sequence[str] = (),
        transport: str = "ros",
        loss: float = 0.0,
        behind: Optional[Mapping[str, Sequence[str]]] = None,
    ) -> None:
        self.partial = mode == "partial"
        self.began = self.cut_at = self.healed_at = 0.0
        if plan is None:
            plan = tokens_work()
        plan = replace(plan, synchronisation=Synchronisation(mode), timing=Timing(evict_after, 0.0))
        self.robots = [robot.name for robot in plan.robots]
        self._places = plan.action_places
        gateways = Gateways(behind or {})
        hosts = set(gateways.hosts)
        public = [*(robot for robot in self.robots if robot not in hosts), *gateways.behind]
        self.network = Network([MASTER, *public, *others], delay, loss, gateways)
        self.folder = tempfile.mkdtemp(prefix="gspn_netns_")
        self.team: NamespaceTeam = TEAMS[transport](self.network, plan, self.folder)

    def __enter__(self) -> PartitionExperiment:
        try:
            self.network.__enter__()
            try:
                self.network.verify()
                self.began = time.monotonic()
                self.team.__enter__()
            except BaseException:
                self.network.__exit__()
                raise
        except BaseException:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise
        return self

    def __exit__(self, kind: Any, *_: Any) -> None:
        try:
            self.team.__exit__()
        finally:
            self.network.__exit__()
            if kind is None or not issubclass(kind, Exception):  # no failure, or interrupted
                shutil.rmtree(self.folder, ignore_errors=True)

    def run_beside(self, node: str, words: Sequence[str]) -> None:
        """Start a program in the namespace of a node that is no robot; it must stay until the team
        ends."""
        self.team.programs.start(node, words, "", self.team.environment(node))

    def said(self, node: str) -> str:
        """What a node has printed."""
        return self.team.programs.output(node)

    # -- what the logs say -------------------------------------------------------------------------

    def read(self) -> Dict[str, LogTail]:
        """The robots' logs by name, as far as they have been written."""
        return self.team.programs.read()

    def moves(self, robot: str, begin: float, end: float = float("inf")) -> int:
        """The number of moves of a robot between two times."""
        return self.read()[robot].moves(begin, end)

    def slots(self, robots: Sequence[str], begin: float, end: float = float("inf")) -> int:
        """The number of distinct slots that entered the logs of these robots between two times."""
        logs = self.read()
        return len({s["slot"] for r in robots for s in logs[r].of("slot", begin, end)})

    # -- waiting -----------------------------------------------------------------------------------

    def wait(self, condition: Callable[[], bool], what: str, seconds: float = 0.0) -> float:
        """Wait for a condition; returns when it became true.

        :param seconds: longest wait; 0: the usual time. After a fault TCP may stay silent for as
            long again as the fault lasted.
        :raises ExecutionError: it did not become true in time.
        """
        seconds = seconds or PATIENCE + self.healed_at - self.cut_at
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                raise ExecutionError(
                    "waited %g s in vain for %s" % (seconds, what), file=self.folder
                )
            time.sleep(0.02)
        return time.monotonic()

    def wait_for_moves(self, robots: Sequence[str], number: int, what: str) -> float:
        """Wait until each of these robots has moved ``number`` times from now on; returns when."""
        now = time.monotonic()
        return self.wait(
            lambda: all(self.moves(r, now) >= number for r in robots),
            "%d moves %s" % (number, what),
        )

    def warm_up(self, moves: int = 8) -> None:
        """Wait until every robot has moved a few times."""
        self.wait_for_moves(self.robots, moves, "of each robot before the fault")

    def all_were_everywhere(self) -> bool:
        """Whether each robot has begun an action in every action place, and so is connected to all
        of its servers."""
        return all(
            {g["place"] for g in log.of("goal")} >= set(self._places)
            for log in self.read().values()
        )

    def pass_time(self, seconds: float, since: float = 0.0) -> Tuple[float, float]:
        """Let time pass while watching the nodes; returns (begin, end).

        :param since: the begin; 0: now.
        """
        begin = since or time.monotonic()
        self.wait(
            lambda: bool(self.read()) and time.monotonic() >= begin + seconds,
            "the time to pass",
            seconds + 60,
        )
        return begin, begin + seconds

    # -- the network -------------------------------------------------------------------------------

    def part(self, *groups: Sequence[str]) -> None:
        """Cut the network into groups of nodes."""
        self.cut(partition(groups))

    def drop(self, sources: Sequence[str], targets: Sequence[str]) -> None:
        """Drop everything from a source to a target; the other direction stays open."""
        self.cut(one_way(sources, targets))

    def cut(self, cuts: Cuts) -> None:
        """Cut the traffic of these pairs of nodes, and only that."""
        self.read()
        self.network.cut(cuts)
        self.begin_fault()
        self.network.verify()

    def begin_fault(self) -> None:
        """A fault begins now."""
        self.cut_at = self.healed_at = time.monotonic()

    def end_fault(self) -> None:
        """The fault ends now."""
        self.healed_at = time.monotonic()

    def hold(self, seconds: float) -> None:
        """Leave the network as it is until ``seconds`` after the cut."""
        self.pass_time(seconds, self.cut_at)

    def heal(self) -> None:
        """Let everything through again."""
        self.end_fault()
        self.network.heal()
        self.network.verify()

    def fault(self) -> Tuple[float, float]:
        """(begin, end) of the cut, from the time at which nothing that was in progress before it
        can still be written."""
        return self.cut_at + SETTLE, self.healed_at

    # -- what must hold ----------------------------------------------------------------------------

    def require(self, condition: bool, what: str) -> None:
        """:raises ExecutionError: the condition does not hold."""
        if not condition:
            raise ExecutionError(what, file=self.folder)

    def catch_up(self, behind: Sequence[str], ahead: Sequence[str]) -> float:
        """Wait until the logs of ``behind`` contain everything that ``ahead`` knew when the network
        was healed; returns the seconds from healing until then."""
        logs = self.read()
        known = max(
            1 + max((s["slot"] for s in logs[r].of("slot", 0, self.healed_at)), default=-1)
            for r in ahead
        )
        caught = self.wait(
            lambda: all(self.read()[r].length >= known for r in behind), "the others to catch up"
        )
        return caught - self.healed_at

    def finish(self) -> AgreedHistory:
        """Let every robot move on, then :meth:`rest`.

        :raises GspnError: the replicas differ, or the history is not valid.
        """
        self.wait_for_moves(self.robots, 5, "of each robot at the end")
        return self.rest()

    def rest(self, quiet: float = 0.0) -> AgreedHistory:
        """Pause the team, check that all replicas end in the same state, end the team, and check
        the history.

        :param quiet: how long (s) nothing may change before all counts as in that state.
        :raises GspnError: the replicas differ, or the history is not valid.
        """
        problem = ["not asked"]

        def paused() -> bool:
            problem[0] = self.team.order(self.robots[0], "pause")
            return not problem[0]

        try:
            self.wait(paused, "the team to pause")
        except ExecutionError as error:
            raise ExecutionError("%s: %s" % (error.message, problem[0]), file=self.folder) from None
        last: Tuple[Tuple[int, ...], float] = ((), 0.0)

        def at_rest() -> bool:
            nonlocal last
            written = tuple(len(log.records) for log in self.read().values())
            if not self._alike() or written != last[0]:
                last = (written, time.monotonic())
            return self._alike() and time.monotonic() - last[1] >= quiet

        self.wait(at_rest, "all logs to end alike")
        self.team.end()
        return check_history([self.team.logs[r].path for r in self.robots])

    def _alike(self) -> bool:
        return len({(log.length, log.hash) for log in self.read().values()}) == 1
