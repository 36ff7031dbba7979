"""Client for an operator's program over Zenoh: queries the robots and gives orders."""

from __future__ import annotations

import json
import time
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.team.addressing import (
    PATIENCE,
    read_status,
    robots_of_run,
    whom_to_order,
)
from gspn_framework_package.team.carrier import OperatorAnswer
from gspn_framework_package.team.commands import ORDER_TIME
from gspn_framework_package.team.gate import json_object
from gspn_framework_package.team.zenoh_session import (
    TeamAccess,
    key_of,
    names_in,
    open_session,
    zenoh_library,
)

_ATTEMPT = 0.3
"""Seconds after which robots that nobody has heard of yet are looked for again."""

UNNAMED = "operator"
"""Who gives orders where nobody has keys."""


class RobotAddress(NamedTuple):
    """A robot in a run."""

    run: str
    robot: str


class ZenohOperator:
    """Talks to all robots that can be reached; every call has a deadline.

    :param access: how to reach the team; to give orders, with an operator's keys.
    :raises GspnError: there is no session with the team.
    """

    def __init__(self, access: TeamAccess) -> None:
        self.name = access.keys.member.name if access.keys is not None else UNNAMED
        self._role = access.keys.member.role if access.keys is not None else "operator"
        self._zenoh = zenoh_library()
        self._session = open_session(access)

    def close(self) -> None:
        """End the session."""
        self._session.close()

    def statuses(self, data: bool = False) -> Dict[RobotAddress, Optional[Dict[str, Any]]]:
        """The status of every robot that answers within :data:`PATIENCE`, with or without
        ``data``; None for one whose answer is not a status."""
        found: Dict[RobotAddress, Optional[Dict[str, Any]]] = {}
        deadline = time.monotonic() + PATIENCE
        while not found and time.monotonic() < deadline:  # a new session does not know them yet
            answers = self._ask(key_of("*", "*", "status"), {"argument": "data" * data}, PATIENCE)
            for at, answer in answers.items():
                status = read_status(answer.message)
                # a robot speaks for itself alone
                mine = status is not None and (status["run"], status["robot"]) == at
                found[at] = status if mine else None
            if not found:
                time.sleep(_ATTEMPT)
        return found

    def order(self, command: str, robot: str, argument: str, run: str = "") -> Tuple[bool, str]:
        """Give an order to a robot that answers, preferably the one that it concerns.

        :param command: the command; see the service ``Command``.
        :param robot: the robot that the order concerns.
        :param argument: the argument of the command.
        :param run: only use robots of this run; necessary if there are several runs.
        :returns: whether the order was carried out, and the robot's message.
        :raises ExecutionError: no robot answers, or robots of several runs do, or these keys are
            not an operator's.
        """
        at = whom_to_order(robots_of_run(self.statuses(), run), command, robot)
        answer = self._command(at, command, robot, argument)
        if answer is None:
            raise ExecutionError(
                "%s does not answer an order of '%s'" % (at.robot, self.name),
                hint="the routers may not know these keys yet: is their team.json up to date?",
            )
        return answer.success, answer.message

    def breakpoints(
        self, argument: str, run: str = ""
    ) -> List[Tuple[str, Optional[OperatorAnswer]]]:
        """Show or set the breakpoints of every robot of a run.

        :param argument: a JSON list of names to set, "" for none.
        :param run: the name of the run; necessary if there are several.
        :returns: pairs of a robot's name and its answer; None if it does not answer.
        :raises ExecutionError: as :meth:`order`.
        """
        there = sorted(robots_of_run(self.statuses(), run))
        return [(at.robot, self._command(at, "breakpoints", "", argument)) for at in there]

    def _command(
        self, at: RobotAddress, command: str, robot: str, argument: str
    ) -> Optional[OperatorAnswer]:
        if self._role != "operator":
            raise ExecutionError(
                "the keys of %s '%s' give no orders" % (self._role, self.name),
                hint="use those of an operator",
            )
        request = {"command": command, "robot": robot, "argument": argument}
        key = key_of(at.run, at.robot, "orders", self.name)
        return self._ask(key, request, ORDER_TIME + PATIENCE).get(at)

    def _ask(
        self, key: str, request: Dict[str, str], seconds: float
    ) -> Dict[RobotAddress, OperatorAnswer]:
        """The answers that come within so many seconds. Ends when all have answered."""
        answers: Dict[RobotAddress, OperatorAnswer] = {}
        replies = self._session.get(
            key,
            payload=json.dumps(request).encode(),
            target=self._zenoh.QueryTarget.ALL,
            consolidation=self._zenoh.ConsolidationMode.NONE,
            timeout=seconds,
        )
        for reply in replies:
            sample = reply.ok
            if sample is None:
                continue
            names = names_in(str(sample.key_expr))
            answer = json_object(bytes(sample.payload))
            if answer is None or not {"success", "message"} <= set(answer):
                continue
            answers[RobotAddress(*names[:2])] = OperatorAnswer(
                answer["success"] is True, str(answer["message"])
            )
        return answers
