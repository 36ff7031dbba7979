"""Handles an operator's orders and questions, which a robot may receive from any carrier."""

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
"""Seconds within which an operator's order must get into the log."""

ADOPT_TIME = 20.0
"""The same for an order to adopt a plan, which is first checked in a separate process."""


_NOBODY = Operator()
"""An operator about whom nothing is known."""


def order_time(command: str) -> float:
    """Seconds within which a robot answers an order."""
    return ADOPT_TIME if command == "adopt" else ORDER_TIME


def is_question(request: OperatorRequest) -> bool:
    """Whether a request is a question, which changes nothing."""
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
                return OperatorAnswer(False, "the team still follows its first plan")
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
                False, "unknown command '%s'; known: %s" % (request.command, _COMMANDS)
            )
        self._worker.enqueue(self._worker.note_order, request, operator)
        return self.order(entry._replace(by=giver_of(operator)))

    def other_run(self, run: str) -> str:
        """Why this robot refuses a request for ``run``; "" if the request is meant for its run."""
        if run in ("", self._worker.run):
            return ""
        return "nothing was done: %s is in run '%s', not in run '%s'" % (
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
            text = (
                "the order is not in the log after %g s, but may still get there (see status)"
                % seconds
            )
            return OperatorAnswer(False, text)
        return OperatorAnswer(result.ok, result.text)

    def _breakpoints(self, argument: str) -> OperatorAnswer:
        """Show or set the breakpoints of the robot; called on the worker thread."""
        try:
            return OperatorAnswer(True, self._worker.breakpoints(argument))
        except GspnError as error:
            return OperatorAnswer(False, str(error))


def ask_worker(worker: Worker, question: Callable[[], AnswerT]) -> AnswerT:
    """Get the worker thread's answer to a plain question.

    :raises ExecutionError: it did not answer within :data:`ANSWER_TIME`.
    """
    try:
        return worker.ask(question, ANSWER_TIME)
    except queue.Empty:
        raise ExecutionError("the node is busy and did not answer in time") from None


def giver_of(operator: Operator) -> log_entries.Giver:
    """The sender of an order, as the log records it."""
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
    :param robot: the robot that was named, otherwise the robot that serves the call.
    :param argument: for ``set_place``, the place; for ``fire``, the transition; for ``submit``, the
        task (see :func:`submitted`); for ``stop``, the reason; for ``stage``, the plan (see
        :func:`staged`); for ``adopt`` and ``unstage``, the number of the stage, "" for the present
        one.
    :raises DataError: the argument is not a task.
    :raises LogError: the argument is not a plan.
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
    """The log entry for a task that an operator submits.

    :param argument: a JSON object with ``transition``, and optionally ``id`` (default: a new id)
        and ``data``. :raises DataError: the argument does not have this form.
    """
    task = json_object(argument)
    if task is None or not set(task) <= {"transition", "id", "data"}:
        raise DataError(
            "%.100r is not a JSON object with transition, id and data" % argument,
            hint='for example {"transition": "order", "id": "o1", "data": {"pose": [1, 2]}}',
        )
    transition, data = task.get("transition"), task.get("data", {})
    if not isinstance(transition, str) or not transition:
        raise DataError("the task names no transition")
    if not isinstance(data, dict):
        raise DataError("the data of the task must be a JSON object, not %.100r" % (data,))
    task_id = task.get("id", "")
    if task_id in ("", None):
        task_id = log_entries.new_task_id("submitted")
    return log_entries.make_submit(transition, task_id, data)


def staged(argument: str) -> log_entries.StagePlan:
    """The log entry that stages a plan.

    :param argument: a JSON object: ``plan`` (the whole plan, as in an event log), ``map`` (names in
        the present net -> names in the new one) and ``folder`` (of its functions; "" to keep the
        present folder).
    :raises LogError: the argument does not have this form.
    """
    given = json_object(argument)
    if given is None or not isinstance(given.get("plan"), dict):
        raise LogError(
            'not a plan: the argument must be a JSON object {"plan": {...}, "map": {...}}'
        )
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
