"""The services of an execution node."""

from __future__ import annotations

import contextlib
import queue
from typing import Iterator

import genpy
import rospy

from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.execution.team_messages import marking_lists
from gspn_framework_package.execution.timed_get import get_within
from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.model.errors import ExecutionError, RefusedError
from gspn_framework_package.ros.inbound import ANSWERED, ASKED, InboundMessages
from gspn_framework_package.srv import (
    Command,
    CommandRequest,
    CommandResponse,
    GetPlace,
    GetPlaceRequest,
    GetPlaceResponse,
    GetState,
    GetStateRequest,
    GetStateResponse,
    SetPlace,
    SetPlaceRequest,
    SetPlaceResponse,
)
from gspn_framework_package.team.carrier import OperatorAnswer, OperatorRequest, sender_of
from gspn_framework_package.team.commands import ANSWER_TIME, Commands, ask_worker
from gspn_framework_package.team.host import ReplicaHost


class NodeServices:
    """Serves, in the robot's namespace:

    - ``get_place`` (gspn_framework_package/GetPlace): this robot's place,
    - ``get_state`` (GetState): its phase, and the marking that it knows,
    - ``set_place`` (SetPlace): an operator's order to move a robot to a place,
    - ``command`` (Command): an operator's other orders, and ``status``.

    The first three carry the protocol of partial synchronisation when a peer calls them.

    :param worker: the host of the robot.
    :param namespace: absolute namespace of the robot.
    :param inbound: checks the messages of peers.
    """

    def __init__(self, worker: ReplicaHost, namespace: str, inbound: InboundMessages) -> None:
        self._worker = worker
        self._inbound = inbound
        self._commands = Commands(worker)
        self._services = [
            rospy.Service(rospy.names.ns_join(namespace, name), service, handler)
            for name, service, handler in (
                ("get_place", GetPlace, self._get_place),
                ("get_state", GetState, self._get_state),
                ("set_place", SetPlace, self._set_place),
                ("command", Command, self._command),
            )
        ]

    @property
    def uri(self) -> str:
        """The address of the services, ``rosrpc://host:port``, for peers that cannot reach the
        master."""
        return str(self._services[0].uri)

    def close(self) -> None:
        """Shut down the services."""
        for service in self._services:
            with contextlib.suppress(rospy.ServiceException):  # rospy may have closed it already
                service.shutdown()

    # -- the handlers, on rospy's threads ----------------------------------------------------------

    def _get_place(self, request: GetPlaceRequest) -> GetPlaceResponse:
        if request.agreement:
            return GetPlaceResponse(agreement=self._protocol(request, request.from_robot))
        state = self._get_state_now()
        return GetPlaceResponse(state.robot, state.place, state.incarnation, state.visit, "")

    def _get_state(self, request: GetStateRequest) -> GetStateResponse:
        if request.agreement:
            return GetStateResponse(agreement=self._protocol(request, request.from_robot))
        return self._get_state_now()

    def _get_state_now(self) -> GetStateResponse:
        with _as_failed_call():
            return ask_worker(self._worker, self._read_state)

    def _read_state(self) -> GetStateResponse:
        """The response of ``get_state``; called on the worker thread."""
        view = self._worker.view()
        places, counts = marking_lists(view.marking, view.net)
        return GetStateResponse(
            self._worker.robot,
            view.place,
            view.robot_state,
            view.incarnation,
            view.visit,
            places,
            counts,
            view.slot,
            view.hash,
            "",
        )

    def _set_place(self, request: SetPlaceRequest) -> SetPlaceResponse:
        if request.agreement:
            return SetPlaceResponse(True, "", self._protocol(request))
        other = self._commands.other_run(request.run)
        if other:
            return SetPlaceResponse(False, other, "")
        robot = request.robot or self._worker.robot
        if not request.place:
            return SetPlaceResponse(
                False, "nothing was done: no place was given for %s" % robot, ""
            )
        asked = OperatorRequest("set_place", robot, request.place, request.run)
        answer = self._obey(asked, request)
        return SetPlaceResponse(answer.success, answer.message, "")

    def _command(self, request: CommandRequest) -> CommandResponse:
        asked = OperatorRequest(request.command, request.robot, request.argument, request.run)
        return CommandResponse(*self._obey(asked, request))

    def _obey(self, asked: OperatorRequest, request: genpy.Message) -> OperatorAnswer:
        """Answer an operator, unless this robot refuses the request."""
        try:
            asked, operator = self._inbound.order(asked, request._connection_header)
        except RefusedError as error:
            return OperatorAnswer(False, error.message)
        with _as_failed_call():
            return self._commands.answer(asked, operator)

    # -- through the worker ------------------------------------------------------------------------

    def _protocol(self, request: genpy.Message, claimed: str = "") -> str:
        """The reply to a peer's call.

        :param claimed: the supposed caller, if the request names one.
        """
        message = self._inbound.read(request.agreement, request._connection_header, ASKED, claimed)
        if message is None:
            return ""
        answers: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._worker.serve(message, answers.put)
        try:
            answer = get_within(answers, ANSWER_TIME)
        except queue.Empty:
            raise rospy.ServiceException("no answer in time") from None
        if not answer:
            return ""
        return self._inbound.sealed(sender_of(message), compact(answer), ANSWERED)


@contextlib.contextmanager
def _as_failed_call() -> Iterator[None]:
    """Make the service call fail if the worker is too busy to answer."""
    try:
        yield
    except ExecutionError as error:
        raise rospy.ServiceException(error.message) from None
