"""What a node's process says, and what it leaves out."""

import threading

import pytest

rospy = pytest.importorskip("rospy")

from gspn_framework_package.ros.transport.node_process import say_nothing_of_sockets_after_the_end  # noqa: E402


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
