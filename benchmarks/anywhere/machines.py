"""Who is where in the demonstration, as data: machines behind gateways, and their programs."""

from __future__ import annotations

from typing import Dict, List, NamedTuple, Sequence

from benchmarks.harness.gateways import Gateways

HUB = "hub"
"""The machine with the router, which all others can reach."""

OUTSIDE = "outside"
"""Where the attacker is: it can reach the router, as anybody can."""

ROBOT_KINDS = ("ros", "agent")


class Machine(NamedTuple):
    """A computer. ``gateway``: what it is behind. ``robots``: name -> ``ros``, a node with a master
    on this machine, or ``agent``, a process without ROS. ``page``: whether somebody watches the
    team from there."""

    name: str
    gateway: str
    robots: Dict[str, str]
    page: bool = False

    @property
    def has_master(self) -> bool:
        """Whether a ROS master runs there."""
        return "ros" in self.robots.values()


THREE = (
    Machine("machine_1", "nat_a", {"robot_1": "ros"}),
    Machine("machine_2", "nat_a", {"robot_2": "ros", "robot_3": "agent"}),
    Machine("machine_3", "nat_b", {"robot_4": "agent"}, page=True),
)
"""Three machines behind two gateways, for the four robots of ``plans/patrol``."""


class Sites(NamedTuple):
    """The network of some machines.

    >>> Sites.of(THREE).nodes
    ['hub', 'outside', 'nat_a', 'nat_b']
    >>> Sites.of(THREE).gateways.behind["nat_a"]
    ['machine_1', 'machine_2']
    """

    nodes: List[str]
    gateways: Gateways
    place_of: Dict[str, str]
    """Robot -> its machine."""
    kind_of: Dict[str, str]
    """Robot -> one of :data:`ROBOT_KINDS`."""

    @classmethod
    def of(cls, machines: Sequence[Machine]) -> Sites:
        """The layout. :raises ValueError: a name or a kind of robot is wrong."""
        behind: Dict[str, List[str]] = {}
        place_of: Dict[str, str] = {}
        kind_of: Dict[str, str] = {}
        for machine in machines:
            behind.setdefault(machine.gateway, []).append(machine.name)
            for robot, kind in machine.robots.items():
                if kind not in ROBOT_KINDS:
                    raise ValueError("%s is neither of %s" % (kind, ", ".join(ROBOT_KINDS)))
                if robot in place_of:
                    raise ValueError("%s is on two machines" % robot)
                place_of[robot], kind_of[robot] = machine.name, kind
        nodes = [HUB, OUTSIDE, *behind]
        names = [*nodes, *(machine.name for machine in machines)]
        if len(set(names)) != len(names):
            raise ValueError("two of these have the same name: %s" % ", ".join(names))
        return cls(nodes, Gateways(behind), place_of, kind_of)

    def alone_behind(self, gateway: str) -> List[str]:
        """The robots that are behind a gateway."""
        hosts = self.gateways.behind[gateway]
        return [robot for robot, place in self.place_of.items() if place in hosts]
