"""The network interface that the page needs to watch a team, implemented for ROS
(:mod:`~gspn_framework_package.visualizer.ros_watch`) and for Zenoh
(:mod:`~gspn_framework_package.visualizer.zenoh_connection`)."""

from __future__ import annotations

import contextlib
import queue
import time
from typing import TYPE_CHECKING, Any, Callable, Iterator, List, Optional, Protocol, Set, Tuple

from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.carrier import OperatorAnswer, OperatorRequest
from gspn_framework_package.team.orders import ADOPT_TIME
from gspn_framework_package.visualizer.live_comparison import Departures

if TYPE_CHECKING:
    Replies = queue.SimpleQueue[Tuple[str, Optional[OperatorAnswer]]]
    """Answers, each with the address of the robot."""

STATUS_TIME = 1.5
"""Seconds within which a robot must report the team's state."""

LONGEST_ORDER_TIME = ADOPT_TIME + 1.0
"""Time limit of an order in seconds; allows for the order that takes a robot longest."""


class UnreachableError(Exception):
    """The team cannot be reached at present; the text says why."""


class RobotLine(Protocol):
    """Asks robots; an answer has a time limit, and one robot does not delay another."""

    def call(
        self,
        address: str,
        robot: str,
        request: OperatorRequest,
        answered: Callable[[Optional[OperatorAnswer]], None],
    ) -> bool:
        """Send a request to the robot at an address; return whether an answer may come.

        :param robot: its name; a question (see
            :func:`~gspn_framework_package.team.orders.is_open`) may go without.
        :param answered: is called with the answer on any thread, once or not at all; None: there
            will be none.
        :raises UnreachableError: nobody can be asked.
        """

    def close(self) -> None:
        """Stop waiting for answers."""


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
            simulated world.
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


def ask_robot(
    line: RobotLine, address: str, robot: str, request: OperatorRequest, answers: Replies
) -> bool:
    """Ask a robot and put its answer into a queue; return whether one may come.

    :raises UnreachableError: see :class:`RobotLine`.
    """
    return line.call(address, robot, request, lambda answer: answers.put((address, answer)))


def answers_of(
    line: RobotLine, addresses: List[str], request: OperatorRequest, seconds: float
) -> Iterator[Tuple[str, OperatorAnswer]]:
    """Put a question to robots; yield the answers that come within a time, each with its address.

    :raises UnreachableError: see :class:`RobotLine`.
    """
    answers: Replies = queue.SimpleQueue()
    give_up = time.monotonic() + seconds
    asked = [ask_robot(line, address, "", request, answers) for address in addresses]
    with contextlib.suppress(queue.Empty):
        for _ in range(sum(asked)):
            address, answer = answers.get(timeout=max(0.0, give_up - time.monotonic()))
            if answer is not None:
                yield address, answer
