"""Sends protocol messages from robot to robot: on topics and, in partial synchronisation, through
services."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple, Union

import genpy
import rospy

from gspn_framework_package.execution.agreement.interface import EVERYBODY, Message, Send
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.msg import Agreement
from gspn_framework_package.ros.facts import RosFacts
from gspn_framework_package.ros.inbound import ANSWERED, ASKED, InboundMessages, said
from gspn_framework_package.ros.messages import stamped_message
from gspn_framework_package.ros.transport.eager_publisher import eager_publisher
from gspn_framework_package.ros.transport.registration import registered_together
from gspn_framework_package.ros.transport.service_calls import ServiceCalls
from gspn_framework_package.ros.transport.shared_reader import read_on_one_thread
from gspn_framework_package.srv import (
    GetPlace,
    GetPlaceRequest,
    GetState,
    GetStateRequest,
    SetPlace,
    SetPlaceRequest,
)
from gspn_framework_package.team.carrier import NotTaken
from gspn_framework_package.team.host import ReplicaHost

SERVICE_OF_MESSAGE = {
    "prepare": "get_state",
    "pull": "get_state",
    "event": "get_place",
    "accept": "set_place",
    "learn": "set_place",
}
"""Kind of message -> the robot's service that takes it in partial synchronisation."""

AGREEMENT_TOPIC = "/gspn_agreement"

_SERVICES: Dict[str, Tuple[type, Callable[[str, str], genpy.Message]]] = {
    "get_place": (GetPlace, lambda me, body: GetPlaceRequest(from_robot=me, agreement=body)),
    "get_state": (GetState, lambda me, body: GetStateRequest(from_robot=me, agreement=body)),
    "set_place": (SetPlace, lambda me, body: SetPlaceRequest(agreement=body)),
}

RECEIVE_BUFFER = 4096
"""Bytes that are read at once from a peer; longer messages take several reads. rospy allocates
them again for each read on each connection, 65,536 by default."""

MOST_ADDRESSES = 1000
"""Maximum number of unknown senders whose addresses are noted between two hellos."""


class _Peer(NamedTuple):
    namespace: str
    service_uri: str


