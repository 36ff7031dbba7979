"""Service calls to other robots that end by a deadline, whatever the other side does."""

from __future__ import annotations

import heapq
import itertools
import queue
import threading
import time
from typing import Any, Callable, Dict, List, Optional, Tuple

import genpy
import rospy
from rospy.exceptions import TransportException
from rospy.impl.tcpros_base import DEFAULT_BUFF_SIZE, TCPROSTransport
from rospy.impl.tcpros_service import TCPROSServiceClient

CONNECTIONS_PER_ROBOT = 3
"""Maximum number of simultaneous calls to one robot."""


class ServiceCalls:
    """Calls services of peers, with separate threads for each peer.

    rospy's ``ServiceProxy`` queries the master at every call, and waits indefinitely for a stopped
    process. Here the caller supplies the address, connections persist, and the socket of a call
    that exceeds its deadline is closed, which ends the call with an error. The peer may have
    carried out such a call, so requests must be idempotent.

    :param deadline: seconds that a call may take.
    :ivar failures: how many calls have failed.
    """

    def __init__(self, deadline: float = 1.0) -> None:
        self.deadline = deadline
        self._lines: Dict[str, List[_Line]] = {}
        self._watch = _Watchdog()
        self.failures = 0

    def call(
        self,
        peer: str,
        uri: str,
        service: str,
        service_class: type,
        request: genpy.Message,
        answered: Callable[[Any], None],
        failed: Callable[[], None] = lambda: None,
    ) -> bool:
        """Call a service.

        :param peer: name of the robot; each robot has its own threads.
        :param uri: the address of its services, ``rosrpc://host:port``.
        :param service: absolute name of the service.
        :param answered: receives the response, on another thread; not called if the call fails.
        :param failed: called instead, on another thread, if the call fails.
        :returns: whether the call is made; False if all threads of the peer are busy.
        """
        lines = self._lines.setdefault(peer, [])
        for line in lines:
            if not line.busy:
                break
        else:
            if len(lines) >= CONNECTIONS_PER_ROBOT:
                return False
            line = _Line(self, peer)
            lines.append(line)
        line.busy = True
        line.tasks.put((uri, service, service_class, request, answered, failed))
        return True

    def forget(self, peer: str) -> None:
        """End the threads of a peer."""
        for line in self._lines.pop(peer, []):
            line.tasks.put(None)

    def close(self) -> None:
        """End the threads. Running calls lose their deadline, and end when the peer answers or the
        process ends."""
        for peer in list(self._lines):
            self.forget(peer)
        self._watch.close()


class _Line:
    """A thread with persistent connections to the services of one peer, for one call at a time."""

    def __init__(self, owner: ServiceCalls, peer: str) -> None:
        self.busy = False
        self.tasks: queue.SimpleQueue[Optional[Tuple[Any, ...]]] = queue.SimpleQueue()
        self._owner = owner
        self._connections: Dict[Tuple[str, str], TCPROSTransport] = {}
        threading.Thread(target=self._work, name="calls to " + peer, daemon=True).start()

    def _work(self) -> None:
        while True:
            task = self.tasks.get()
            if task is None:
                break
            uri, service, service_class, request, answered, failed = task
            try:
                response = self._call(uri, service, service_class, request)
            except Exception as error:  # rospy and sockets raise many kinds of exceptions
                self._owner.failures += 1
                rospy.logdebug("calling %s failed: %s", service, error)
                response = None
            self.busy = False
            if response is not None:
                answered(response)
            else:
                failed()
        for transport in self._connections.values():
            transport.close()

    def _call(
        self, uri: str, service: str, service_class: type, request: genpy.Message
    ) -> genpy.Message:
        give_up = time.monotonic() + self._owner.deadline
        transport = self._connections.pop((uri, service), None)
        if transport is None:
            protocol = TCPROSServiceClient(service, service_class, headers={"persistent": "1"})
            transport = TCPROSTransport(protocol, service)
            transport.buff_size = DEFAULT_BUFF_SIZE
            host, port = rospy.core.parse_rosrpc_uri(uri)
            transport.connect(host, port, uri, timeout=self._owner.deadline)
        ticket = self._owner._watch.add(give_up, transport)
        try:
            transport.send_message(request, 0)
            responses = transport.receive_once()
        except BaseException:
            transport.close()
            raise
        finally:
            self._owner._watch.remove(ticket)
        if transport.done or len(responses) != 1:
            transport.close()
            raise TransportException("no answer")
        self._connections[uri, service] = transport
        return responses[0]


class _Watchdog:
    """Closes transports whose deadline has passed, with one thread for all of them."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._due: List[Tuple[float, int]] = []
        self._transports: Dict[int, TCPROSTransport] = {}
        self._numbers = itertools.count()
        self._closed = False
        self._thread: Optional[threading.Thread] = None

    def add(self, give_up: float, transport: TCPROSTransport) -> int:
        with self._changed:
            number = next(self._numbers)
            self._transports[number] = transport
            heapq.heappush(self._due, (give_up, number))
            if self._thread is None:
                self._thread = threading.Thread(target=self._watch, name="deadlines", daemon=True)
                self._thread.start()
            elif self._due[0][1] == number:
                self._changed.notify()
            return number

    def remove(self, number: int) -> None:
        with self._changed:
            self._transports.pop(number, None)

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify()

    def _watch(self) -> None:
        with self._changed:
            while not self._closed:
                while self._due and self._due[0][1] not in self._transports:
                    heapq.heappop(self._due)
                now = time.monotonic()
                if self._due and self._due[0][0] <= now:
                    self._transports.pop(heapq.heappop(self._due)[1]).close()
                else:
                    self._changed.wait(max(0.0, self._due[0][0] - now) if self._due else None)
