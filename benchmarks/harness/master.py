"""A ROS master on this machine, and what a program with ROS needs."""

from __future__ import annotations

import importlib.util
import os
import shutil
import tempfile
import xmlrpc.client
from typing import Any, Dict, Tuple

from benchmarks.harness.ports import free_port
from benchmarks.harness.programs import Programs
from gspn_framework_package.model.errors import UsageError

PACKAGE = "gspn_framework_package"


def why_no_ros() -> str:
    """Why no team can run on ROS here; "" if one can."""
    for program in ("rosmaster", "roslaunch"):
        if shutil.which(program) is None:
            return "there is no program '%s': ROS is not installed, or not sourced" % program
    for module in ("rospy", "actionlib", PACKAGE + ".msg"):
        if importlib.util.find_spec(module) is None:
            return (
                "there is no Python module %s (source the workspace in which this package was "
                "built)" % module
            )
    return ""


def need_ros() -> None:
    """:raises UsageError: no team can run on ROS here."""
    reason = why_no_ros()
    if reason:
        raise UsageError(reason)


def master_words(port: int) -> Tuple[str, ...]:
    """The command line of a ROS master."""
    return ("rosmaster", "--core", "-p", str(port))


def ros_environment(address: str, uri: str, folder: str) -> Dict[str, str]:
    """The environment of a ROS program.

    :param address: its own.
    :param uri: of its master.
    :param folder: for what ROS writes.
    """
    return {
        "ROS_IP": address,
        "ROS_MASTER_URI": uri,
        "ROS_HOME": folder,
        "ROS_LOG_DIR": os.path.join(folder, "log"),
    }


class Master:
    """A ROS master on a free port of this machine, with a folder for everything that nodes write.
    It ends with the ``with`` block; during that, this process and what it starts use it."""

    def __enter__(self) -> Master:
        self.folder = tempfile.mkdtemp(prefix="gspn_master_")
        self.port = free_port()
        self.uri = "http://localhost:%d" % self.port
        self.programs = Programs(self.folder)
        self._before = dict(os.environ)
        os.environ.update(ros_environment("127.0.0.1", self.uri, self.folder))
        os.environ.pop("ROS_HOSTNAME", None)
        os.environ.pop("ROS_NAMESPACE", None)
        try:
            self.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: Any) -> None:
        self.programs.end(["master"])
        os.environ.clear()
        os.environ.update(self._before)
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(self) -> None:
        """Start it, and wait until it answers."""
        self.programs.start("master", master_words(self.port))
        self.programs.await_port("master", self.port)

    def kill(self) -> None:
        """Kill it (SIGKILL)."""
        self.programs.kill("master")

    def process_of(self, node: str) -> int:
        """Process id of a node."""
        address: Any = xmlrpc.client.ServerProxy(self.uri).lookupNode("/bench", node)
        answer: Any = xmlrpc.client.ServerProxy(address[2]).getPid("/bench")
        return int(answer[2])
