"""The robots of a team and what is between them, each in its own namespace of a network: nodes with
a ROS master, or agents with a router."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import sys
from typing import Any, Dict, List

from benchmarks.log_tail import LogTail
from benchmarks.netns.network import Network
from benchmarks.netns.programs import Programs, ros_environment
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.keys import NewMember, make_team

MASTER = "master"
"""The name of the node in the middle, with the master or the router; the robots' nodes have the
robots' names."""

MASTER_PORT = 11311
ROS_MASTER = ("rosmaster", "--core", "-p", str(MASTER_PORT))
"""Starts a ROS master."""

ROUTER_PORT = 7447
RUN = "lab"
OPERATOR = "ann"
WORK_MODULE = "benchmarks.netns.work"
"""Where the functions of the robots' actions are."""

_PACKAGE = "gspn_framework_package"
NODE = """
from gspn_framework_package.ros import node_main
from gspn_framework_package.ros.transport import node_process
node_process.exit_with(node_main.run_execution_node())
"""
"""A program for ``python3 -c``: a robot with ROS."""

GSPN = (sys.executable, "-m", _PACKAGE)
"""The command ``gspn``."""


def why_no_ros() -> str:
    """Why no team can run on ROS here; "" if one can."""
    for program in ("rosmaster", "rosservice"):
        if shutil.which(program) is None:
            return "there is no program '%s': ROS is not installed, or not sourced" % program
    for module in ("rospy", "actionlib", _PACKAGE + ".msg"):
        if importlib.util.find_spec(module) is None:
            return (
                "there is no Python module %s (source the workspace in which this package was "
                "built)" % module
            )
    return ""


def why_no_zenoh() -> str:
    """Why no team can run on Zenoh with keys here; "" if one can."""
    for module, package in (("zenoh", "eclipse-zenoh"), ("cryptography", "cryptography")):
        if importlib.util.find_spec(module) is None:
            return "there is no Python module %s (pip install %s)" % (module, package)
    return ""


class NamespaceTeam:
    """The robots of a team, which end with the ``with`` block.

    :param network: has a node :data:`MASTER` and a place for each robot of the plan.
    :param folder: for the plan, the logs, and the output of the programs.
    """

    def __init__(self, network: Network, plan: Plan, folder: str) -> None:
        self.robots = [robot.name for robot in plan.robots]
        paths = {name: os.path.join(folder, RUN, name + ".jsonl") for name in self.robots}
        self.programs = Programs(network, folder, paths)
        self._network, self._plan, self._folder = network, plan, folder

    @property
    def logs(self) -> Dict[str, LogTail]:
        """The logs of the robots, as far as they were read."""
        return self.programs.logs

    def __enter__(self) -> NamespaceTeam:
        with open(os.path.join(self._folder, "plan.json"), "w", encoding="utf-8") as file:
            json.dump(plan_to_json(self._plan), file)
        try:
            self.start_middle()
            for robot in self.robots:
                self.start_robot(robot)
        except BaseException:
            self.end()
            raise
        return self

    def __exit__(self, *_: Any) -> None:
        self.end()

    def end(self) -> None:
        """End the other programs, then the robots, then what is in the middle."""
        self.programs.end(self.robots, self.middle())

    def middle(self) -> List[str]:
        """The programs that the robots meet at."""
        return [MASTER]

    def start_middle(self) -> None:
        """Start what the robots meet at, and wait until it is there."""
        raise NotImplementedError

    def start_robot(self, robot: str) -> None:
        """Start a robot."""
        raise NotImplementedError

    def order(self, robot: str, command: str) -> str:
        """Give the team an operator's command through a robot; returns "" if it was carried out,
        otherwise why not."""
        raise NotImplementedError

    def environment(self, node: str) -> Dict[str, str]:
        """What the environment of a node's programs needs."""
        return {}


