"""Client for an operator's program over Zenoh: queries the robots and gives orders."""

from __future__ import annotations

import contextlib
import json
import time
from typing import TYPE_CHECKING, Any, Callable, Dict, List, NamedTuple, Optional, Tuple

from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.team.addressing import (
    SILENCE_PATIENCE,
    read_status,
    robots_of_run,
    whom_to_order,
)
from gspn_framework_package.team.carrier import OperatorAnswer, OperatorRequest
from gspn_framework_package.team.message_filter import json_object
from gspn_framework_package.team.orders import ORDERS, is_open
from gspn_framework_package.team.zenoh_session import (
    TeamAccess,
    key_of,
    names_in_key,
    open_session,
    zenoh_library,
)

if TYPE_CHECKING:
    import zenoh

_ATTEMPT = 0.3
"""Seconds after which the search for robots that have not been found yet is repeated."""

UNNAMED = "operator"
"""Name of the operator in a team without keys."""


class RobotAddress(NamedTuple):
    """A robot in a run."""

    run: str
    robot: str


class ZenohOperator:
    """Connects to all robots that can be reached; every call has a deadline.

    :param access: how to reach the team; to give orders, with an operator's keys.
    :raises GspnError: no session with the team can be opened.
    """

    def __init__(self, access: TeamAccess) -> None:
        self.name = access.keys.member.name if access.keys is not None else UNNAMED
        self._role = access.keys.member.role if access.keys is not None else "operator"
        self._zenoh = zenoh_library()
        self.session = open_session(access)

    def close(self) -> None:
        """End the session."""
        with contextlib.suppress(self._zenoh.ZError):
            self.session.close()

    @property
    def gives_orders(self) -> bool:
        """Whether the holder of these keys may give orders; without keys everybody may."""
        return self._role == "operator"

    @property
    def connected(self) -> bool:
        """Whether a router or a listening robot is connected now."""
        return bool(self.session.info.routers_zid() or self.session.info.peers_zid())

    def statuses(self, data: bool = False) -> Dict[RobotAddress, Optional[Dict[str, Any]]]:
        """The status of every robot that answers within :data:`SILENCE_PATIENCE`, with or without
        ``data``; None for one whose answer is not a status."""
        found: Dict[RobotAddress, Optional[Dict[str, Any]]] = {}
        deadline = time.monotonic() + SILENCE_PATIENCE
        # a new session does not know the robots yet
        while not found and time.monotonic() < deadline:
            answers = self._ask(
                key_of("*", "*", "status"), {"argument": "data" * data}, SILENCE_PATIENCE
            )
            for at, answer in answers.items():
                status = read_status(answer.message)
                # a robot may answer only for itself
                mine = status is not None and (status["run"], status["robot"]) == at
                found[at] = status if mine else None
            if not found:
                time.sleep(_ATTEMPT)
        return found

    def order(self, command: str, robot: str, argument: str, run: str = "") -> Tuple[bool, str]:
        """Give an order to a robot that answers, preferably the one that it concerns.

        :param command: the name of the order or question.
        :param robot: the robot that the order concerns.
        :param argument: the argument of the command.
        :param run: the name of the run; required if there are several.
        :returns: whether the order was carried out, and the robot's message.
        :raises ExecutionError: no robot answers, robots of several runs do, or the keys are not an
            operator's.
        """
        at = whom_to_order(robots_of_run(self.statuses(), run), command, robot)
        answer = self._command(at, command, robot, argument)
        if answer is None:
            raise ExecutionError(
                "%s does not answer an order of '%s'" % (at.robot, self.name),
                hint="the routers may not know these keys yet; check that their team.json is up to "
                "date",
            )
        return answer.success, answer.message

    def breakpoints(
        self, argument: str, run: str = ""
    ) -> List[Tuple[str, Optional[OperatorAnswer]]]:
        """Show or set the breakpoints of every robot of a run.

        :param argument: a JSON list of names to set, "" for none.
        :param run: the name of the run; required if there are several.
        :returns: pairs of a robot's name and its answer; None if it does not answer.
        :raises ExecutionError: as :meth:`order`.
        """
        there = sorted(robots_of_run(self.statuses(), run))
        return [(at.robot, self._command(at, "breakpoints", "", argument)) for at in there]

    def _command(
        self, at: RobotAddress, command: str, robot: str, argument: str
    ) -> Optional[OperatorAnswer]:
        if not self.gives_orders:
            raise ExecutionError(
                "the keys of %s '%s' cannot give orders" % (self._role, self.name),
                hint="use an operator's keys",
            )
        request = {"command": command, "robot": robot, "argument": argument}
        return self._ask(
            self._key(at, command), request, ORDERS[command].seconds + SILENCE_PATIENCE
        ).get(at)

    def _key(self, at: RobotAddress, command: str) -> str:
        """The key under which a robot answers a question or an order."""
        if is_open(command):
            return key_of(at.run, at.robot, "status")
        return key_of(at.run, at.robot, "orders", self.name)

    def ask(
        self,
        at: RobotAddress,
        request: OperatorRequest,
        seconds: float,
        answered: Callable[[Optional[OperatorAnswer]], None],
    ) -> None:
        """Ask a robot, or give it an order, without waiting.

        :param seconds: maximum time for the answer.
        :param answered: called once, on a thread of Zenoh, with the answer; with None when the time
            is over or no answer can come.
        """
        got: List[OperatorAnswer] = []
        body = {n: getattr(request, n) for n in ("command", "robot", "argument")}

        def replied(reply: zenoh.Reply) -> None:
            found = _answer_in(reply)
            if found is not None and found[0] == at and not got:
                got.append(found[1])
                answered(found[1])

        def over() -> None:
            if not got:
                answered(None)

        self.session.get(
            self._key(at, request.command),
            self._zenoh.handlers.Callback(replied, over),
            payload=json.dumps(body).encode(),
            timeout=seconds,
        )

    def _ask(
        self, key: str, request: Dict[str, str], seconds: float
    ) -> Dict[RobotAddress, OperatorAnswer]:
        """The answers that arrive within some seconds. Returns when all have answered."""
        replies = self.session.get(
            key,
            payload=json.dumps(request).encode(),
            target=self._zenoh.QueryTarget.ALL,
            consolidation=self._zenoh.ConsolidationMode.NONE,
            timeout=seconds,
        )
        return dict(filter(None, map(_answer_in, replies)))


def _answer_in(reply: zenoh.Reply) -> Optional[Tuple[RobotAddress, OperatorAnswer]]:
    """The robot that answers, and its answer; None if the reply is not an answer."""
    sample = reply.ok
    answer = json_object(bytes(sample.payload)) if sample is not None else None
    if sample is None or answer is None or not {"success", "message"} <= set(answer):
        return None
    at = RobotAddress(*names_in_key(str(sample.key_expr))[:2])
    return at, OperatorAnswer(answer["success"] is True, str(answer["message"]))
