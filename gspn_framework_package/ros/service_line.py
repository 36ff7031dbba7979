"""Carries the requests of an operator's program to the service ``command`` of the robots."""

from __future__ import annotations

import getpass
import json
from functools import partial
from typing import Any, Callable, Dict, List, Optional

import rosgraph
import rospy

from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.ros.inbound import NO_KEY
from gspn_framework_package.ros.transport.registration import (
    MASTER_ERRORS,
    address_of,
    master_proxy,
)
from gspn_framework_package.ros.transport.service_calls import ServiceCalls
from gspn_framework_package.srv import Command, CommandRequest, CommandResponse
from gspn_framework_package.team.addressing import SILENCE_PATIENCE, read_status
from gspn_framework_package.team.carrier import OperatorAnswer, OperatorRequest
from gspn_framework_package.team.operator_client import (
    CLIENT_TIME,
    OperatorClient,
    UnreachableError,
    ask_robots,
)
from gspn_framework_package.team.orders import is_question
from gspn_framework_package.team.run_key import find_run_key
from gspn_framework_package.team.seal import ORDER, SEALED, Seal, TeamKey


class SealedOrders:
    """Writes orders in the name of whoever runs this program, sealed if the team has a key.

    :param key: the key of the team; None: that which the team made for its run on this machine, if
        there is one.
    :param program: what gives the orders, which is recorded beside the name; "": the person alone.
    """

    def __init__(self, key: Optional[TeamKey] = None, program: str = "") -> None:
        self._key = key
        self._name = _user() + (" (%s)" % program if program else "")
        self._seals: Dict[str, Seal] = {}

    @property
    def is_found(self) -> bool:
        """Whether nobody gave the key, so that it may be of an earlier team of this run."""
        return self._key is None

    def write(self, to: str, request: OperatorRequest) -> CommandRequest:
        """The request of the service.

        :param to: the robot that is asked; the others may not carry the order out.
        """
        run = request.run
        if is_question(request):
            return CommandRequest(*request)
        if run not in self._seals:
            key = self._key or find_run_key(run)
            if key is None:
                return CommandRequest(*request)
            self._seals[run] = Seal(key, run, self._name)
        body = json.dumps(request._asdict())
        return CommandRequest(SEALED, "", self._seals[run].close(to, body, ORDER), run)


class ServiceLine:
    """A :class:`~gspn_framework_package.team.operator_client.RobotLine` of services; a robot's
    address is its namespace.

    :param seconds: time limit of an answer.
    :param orders: writes the orders.
    :ivar nodes: the namespaces of the nodes that :meth:`statuses` asks.
    """

    def __init__(self, seconds: float, orders: Optional[SealedOrders] = None) -> None:
        self._calls, self._orders = ServiceCalls(seconds), orders or SealedOrders()
        self.nodes: List[str] = []

    def call(
        self,
        address: str,
        robot: str,
        request: OperatorRequest,
        answered: Callable[[Optional[OperatorAnswer]], None],
    ) -> bool:
        """See :class:`RobotLine`."""
        name = rospy.names.ns_join(address, "command")
        try:
            uri = address_of(name)
        except MASTER_ERRORS as error:
            raise UnreachableError("the ROS master does not answer (%s)" % error) from None
        if uri is None:
            return False

        def send(written: CommandRequest, may_be_plain: bool) -> bool:
            def reply(response: CommandResponse) -> None:
                if not may_be_plain or response.message != NO_KEY:
                    answered(OperatorAnswer(response.success, response.message))
                elif not send(CommandRequest(*request), False):
                    answered(None)

            failed = partial(answered, None)
            return self._calls.call(address, uri, name, Command, written, reply, failed)

        return send(self._orders.write(robot, request), self._orders.is_found)

    def statuses(self, argument: str) -> Dict[str, Optional[Dict[str, Any]]]:
        """See :class:`RobotLine`."""
        request = OperatorRequest("status", argument=argument)
        answers = ask_robots(self, dict.fromkeys(self.nodes, ""), request, SILENCE_PATIENCE)
        return {at: read_status(a.message) if a is not None else None for at, a in answers.items()}

    def label(self, address: str) -> str:
        """See :class:`RobotLine`."""
        return address

    def silence(self, address: str) -> ExecutionError:
        """See :class:`RobotLine`."""
        return ExecutionError("%s does not answer" % address)

    def close(self) -> None:
        """See :class:`RobotLine`."""
        self._calls.close()


def client_on_ros(key: Optional[TeamKey] = None) -> OperatorClient:
    """A client of all execution nodes that the ROS master knows.

    :param key: the key of the team, to give orders; None if it has none.
    :raises ExecutionError: no master answers, or it knows no execution node.
    """
    nodes = find_nodes()  # before rospy calls the master, which has no time limit
    if not rospy.core.is_initialized():
        rospy.init_node("gspn_operator", anonymous=True, disable_signals=True, disable_rosout=True)
    line = ServiceLine(CLIENT_TIME, SealedOrders(key))
    line.nodes = nodes
    return OperatorClient(line)


def ask_node(namespace: str, request: OperatorRequest) -> Optional[OperatorAnswer]:
    """The answer of the execution node in a namespace to a question; None if there is no node, or
    it does not answer. May be called before this process is a node itself.

    :raises UnreachableError: no master answers.
    """
    line = ServiceLine(SILENCE_PATIENCE)
    try:
        return ask_robots(line, {namespace: ""}, request, SILENCE_PATIENCE)[namespace]
    finally:
        line.close()


def status_in(namespace: str) -> Optional[Dict[str, Any]]:
    """The status of the execution node in a namespace; as :func:`ask_node`."""
    answer = ask_node(namespace, OperatorRequest("status"))
    return read_status(answer.message) if answer else None


def find_nodes(within: str = "/") -> List[str]:
    """The namespaces of the execution nodes that the master knows.

    :param within: only those in this namespace.
    :raises ExecutionError: no master answers, or it knows no such node.
    """
    try:
        master: Any = master_proxy()
        _, _, (_, _, services) = master.getSystemState("/gspn_operator")
    except MASTER_ERRORS as error:
        raise ExecutionError(
            "no ROS master answers at %s (%s)" % (rosgraph.get_master_uri(), error)
        ) from None
    names = {name for name, _ in services}
    spaces = [name.rpartition("/")[0] for name in names if name.endswith("/command")]
    top = within.rstrip("/")
    nodes = [
        space or "/"
        for space in spaces
        if space + "/get_place" in names and (space + "/").startswith(top + "/")
    ]
    if not nodes:
        raise ExecutionError(
            "no execution node%s is known to the ROS master at %s"
            % (" in %s" % within if top else "", rosgraph.get_master_uri())
        )
    return sorted(nodes)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):  # a container may have no such user
        return "operator"
