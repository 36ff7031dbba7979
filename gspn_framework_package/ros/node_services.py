"""The services of an execution node."""

from __future__ import annotations

import json
import queue
from typing import Any, Callable, Dict, NamedTuple, Optional, Tuple, TypeVar

import rospy

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.interface import Message
from gspn_framework_package.execution.plan_change import digest_of
from gspn_framework_package.model.errors import DataError, GspnError, LogError
from gspn_framework_package.model.net import Marking, Net
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
from gspn_framework_package.team.carrier import json_object, marking_fields

ANSWER_TIME = 2.0
"""Seconds within which the node's worker must answer a plain question."""

ORDER_TIME = 5.0
"""Seconds that an operator's order waits to get into the log."""


class View(NamedTuple):
    """What a node knows about its robot and the team, including its own local transitions."""

    place: str
    """Name of the robot's place; "" while it has none."""
    robot_state: str
    incarnation: int
    visit: int
    marking: Marking
    net: Net
    slot: int
    hash: str


Answer = TypeVar("Answer")


class Worker:
    """The interface of the node that the services use. ``enqueue`` and ``ask`` may be called from
    any thread, the other methods only on the worker thread."""

    robot: str
    run: str

    def enqueue(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Make the worker thread call ``function(*arguments)`` soon."""
        raise NotImplementedError

    def ask(self, question: Callable[[], Answer], timeout: float) -> Answer:
        """Call ``question()`` on the worker thread and return its result.

        :param timeout: seconds to wait for it.
        :raises queue.Empty: it did not return in time.
        """
        raise NotImplementedError

    def view(self) -> View:
        """The robot and the team as this node knows them; call it on the worker thread."""
        raise NotImplementedError

    def status(self, data: str = "") -> Dict[str, Any]:
        """The node's status, for people and programs, as a JSON object; call it on the worker
        thread.

        :param data: ``data``: with the data, tasks and held events of the team; ``brief``: with
            these as short texts; "": without.
        """
        raise NotImplementedError

    def breakpoints(self, argument: str) -> str:
        """The breakpoints of this node's robot, for people; call it on the worker thread.

        :param argument: a JSON list of names to set, "" for none.
        :raises GspnError: it is not a list of names of the plan, or cannot be kept in the file.
        """
        raise NotImplementedError

    def request(self, message: Message, answer: Callable[[Message], None]) -> None:
        """Pass a peer's protocol message to the replica; call it on the worker thread.

        :param answer: receives the reply, once.
        """
        raise NotImplementedError

    def order(
        self, entry: Optional[log_entries.Entry], force_evict: str, answer: Callable[[Any], None]
    ) -> None:
        """Give an operator's order to the replica; call it on the worker thread.

        :param entry: the order; None for an eviction by force.
        :param force_evict: the robot to evict by force, if ``entry`` is None.
        :param answer: receives the ``OrderResult``.
        """
        raise NotImplementedError


class NodeServices:
    """Serves, in the robot's namespace:

    - ``get_place`` (gspn_framework_package/GetPlace): where this robot is,
    - ``get_state`` (GetState): what it does, and the marking that it knows,
    - ``set_place`` (SetPlace): an operator's order to put a robot into a place,
    - ``command`` (Command): an operator's other orders, and ``status``.

    The first three carry the protocol of partial synchronisation when a peer calls them.

    :param worker: the node.
    :param namespace: absolute namespace of the robot.
    """

    def __init__(self, worker: Worker, namespace: str) -> None:
        self._worker = worker
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
            service.shutdown()

    # -- the handlers, on rospy's threads ----------------------------------------------------------

    def _get_place(self, request: GetPlaceRequest) -> GetPlaceResponse:
        if request.agreement:
            return GetPlaceResponse(agreement=self._protocol(request.agreement))
        state = self._get_state_now()
        return GetPlaceResponse(state.robot, state.place, state.incarnation, state.visit, "")

    def _get_state(self, request: GetStateRequest) -> GetStateResponse:
        if request.agreement:
            return GetStateResponse(agreement=self._protocol(request.agreement))
        return self._get_state_now()

    def _get_state_now(self) -> GetStateResponse:
        try:
            response: GetStateResponse = self._worker.ask(self._read_state, ANSWER_TIME)
        except queue.Empty:
            raise rospy.ServiceException("the node is busy; no answer in time") from None
        return response

    def _read_state(self) -> GetStateResponse:
        """The response of ``get_state``; called on the worker thread."""
        view = self._worker.view()
        places, counts = marking_fields(view.marking, view.net)
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
            return SetPlaceResponse(True, "", self._protocol(request.agreement))
        other = self._other_run(request.run)
        if other:
            return SetPlaceResponse(False, other, "")
        if not request.place:
            robot = request.robot or self._worker.robot
            return SetPlaceResponse(False, "nothing to do: no place was given for %s" % robot, "")
        entry = log_entries.SetPlace(request.robot or self._worker.robot, request.place)
        ok, text = self._order(entry)
        return SetPlaceResponse(ok, text, "")

    def _other_run(self, run: str) -> str:
        """Why a call for ``run`` is refused here; "" if it is meant for this node's run."""
        if run in ("", self._worker.run):
            return ""
        return "%s is in run '%s', not in run '%s': nothing was done" % (
            self._worker.robot,
            self._worker.run,
            run,
        )

    def _command(self, request: CommandRequest) -> CommandResponse:
        other = self._other_run(request.run)
        if other:
            return CommandResponse(False, other)
        if request.command == "status":
            try:
                status = self._worker.ask(
                    lambda: self._worker.status(request.argument), ANSWER_TIME
                )
            except queue.Empty:
                raise rospy.ServiceException("the node is busy; no answer in time") from None
            return CommandResponse(True, json.dumps(status))
        if request.command == "breakpoints":
            return self._breakpoints(request.argument)
        robot = request.robot or self._worker.robot
        if request.command == "force_evict":
            return CommandResponse(*self._order(None, robot))
        try:
            entry = order_entry(request.command, request.robot, robot, request.argument)
        except DataError as error:
            return CommandResponse(False, "not a task: %s" % error)
        except LogError as error:
            return CommandResponse(False, str(error))
        if entry is None:
            return CommandResponse(
                False, "there is no command '%s'; there are: %s" % (request.command, _COMMANDS)
            )
        return CommandResponse(*self._order(entry))

    def _breakpoints(self, argument: str) -> CommandResponse:
        """Show or set the breakpoints of this node's robot."""

        def take() -> CommandResponse:
            try:
                return CommandResponse(True, self._worker.breakpoints(argument))
            except GspnError as error:
                return CommandResponse(False, str(error))

        try:
            return self._worker.ask(take, ANSWER_TIME)
        except queue.Empty:
            raise rospy.ServiceException("the node is busy; no answer in time") from None

    # -- through the worker ------------------------------------------------------------------------

    def _protocol(self, body: str) -> str:
        message = json_object(body)
        if message is None:
            return ""
        answers: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._worker.enqueue(self._worker.request, message, answers.put)
        try:
            answer = answers.get(timeout=ANSWER_TIME)
        except queue.Empty:
            raise rospy.ServiceException("no answer in time") from None
        return json.dumps(answer, separators=(",", ":")) if answer else ""

    def _order(self, entry: Optional[log_entries.Entry], force_evict: str = "") -> Tuple[bool, str]:
        results: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._worker.enqueue(self._worker.order, entry, force_evict, results.put)
        try:
            result = results.get(timeout=ORDER_TIME)
        except queue.Empty:
            text = "not in the log after %g s; it may still get there (see status)" % ORDER_TIME
            return False, text
        return result.ok, result.text


_COMMANDS = (
    "pause, resume, evict, force_evict, set_place, retry, fire, submit, leave, stop, "
    "stage, adopt, unstage, breakpoints, status"
)


def order_entry(command: str, given: str, robot: str, argument: str) -> Optional[log_entries.Entry]:
    """The log entry of an operator's command; None if the command is unknown.

    :param command: the name of the command.
    :param given: the robot that was named; "" for the whole team, if the command allows that.
    :param robot: the robot that was named, or else the one that serves the call.
    :param argument: for ``set_place``, the place; for ``fire``, the transition; for ``submit``, the
        task (see :func:`submitted`); for ``stop``, the reason; for ``stage``, the plan (see
        :func:`staged`); for ``adopt`` and ``unstage``, the number of the stage, "" for the present
        one.
    :raises DataError: the argument is no task.
    :raises LogError: the argument is no plan.
    """
    if command == "pause":
        return log_entries.Pause(given)
    if command == "resume":
        return log_entries.Resume(given)
    if command == "evict":
        return log_entries.Evict(robot, -1)
    if command == "leave":
        return log_entries.Leave(robot)
    if command == "set_place":
        return log_entries.SetPlace(robot, argument)
    if command == "retry":
        return log_entries.Retry(robot)
    if command == "fire":
        return log_entries.Fire(argument)
    if command == "stage":
        return staged(argument)
    if command in ("adopt", "unstage"):
        stage = int(argument) if argument.isdigit() else -1
        return log_entries.Adopt(stage) if command == "adopt" else log_entries.Unstage(stage)
    if command == "submit":
        return submitted(argument)
    if command == "stop":
        return log_entries.Stop(argument or log_entries.Stop().reason)
    return None


def submitted(argument: str) -> log_entries.Submit:
    """The entry for a task that is given by hand.

    :param argument: a JSON object with ``transition``, and perhaps ``id`` (default: a new one) and
        ``data``.
    :raises DataError: it is not.
    """
    task = json_object(argument)
    if task is None or not set(task) <= {"transition", "id", "data"}:
        raise DataError(
            "%.100r is not a JSON object with transition, id and data" % argument,
            hint='like {"transition": "order", "id": "o1", "data": {"pose": [1, 2]}}',
        )
    transition, data = task.get("transition"), task.get("data", {})
    if not isinstance(transition, str) or not transition:
        raise DataError("it names no transition")
    if not isinstance(data, dict):
        raise DataError("its data are not a JSON object, but %.100r" % (data,))
    task_id = task.get("id", "")
    if task_id in ("", None):
        task_id = log_entries.new_task_id("submitted")
    return log_entries.make_submit(transition, task_id, data)


def staged(argument: str) -> log_entries.StagePlan:
    """The log entry that stages a plan.

    :param argument: a JSON object: ``plan`` (the plan whole, as an event log has it), ``map``
        (names of the present net -> names of the new one) and ``folder`` (of its functions; "":
        where they were).
    :raises LogError: it is not of this form.
    """
    given = json_object(argument)
    if given is None or not isinstance(given.get("plan"), dict):
        raise LogError('not a plan: the argument is no JSON object {"plan": {...}, "map": {...}}')
    entry = log_entries.checked(
        log_entries.StagePlan(
            given["plan"],
            digest_of(given["plan"]),
            given.get("map", {}),
            given.get("folder", ""),
        )
    )
    assert isinstance(entry, log_entries.StagePlan)
    return entry
