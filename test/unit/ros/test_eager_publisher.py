"""A connection that writes at once what its socket takes, and waits for nobody."""

import socket
import time

import pytest

rospy = pytest.importorskip("rospy")

from gspn_framework_package.ros.transport import eager_publisher  # noqa: E402


class Transport:
    """What the connection needs of rospy's."""

    def __init__(self, end):
        self.socket = end
        self.done = False
        self.stat_bytes = self.stat_num_msg = 0
        self.endpoint_id = "/listener"

    def write_data(self, data):
        self.socket.sendall(data)
        self.stat_num_msg += 1


@pytest.fixture
def ends():
    ours, theirs = socket.socketpair()
    theirs.settimeout(20)
    yield ours, theirs
    ours.close()
    theirs.close()


def read(end, number):
    data = b""
    while len(data) < number:
        part = end.recv(1 << 20)
        assert part, "the end after %d bytes" % len(data)
        data += part
    return data


def message(number, size=10_000):
    return b"%06d" % number + b"." * (size - 6)


def test_what_is_written_is_there_at_once(ends):
    transport = Transport(ends[0])
    connection = eager_publisher._EagerConnection(transport)
    assert connection.write_data(b"one") and connection.write_data(b"two")
    ends[1].setblocking(False)
    assert ends[1].recv(100) == b"onetwo"
    assert (transport.stat_bytes, transport.stat_num_msg) == (6, 2)
    assert connection.endpoint_id == "/listener"


def test_a_reader_that_is_stuck_holds_nobody_up_and_gets_whole_messages_in_order(ends):
    connection = eager_publisher._EagerConnection(Transport(ends[0]))
    begin = time.monotonic()
    for number in range(500):  # far more than a socket holds
        connection.write_data(message(number))
    assert time.monotonic() - begin < 10  # the reader has read nothing yet
    data = read(ends[1], 500 * 10_000)
    assert data == b"".join(message(number) for number in range(500))
    connection.write_data(b"and on")
    assert read(ends[1], 6) == b"and on"


def test_of_too_many_the_oldest_are_dropped(ends, monkeypatch):
    monkeypatch.setattr(eager_publisher, "QUEUE_LIMIT", 5)
    connection = eager_publisher._EagerConnection(Transport(ends[0]))
    for number in range(500):
        connection.write_data(message(number))
    connection.write_data(message(999))
    data = b""
    while not data.endswith(message(999)):
        data += read(ends[1], 1)
    numbers = [int(data[at : at + 6]) for at in range(0, len(data), 10_000)]
    assert data == b"".join(message(number) for number in numbers)
    assert numbers == sorted(numbers)
    assert numbers[-5:] == [496, 497, 498, 499, 999]
    assert len(numbers) < 500


def test_a_closed_connection_says_so(ends):
    transport = Transport(ends[0])
    connection = eager_publisher._EagerConnection(transport)
    ends[1].close()
    with pytest.raises(rospy.exceptions.TransportTerminated):
        connection.write_data(b"one")
    transport.done = True
    with pytest.raises(rospy.exceptions.TransportTerminated):
        connection.write_data(b"two")
