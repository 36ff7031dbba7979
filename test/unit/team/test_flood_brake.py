"""A connection that floods is handed over in large pieces, and no other."""

import contextlib
import os
import select
import socket
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import wait_for

from gspn_framework_package.team import flood_brake
from gspn_framework_package.team.flood_brake import (
    HOLDS,
    LOOK,
    MOST_BYTES,
    MOST_SEGMENTS,
    PIECE,
    Brought,
    FloodBrake,
    FloodWatch,
)
from gspn_framework_package.team.lanes import PAUSE

CHANNELS, LANES_OF_A_CHANNEL = 2, 32
A_LOOK = Brought(int(MOST_BYTES * LOOK), int(MOST_SEGMENTS * LOOK))
"""As much as a connection may bring between two looks."""

on_linux = pytest.mark.skipif(not os.path.exists("/proc/self/net/tcp"), reason="no /proc")


class Looks:
    """Looks in turn, at a connection that brings something in between."""

    def __init__(self):
        self.watch = FloodWatch()
        self.now, self.have = 100.0, Brought(0, 0)
        self.look()

    def look(self, more_bytes=0, more_segments=0):
        self.now += LOOK
        self.have = Brought(self.have.bytes + more_bytes, self.have.segments + more_segments)
        return self.watch.look(self.now, {"it": self.have, "other": Brought(0, 0)})


@pytest.mark.parametrize("flood", [(A_LOOK.bytes + 1, 0), (0, A_LOOK.segments + 1)])
def test_who_is_too_fast_in_two_looks_is_braked_until_it_was_slow_for_some_time(flood):
    looks = Looks()
    assert looks.look(*flood) == set()
    assert looks.look(*flood) == {"it"}
    for _ in range(int(HOLDS / LOOK) - 1):
        assert looks.look() == {"it"}
    assert looks.look() == set()
    assert looks.look(*flood) == set()


def test_who_floods_again_while_braked_stays_so():
    looks = Looks()
    looks.look(0, 1_000_000)
    for _ in range(5):
        assert looks.look(0, 1_000_000) == {"it"}
        assert looks.look() == {"it"}


def test_one_burst_is_no_flood():
    looks = Looks()
    for _ in range(5):
        assert looks.look(*A_LOOK) == set()
        assert looks.look(4 * 1024 * 1024, 3000) == set()


def test_a_connection_that_is_gone_is_forgotten():
    looks = Looks()
    looks.look(0, 1_000_000)
    assert looks.look(0, 1_000_000) == {"it"}
    looks.now += LOOK
    assert looks.watch.look(looks.now, {}) == set()
    assert looks.look() == set()


@given(st.lists(st.tuples(st.integers(0, A_LOOK.bytes), st.integers(0, A_LOOK.segments))))
def test_who_keeps_to_the_limit_is_never_braked(brought):
    looks = Looks()
    assert all(looks.look(*more) == set() for more in brought)


def test_a_robot_whose_lanes_are_all_busy_keeps_to_the_limit():
    assert CHANNELS * LANES_OF_A_CHANNEL / PAUSE < 0.6 * MOST_SEGMENTS


@pytest.fixture(name="pair")
def _pair():
    """The two ends of a connection, and the port at which it was accepted."""
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(contextlib.closing(socket.socket()))
        server.bind(("127.0.0.1", 0))
        server.listen()
        here = stack.enter_context(socket.create_connection(server.getsockname()))
        there = stack.enter_context(server.accept()[0])
        yield here, there, server.getsockname()[1]


def send(here, there, size):
    """Send so many bytes and take them.

    They are taken without waiting for them: who waits in ``recv`` at a braked connection is woken
    only by a whole piece or by a look, and here nobody looks meanwhile.
    """
    sender = threading.Thread(target=here.sendall, args=(b"x" * size,))
    sender.start()
    left = size

    def took_all():
        nonlocal left
        with contextlib.suppress(BlockingIOError):
            while left:
                left -= len(there.recv(min(left, 65536), socket.MSG_DONTWAIT))
        return not left

    wait_for(took_all, 60, "%d bytes" % size)
    sender.join()


def flood(here, there, brake):
    """Send too much too fast, until the connection is braked."""

    def braked():
        send(here, there, 3_000_000)
        brake.look()
        return least(there) == PIECE

    brake.look()
    wait_for(braked, 60, "a braked connection")


def least(end):
    return end.getsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT)


@on_linux
def test_a_braked_connection_is_read_in_pieces_and_at_each_look(pair, monkeypatch):
    here, there, port = pair
    monkeypatch.setattr(flood_brake, "LOOK", 3600.0)  # the test looks
    monkeypatch.setattr(flood_brake, "HOLDS", 3600.0)
    brake = FloodBrake([port])
    try:
        flood(here, there, brake)
        assert least(there) == PIECE and least(here) == 1
        name = "%s:%d" % here.getsockname()
        assert brake.news() == [
            "%s sends more than a robot should; reading from it more slowly" % name
        ]
        assert brake.news() == []
        here.sendall(b"a little")
        assert select.select([there], [], [], 0) == ([], [], [])
        came = threading.Thread(target=select.select, args=([there], [], [], 60))
        came.start()
        wait_for(lambda: brake.look() or not came.is_alive(), 30, "what waits, at a look")
        assert there.recv(len(b"a little")) == b"a little"
        send(here, there, 3_000_000)
        brake._watch = FloodWatch()  # as if all were quiet for long
        brake.look()
        assert least(there) == 1
        assert brake.news() == ["%s has slowed down or disconnected; no longer limited" % name]
    finally:
        brake.close()


@on_linux
def test_who_is_braked_is_let_go_when_the_brake_is_closed(pair, monkeypatch):
    here, there, port = pair
    monkeypatch.setattr(flood_brake, "LOOK", 3600.0)
    brake = FloodBrake([port])
    flood(here, there, brake)
    brake.close()
    assert least(there) == 1
