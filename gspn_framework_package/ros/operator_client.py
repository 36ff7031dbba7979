"""Client for an operator's program: finds the execution nodes, queries them and gives orders."""

from __future__ import annotations

import contextlib
import queue
import time
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import rosgraph
import rospy

from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.ros.team_orders import TeamOrders
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, master_proxy
from gspn_framework_package.ros.transport.service_calls import ServiceCalls
from gspn_framework_package.srv import Command, CommandRequest, CommandResponse
from gspn_framework_package.team.addressing import (
    SILENCE_PATIENCE,
    read_status,
    robots_of_run,
    whom_to_order,
)
from gspn_framework_package.team.commands import ADOPT_TIME, order_time
from gspn_framework_package.team.seal import TeamKey


class NodeAddress(NamedTuple):
    """An execution node: the namespace of its robot, and the address of its services."""

    namespace: str
    uri: str


class NodeAnswer(NamedTuple):
    """A node's answer to a command."""

    node: NodeAddress
    success: bool
    message: str


def status_in(namespace: str) -> Optional[Dict[str, Any]]:
    """The status of the execution node in a namespace; None if there is no node, or it does not
    answer. May be called before this process is a node itself.

    :raises OSError: or another of ``MASTER_ERRORS``, no master answers.
    """
    answer = ask_node(namespace, CommandRequest(command="status"))
    return read_status(answer.message) if answer else None


def ask_node(namespace: str, request: CommandRequest) -> Optional[CommandResponse]:
    """Ask the execution node in a namespace a question; None if there is no node, or it does not
    answer within ``PATIENCE``. (An order would need the key of the team.)

    :raises OSError: or another of ``MASTER_ERRORS``, no master answers.
    """
    name = rospy.names.ns_join(namespace, "command")
    master: Any = master_proxy()
    code, _, uri = master.lookupService("/gspn_operator", name)
    if code != 1:
        return None
    calls = ServiceCalls(deadline=SILENCE_PATIENCE)
    answers: queue.SimpleQueue[CommandResponse] = queue.SimpleQueue()
    try:
        calls.call(namespace, uri, name, Command, request, answers.put)
        deadline = time.monotonic() + SILENCE_PATIENCE
        # a failure means that the node is gone, and the master has not noticed yet
        while time.monotonic() < deadline and not calls.failures:
            with contextlib.suppress(queue.Empty):
                return answers.get(timeout=0.02)
        return None
    finally:
        calls.close()


class OperatorClient:
    """Connects to all execution nodes that the ROS master knows; every call has a deadline.

    Call :meth:`close` to end its threads.

    :param key: the key of the team, to give orders; None if it has none.
    :raises ExecutionError: no master answers, or it knows no execution node.
    """

    def __init__(self, key: Optional[TeamKey] = None) -> None:
        self._orders = TeamOrders(key)
        self.nodes = self._find()  # checked before rospy calls the master, which has no time limit
        self._calls = ServiceCalls(deadline=ADOPT_TIME + SILENCE_PATIENCE)
        if not rospy.core.is_initialized():
            rospy.init_node(
                "gspn_operator", anonymous=True, disable_signals=True, disable_rosout=True
            )

    def close(self) -> None:
        """End the threads of the calls."""
        self._calls.close()

    def _find(self) -> List[NodeAddress]:
        try:
            master: Any = master_proxy()
            _, _, (_, _, services) = master.getSystemState("/gspn_operator")
            names = {name for name, _ in services}
            nodes = []
            for name in names:
                namespace, _, service = name.rpartition("/")
                if service == "command" and namespace + "/get_place" in names:
                    _, _, uri = master.lookupService("/gspn_operator", name)
                    nodes.append(NodeAddress(namespace or "/", uri))
        except MASTER_ERRORS as error:
            raise ExecutionError(
                "no ROS master answers at %s (%s)" % (rosgraph.get_master_uri(), error)
            ) from None
        if not nodes:
            raise ExecutionError(
                "no execution node is known to the ROS master at %s" % rosgraph.get_master_uri()
            )
        return sorted(nodes)

    def ask_all(
        self,
        command: str,
        seconds: float = SILENCE_PATIENCE,
        argument: str = "",
    ) -> Dict[NodeAddress, Optional[NodeAnswer]]:
        """The answers of all nodes to a command; None for a node that does not answer within
        ``seconds``."""
        request = CommandRequest(command=command, argument=argument)
        return self._gather(dict.fromkeys(self.nodes, request), seconds)

    def _gather(
        self, requests: Dict[NodeAddress, CommandRequest], seconds: float
    ) -> Dict[NodeAddress, Optional[NodeAnswer]]:
        answers: queue.SimpleQueue[NodeAnswer] = queue.SimpleQueue()
        for node, request in requests.items():
            self._send(node, request, answers)
        got: Dict[NodeAddress, Optional[NodeAnswer]] = dict.fromkeys(requests)
        deadline = time.monotonic() + seconds
        while any(answer is None for answer in got.values()):
            try:
                answer = answers.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                break
            got[answer.node] = answer
        return got

    def statuses(self, data: bool = False) -> Dict[NodeAddress, Optional[Dict[str, Any]]]:
        """The status of every node, with or without ``data``; None for a node without a valid
        answer."""
        return {
            node: read_status(answer.message) if answer is not None else None
            for node, answer in self.ask_all("status", argument="data" * data).items()
        }

    def breakpoints(self, argument: str, run: str = "") -> List[Tuple[str, Optional[NodeAnswer]]]:
        """Show or set the breakpoints of every robot of a run.

        :param argument: a JSON list of names to set, "" for none.
        :param run: the name of the run; required if there are several.
        :returns: pairs of a node's namespace and its answer; None if it does not answer.
        :raises ExecutionError: no node answers, or nodes of several runs do.
        """
        there = robots_of_run(self.statuses(), run)
        answers = self._gather(
            {
                node: self._orders.request(
                    status["robot"], "breakpoints", "", argument, status["run"]
                )
                for node, status in sorted(there.items())
            },
            SILENCE_PATIENCE,
        )
        return [(node.namespace, answer) for node, answer in answers.items()]

    def order(self, command: str, robot: str, argument: str, run: str = "") -> Tuple[bool, str]:
        """Give an order to a node that answers, preferably the robot's own.

        :param command: the command; see the service ``Command``.
        :param robot: the robot that the order concerns.
        :param argument: the argument of the command.
        :param run: the name of the run; required if there are several.
        :returns: whether the order was carried out, and the node's message.
        :raises ExecutionError: no node answers, or nodes of several runs do.
        """
        there = robots_of_run(self.statuses(), run)
        node = whom_to_order(there, command, robot)
        answers: queue.SimpleQueue[NodeAnswer] = queue.SimpleQueue()
        asked = there[node]
        request = self._orders.request(asked["robot"], command, robot, argument, asked["run"])
        self._send(node, request, answers)
        try:
            answer = answers.get(timeout=order_time(command) + SILENCE_PATIENCE)
        except queue.Empty:
            raise ExecutionError("%s does not answer" % node.namespace) from None
        return answer.success, answer.message

    def _send(
        self, node: NodeAddress, request: CommandRequest, answers: queue.SimpleQueue[NodeAnswer]
    ) -> None:
        self._calls.call(
            node.namespace,
            node.uri,
            rospy.names.ns_join(node.namespace, "command"),
            Command,
            request,
            lambda response: answers.put(NodeAnswer(node, response.success, response.message)),
        )
