"""Connections that are read on one thread: as rospy reads them, and none waits for another."""

import io
import queue
import socket
import threading
import time

import pytest

rospy = pytest.importorskip("rospy")

from rospy.impl.tcpros_base import TCPROSTransport  # noqa: E402
from rospy.impl.tcpros_pubsub import TCPROSSub  # noqa: E402

from gspn_framework_package.msg import Agreement  # noqa: E402
from gspn_framework_package.ros.transport import shared_reader  # noqa: E402

PATIENCE = 20
"""Seconds within which a message must come."""


class Peer:
    """A publisher and the connection to it."""

    def __init__(self, callback=None):
        ours, self.end = socket.socketpair()
        self.got = queue.Queue()
        protocol = TCPROSSub("/topic", Agreement, buff_size=4096)
        self.connection = TCPROSTransport(protocol, "/topic", header={"callerid": "/peer"})
        self.connection.socket = ours
        self._callback = callback
        self.ended = threading.Event()
        self.connection.set_cleanup_callback(lambda _: self.ended.set())

    def start(self):
        shared_reader._start_reading(self.connection, self._take)

    def _take(self, messages, connection):
        assert connection is self.connection
        for message in messages:
            assert message._connection_header == {"callerid": "/peer"}
            self.got.put((message.body, threading.current_thread().name, time.monotonic()))
            if self._callback is not None:
                self._callback(message)

    def say(self, *bodies):
        self.end.sendall(b"".join(packed(body) for body in bodies))

    def next(self):
        return self.got.get(timeout=PATIENCE)[0]

    def close(self):
        self.connection.close()
        self.end.close()


def packed(body):
    buffer = io.BytesIO()
    Agreement(body=body).serialize(buffer)
    data = buffer.getvalue()
    return len(data).to_bytes(4, "little") + data


@pytest.fixture
def make():
    made = []

    def make(*arguments, start=True):
        peer = Peer(*arguments)
        made.append(peer)
        if start:
            peer.start()
        return peer

    yield make
    for peer in made:
        peer.close()


def test_many_are_read_in_order_on_one_thread(make):
    peers = [make() for _ in range(20)]
    for number in range(50):
        for peer in peers:
            peer.say(str(number))
    for peer in peers:
        got = [peer.got.get(timeout=PATIENCE) for _ in range(50)]
        assert [body for body, _, _ in got] == [str(number) for number in range(50)]
        assert {thread for _, thread, _ in got} == {"reader"}


def test_half_a_message_holds_nobody_up(make):
    slow, other = make(), make()
    data = packed("x" * 100_000)
    slow.end.sendall(data[:50_000])
    other.say("quick")
    assert other.next() == "quick" and slow.got.empty()
    slow.end.sendall(data[50_000:])
    assert slow.next() == "x" * 100_000


def test_who_is_held_up_is_read_later_and_no_other(make):
    held = make(lambda message: shared_reader.hold_up(1.0))
    other = make()
    begin = time.monotonic()
    held.say("one", "two")  # in one piece, so both count
    assert [held.next(), held.next()] == ["one", "two"]
    held.say("three")
    other.say("quick")
    _, _, when_quick = other.got.get(timeout=PATIENCE)
    _, _, when_three = held.got.get(timeout=PATIENCE)
    assert when_quick < when_three and when_three - begin >= 2.0


def test_on_another_thread_a_call_sleeps(monkeypatch):
    slept = []
    monkeypatch.setattr(shared_reader.time, "sleep", slept.append)
    shared_reader.hold_up(0.3)
    assert slept == [0.3]


def test_what_came_with_the_header_is_not_lost(make):
    peer = make(start=False)
    data = packed("first") + packed("second")
    peer.connection.read_buff.write(data[:-5])
    peer.start()
    assert peer.next() == "first"
    peer.end.sendall(data[-5:])
    assert peer.next() == "second"


def test_a_publisher_that_ends_is_closed(make):
    peer = make()
    peer.say("last")
    peer.end.close()
    assert peer.next() == "last"
    assert peer.ended.wait(PATIENCE) and peer.connection.done


def test_after_something_unreadable_rospy_connects_again(make, monkeypatch):
    again = threading.Event()

    def reconnect(connection):
        connection.done = True
        again.set()

    monkeypatch.setattr(TCPROSTransport, "_reconnect", reconnect)
    peer, other = make(), make()
    peer.end.sendall((4).to_bytes(4, "little") + b"\xff" * 4)
    assert again.wait(PATIENCE)
    assert peer.end.recv(1) == b""  # closed, as rospy does
    other.say("on")
    assert other.next() == "on"


def test_a_connection_that_rospy_closes_leaves_its_descriptor_to_the_next(make):
    for number in range(20):
        peer = make()
        peer.say(str(number))
        assert peer.next() == str(number)
        peer.close()
    assert len(shared_reader._reader._watched) <= 1


def test_connections_of_a_subscriber_are_read_so(make):
    subscriber = rospy.Subscriber("/topic_of_the_reader", Agreement, lambda message: None)
    try:
        shared_reader.read_on_one_thread(subscriber)
        peer = make(start=False)
        assert subscriber.impl.add_connection(peer.connection)
        peer.connection.receive_loop(peer._take)  # as rospy's thread, which it ends
        peer.say("one")
        assert peer.got.get(timeout=PATIENCE)[:2] == ("one", "reader")
    finally:
        subscriber.unregister()
