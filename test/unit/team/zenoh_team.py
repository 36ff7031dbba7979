"""Help for the tests that talk through Zenoh: keys, a router, sessions, and waiting."""

import contextlib
import os
import shutil
import socket
import time

import pytest

pytest.importorskip("zenoh")

from gspn_framework_package.team import keys, zenoh_session
from gspn_framework_package.team.keys import NewMember
from gspn_framework_package.team.router import Router

MEMBERS = [
    NewMember("robot_1", "robot"),
    NewMember("robot_2", "robot"),
    NewMember("robot_3", "robot"),
    NewMember("ann", "operator"),
    NewMember("screen", "watcher"),
    NewMember("hub", "router", ("127.0.0.1",)),
]


def make_keys(folder, members=MEMBERS):
    keys.make_team(str(folder), members, 30)
    return str(folder)


def free_port():
    with contextlib.closing(socket.socket()) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def wait_for(condition, seconds=10.0):
    """Wait until the condition holds, and fail if it does not in time."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "not in time"
        time.sleep(0.01)


class Hub:
    """A router, and sessions with it, all closed at the end."""

    def __init__(self, folder=""):
        self.folder = folder
        self.endpoint = "%s/127.0.0.1:%d" % ("tls" if folder else "tcp", free_port())
        self._open = contextlib.ExitStack()
        self._open.callback(lambda: self.router.close())
        self.reopen()

    def reopen(self):
        """Start the router, again if it was closed."""
        own = os.path.join(self.folder, "hub") if self.folder else ""
        self.router = Router([self.endpoint], (), own)

    def access(self, name, folder=None):
        found = None
        if self.folder:
            found = keys.read_keys(os.path.join(folder or self.folder, name))
        return zenoh_session.TeamAccess((self.endpoint,), (), found)

    def session(self, name, folder=None):
        return self.keep(zenoh_session.open_session(self.access(name, folder)))

    def keep(self, made):
        """Close it at the end, before the router."""
        self._open.callback(made.close)
        return made

    def close(self):
        self._open.close()


def copy_keys(folder, name, to):
    shutil.copytree(os.path.join(folder, name), str(to))
    return str(to)