class MasterTeam(NamespaceTeam):
    """Robots with ROS, and one master."""

    def start_middle(self) -> None:
        """See :class:`NamespaceTeam`."""
        self.programs.start(MASTER, ROS_MASTER, "", self.environment(MASTER))
        self.programs.await_port(MASTER, MASTER_PORT)

    def start_robot(self, robot: str) -> None:
        """See :class:`NamespaceTeam`."""
        parameters = {"plan": self._folder, "robot": robot, "run": RUN, "log_dir": self._folder}
        words = node_words(robot, {**parameters, "modules": WORK_MODULE})
        self.programs.start(robot, words, "", self.environment(robot))

    def order(self, robot: str, command: str) -> str:
        """See :class:`NamespaceTeam`; the call comes from that robot's own namespace."""
        words = ["rosservice", "call", "/%s/command" % robot, "{command: %s}" % command]
        _, said = self.programs.ask(robot, words, self.environment(robot))
        return "" if "success: True" in said else said

    def environment(self, node: str) -> Dict[str, str]:
        """See :class:`NamespaceTeam`."""
        own, master = self._network.address(node), self._network.address(MASTER)
        return ros_environment(own, master, MASTER_PORT, self._folder)


class OwnMastersTeam(MasterTeam):
    """Robots with ROS, each with a master of its own; programs like those of ``fkie_multimaster``
    synchronise the masters."""

    def start_middle(self) -> None:
        """See :class:`NamespaceTeam`: here, every robot's master."""
        for robot in self.robots:
            name = robot + "_master"
            self.programs.start(name, ROS_MASTER, robot, self.environment(robot))
        for robot in self.robots:
            self.programs.await_port(robot + "_master", MASTER_PORT, robot)
            others = [self._master(other) for other in self.robots if other != robot]
            module = "benchmarks.netns.master_sync"
            words = [sys.executable, "-m", module, self._master(robot), *others]
            self.programs.start(robot + "_sync", words, robot)

    def middle(self) -> List[str]:
        """See :class:`NamespaceTeam`."""
        return [robot + kind for kind in ("_sync", "_master") for robot in self.robots]

    def environment(self, node: str) -> Dict[str, str]:
        """See :class:`NamespaceTeam`."""
        own = self._network.address(node)
        return ros_environment(own, own, MASTER_PORT, self._folder)

    def _master(self, robot: str) -> str:
        return self.environment(robot)["ROS_MASTER_URI"]


class RouterTeam(NamespaceTeam):
    """Robots without ROS and one router, with keys: mutual TLS."""

    def start_middle(self) -> None:
        """See :class:`NamespaceTeam`."""
        keys = os.path.join(self._folder, "keys")
        if not os.path.exists(keys):
            members = [NewMember(robot, "robot") for robot in self.robots]
            members.append(NewMember(OPERATOR, "operator"))
            members.append(NewMember(MASTER, "router", (self._network.address(MASTER),)))
            make_team(keys, members, 1)
        listen = ["--listen", "tls/0.0.0.0:%d" % ROUTER_PORT]
        self.programs.start(MASTER, [*GSPN, "router", *listen, *self._keys(MASTER)])
        self.programs.await_port(MASTER, ROUTER_PORT)

    def start_robot(self, robot: str) -> None:
        """See :class:`NamespaceTeam`."""
        words = ["agent", self._folder, "--robot", robot, "--run", RUN, "--modules", WORK_MODULE]
        log = ["--log", self.logs[robot].path]
        self.programs.start(robot, [*GSPN, *words, *log, *self._way(robot)])

    def order(self, robot: str, command: str) -> str:
        """See :class:`NamespaceTeam`; the operator is where the router is."""
        code, said = self.programs.ask(MASTER, [*GSPN, command, *self._way(OPERATOR)])
        return "" if code == 0 else said or "it failed"

    def _way(self, member: str) -> List[str]:
        endpoint = "tls/%s:%d" % (self._network.address(MASTER), ROUTER_PORT)
        return ["--connect", endpoint, *self._keys(member)]

    def _keys(self, member: str) -> List[str]:
        return ["--keys", os.path.join(self._folder, "keys", member)]


def node_words(robot: str, parameters: Dict[str, Any]) -> List[str]:
    """The command line of a robot with ROS.

    :param parameters: private parameters of its node.
    """
    words = ["_%s:=%s" % (key, json.dumps(value)) for key, value in parameters.items()]
    return [sys.executable, "-c", NODE, "__ns:=/" + robot, "__name:=executor", *words]


TEAMS = {"ros": MasterTeam, "masters": OwnMastersTeam, "zenoh": RouterTeam}
"""The kind of team for each transport."""