class _Neighbours:
    """The robots of one run that are hosted in this process, which exchange messages without a
    topic."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._links: Dict[str, Dict[str, Link]] = {}

    def add(self, link: Link) -> None:
        with self._lock:
            self._links[link.run] = {**self._links.get(link.run, {}), link.robot: link}

    def remove(self, link: Link) -> None:
        with self._lock:
            self._links[link.run] = {
                r: other for r, other in self._links[link.run].items() if other is not link
            }

    def of(self, link: Link) -> Dict[str, Link]:
        """Robot -> its link, including ``link`` itself. Do not change the result."""
        return self._links.get(link.run, {})


_NEIGHBOURS = _Neighbours()


class Link(RosFacts):
    """The common part of both links, which carry a replica's messages over ROS (see
    :class:`Carrier`): the agreement topic, which all robots publish and read.

    It publishes and subscribes to ``/gspn_agreement`` (gspn_framework_package/Agreement). Robots
    hosted in the same process exchange messages without it.

    A robot without a message on its topics for three heartbeats has its services called as well.
    Senders that the host does not know get neither a thread nor a connection, since anybody can
    send under any name.

    :param host: the host of the robot; messages of other runs are ignored.
    :param namespace: absolute namespace of the robot.
    :param service_uri: the address of this robot's services, for peers.
    :param inbound: checks what other nodes send.

    :ivar sent: how many messages this robot has sent; a message to several robots counts once.
    """

    def __init__(
        self, host: ReplicaHost, namespace: str, service_uri: str, inbound: InboundMessages
    ) -> None:
        super().__init__(namespace)
        self.robot, self.run = host.robot, host.run
        self._received, self._serve, self._knows = host.receive, host.serve, host.knows
        self._quiet = 3 * host.heartbeat
        self._namespace, self._service_uri = namespace, service_uri
        self._inbound = inbound
        self._node = rospy.get_name()
        self.sent = 0
        self._peers: Dict[str, _Peer] = {}
        self._heard: Dict[str, float] = {}
        self._calls = ServiceCalls()
        self._publisher = eager_publisher(AGREEMENT_TOPIC, Agreement)
        self._subscriber = self._subscribe(AGREEMENT_TOPIC)
        _NEIGHBOURS.add(self)

    def send(self, sends: List[Send]) -> None:
        """Send messages to the robots that they name."""
        raise NotImplementedError

    def refusals(self) -> List[NotTaken]:
        """See :class:`Carrier`."""
        return self._inbound.refusals()

    def close(self) -> None:
        """End the threads of the calls, and unregister from the topic."""
        _NEIGHBOURS.remove(self)
        self._calls.close()
        _unregister(self._subscriber, self._publisher)

    def _publish(self, publisher: rospy.Publisher, to: str, message: Message) -> None:
        """Pass a message to robots in the same process directly, and publish it for the others.

        :param publisher: publishes on the topic that ``to`` reads.
        :param to: the receiving robot; "" is everybody.
        """
        self.sent += 1
        body = compact(message)
        neighbours = self._neighbours()
        if to in neighbours:
            neighbours[to]._received(json.loads(body))
            return
        if not to:
            for link in neighbours.values():
                link._received(json.loads(body))  # a copy for each, since they may keep parts of it
        if self._somebody_else_listens(publisher):
            publisher.publish(self._news(to, body))

    def _neighbours(self) -> Dict[str, Link]:
        return {robot: link for robot, link in _NEIGHBOURS.of(self).items() if link is not self}

    def _somebody_else_listens(self, publisher: rospy.Publisher) -> bool:
        """Whether a node other than this one is connected to the topic."""
        return any(
            connection.endpoint_id != self._node for connection in publisher.impl.connections
        )

    def _news(self, to: str, body: str) -> Agreement:
        return stamped_message(
            Agreement,
            run=self.run,
            sender=self.robot,
            namespace=self._namespace,
            service_uri=self._service_uri,
            to=to,
            body=self._inbound.sealed(to, body, said(self._namespace, self._service_uri)),
        )

    def _subscribe(self, topic: str) -> rospy.Subscriber:
        with registered_together():  # no publisher is connected before the end of the block
            subscriber = rospy.Subscriber(
                topic, Agreement, self._on_message, buff_size=RECEIVE_BUFFER, tcp_nodelay=True
            )
            read_on_one_thread(subscriber)
        return subscriber

    def _on_message(self, news: Agreement) -> None:
        if news._connection_header.get("callerid") == self._node:
            return  # our own, or from a robot in this process, which has passed it on directly
        if news.run != self.run or news.to not in ("", self.robot):
            self._inbound.pass_by(news.body, news._connection_header)
            return
        message = self._inbound.read(
            news.body, news._connection_header, said(news.namespace, news.service_uri), news.sender
        )
        if message is None:
            return
        is_new = news.sender not in self._peers
        if news.sender != self.robot and not (is_new and len(self._peers) >= MOST_ADDRESSES):
            self._peers[news.sender] = _Peer(news.namespace, news.service_uri)
            self._heard[news.sender] = time.monotonic()
        self._received(message)

    def _call_quiet(self, to: str, message: Message) -> None:
        """Call the services of robots that are quiet on their topics. After a partition, TCP waits
        about as long as the partition lasted (at most two minutes) before it retransmits; a new
        call gets through at once."""
        service = SERVICE_OF_MESSAGE.get(message.get("kind", ""), "get_place")
        now = time.monotonic()
        for name in self._known_peers(to):
            if now - self._heard.get(name, now) > self._quiet:
                self._call(name, service, compact(message))

    def _known_peers(self, to: str) -> List[str]:
        """The robot ``to``, or all robots with an address; unknown robots are forgotten."""
        names = [to] if to else list(self._peers)
        for name in names:
            if not self._knows(name):
                self._forget(name)
        return [name for name in names if name in self._peers]

    def _forget(self, name: str) -> None:
        self._peers.pop(name, None)
        self._heard.pop(name, None)
        self._calls.forget(name)

    def _call(self, name: str, service: str, body: str) -> None:
        peer = self._peers.get(name)
        if peer is None or not peer.service_uri:
            return  # its address is unknown; this is the same as a lost message
        self.sent += 1
        service_class, request = _SERVICES[service]
        self._calls.call(
            name,
            peer.service_uri,
            rospy.names.ns_join(peer.namespace, service),
            service_class,
            request(self.robot, self._inbound.sealed(name, body, ASKED)),
            lambda response: self._answered(name, response),
        )

    def _answered(self, name: str, response: genpy.Message) -> None:
        if not response.agreement:
            return  # an empty reply
        message = self._inbound.read(
            response.agreement, response._connection_header, ANSWERED, name
        )
        if message is not None:
            self._received(message)


class TopicLink(Link):
    """Sends all messages on topics (full synchronisation): messages to several robots on the
    agreement topic, messages to one robot into its *inbox*, so that the others need not read them.

    It subscribes to ``NAMESPACE/agreement`` and publishes on the inboxes of the robots to which it
    sends messages (gspn_framework_package/Agreement). While an inbox is not connected, its messages
    go on the agreement topic.
    """

    def __init__(
        self, host: ReplicaHost, namespace: str, service_uri: str, inbound: InboundMessages
    ) -> None:
        super().__init__(host, namespace, service_uri, inbound)
        self._inboxes: Dict[str, Any] = {}
        self._pool = WorkerPool("inboxes")
        self._inbox = self._subscribe(_inbox_of(namespace))

    def send(self, sends: List[Send]) -> None:
        """Send messages; a message to several robots is sent once, to everybody."""
        while sends:
            to, message = sends[0]
            same = [s for s in sends if s.message is message or s.message == message]
            sends = [s for s in sends if s not in same]
            one = to if len(same) == 1 else EVERYBODY
            inbox = self._connected_inbox(one) if one else None
            self._publish(inbox or self._publisher, one, message)
            self._call_quiet(one, message)

    def close(self) -> None:
        """Unregister from all topics."""
        _unregister(self._inbox, *filter(None, list(self._inboxes.values())))
        super().close()

    def _connected_inbox(self, robot: str) -> Optional[rospy.Publisher]:
        peer = self._peers.get(robot)
        if peer is None:
            return None
        name = _inbox_of(peer.namespace)
        if name not in self._inboxes:
            if not self._knows(robot):
                return None
            self._inboxes[name] = None
            self._pool.submit(lambda: self._open(name))  # blocks while there is no master
        inbox = self._inboxes[name]
        return inbox if inbox is not None and inbox.get_num_connections() else None

    def _open(self, name: str) -> None:
        self._inboxes[name] = eager_publisher(name, Agreement)

    def _forget(self, name: str) -> None:
        peer = self._peers.get(name)
        inbox = self._inboxes.pop(_inbox_of(peer.namespace), None) if peer is not None else None
        if inbox is not None:
            self._pool.submit(lambda: _unregister(inbox))  # it calls the master
        super()._forget(name)


def _unregister(*topics: Union[rospy.Publisher, rospy.Subscriber]) -> None:
    for topic in topics:
        with contextlib.suppress(rospy.ROSException):  # rospy may have closed it already
            topic.unregister()


def _inbox_of(namespace: str) -> str:
    return str(rospy.names.ns_join(namespace, "agreement"))


class ServiceLink(Link):
    """Sends messages through the services of the receiving robots (partial synchronisation);
    messages that are not requests of a service go on the topic.

    It calls ``get_place``, ``get_state`` and ``set_place`` in the namespaces of the other robots,
    which it learns from their messages on the topic.
    """

    def send(self, sends: List[Send]) -> None:
        """Send each message as the request of its service; one without a service goes on the
        topic."""
        for to, message in sends:
            service = SERVICE_OF_MESSAGE.get(message.get("kind", ""))
            if service is None:
                self._publish(self._publisher, to, message)
                self._call_quiet(to, message)
                continue
            body = compact(message)
            neighbours = self._neighbours()
            near = [name for name in neighbours if to in ("", name)]
            for name in near if to in neighbours else [*near, *self._known_peers(to)]:
                if name in neighbours:
                    self.sent += 1
                    neighbours[name]._serve(json.loads(body), self._replied)
                else:
                    self._call(name, service, body)

    def _replied(self, message: Message) -> None:
        if message:
            self._received(json.loads(json.dumps(message)))
