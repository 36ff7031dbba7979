"""What a hostile or broken program on the ROS network can send to a team: malformed, forged or
replayed protocol messages, floods of them, garbage in service calls, and bytes that are not ROS at
all. After each kind every node must be alive and every robot must still move."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections import Counter
from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple
from urllib.parse import urlparse

from benchmarks.faults.each_in_turn import EVICT_AFTER, MOVES, Tell
from benchmarks.faults.team import FaultyTeam, require
from benchmarks.harness.team import RUN
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.model.plan import Synchronisation

FLOOD = 3.0
"""Duration (s) of each flood."""

DEEP = 100_000
"""Depth of nested brackets: more than any JSON parser accepts."""

LARGE = 8_000_000
"""Characters of a large message."""

Body = Dict[str, Any]


class Hostile:
    """Sends each kind to a team.

    :param tell: called with a description of each step.

    :ivar injected: how many messages of each kind were sent.
    """

    def __init__(self, robots: int, mode: Synchronisation, tell: Tell) -> None:
        self._tell = tell
        self.injected: Counter[str] = Counter()
        self.team = FaultyTeam(robots, mode, EVICT_AFTER)
        self._heard: Dict[Tuple[str, str], Body] = {}
        self._early: List[Any] = []

    def run(self) -> None:
        """Send everything, then wait until the team is at rest.

        :raises ExecutionError: the team did not continue as it must.
        """
        import rospy

        from gspn_framework_package.msg import Agreement

        team = self.team
        if not rospy.core.is_initialized():
            rospy.init_node(
                "gspn_hostile", anonymous=True, disable_signals=True, disable_rosout=True
            )
        self._publisher = rospy.Publisher("/gspn_agreement", Agreement, queue_size=10_000)
        listener = rospy.Subscriber("/gspn_agreement", Agreement, self._listen)
        try:
            team.wait(team.is_complete, "the start")
            team.wait_for_moves(team.robots, MOVES)
            team.wait(lambda: ("hello", team.robots[0]) in self._heard, "a greeting")
            team.wait(
                lambda: self._publisher.get_num_connections() >= len(team.robots), "the connections"
            )
            for name, send in self._attacks():
                self.injected[name] += send()
                team.wait_for_moves(team.robots, MOVES)
                require(
                    not team.ended(),
                    "%s: the nodes of %s have ended" % (name, ", ".join(team.ended())),
                )
                self._tell("%s: all alive, and move" % name)
            team.rest()
            require(not team.tracebacks(), "a traceback in %s" % ", ".join(team.tracebacks()))
        finally:
            listener.unregister()
            self._publisher.unregister()

    def _listen(self, news: Any) -> None:
        try:
            body = json.loads(news.body)
            self._heard[body["kind"], body["from"]] = body
        except (ValueError, KeyError, TypeError, RecursionError):
            return  # one of ours
        if len(self._early) < 300:
            self._early.append(news)

    # -- the kinds ---------------------------------------------------------------------------------

    def _attacks(self) -> Iterator[Tuple[str, Callable[[], int]]]:
        bodies: Dict[str, Callable[[], Any]] = {
            "no JSON": lambda: "{",
            "a list": lambda: [1, 2],
            "brackets in brackets": lambda: "[" * DEEP,
            "a number of a million digits": lambda: '{"kind": %s}' % ("9" * 10**6),
            "no fields": lambda: {"kind": "hello"},
            "not a number": lambda: {
                **self._hello(),
                "length": float("nan"),
                "records": float("inf"),
            },
            "half a character": lambda: {**self._hello(), "log": "\ud800", "hash": "\0"},
            "another version": lambda: {**self._hello(), "version": 1},
            "an unknown kind": lambda: {**self._hello(), "kind": "bye"},
            "a ballot of 4,300 digits": lambda: self._in_name(
                "prepare", ballot=[10**4299, "x", "x"], frozen=True
            ),
            "a negative ballot": lambda: self._in_name("accept", ballot=[-1, "x", "x"], batch=[]),
            "a batch of numbers": lambda: self._in_name(
                "accept", ballot=[99, "x", "x"], batch=[1, 2]
            ),
            "a broken snapshot": lambda: self._in_name(
                "learn", snapshot={"slot": self._length() + 9, "state": {}}
            ),
            "a wrong hash": lambda: {**self._hello(), "hash": "0" * 32},
            "ten ghosts": lambda: self._event(
                *(
                    Item(log_entries.Join("g%d" % i, 0, "p1", "x"), Origin("g%d" % i, 0, 1, "x"))
                    for i in range(10)
                )
            ),
            "a later life": lambda: self._event(self._done(self._last(), 1, incarnation=99)),
            "number a million": lambda: self._event(self._done(self._last(), 10**6)),
            "a robot that nobody knows": lambda: {**self._hello(), "from": "ghost"},
            "text without end": lambda: {**self._hello(), "log": "x" * LARGE},
        }
        for name, body in bodies.items():
            yield name, lambda body=body: self._send_all(body())  # type: ignore[misc]
        yield "what was sent before", self._replay
        yield (
            "a flood of greetings",
            lambda: self._flood(lambda i: {**self._hello(), "from": "ghost%d" % i}),
        )
        yield "a flood of rubbish", lambda: self._flood(lambda i: "[" * 1000)
        yield "services elsewhere", self._elsewhere
        yield "rubbish in service calls", self._calls
        yield "bytes that are no ROS", self._bytes

    def _send_all(self, body: Any) -> int:
        """Publish a body in the name of each robot, twice."""
        text = body if isinstance(body, str) else json.dumps(body)
        for name in self.team.robots:
            for _ in range(2):
                self._publish(name, text)
        return 2 * len(self.team.robots)

    def _publish(self, sender: str, body: str, service_uri: str = "") -> None:
        from gspn_framework_package.msg import Agreement

        self._publisher.publish(
            Agreement(
                run=RUN,
                sender=sender,
                namespace="/" + sender,
                service_uri=service_uri,
                to="",
                body=body,
            )
        )

    def _replay(self) -> int:
        for news in list(self._early):
            self._publisher.publish(news)
        return len(self._early)

    def _flood(self, body: Callable[[int], Any]) -> int:
        sent, end = 0, time.monotonic() + FLOOD
        while time.monotonic() < end:
            made = body(sent)
            self._publish(self.team.robots[0], made if isinstance(made, str) else json.dumps(made))
            sent += 1
            time.sleep(0.001)
        return sent

    def _elsewhere(self) -> int:
        """Claim that every robot's services are at an address where nothing answers."""
        for name in self.team.robots:
            self._publish(name, json.dumps(self._hello(name)), "rosrpc://127.0.0.1:9")
        return len(self.team.robots)

    def _calls(self) -> int:
        import rospy

        from gspn_framework_package.srv import Command, GetPlace, GetState, SetPlace

        texts = [
            "{",
            "[" * DEEP,
            '{"kind": "hello"}',
            json.dumps({**self._hello(), "records": -1}),
            "\ud7ff" * 1000,
        ]
        sent = 0
        for name in self.team.robots:
            for text in texts:
                for service, kind, fields in (
                    ("get_place", GetPlace, {"from_robot": text[:1000], "agreement": text}),
                    ("get_state", GetState, {"from_robot": text[:1000], "agreement": text}),
                    ("set_place", SetPlace, {"place": text, "run": RUN}),
                    ("set_place", SetPlace, {"agreement": text}),
                    (
                        "command",
                        Command,
                        {"command": text, "robot": text, "argument": text, "run": RUN},
                    ),
                    ("command", Command, {"command": "evict", "robot": text, "run": RUN}),
                    ("command", Command, {"command": "fire", "argument": text, "run": RUN}),
                ):
                    with contextlib.suppress(rospy.ServiceException):  # refused
                        rospy.ServiceProxy("/%s/%s" % (name, service), kind)(**fields)
                    sent += 1
        return sent

    def _bytes(self) -> int:
        """Send bytes to the ports of each node: its XML-RPC server, and the server of its topics
        and services."""
        import rosgraph

        master = rosgraph.Master("/gspn_hostile")
        sent = 0
        for name in self.team.robots:
            addresses = [
                master.lookupNode("/%s/executor" % name),
                master.lookupService("/%s/command" % name),
            ]
            for address in addresses:
                found = urlparse(address)
                for data in (
                    b"\xff\xff\xff\xff",
                    b"\x05\x00\x00\x00hello",
                    b"GET / HTTP/1.1\r\n\r\n",
                    b"\0" * 10_000,
                ):
                    with socket.create_connection(
                        (found.hostname or "", found.port or 0), 5
                    ) as connection:
                        connection.settimeout(0.5)
                        with contextlib.suppress(OSError):  # no answer, or connection closed
                            connection.sendall(data)
                            connection.recv(1000)
                    sent += 1
        return sent

    # -- forged messages ---------------------------------------------------------------------------

    def _hello(self, robot: Optional[str] = None) -> Body:
        return dict(self._heard["hello", robot or self.team.robots[0]])

    def _length(self) -> int:
        return int(self._hello()["length"])

    def _last(self) -> str:
        return self.team.robots[-1]

    def _in_name(self, kind: str, **fields: Any) -> Body:
        """A message with the true envelope of the first robot."""
        envelope = ("version", "from", "team", "log", "incarnation", "records", "length", "hash")
        true = self._hello()
        return {
            **{key: true[key] for key in envelope},
            "kind": kind,
            "slot": true["length"],
            **fields,
        }

    def _event(self, *items: Item) -> Body:
        return self._in_name("event", items=[item.to_json() for item in items], vote=True)

    def _done(self, robot: str, number: int, incarnation: Optional[int] = None) -> Item:
        known = self._hello(robot)
        life = known["incarnation"] if incarnation is None else incarnation
        return Item(
            log_entries.Done(robot, life, number), Origin(robot, life, number, known["log"][:8])
        )
