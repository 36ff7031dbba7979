"""Reads the connections of a topic with very many publishers on one thread."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import select
import socket
import threading
import time
from functools import partial
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple

import rospy
from rospy.impl.tcpros_base import TCPROSTransport

Callback = Callable[[List[Any], Any], None]
"""Takes messages and the connection on which they came."""


def read_on_one_thread(subscriber: rospy.Subscriber) -> None:
    """Read future connections of a subscriber on one thread, which all subscribers passed to this
    function share. rospy has a thread for each, which takes about 50 kB.

    A connection still has rospy's thread until it is set up, and again when it has ended or
    delivered something unreadable. Where there is no ``epoll``, rospy's threads read.

    :param subscriber: has no connection yet; its callbacks must not block, but may call
        :func:`hold_up`.
    """
    if not hasattr(select, "epoll"):
        return
    implementation = subscriber.impl

    def add_connection(connection: Any) -> Any:
        connection.receive_loop = partial(_start_reading, connection)
        return type(implementation).add_connection(implementation, connection)

    implementation.add_connection = add_connection


def hold_up(seconds: float) -> None:
    """Stop reading a connection for some time. Call this from the callback that takes its messages;
    on any other thread, this sleeps.

    :param seconds: added to the times of earlier calls for the same messages.
    """
    if _reader is not None and threading.current_thread() is _reader.thread:
        _reader.hold += seconds
    else:
        time.sleep(seconds)


def _start_reading(connection: Any, callback: Callback) -> None:
    """Replaces ``receive_loop`` of a connection: returns at once."""
    global _reader
    with _lock:
        if _reader is None:
            _reader = _Reader()
    _reader.add(_Watched(connection, callback))


class _Watched(NamedTuple):
    connection: Any
    callback: Callback

    def receive(self) -> None:
        """Read once, without waiting, as rospy's ``receive_once``.

        :raises Exception: it cannot be read.
        """
        connection = self.connection
        try:
            data = connection.socket.recv(connection.protocol.buff_size, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        if not data:
            raise EOFError
        connection.read_buff.write(data)
        connection.stat_bytes += len(data)
        self.deliver()

    def deliver(self) -> None:
        """Pass on what has been read completely."""
        connection = self.connection
        messages: List[Any] = []
        connection.protocol.read_messages(connection.read_buff, messages, connection.socket)
        connection.stat_num_msg += len(messages)
        for message in messages:
            message._connection_header = connection.header
        if messages and connection.is_latched:
            connection.latch = messages[-1]
        if messages and not connection.done and not rospy.is_shutdown():
            self.callback(messages, connection)


class _Reader:
    """:ivar hold: how long (s) not to read the connection whose messages are being handled."""

    def __init__(self) -> None:
        self.hold = 0.0
        self._poll = select.epoll()
        self._lock = threading.Lock()
        self._watched: Dict[int, _Watched] = {}
        self._held: List[Tuple[float, int, _Watched]] = []
        self._numbers = itertools.count()
        self.thread = threading.Thread(target=self._read_all, name="reader", daemon=True)
        self.thread.start()

    def add(self, watched: _Watched) -> None:
        """Read a connection from now on."""
        try:
            watched.deliver()  # rospy may have read more than the header
            self._watch(watched)
        except Exception:  # rospy and sockets raise many kinds of exceptions
            _give_back(watched)

    def _watch(self, watched: _Watched) -> None:
        with self._lock:
            self._watched = {
                number: other
                for number, other in self._watched.items()
                if not other.connection.done  # closing has ended the polling of its descriptor
            }
            number = watched.connection.socket.fileno()
            self._poll.register(number, select.EPOLLIN)
            self._watched[number] = watched

    def _unwatch(self, number: int, watched: _Watched) -> None:
        with self._lock:
            # if it was closed, a new connection may have been given the same descriptor
            if self._watched.get(number) is watched:
                del self._watched[number]
                with contextlib.suppress(OSError):
                    self._poll.unregister(number)

    def _read_all(self) -> None:
        while True:
            wait = self._held[0][0] - time.monotonic() if self._held else None
            for number, _ in self._poll.poll(wait if wait is None else max(0.0, wait)):
                watched = self._watched.get(number)
                if watched is not None:
                    self._read(number, watched)
            while self._held and self._held[0][0] <= time.monotonic():
                self._continue(heapq.heappop(self._held)[2])

    def _read(self, number: int, watched: _Watched) -> None:
        self.hold = 0.0
        try:
            watched.receive()
        except Exception:  # rospy gets the same error again
            self._unwatch(number, watched)
            _give_back(watched)
            return
        if self.hold:
            self._unwatch(number, watched)
            due = time.monotonic() + self.hold
            heapq.heappush(self._held, (due, next(self._numbers), watched))

    def _continue(self, watched: _Watched) -> None:
        try:
            self._watch(watched)
        except Exception:  # closed in the meantime
            _give_back(watched)


def _give_back(watched: _Watched) -> None:
    """Let rospy read a connection, which reports, closes or connects it again."""
    threading.Thread(
        target=TCPROSTransport.receive_loop,
        args=watched,
        name="connection",
        daemon=True,
    ).start()


_reader: Optional[_Reader] = None
_lock = threading.Lock()
