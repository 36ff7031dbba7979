"""A publisher that writes to its connections directly, for topics with very many connections."""

from __future__ import annotations

import collections
import socket
import threading
from typing import Any, Deque, Optional

import rospy
from rospy.exceptions import TransportTerminated
from rospy.topics import _PublisherImpl

from gspn_framework_package.ros.transport.registration import registered_together

QUEUE_LIMIT = 1000
"""Maximum number of messages queued for a stuck subscriber; beyond it, the oldest is dropped."""


def eager_publisher(name: str, data_class: Any) -> Any:
    """A ``rospy.Publisher`` that has no thread for each subscriber, but never waits for one.

    rospy's own publisher either passes every message to a thread of each connection, which in a
    team of 50 means 49 wake-ups for each message and thousands of threads, or lets one stuck
    subscriber block all others.

    :param name: the name of the topic; no other publisher of this node may use it.
    :param data_class: the class of its messages.
    """
    with registered_together():  # no subscriber connects before the end of the block
        publisher = rospy.Publisher(name, data_class, queue_size=QUEUE_LIMIT)
        implementation = publisher.impl
        implementation.queue_size = None

        def add_connection(transport: Any) -> Any:
            return _PublisherImpl.add_connection(implementation, _EagerConnection(transport))

        implementation.add_connection = add_connection
    return publisher


class _EagerConnection:
    """Wraps a transport: writes what the socket accepts immediately, and starts a thread for the
    rest only while the subscriber is stuck. Otherwise it behaves like the transport."""

    def __init__(self, transport: Any) -> None:
        self._transport = transport
        self._lock = threading.Lock()
        self._waiting: Deque[bytes] = collections.deque()
        self._stuck = False
        self._error: Optional[BaseException] = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write_data(self, data: bytes) -> bool:
        """Send a message, or queue it while the subscriber is stuck; a full queue drops its oldest
        message.

        :raises TransportTerminated: the connection is closed.
        """
        with self._lock:
            if self._error is not None:
                raise TransportTerminated(str(self._error))
            if self._stuck:
                if len(self._waiting) >= QUEUE_LIMIT:
                    self._waiting.popleft()
                self._waiting.append(data)
                return True
            transport = self._transport
            if transport.done or transport.socket is None:
                raise TransportTerminated("connection closed")
            try:
                sent = transport.socket.send(data, socket.MSG_DONTWAIT)
            except BlockingIOError:
                sent = 0
            except OSError as error:
                raise TransportTerminated(str(error)) from error
            if sent < len(data):
                self._stuck = True
                thread = threading.Thread(
                    target=self._write, args=(data[sent:],), name="stuck subscriber", daemon=True
                )
                thread.start()
            else:
                transport.stat_bytes += sent
                transport.stat_num_msg += 1
        return True

    def _write(self, rest: bytes) -> None:
        try:
            while True:
                self._transport.write_data(rest)
                with self._lock:
                    if not self._waiting:
                        self._stuck = False
                        return
                    rest = self._waiting.popleft()
        except Exception as error:  # rospy and sockets raise many kinds of exceptions
            with self._lock:
                self._error = error
