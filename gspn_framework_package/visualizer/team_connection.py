"""The network interface that the page needs to watch a team, implemented for ROS
(:mod:`~gspn_framework_package.visualizer.ros_watch`) and for Zenoh
(:mod:`~gspn_framework_package.visualizer.zenoh_connection`)."""

from __future__ import annotations

from typing import Any, Callable, Protocol, Set

from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.operator_client import RobotLine
from gspn_framework_package.team.orders import ADOPT_TIME
from gspn_framework_package.visualizer.live_comparison import Departures

STATUS_TIME = 1.5
"""Seconds within which a robot must report the team's state."""

LONGEST_ORDER_TIME = ADOPT_TIME + 1.0
"""Time limit of an order in seconds; allows for the order that takes a robot longest."""


class TeamConnection(Protocol):
    """The network interface of a watch. An address identifies the endpoint of a robot.

    :cvar says: what the page shows, in words.
    :cvar where: where other runs were heard, in words.
    :ivar orders: whether the page may give orders.
    """

    says: str
    where: str
    orders: bool

    def open(self, seen: Callable[[str, Any], None]) -> None:
        """Start watching.

        :param seen: takes, on any thread, ``"fired"`` and a
            :class:`~gspn_framework_package.visualizer.fired_follower.FiredMessage`; ``"activity"``
            with the address of a robot and what it does; ``"room"`` and ``"world"`` with data of a
            simulated world, or ``"map"`` and ``"poses"`` with where real robots are.
        """

    def find(self) -> Set[str]:
        """The addresses of all robots known so far, of any run; make new ones report what they do.

        :raises UnreachableError: the search is not possible.
        """

    def line(self, seconds: float) -> RobotLine:
        """A line with this time limit for answers."""

    def label(self, address: str) -> str:
        """An address in words."""

    def why_unheard(self) -> str:
        """Why no firing may be heard although the robots answer."""

    def report(self, text: str) -> None:
        """Log a line for the operator of the server, at most every few seconds."""

    def report_departures(self, plan: Plan, run: str, found: Departures) -> None:
        """Report once a second, on a separate thread, whether the run matches the prediction."""

    def close(self) -> None:
        """Stop watching."""
