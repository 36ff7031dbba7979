"""One team in one network that can be cut: the building block of every scenario."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Dict, Mapping, Optional, Sequence, Tuple, Type

from benchmarks.harness.gateways import Gateways
from benchmarks.harness.network import Network
from benchmarks.harness.rules import Cuts, one_way, partition
from benchmarks.harness.team import MASTER, AgentTeam, NodeTeam, OwnMastersTeam, Team
from benchmarks.plans import SHORT, tokens_plan
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Plan, Synchronisation, Timing

SETTLE = 0.5
"""Seconds after a cut in which pending records may still be written."""

PATIENCE = 40.0
"""Seconds within which an expected event must happen."""


class PartitionExperiment(Team):
    """A working team in a network that can be cut; see :func:`partition_experiment`.

    :ivar cut_at: when the last fault began.
    :ivar healed_at: when it ended.
    """

    cut_at = healed_at = 0.0
    network: Network

    def __enter__(self) -> PartitionExperiment:
        self.patience = PATIENCE
        super().__enter__()
        return self

    @property
    def partial(self) -> bool:
        """Whether the team's synchronisation is partial."""
        return self.plan.synchronisation is Synchronisation.PARTIAL

    # -- what the logs say -------------------------------------------------------------------------

    def moves(self, robot: str, begin: float, end: float = float("inf")) -> int:
        """The number of moves of a robot between two times."""
        return self.read()[robot].moves(begin, end)

    def slots(self, robots: Sequence[str], begin: float, end: float = float("inf")) -> int:
        """The number of distinct slots that entered the logs of these robots between two times."""
        logs = self.read()
        return len({s["slot"] for r in robots for s in logs[r].of("slot", begin, end)})

    def warm_up(self, moves: int = 8) -> None:
        """Wait until every robot has moved a few times."""
        self.wait_for_moves(number=moves)

    def all_were_everywhere(self) -> bool:
        """Whether each robot has begun an action in every action place, and so is connected to all
        of its servers."""
        return all(
            {g["place"] for g in log.of("goal")} >= set(self.plan.action_places)
            for log in self.read().values()
        )

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
        self.patience = PATIENCE

    def end_fault(self) -> None:
        """The fault ends now. TCP may stay silent for as long again as it lasted."""
        self.healed_at = time.monotonic()
        self.patience = PATIENCE + self.healed_at - self.cut_at

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


class CutNodes(PartitionExperiment, NodeTeam):
    """A team with a ROS master in the middle."""


class CutOwnMasters(PartitionExperiment, OwnMastersTeam):
    """A team with a ROS master for each robot."""


class CutAgents(PartitionExperiment, AgentTeam):
    """A team with a router in the middle, and without ROS."""


TRANSPORTS: Dict[str, Type[PartitionExperiment]] = {
    "ros": CutNodes,
    "masters": CutOwnMasters,
    "zenoh": CutAgents,
}
"""The kind of team for each transport."""


def partition_experiment(
    mode: str,
    *,
    evict_after: float = 15.0,
    delay: float = 0.0,
    plan: Optional[Plan] = None,
    others: Sequence[str] = (),
    transport: str = "ros",
    loss: float = 0.0,
    behind: Optional[Mapping[str, Sequence[str]]] = None,
) -> PartitionExperiment:
    """A team in a network of its own.

    :param mode: ``full`` or ``partial``.
    :param evict_after: see :class:`~gspn_framework_package.model.plan.Timing`.
    :param delay: one-way delay (s) from any node to any other.
    :param plan: what the team executes; by default three robots execute the net of thesis
        Figure 6.1 with short actions. In partial synchronisation, the places before a resource or a
        choice of the policy need the team's agreement; the others are private.
    :param others: more nodes of the network, for programs that are no robots.
    :param transport: a key of :data:`TRANSPORTS`.
    :param loss: share of the packets that are lost.
    :param behind: robots that are behind a gateway, for each gateway.
    """
    plan = replace(
        plan or tokens_plan(SHORT).for_robots(3),
        synchronisation=Synchronisation(mode),
        timing=Timing(evict_after, 0.0),
    )
    gateways = Gateways(behind or {})
    hosts = set(gateways.hosts)
    public = [r.name for r in plan.robots if r.name not in hosts]
    network = Network([MASTER, *public, *gateways.behind, *others], delay, loss, gateways)
    return TRANSPORTS[transport](plan, network)
