"""Carries the requests of an operator's program to the robots over Zenoh."""

from __future__ import annotations

import contextlib
import json
import time
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Tuple

from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.team.addressing import SILENCE_PATIENCE, read_status
from gspn_framework_package.team.carrier import OperatorAnswer, OperatorRequest
from gspn_framework_package.team.message_filter import json_object
from gspn_framework_package.team.operator_client import (
    CLIENT_TIME,
    OperatorClient,
    UnreachableError,
)
from gspn_framework_package.team.orders import is_open
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


class ZenohOperator:
    """A session with all robots that can be reached.

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

    def require_orders(self) -> None:
        """:raises ExecutionError: these keys cannot give orders."""
        if not self.gives_orders:
            raise ExecutionError(
                "the keys of %s '%s' cannot give orders" % (self._role, self.name),
                hint="use an operator's keys",
            )

    @property
    def connected(self) -> bool:
        """Whether a router or a listening robot is connected now."""
        return bool(self.session.info.routers_zid() or self.session.info.peers_zid())


class ZenohLine:
    """A :class:`~gspn_framework_package.team.operator_client.RobotLine` over Zenoh; a robot's
    address is the beginning of its keys.

    :param operator: the session with the team.
    :param seconds: time limit of an answer.
    :param closed: called by :meth:`close`.
    """

    def __init__(
        self, operator: ZenohOperator, seconds: float, closed: Callable[[], None] = lambda: None
    ) -> None:
        self._operator, self._seconds, self._closed = operator, seconds, closed
        self._zenoh = zenoh_library()

    def call(
        self,
        address: str,
        robot: str,
        request: OperatorRequest,
        answered: Callable[[Optional[OperatorAnswer]], None],
    ) -> bool:
        """See :class:`RobotLine`. :raises ExecutionError: the keys cannot give orders."""
        operator, at = self._operator, names_in_key(address + "/status")[:2]
        if is_open(request.command):
            key = key_of(*at, "status")
        else:
            operator.require_orders()
            key = key_of(*at, "orders", operator.name)
        if not operator.connected:
            raise UnreachableError("no connection with the team")
        got: List[OperatorAnswer] = []
        body = {n: getattr(request, n) for n in ("command", "robot", "argument")}

        def replied(reply: zenoh.Reply) -> None:
            found = _answer_in(reply)
            if found is not None and found[0] == address and not got:
                got.append(found[1])
                answered(found[1])

        def over() -> None:
            if not got:
                answered(None)

        operator.session.get(
            key,
            self._zenoh.handlers.Callback(replied, over),
            payload=json.dumps(body).encode(),
            timeout=self._seconds,
        )
        return True

    def statuses(self, argument: str) -> Dict[str, Optional[Dict[str, Any]]]:
        """See :class:`RobotLine`; of the robots that answer within :data:`SILENCE_PATIENCE`."""
        found: Dict[str, Optional[Dict[str, Any]]] = {}
        deadline = time.monotonic() + SILENCE_PATIENCE
        # a new session does not know the robots yet
        while not found and time.monotonic() < deadline:
            replies = self._operator.session.get(
                key_of("*", "*", "status"),
                payload=json.dumps({"argument": argument}).encode(),
                target=self._zenoh.QueryTarget.ALL,
                consolidation=self._zenoh.ConsolidationMode.NONE,
                timeout=SILENCE_PATIENCE,
            )
            for at, answer in filter(None, map(_answer_in, replies)):
                status = read_status(answer.message)
                # a robot may answer only for itself
                mine = status is not None and key_of(status["run"], status["robot"]) == at
                found[at] = status if mine else None
            if not found:
                time.sleep(_ATTEMPT)
        return found

    def label(self, address: str) -> str:
        """See :class:`RobotLine`."""
        return robot_at(address)

    def silence(self, address: str) -> ExecutionError:
        """See :class:`RobotLine`."""
        return ExecutionError(
            "%s does not answer an order of '%s'" % (robot_at(address), self._operator.name),
            hint="the routers may not know these keys yet; check that their team.json is up to "
            "date",
        )

    def close(self) -> None:
        """See :class:`RobotLine`."""
        self._closed()


def client_on_zenoh(access: TeamAccess) -> OperatorClient:
    """A client of all robots that can be reached.

    :param access: how to reach the team; to give orders, with an operator's keys.
    :raises GspnError: no session with the team can be opened.
    """
    operator = ZenohOperator(access)
    return OperatorClient(ZenohLine(operator, CLIENT_TIME, operator.close))


def robot_at(address: str) -> str:
    """The robot at an address."""
    return names_in_key(address + "/status")[1]


def _answer_in(reply: zenoh.Reply) -> Optional[Tuple[str, OperatorAnswer]]:
    """The robot that answers, and its answer; None if the reply is not an answer."""
    sample = reply.ok
    answer = json_object(bytes(sample.payload)) if sample is not None else None
    if sample is None or answer is None or not {"success", "message"} <= set(answer):
        return None
    at = key_of(*names_in_key(str(sample.key_expr))[:2])
    return at, OperatorAnswer(answer["success"] is True, str(answer["message"]))
