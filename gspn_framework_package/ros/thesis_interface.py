"""The node ``thesis_interface``: offers a team's interface under the ROS names of the thesis
(4.3.3), for programs written for them.

It publishes every firing on ``/TRANSITIONS_FIRED`` (GSPNFiringData), and serves, for each robot N
in its namespace, ``current_place_robot_N`` (CurrentPlace) and ``fire_sync_transition_N``
(FireSyncTransition). It only translates: it keeps no marking, and no robot waits for it. It ignores
what others publish on ``/TRANSITIONS_FIRED``, because only the robots decide what fires.

Private parameters: ``robots`` (the number of robots), ``prefix`` (the common prefix of their
namespaces), ``run`` (name of the run; "" takes the first one heard).
"""

from __future__ import annotations

import queue
import re
from typing import Any, Callable, Dict

import genpy
import rospy

from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.timed_get import get_within
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.msg import FiredTransition, GSPNFiringData
from gspn_framework_package.ros.messages import FIRED_TOPIC
from gspn_framework_package.ros.service_line import ServiceLine, status_in
from gspn_framework_package.ros.transport.ending import Ending
from gspn_framework_package.ros.transport.node_process import run_node
from gspn_framework_package.ros.transport.registration import MASTER_ERRORS, address_of
from gspn_framework_package.ros.transport.service_calls import ServiceCalls
from gspn_framework_package.srv import (
    CurrentPlace,
    CurrentPlaceResponse,
    FireSyncTransition,
    FireSyncTransitionResponse,
    GetState,
    GetStateRequest,
)
from gspn_framework_package.team.carrier import OperatorRequest
from gspn_framework_package.team.operator_client import UnreachableError, ask_robots
from gspn_framework_package.team.orders import ORDER_TIME

_TOPIC = "/TRANSITIONS_FIRED"


def run_thesis_interface() -> int:
    """Run the node; returns the exit code of the process."""
    return run_node("thesis_interface", _translate)


def _translate(ending: Ending) -> int:
    robots = rospy.get_param("~robots", 0)
    if not isinstance(robots, int) or isinstance(robots, bool) or robots < 1:
        raise UsageError("%r is not a number of robots" % (robots,), element="parameter ~robots")
    interface = ThesisInterface(
        robots, str(rospy.get_param("~prefix", "robot_")), str(rospy.get_param("~run", ""))
    )
    ending.wait()
    interface.close()
    return 0


class ThesisInterface:
    """Translates between a team and the interface of the thesis; see the module.

    :param prefix: the prefix of their namespaces; the robot's number follows it.
    :param run: name of the run; "" for the first one heard.
    """

    def __init__(self, robots: int, prefix: str, run: str) -> None:
        self._prefix, self._run = prefix, run
        self._calls = ServiceCalls(deadline=ORDER_TIME)
        self._line = ServiceLine(ORDER_TIME)
        self._publisher = rospy.Publisher(_TOPIC, GSPNFiringData, queue_size=1000)
        self._services = []
        for number in range(1, robots + 1):
            for name, service_class, serve in (
                ("current_place_robot_%d", CurrentPlace, self._current_place),
                ("fire_sync_transition_%d", FireSyncTransition, self._fire_sync),
            ):
                whole = self._service(number, name % number)
                self._services.append(rospy.Service(whole, service_class, _bound(serve, number)))
        self._subscriber = rospy.Subscriber(
            FIRED_TOPIC, FiredTransition, self._on_fired, tcp_nodelay=True
        )

    def close(self) -> None:
        """End the threads of the calls."""
        self._calls.close()
        self._line.close()

    def _service(self, number: int, name: str) -> str:
        return str(rospy.resolve_name("/%s%d/%s" % (self._prefix.strip("/"), number, name)))

    def _on_fired(self, message: FiredTransition) -> None:
        self._run = self._run or message.run
        if message.run == self._run:
            self._publisher.publish(firing_data(message))

    def _current_place(self, number: int, request: genpy.Message) -> CurrentPlaceResponse:
        state = self._ask(number, "get_state", GetState, GetStateRequest())
        doing = Phase.of_state(state.state) is Phase.DOING
        return CurrentPlaceResponse(state.place, "DOING" if doing else "DONE", number)

    def _fire_sync(self, number: int, request: genpy.Message) -> FireSyncTransitionResponse:
        namespace = self._service(number, "")
        status = status_in(namespace)
        if status is None:
            raise rospy.ServiceException("%s does not answer" % namespace)
        run = self._run or status["run"]
        order = OperatorRequest("set_place", status["robot"], request.place_to_go, run)
        asked = {namespace: str(status["robot"])}
        try:
            answer = ask_robots(self._line, asked, order, ORDER_TIME + 1.0)[namespace]
        except UnreachableError as error:
            raise rospy.ServiceException(str(error)) from None
        if answer is None:
            raise rospy.ServiceException("%s does not answer" % namespace)
        return FireSyncTransitionResponse("SUCCESS" if answer.success else answer.message)

    def _ask(self, number: int, name: str, service_class: type, request: genpy.Message) -> Any:
        """The answer of a robot's node. :raises rospy.ServiceException: it does not answer."""
        service = self._service(number, name)
        try:
            uri = address_of(service)
        except MASTER_ERRORS as error:
            raise rospy.ServiceException("no ROS master answers (%s)" % error) from None
        if uri is None:
            raise rospy.ServiceException("there is no service %s" % service)
        answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._calls.call(service, uri, service, service_class, request, answers.put)
        try:
            return get_within(answers, ORDER_TIME + 1.0)
        except queue.Empty:
            raise rospy.ServiceException("%s does not answer" % service) from None


def firing_data(message: FiredTransition) -> GSPNFiringData:
    """A FiredTransition as the message of the thesis; its marking is the ``str`` of a dict."""
    marking: Dict[str, int] = dict(zip(message.places, message.counts))
    number = re.search(r"[0-9]{1,18}$", message.robot)
    return GSPNFiringData(
        transition=message.transition,
        marking=str(marking),
        robot_id=int(number.group()) if number else 0,
        timestamp=str(message.header.stamp),
    )


def _bound(
    serve: Callable[[int, genpy.Message], genpy.Message], number: int
) -> Callable[[genpy.Message], genpy.Message]:
    return lambda request: serve(number, request)
