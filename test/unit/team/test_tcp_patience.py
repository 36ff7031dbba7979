"""Connections over which nothing is acknowledged are given up by the operating system."""

import contextlib
import fcntl
import os
import socket

import pytest

from gspn_framework_package.team import own_sockets
from gspn_framework_package.team.tcp_patience import GIVES_UP, SilenceLimit, ports_of

pytestmark = pytest.mark.skipif(not os.path.exists("/proc/self/net/tcp"), reason="no /proc")


def patience(end):
    return end.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) / 1000.0


@pytest.fixture
def server():
    with contextlib.closing(socket.socket()) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        yield listening


def test_what_a_listening_socket_accepts_inherits_the_limit(server):
    port = server.getsockname()[1]
    assert SilenceLimit(listens=[port]).apply() == 1
    with socket.create_connection(("127.0.0.1", port)) as here:
        there, _ = server.accept()
        with there:
            assert patience(there) == GIVES_UP
            assert patience(here) == 0.0


def test_connections_to_a_port_are_limited_and_no_others(server):
    port = server.getsockname()[1]
    with socket.create_connection(("127.0.0.1", port)) as here, socket.socket() as other:
        assert SilenceLimit(connects=[port]).apply() == 1
        assert patience(here) == GIVES_UP
        assert patience(server) == patience(other) == 0.0
        here.sendall(b"it still works")
        there, _ = server.accept()
        with there:
            assert there.recv(14) == b"it still works"


def test_connections_that_are_made_later_are_limited(server):
    port = server.getsockname()[1]
    limit = SilenceLimit(connects=[port])
    for _ in range(3):
        assert limit.apply() == 0
    with socket.create_connection(("127.0.0.1", port)) as here:
        assert limit.apply() == 1
        assert patience(here) == GIVES_UP
        assert limit.apply() == limit.apply() == 1
    assert limit.apply() == 0


def test_the_table_is_read_only_after_a_change(monkeypatch):
    descriptors, reads = {"socket:[1]": 3}, []
    monkeypatch.setattr(own_sockets, "_descriptors", lambda: dict(descriptors))
    monkeypatch.setattr(own_sockets, "_numbers", lambda wanted: reads.append(wanted) or {})
    sockets = own_sockets.OwnSockets(lambda *_: True)
    for times in (2, 4):
        for _ in range(5):
            assert list(sockets) == []
        assert len(reads) == times
        descriptors["socket:[2]"] = 4


def test_a_file_that_took_the_number_of_a_closed_socket_is_not_kept_open(tmp_path, monkeypatch):
    with open(tmp_path / "lock", "wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        monkeypatch.setattr(own_sockets, "_descriptors", lambda: {"socket:[1]": lock.fileno()})
        monkeypatch.setattr(own_sockets, "_numbers", lambda wanted: {"socket:[1]": "1"})
        assert list(own_sockets.OwnSockets(lambda *_: True)) == []
    with open(tmp_path / "lock", "wb") as again:
        fcntl.flock(again, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_a_connection_that_is_being_made_is_limited():
    with socket.socket() as trying:
        trying.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            trying.connect(("192.0.2.1", 9))  # nobody answers from there
        with contextlib.suppress(OSError):
            trying.getpeername()
            pytest.skip("it is answered, or refused, here")
        if SilenceLimit(connects=[9]).apply():
            assert patience(trying) == GIVES_UP


def test_ports_are_found_in_endpoints():
    assert ports_of(["tls/hub:7447", "tcp/[::1]:7448", "tcp/host"]) == {7447, 7448}
