"""Help for the tests that talk through Zenoh: keys, a router, sessions, agents, and waiting."""

import contextlib
import json
import os
import shutil
import socket
import time

import pytest

pytest.importorskip("zenoh")

from meeting import WORK, meeting_of

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.team import keys, zenoh_session
from gspn_framework_package.team.agent import PrintedReporter, make_agent
from gspn_framework_package.team.commands import handlers_of
from gspn_framework_package.team.host import HostOptions
from gspn_framework_package.team.keys import NewMember
from gspn_framework_package.team.router import Router
from gspn_framework_package.team.zenoh_carrier import ZenohCarrier

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


class Agents:
    """Robots of this process that run the plan of the meeting through a router.

    :ivar folder: of the plan.
    """

    def __init__(self, hub, folder, robots=2, **more):
        self.hub, self.folder, self.hosts = hub, folder, {}
        folder.mkdir()
        fields = {**meeting_of(robots), **more}
        (folder / "plan.json").write_text(json.dumps(fields))
        (folder / "work.py").write_text(WORK)
        self.plan = read_plan(str(folder))
        for robot in fields["robots"]:
            self.start(robot)

    def start(self, robot, run="monday"):
        def carrier(host):
            partial = self.plan.synchronisation.value == "partial"
            return ZenohCarrier(robot, run, self.hub.access(robot), handlers_of(host), partial)

        log = str(self.folder / "logs" / run / (robot + ".jsonl"))
        host = make_agent(
            self.plan,
            robot,
            HostOptions(run, log, stay=True),
            PrintedReporter(robot, True),
            carrier,
        )
        self.hosts[robot] = host
        host.start(lambda robot: None)

    def wait_for_team(self):
        """Wait until each robot takes part, and would answer an operator."""

        def all_in():
            told = [host.ask(lambda host=host: host.status(), 10) for host in self.hosts.values()]
            return all(status["active"] and status["quorum"] for status in told)

        wait_for(all_in, 30)

    def let_them_meet(self):
        (self.folder / "open").touch()

    def close(self):
        for host in self.hosts.values():
            host.stop()
        for host in self.hosts.values():
            host.join(20)
