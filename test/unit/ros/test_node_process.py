"""What a node's process says, and what it leaves out."""

import linecache
import threading
import traceback

import pytest
from waiting import PATIENCE

pytest.importorskip("rospy")

import rospy
from rospy.impl.masterslave import ROSHandler
from rospy.impl.tcpros_base import TCPROSTransport, TCPROSTransportProtocol
from rospy.impl.tcpros_pubsub import robust_connect_subscriber

from gspn_framework_package.ros.transport.node_process import (
    connect_once,
    say_nothing_of_sockets_after_the_end,
    share_source_lines,
)


@pytest.mark.parametrize(
    "error, ended, told",
    [
        (OSError(9, "Bad file descriptor"), True, False),
        (OSError(9, "Bad file descriptor"), False, True),
        (ValueError("a fault"), True, True),
    ],
)
def test_only_sockets_of_a_node_that_has_ended_are_no_news(monkeypatch, error, ended, told):
    heard = []
    monkeypatch.setattr(threading, "excepthook", heard.append)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: ended)
    say_nothing_of_sockets_after_the_end()
    threading.excepthook(threading.ExceptHookArgs((type(error), error, None, None)))
    assert [args.exc_value for args in heard] == ([error] if told else [])


def test_a_publisher_that_is_reported_of_twice_in_a_moment_is_connected_once(monkeypatch):
    """rospy looks whether there is a connection, and then asks the publisher for its address."""
    connected, made, asked = set(), [], threading.Semaphore(0)
    answer = threading.Event()

    def connect(handler, topic, publisher):
        if (topic, publisher) not in connected:
            asked.release()
            assert answer.wait(20.0)
            made.append((topic, publisher))
            connected.add((topic, publisher))

    monkeypatch.setattr(ROSHandler, "_connect_topic", connect)
    connect_once()
    asks = [("/t", "http://a/"), ("/t", "http://a/"), ("/t", "http://b/"), ("/u", "http://a/")]
    threads = [
        threading.Thread(target=ROSHandler._connect_topic, args=(None, *ask)) for ask in asks
    ]
    for thread in threads:
        thread.start()
    for _ in set(asks):  # none of them waits for another one
        assert asked.acquire(timeout=20.0 * PATIENCE)
    answer.set()
    for thread in threads:
        thread.join(20.0)
    assert sorted(made) == sorted(set(asks))


def test_the_traceback_of_a_lost_connection_reads_no_source_file(monkeypatch):
    """rospy formats one whenever a connection ends: 0.5 MB of lines in each robot."""
    linecache.clearcache()
    share_source_lines()
    read, formatted = [], []
    monkeypatch.setattr(linecache, "updatecache", lambda file, *_: read.append(file) or [])
    told = traceback.format_exc
    monkeypatch.setattr(traceback, "format_exc", lambda: formatted.append(told()) or formatted[-1])

    def lose(*_, **__):
        raise rospy.exceptions.TransportTerminated("lost")

    connection = TCPROSTransport(TCPROSTransportProtocol("/topic", None), "/topic")
    monkeypatch.setattr(connection, "socket", object())
    monkeypatch.setattr(connection, "connect", lambda *_, **__: None)
    monkeypatch.setattr(connection, "receive_once", lose)
    monkeypatch.setattr(connection, "close", lambda: None)
    thread = threading.Thread(
        target=robust_connect_subscriber,
        args=(connection, "localhost", 1, "http://localhost:1", lose, "/topic"),
    )
    thread.start()
    thread.join(30)
    assert not thread.is_alive() and "lost" in formatted[0]
    assert [file for file in read if file != __file__] == []
