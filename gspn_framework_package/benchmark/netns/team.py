"""A ROS master and the execution nodes of a team, each in its own namespace of a network."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from typing import Any, Dict, List, Sequence

from gspn_framework_package.benchmark.log_tail import LogTail
from gspn_framework_package.benchmark.netns.network import Network, inside
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Plan

MASTER = "master"
"""The name of the master's node in the network; the robots' nodes have the robots' names."""

MASTER_PORT = 11311
RUN = "lab"
_PACKAGE = "gspn_framework_package"
_ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", "..", ".."))
_NODE = """
from gspn_framework_package.ros import node_main
from gspn_framework_package.ros.transport import node_process
node_process.exit_with(node_main.run_execution_node())
"""


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


class NamespaceTeam:
    """The nodes of a team; they end with the ``with`` block.

    :param network: has a node ``master`` and one for each robot of the plan.
    :param folder: for the plan, the logs, and the output of the nodes.
    """

    def __init__(self, network: Network, plan: Plan, folder: str) -> None:
        self._network, self._plan, self._folder = network, plan, folder
        self.robots = [robot.name for robot in plan.robots]
        self.logs = {
            name: LogTail(os.path.join(folder, RUN, name + ".jsonl")) for name in self.robots
        }
        self._processes: Dict[str, Any] = {}

    def __enter__(self) -> NamespaceTeam:
        with open(os.path.join(self._folder, "plan.json"), "w", encoding="utf-8") as file:
            json.dump(plan_to_json(self._plan), file)
        try:
            self.start(MASTER, ["rosmaster", "--core", "-p", str(MASTER_PORT)])
            self._await_master()
            for name in self.robots:
                told = {"plan": self._folder, "robot": name, "run": RUN, "log_dir": self._folder}
                words = ["_%s:=%s" % (key, json.dumps(value)) for key, value in told.items()]
                self.start(
                    name,
                    [sys.executable, "-c", _NODE, "__ns:=/" + name, "__name:=executor", *words],
                )
        except BaseException:
            self.end()
            raise
        return self

    def __exit__(self, *_: Any) -> None:
        self.end()

    def read(self) -> Dict[str, LogTail]:
        """All logs, as far as they have been written.

        :raises ExecutionError: a node has ended.
        """
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise ExecutionError(
                    "%s ended with %s: %s" % (name, process.returncode, self._said(name))
                )
        for log in self.logs.values():
            log.read()
        return self.logs

    def order(self, robot: str, command: str) -> str:
        """Give the team an operator's command through a robot, from that robot's own namespace;
        returns "" if it was carried out, otherwise why not."""
        words = self._network.command(
            robot, ["rosservice", "call", "/%s/command" % robot, "{command: %s}" % command]
        )
        try:
            done = subprocess.run(
                words,
                env=self._environment(robot),
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=20,
            )
        except subprocess.TimeoutExpired:
            return "no answer"
        return "" if "success: True" in done.stdout else done.stdout.strip()

    def end(self) -> None:
        """End the other programs, then the robots in order, then the master; kill those that do not
        end within 5 s."""
        others = [name for name in self._processes if name not in (MASTER, *self.robots)]
        for names in (others, self.robots, [MASTER]):
            running = [self._processes[name] for name in names if name in self._processes]
            for process in running:
                if process.poll() is None:
                    process.send_signal(signal.SIGTERM)
            deadline = time.monotonic() + 5
            for process in running:
                try:
                    process.wait(max(0.1, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
        for log in self.logs.values():
            log.read()

    def start(self, node: str, words: Sequence[str]) -> None:
        """Start a program in the namespace of a node; it must run until the team ends."""
        with open(self._output_file(node), "wb") as output:
            self._processes[node] = subprocess.Popen(
                self._network.command(node, words),
                env=self._environment(node),
                cwd=self._folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def _await_master(self) -> None:
        deadline = time.monotonic() + 20
        while True:
            with inside(self._network.namespace(MASTER)), socket.socket() as probe:
                if probe.connect_ex((self._network.address(MASTER), MASTER_PORT)) == 0:
                    return
            if time.monotonic() > deadline or self._processes[MASTER].poll() is not None:
                raise ExecutionError("the ROS master did not start: " + self._said(MASTER))
            time.sleep(0.05)

    def _environment(self, node: str) -> Dict[str, str]:
        environment = dict(os.environ)
        for name in ("ROS_HOSTNAME", "ROS_NAMESPACE"):
            environment.pop(name, None)
        paths: List[str] = [_ROOT, environment.get("PYTHONPATH", "")]
        return dict(
            environment,
            ROS_IP=self._network.address(node),
            ROS_MASTER_URI="http://%s:%d" % (self._network.address(MASTER), MASTER_PORT),
            ROS_HOME=self._folder,
            ROS_LOG_DIR=os.path.join(self._folder, "log"),
            PYTHONPATH=os.pathsep.join(filter(None, paths)),
        )

    def output(self, node: str) -> str:
        """What the program of a node has printed."""
        with open(self._output_file(node), encoding="utf-8", errors="replace") as file:
            return file.read()

    def _output_file(self, node: str) -> str:
        return os.path.join(self._folder, node + ".txt")

    def _said(self, node: str) -> str:
        return " / ".join(line.strip() for line in self.output(node).splitlines()[-3:])
