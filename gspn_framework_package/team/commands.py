"""The orders and questions of an operator, as a robot takes them from any carrier."""

from __future__ import annotations

import json
import queue
from typing import Any, Callable, Optional

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.plan_change import digest_of
from gspn_framework_package.model.errors import DataError, ExecutionError, GspnError, LogError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.team.carrier import Operator, OperatorAnswer, OperatorRequest
from gspn_framework_package.team.message_filter import json_object
from gspn_framework_package.team.worker import AnswerT, Worker

ANSWER_TIME = 2.0
"""Seconds within which the host's worker must answer a plain question."""

ORDER_TIME = 5.0
"""Seconds that an operator's order waits to get into the log."""

ADOPT_TIME = 20.0
"""The same for an order to adopt a plan, which is checked first, in a process of its own."""


_NOBODY = Operator()
"""An operator of whom nothing is known."""


def order_time(command: str) -> float:
    """Seconds within which a robot answers an order."""
    return ADOPT_TIME if command == "adopt" else ORDER_TIME


def is_question(request: OperatorRequest) -> bool:
    """Whether a request orders nothing."""
    asks = request.command == "breakpoints" and not request.argument
    return asks or request.command in ("status", "plan")


class Commands:
    """Answers the requests of operators, on any thread.

    :param worker: the host of the robot.
    """

    def __init__(self, worker: Worker) -> None:
        self._worker = worker

    def answer(self, request: OperatorRequest, operator: Operator = _NOBODY) -> OperatorAnswer:
        """Carry out a request, and wait for the outcome.

        :raises ExecutionError: the worker is too busy to answer a question.
        """
        other = self.other_run(request.run)
        if other:
            return OperatorAnswer(False, other)
        if request.command == "status":
            status = ask_worker(self._worker, lambda: self._worker.status(request.argument))
            return OperatorAnswer(True, json.dumps(status))
        if request.command == "plan":
            adopted = ask_worker(self._worker, self._worker.adopted)
            if adopted is None:
                return OperatorAnswer(False, "the team follows the plan that it began with")
            return OperatorAnswer(True, json.dumps(adopted.to_json()))
        if request.command == "breakpoints":
            if request.argument:
                self._worker.enqueue(self._worker.note_order, request, operator)
            return ask_worker(self._worker, lambda: self._breakpoints(request.argument))
        robot = request.robot or self._worker.robot
        try:
            entry = order_entry(request.command, request.robot, robot, request.argument)
        except DataError as error:
            return OperatorAnswer(False, "not a task: %s" % error)
        except LogError as error:
            return OperatorAnswer(False, str(error))
        if entry is None:
            return OperatorAnswer(
                False, "there is no command '%s'; there are: %s" % (request.command, _COMMANDS)
            )
        self._worker.enqueue(self._worker.note_order, request, operator)
        return self.order(entry._replace(by=giver_of(operator)))

    def other_run(self, run: str) -> str:
        """Why a request for ``run`` is refused here; "" if it is meant for this robot's run."""
        if run in ("", self._worker.run):
            return ""
        return "%s is in run '%s', not in run '%s': nothing was done" % (
            self._worker.robot,
            self._worker.run,
            run,
        )

    def order(self, entry: log_entries.Ordered) -> OperatorAnswer:
        """Give an order to the replica, and wait until it is in the log."""
        results: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._worker.enqueue(self._worker.order, entry, results.put)
        seconds = ADOPT_TIME if isinstance(entry, log_entries.Adopt) else ORDER_TIME
        try:
            result = results.get(timeout=seconds)
        except queue.Empty:
            text = "not in the log after %g s; it may still get there (see status)" % seconds
            return OperatorAnswer(False, text)
        return OperatorAnswer(result.ok, result.text)

    def _breakpoints(self, argument: str) -> OperatorAnswer:
        """Show or set the breakpoints of the robot; called on the worker thread."""
        try:
            return OperatorAnswer(True, self._worker.breakpoints(argument))
        except GspnError as error:
            return OperatorAnswer(False, str(error))


def ask_worker(worker: Worker, question: Callable[[], AnswerT]) -> AnswerT:
    """The answer of the worker thread to a plain question.

    :raises ExecutionError: it did not answer within :data:`ANSWER_TIME`.
    """
    try:
        return worker.ask(question, ANSWER_TIME)
    except queue.Empty:
        raise ExecutionError("the node is busy; no answer in time") from None


def giver_of(operator: Operator) -> log_entries.Giver:
    """Who gives an order, as the log has it."""
    name = shorten(operator.name, log_entries.GIVER_LIMIT)
    return log_entries.Giver(name, shorten(operator.proof, log_entries.GIVER_LIMIT))


_COMMANDS = (
    "pause, resume, evict, force_evict, trust, set_place, retry, fire, submit, leave, stop, "
    "stage, adopt, unstage, breakpoints, plan, status"
)


def order_entry(
    command: str, given: str, robot: str, argument: str
) -> Optional[log_entries.Ordered]:
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
    if command in ("evict", "force_evict"):
        return log_entries.Evict(robot, -1, command == "force_evict")
    if command == "trust":
        return log_entries.Evict("", -1, True)
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
