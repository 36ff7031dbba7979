"""Carries the messages of a robot over Zenoh, under the keys defined in
:mod:`~gspn_framework_package.team.zenoh_session`."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from typing import TYPE_CHECKING, Any, Dict, Iterator, List, Tuple

from gspn_framework_package.execution.agreement.interface import EVERYBODY, Send
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.team.carrier import (
    Handlers,
    NotTaken,
    Operator,
    OperatorAnswer,
    OperatorRequest,
)
from gspn_framework_package.team.lanes import Lanes
from gspn_framework_package.team.message_filter import LARGEST_MESSAGE, MessageFilter, json_object
from gspn_framework_package.team.orders import is_open
from gspn_framework_package.team.tcp_patience import SilenceLimit, ports_of
from gspn_framework_package.team.zenoh_body import is_compressed, unwrapped, wrapped
from gspn_framework_package.team.zenoh_session import (
    TeamAccess,
    key_of,
    names_in_key,
    open_session,
    zenoh_library,
)

if TYPE_CHECKING:
    import zenoh

MOST_WAITING = 16
"""How many orders, and how many questions, a robot answers at the same time; more are refused."""

LARGEST_PACK = 60_000
"""Maximum size in bytes of messages that are sent as one; Zenoh fragments larger ones."""

MOST_ALONE = 3
"""Maximum number of receivers to which a message is sent individually in partial synchronisation,
so that no other robot is disturbed; for more receivers it is broadcast."""

HEARD = 1000.0
"""Messages accepted from a robot per second in a channel: slightly more than its lanes let it
send."""

_LOOK = 1.0
"""Seconds between two checks for new connections."""

NAMESAKE_TIME = 1.0
"""Maximum number of seconds to wait, at the start, for an answer from another process of the same
name."""

_MOST_PUBLISHERS = 4096
_MOST_KEYS = 10_000


class ZenohCarrier:
    """The :class:`~gspn_framework_package.team.carrier.Carrier` of one robot over a Zenoh session.

    A message to one robot is sent under that robot's key. A message to several robots is broadcast
    in full synchronisation; in partial synchronisation, if they are few, it is sent to each, so
    that no other robot is disturbed. Messages of one step to the same robots are sent together, as
    a list. Answers are messages as well. Messages are dropped while the connection is congested, so
    that a slow peer does not slow this robot down; the agreement tolerates the loss.

    Orders are accepted from operators under their certificate's name. Create the carrier after the
    last fork.

    :param run: name of the run; messages of other runs do not come here.
    :param access: how to reach the team.
    :param handlers: callbacks for received messages.
    :param partial: whether the plan's synchronisation is partial.
    :raises GspnError: no session with the team can be opened, or another process runs this robot in
        the run.

    :ivar sent: how many messages the robot has sent; a message to several robots counts once.
    """

    def __init__(
        self, robot: str, run: str, access: TeamAccess, handlers: Handlers, partial: bool = False
    ) -> None:
        self.robot, self.run = robot, run
        self.sent = 0
        self._handlers = handlers
        self._partial = partial
        self._proof = "certificate" if access.keys is not None else ""
        self._filter = MessageFilter(LARGEST_MESSAGE, HEARD)
        self._lanes = {"all": Lanes(), "to": Lanes()}
        self._pool = WorkerPool("operator")
        self._room = {"orders": MOST_WAITING, "status": MOST_WAITING}
        self._lock = threading.Lock()
        self._activity = b"{}"
        self._senders: Dict[str, Tuple[str, str]] = {}  # key -> robot and channel
        self._publishers: Dict[Tuple[str, ...], zenoh.Publisher] = {}
        self._zenoh = zenoh_library()
        self._session = open_session(access)
        self._limit = SilenceLimit(ports_of(access.listen), ports_of(access.connect))
        self._limit.apply()  # accepted sockets inherit the option
        # a process that only listens makes no connections later
        self._limited_at = -math.inf if access.connect else math.inf
        try:
            self._refuse_namesake()
            self._declared: List[Any] = self._declare()
        except BaseException:
            self.close()
            raise

    def _refuse_namesake(self) -> None:
        """Refuse to start if another process already runs this robot: the team would admit this one
        as its spare.

        :raises ExecutionError: such a process answers.
        """
        key = key_of(self.run, self.robot, "activity")
        replies = self._session.get(key, timeout=NAMESAKE_TIME)
        if any(reply.ok is not None for reply in replies):
            raise ExecutionError(
                "another process already runs robot '%s' in run '%s'" % (self.robot, self.run),
                hint="stop that process first, or choose another run",
            )

    def _declare(self) -> List[Any]:
        """Subscribe to the team's messages, and answer queries."""
        run, robot, session = self.run, self.robot, self._session
        # handled on the receiving thread: handing over to another thread would cost more
        take = self._zenoh.handlers.Callback(self._on_message, indirect=False)
        return [
            session.declare_subscriber(key_of(run, "*", "all", "*"), take),
            session.declare_subscriber(key_of(run, "*", "to", robot, "*"), take),
            session.declare_queryable(key_of(run, robot, "orders", "*"), self._on_order),
            session.declare_queryable(key_of(run, robot, "status"), self._on_status),
            session.declare_queryable(key_of(run, robot, "activity"), self._on_asked),
        ]

    # -- sending, on the host's worker thread ------------------------------------------------------

    def send(self, sends: List[Send]) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        now = time.monotonic()
        if now >= self._limited_at + _LOOK:  # there may be a new connection
            self._limited_at = now
            self._limit.apply()
        alone = MOST_ALONE if self._partial else 1
        packs: Dict[Tuple[str, ...], List[bytes]] = {}
        while sends:
            message = sends[0].message
            same = [s for s in sends if s.message is message or s.message == message]
            sends = [s for s in sends if s not in same]
            body = _json(message)
            self.sent += 1
            to = {send.to for send in same}
            if len(to) > alone or EVERYBODY in to:
                packs.setdefault(("all",), []).append(body)
                continue
            for robot in to:
                packs.setdefault(("to", robot), []).append(body)
        for channel, bodies in packs.items():
            for pack in _packs(bodies):
                self._put_in_lane(pack, channel)

    def _put_in_lane(self, body: bytes, channel: Tuple[str, ...]) -> None:
        """Send in the next lane, and wait for it if this robot sends fast: messages that arrive in
        the meantime are then answered together."""
        lane, wait = self._lanes[channel[0]].take(time.monotonic())
        if wait > 0:
            time.sleep(wait)
        self._put(wrapped(body), *channel, str(lane))

    def publish_firings(self, firings: List[Dict[str, Any]]) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        # published without checking for subscribers: just after the start or a disconnection they
        # are not known yet
        for pack in _packs([_json(fields) for fields in firings]):
            self._put(pack, "fired")

    def publish_task(self, task: Dict[str, Any]) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        self._put(_json(task), "tasks")

    def publish_activity(self, activity: Dict[str, Any]) -> None:
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
        """Never: watchers over Zenoh read the firings, and query the status."""
        return False

    def publish_team(self, marking: Dict[str, Any], team: Dict[str, Any]) -> None:
        """See :meth:`is_team_watched`."""

    def close(self) -> None:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        self._session.close()

    def refusals(self) -> List[NotTaken]:
        """See :class:`~gspn_framework_package.team.carrier.Carrier`."""
        return self._filter.refusals()

    def _put(self, body: bytes, *rest: str) -> None:
        with contextlib.suppress(self._zenoh.ZError):  # closed, or closing
            self._publisher(*rest).put(body)

    def _publisher(self, *rest: str) -> zenoh.Publisher:
        publisher = self._publishers.get(rest)
        if publisher is None:
            if len(self._publishers) >= _MOST_PUBLISHERS:  # robots come and go: discard the oldest
                self._publishers.pop(next(iter(self._publishers))).undeclare()
            publisher = self._publishers[rest] = self._session.declare_publisher(
                key_of(self.run, self.robot, *rest),
                congestion_control=self._zenoh.CongestionControl.DROP,
                priority=self._zenoh.Priority.DATA_HIGH,
                express=True,
                allowed_destination=self._zenoh.Locality.REMOTE,
            )
        return publisher

    # -- receiving, on Zenoh's threads -------------------------------------------------------------

    def _on_message(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        sender = self._senders.get(key)
        if sender is None:
            _, robot, channel, *_ = names_in_key(key)
            sender = (robot, channel)
            if len(self._senders) < _MOST_KEYS:
                self._senders[key] = sender
        robot, channel = sender
        payload = sample.payload
        if not self._filter.admits(robot, len(payload), time.monotonic(), channel):
            return
        body = bytes(payload)
        if is_compressed(body):
            grown = unwrapped(body, LARGEST_MESSAGE)
            if grown is None:
                self._filter.refuse(robot, "cannot be decompressed")
                return
            if not self._filter.admits(robot, len(grown), time.monotonic(), channel):
                return
            body = grown
        for message in self._filter.read(robot, body):
            self._handlers.received(message)

    def _on_asked(self, query: zenoh.Query) -> None:
        self._reply(query, self._activity, "activity")

    def _on_status(self, query: zenoh.Query) -> None:
        given = self._read(query)
        command = str(given.get("command", ""))
        command = command if is_open(command) else "status"
        argument = str(given.get("argument", ""))
        self._answer(query, OperatorRequest(command, "", argument, self.run), "status")

    def _on_order(self, query: zenoh.Query) -> None:
        operator = names_in_key(str(query.key_expr))[-1]
        given = self._read(query)
        command, robot, argument = (given.get(n, "") for n in ("command", "robot", "argument"))
        if not all(isinstance(text, str) for text in (command, robot, argument)) or not command:
            self._filter.refuse(operator, "an unreadable order")
            self._reply(
                query, _json(OperatorAnswer(False, "not an order")._asdict()), "orders", operator
            )
            return
        request = OperatorRequest(command, robot, argument, self.run)
        self._answer(query, request, "orders", operator)

    def _read(self, query: zenoh.Query) -> Dict[str, Any]:
        """The JSON object in a query; {} if there is none."""
        payload = query.payload
        if payload is None or len(payload) > LARGEST_MESSAGE:
            return {}
        return json_object(bytes(payload)) or {}

    def _answer(self, query: zenoh.Query, request: OperatorRequest, *rest: str) -> None:
        """Answer on a separate thread, because it may take seconds.

        :param rest: the rest of the key: the kind of query, and the operator.
        """
        kind = rest[0]
        operator = Operator(rest[1] if len(rest) > 1 else "", self._proof)
        with self._lock:
            has_room = self._room[kind] > 0
            self._room[kind] -= has_room
        if not has_room:
            self._filter.refuse(operator.name, "too many %s at once" % kind)
            answer = OperatorAnswer(False, "%s is busy with other %s" % (self.robot, kind))
            self._reply(query, _json(answer._asdict()), *rest)
            return

        def work() -> None:
            try:
                answer = self._handlers.command(request, operator)
            except Exception as error:  # must not end a thread of the pool
                answer = OperatorAnswer(False, "%s: %s" % (type(error).__name__, error))
            finally:
                with self._lock:
                    self._room[kind] += 1
            self._reply(query, _json(answer._asdict()), *rest)

        self._pool.submit(work)

    def _reply(self, query: zenoh.Query, body: bytes, *rest: str) -> None:
        # the session is closed, or the client is gone
        with contextlib.suppress(self._zenoh.ZError):
            query.reply(key_of(self.run, self.robot, *rest), body)
            query.drop()


def _packs(bodies: List[bytes]) -> Iterator[bytes]:
    """Pack messages into bodies, as many as fit into each."""
    while bodies:
        size, number = 0, 0
        while number < len(bodies) and (not number or size + len(bodies[number]) <= LARGEST_PACK):
            size += len(bodies[number])
            number += 1
        yield bodies[0] if number == 1 else b"[%s]" % b",".join(bodies[:number])
        bodies = bodies[number:]


def _json(fields: Dict[str, Any]) -> bytes:
    return compact(fields).encode()
