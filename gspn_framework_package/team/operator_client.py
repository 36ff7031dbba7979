"""The client of an operator's program: asks robots, and gives them orders.

A :class:`RobotLine` carries the requests: on ROS
:class:`~gspn_framework_package.ros.service_line.ServiceLine`, over Zenoh
:class:`~gspn_framework_package.team.zenoh_operator.ZenohLine`.
"""

from __future__ import annotations

import queue
import time
from typing import Any, Callable, Dict, List, Mapping, Optional, Protocol, Tuple

from gspn_framework_package.execution.timed_get import get_within
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.team.addressing import SILENCE_PATIENCE, robots_of_run, whom_to_order
from gspn_framework_package.team.carrier import OperatorAnswer, OperatorRequest
from gspn_framework_package.team.orders import ADOPT_TIME, ORDERS

CLIENT_TIME = ADOPT_TIME + SILENCE_PATIENCE
"""Seconds after which a client receives no more answers."""


class UnreachableError(ExecutionError):
    """The team cannot be reached now; the text says why."""


class RobotLine(Protocol):
    """Sends requests to robots. Each answer has a time limit, and a slow robot does not delay the
    others. A request goes to the address of a robot."""

    def call(
        self,
        address: str,
        robot: str,
        request: OperatorRequest,
        answered: Callable[[Optional[OperatorAnswer]], None],
    ) -> bool:
        """Ask the robot at an address; return whether an answer may come.

        :param robot: its name; may be "" for a question.
        :param answered: called with the answer on any thread, at most once; with None when none can
            come.
        :raises UnreachableError: nobody can be asked.
        """

    def statuses(self, argument: str) -> Dict[str, Optional[Dict[str, Any]]]:
        """The status of every robot that can be reached; None for one without a valid answer.

        :param argument: of the question ``status``.
        :raises ExecutionError: nobody can be asked.
        """

    def label(self, address: str) -> str:
        """An address in words."""

    def silence(self, address: str) -> ExecutionError:
        """The error for a robot that does not answer an order."""

    def close(self) -> None:
        """Stop waiting for answers."""


def ask_robots(
    line: RobotLine, robots: Mapping[str, str], request: OperatorRequest, seconds: float
) -> Dict[str, Optional[OperatorAnswer]]:
    """The answers of robots to a request; None for a robot that does not answer in time.

    :param robots: address -> robot.
    :raises UnreachableError: see :class:`RobotLine`.
    """
    answers: queue.SimpleQueue[Tuple[str, Optional[OperatorAnswer]]] = queue.SimpleQueue()

    def answered_by(address: str) -> Callable[[Optional[OperatorAnswer]], None]:
        return lambda answer: answers.put((address, answer))

    asked = [line.call(at, robot, request, answered_by(at)) for at, robot in robots.items()]
    found: Dict[str, Optional[OperatorAnswer]] = dict.fromkeys(robots)
    deadline = time.monotonic() + seconds
    for _ in range(sum(asked)):
        try:
            address, answer = get_within(answers, deadline - time.monotonic())
        except queue.Empty:
            break
        found[address] = answer
    return found


class OperatorClient:
    """Talks to all robots that can be reached; every call has a deadline.

    A program that no longer needs it calls :meth:`close`.
    """

    def __init__(self, line: RobotLine) -> None:
        self.line = line

    def close(self) -> None:
        """Stop waiting for answers."""
        self.line.close()

    def statuses(self, data: bool = False) -> Dict[str, Optional[Dict[str, Any]]]:
        """The status of every robot, by its address, with or without ``data``; None for one without
        a valid answer."""
        return self.line.statuses("data" * data)

    def order(self, command: str, robot: str, argument: str, run: str = "") -> Tuple[bool, str]:
        """Give an order to a robot that answers, preferably the one that it concerns.

        :param run: the name of the run; required if there are several.
        :returns: whether the order was carried out, and the robot's message.
        :raises ExecutionError: no robot answers, robots of several runs do, or whoever asks may not
            give orders.
        """
        at, answer = self.order_one(robots_of_run(self.statuses(), run), command, robot, argument)
        if answer is None:
            raise self.line.silence(at)
        return answer.success, answer.message

    def order_one(
        self, there: Mapping[str, Dict[str, Any]], command: str, robot: str, argument: str
    ) -> Tuple[str, Optional[OperatorAnswer]]:
        """Give an order to one of the robots of a run. No other gets it too: an order that two
        robots were given might be carried out twice.

        :param there: address -> the status of its robot.
        :returns: the address of the robot that got it, and its answer; None if it does not answer.
        """
        at = whom_to_order(there, command, robot)
        return at, self._ask({at: there[at]}, command, robot, argument)[at]

    def breakpoints(
        self, argument: str, run: str = ""
    ) -> List[Tuple[str, Optional[OperatorAnswer]]]:
        """Show or set the breakpoints of every robot of a run.

        :returns: pairs of a label for a robot and its answer; None if it does not answer.
        :raises ExecutionError: as :meth:`order`.
        """
        answers = self._ask(robots_of_run(self.statuses(), run), "breakpoints", "", argument)
        return [(self.line.label(at), answer) for at, answer in sorted(answers.items())]

    def _ask(
        self, there: Mapping[str, Mapping[str, Any]], command: str, robot: str, argument: str
    ) -> Dict[str, Optional[OperatorAnswer]]:
        """The answers of robots of one run.

        :param there: address -> the status of its robot.
        """
        run = next(iter(there.values()))["run"]
        return ask_robots(
            self.line,
            {at: status["robot"] for at, status in there.items()},
            OperatorRequest(command, robot, argument, run),
            ORDERS[command].seconds + SILENCE_PATIENCE,
        )
