"""Carries the messages of a robot over Zenoh; the keys are those of
:mod:`~gspn_framework_package.team.zenoh_session`."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from typing import TYPE_CHECKING, Any, Dict, List

from gspn_framework_package.execution.agreement.interface import EVERYBODY, Send
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.team.carrier import (
    Handlers,
    NotTaken,
    OperatorAnswer,
    OperatorRequest,
)
from gspn_framework_package.team.gate import LARGEST_MESSAGE, MessageGate, json_object
from gspn_framework_package.team.zenoh_session import (
    TeamAccess,
    key_of,
    names_in,
    open_session,
    zenoh_library,
)

if TYPE_CHECKING:
    import zenoh

MOST_WAITING = 16
"""Orders, and questions, that a robot answers at the same time; more are refused."""

_MOST_KEYS = 10_000


class ZenohCarrier:
    """One robot's session; a :class:`~gspn_framework_package.team.carrier.Carrier`.

    A message to one robot goes under that robot's key. In full synchronisation one to several
    robots goes once, to everybody; in partial synchronisation to each alone, so that nobody else
    is disturbed. Answers are messages as well. A message that finds the connection congested is
    dropped, which the agreement copes with: a slow peer does not slow this robot down.

    Orders are taken from operators under their certificate's name. Make it after the last fork.

    :param robot: name of the robot.
    :param run: name of the run; messages of other runs do not come here.
    :param access: how to reach the team.
    :param handlers: what to do with what comes.
    :param partial: whether the plan's synchronisation is partial.
    :raises GspnError: there is no session with the team.

    :ivar sent: how many messages the robot has sent; one to several robots counts once.
    """

    def __init__(
        self, robot: str, run: str, access: TeamAccess, handlers: Handlers, partial: bool = False
    ) -> None:
        self.robot, self.run = robot, run
        self.sent = 0
        self._handlers = handlers
        self._partial = partial
        self._authenticated = access.keys is not None
        self._gate = MessageGate(LARGEST_MESSAGE)
        self._pool = WorkerPool("operator")
        self._room = {"orders": MOST_WAITING, "status": MOST_WAITING}
        self._lock = threading.Lock()
        self._activity = b"{}"
        self._senders: Dict[str, str] = {}
        self._publishers: Dict[str, zenoh.Publisher] = {}
        self._zenoh = zenoh_library()
        self._session = open_session(access)
        self._declared: List[Any] = [
            self._session.declare_subscriber(key_of(run, "*", "all"), self._on_message),
            self._session.declare_subscriber(key_of(run, "*", "to", robot), self._on_message),
            self._session.declare_queryable(key_of(run, robot, "orders", "*"), self._on_order),
            self._session.declare_queryable(key_of(run, robot, "status"), self._on_status),
            self._session.declare_queryable(key_of(run, robot, "activity"), self._on_asked),
        ]

    # -- out, on the host's worker thread ----------------------------------------------------------

    def send(self, sends: List[Send]) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        while sends:
            message = sends[0].message
            same = [s for s in sends if s.message is message or s.message == message]
            sends = [s for s in sends if s not in same]
            body = _json(message)
            self.sent += 1
            if len(same) > 1 and not self._partial:
                self._put(body, "all")
                continue
            for send in same:
                self._put(body, *(("all",) if send.to == EVERYBODY else ("to", send.to)))

    def tell_firing(self, fields: Dict[str, Any]) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        self._put(_json(fields), "fired")

    def tell_activity(self, activity: Dict[str, Any]) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        self._activity = _json(activity)
        self._put(self._activity, "activity")

    def is_watched(self) -> bool:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        with contextlib.suppress(self._zenoh.ZError):
            status: Any = self._publisher("activity").matching_status
            return bool(status.matching)
        return False

    def is_team_watched(self) -> bool:
        """Never: who watches over Zenoh reads the firings, and asks for the status."""
        return False

    def tell_team(self, marking: Dict[str, Any], team: Dict[str, Any]) -> None:
        """See :meth:`is_team_watched`."""

    def close(self) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        self._session.close()

    def refusals(self) -> List[NotTaken]:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        return self._gate.refusals()

    def _put(self, body: bytes, *rest: str) -> None:
        with contextlib.suppress(self._zenoh.ZError):  # closed, or closing
            self._publisher(*rest).put(body)

    def _publisher(self, *rest: str) -> zenoh.Publisher:
        key = key_of(self.run, self.robot, *rest)
        if key not in self._publishers:
            self._publishers[key] = self._session.declare_publisher(
                key,
                congestion_control=self._zenoh.CongestionControl.DROP,
                priority=self._zenoh.Priority.DATA_HIGH,
                express=True,
                allowed_destination=self._zenoh.Locality.REMOTE,
            )
        return self._publishers[key]

    # -- in, on Zenoh's threads --------------------------------------------------------------------

    def _on_message(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        robot = self._senders.get(key)
        if robot is None:
            robot = names_in(key)[1]
            if len(self._senders) < _MOST_KEYS:
                self._senders[key] = robot
        if not self._gate.admits(robot, len(sample.payload), time.monotonic()):
            return
        message = self._gate.read(robot, bytes(sample.payload))
        if message is not None:
            self._handlers.received(message)

    def _on_asked(self, query: zenoh.Query) -> None:
        self._reply(query, self._activity, "activity")

    def _on_status(self, query: zenoh.Query) -> None:
        argument = str(self._read(query).get("argument", ""))
        self._answer(query, OperatorRequest("status", "", argument, self.run), "status")

    def _on_order(self, query: zenoh.Query) -> None:
        operator = names_in(str(query.key_expr))[-1]
        given = self._read(query)
        command, robot, argument = (given.get(n, "") for n in ("command", "robot", "argument"))
        if not all(isinstance(text, str) for text in (command, robot, argument)) or not command:
            self._gate.refuse(operator, "an order that cannot be read")
            self._reply(
                query, _json(OperatorAnswer(False, "not an order")._asdict()), "orders", operator
            )
            return
        request = OperatorRequest(command, robot, argument, self.run)
        self._answer(query, request, "orders", operator)

    def _read(self, query: zenoh.Query) -> Dict[str, Any]:
        """The JSON object that came with a query, {} if there is none."""
        payload = query.payload
        if payload is None or len(payload) > LARGEST_MESSAGE:
            return {}
        return json_object(bytes(payload)) or {}

    def _answer(self, query: zenoh.Query, request: OperatorRequest, *rest: str) -> None:
        """Answer on a thread of its own, because it may take seconds.

        :param rest: of the key: what was asked for, and by which operator.
        """
        kind, operator = rest[0], rest[-1] if len(rest) > 1 and self._authenticated else ""
        with self._lock:
            has_room = self._room[kind] > 0
            self._room[kind] -= has_room
        if not has_room:
            self._gate.refuse(operator, "too many %s at once" % kind)
            answer = OperatorAnswer(False, "%s is busy with other %s" % (self.robot, kind))
            self._reply(query, _json(answer._asdict()), *rest)
            return

        def work() -> None:
            try:
                answer = self._handlers.command(request, operator)
            except Exception as error:  # a thread of the pool must not end with it
                answer = OperatorAnswer(False, "%s: %s" % (type(error).__name__, error))
            finally:
                with self._lock:
                    self._room[kind] += 1
            self._reply(query, _json(answer._asdict()), *rest)

        self._pool.submit(work)

    def _reply(self, query: zenoh.Query, body: bytes, *rest: str) -> None:
        with contextlib.suppress(self._zenoh.ZError):  # the session is closed, or who asked is gone
            query.reply(key_of(self.run, self.robot, *rest), body)
            query.drop()


def _json(fields: Dict[str, Any]) -> bytes:
    return json.dumps(fields, separators=(",", ":")).encode()
