"""Whoever starts before the router waits for it, and says so once."""

import socket

import pytest

from gspn_framework_package.team.router_wait import await_router


@pytest.fixture(name="free")
def _free():
    """An endpoint at which nobody listens, and the socket that can."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        yield "tcp/127.0.0.1:%d" % bound.getsockname()[1], bound


def test_it_waits_until_somebody_listens_and_says_so_once(free):
    endpoint, bound = free
    said, waits = [], []

    def wait(seconds):
        waits.append(seconds)
        if len(waits) == 3:
            bound.listen()

    await_router(["tls/127.0.0.1:0", endpoint], said.append, wait)
    assert len(waits) == 3
    assert len(said) == 1 and said[0].startswith("waits for a router (tls/127.0.0.1:0: ")
    assert endpoint in said[0]


def test_it_stops_waiting_when_asked(free):
    said = []
    await_router([free[0]], said.append, lambda seconds: True)
    assert len(said) == 1


@pytest.mark.parametrize("endpoint", ["udp/127.0.0.1:7447", "tcp/nowhere", "tls/x:y", ""])
def test_what_cannot_be_tried_is_left_to_the_session(endpoint):
    await_router([endpoint], pytest.fail, pytest.fail)


def test_without_a_router_there_is_nothing_to_wait_for():
    await_router([], pytest.fail, pytest.fail)
