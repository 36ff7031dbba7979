"""Handles an operator's orders and questions, which a robot may receive from any carrier."""

from __future__ import annotations

import json
import queue
from typing import Any, Callable, Dict, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.actions import TEXT_LIMIT
from gspn_framework_package.execution.agreement.interface import OrderGiven
from gspn_framework_package.execution.timed_get import get_within
from gspn_framework_package.model.errors import ExecutionError, GspnError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.team.carrier import Handlers, Operator, OperatorAnswer, OperatorRequest
from gspn_framework_package.team.host import AnswerT, ReplicaHost
from gspn_framework_package.team.orders import ORDERS, OrderKind

ANSWER_TIME = 2.0
"""Seconds within which the host's worker must answer a plain question."""


_NOBODY = Operator()
"""An operator about whom nothing is known."""


class Commands:
    """Answers the requests of operators, on any thread.

    :param worker: the host of the robot.
    """

    def __init__(self, worker: ReplicaHost) -> None:
        self._worker = worker

    def answer(self, request: OperatorRequest, operator: Operator = _NOBODY) -> OperatorAnswer:
        """Carry out a request, and wait for the outcome.

        :raises ExecutionError: the worker is too busy to answer a question.
        """
        other = self.other_run(request.run)
        if other:
            return OperatorAnswer(False, other)
        kind = ORDERS.get(request.command)
        if kind is None:
            names = ", ".join(ORDERS)
            return OperatorAnswer(
                False, "unknown command '%s'; known: %s" % (request.command, names)
            )
        try:
            values = kind.read(request.robot, request.argument, self._worker.robot)
            entry = kind.entry(**values) if kind.entry is not None else None
        except GspnError as error:
            what = "not a %s: " % kind.noun if kind.noun else ""
            return OperatorAnswer(False, "%s%s" % (what, error))
        if not kind.is_question(request.argument):
            argument = shorten(request.argument, TEXT_LIMIT)
            noted = OrderGiven(request.command, request.robot, argument, *giver_of(operator))
            self._worker.enqueue(self._worker.note_order, noted)
        if entry is None:
            return self._answer(kind, values)
        return self._order(entry._replace(by=giver_of(operator)), kind.seconds)

    def other_run(self, run: str) -> str:
        """Why this robot refuses a request for ``run``; "" if the request is meant for its run."""
        if run in ("", self._worker.run):
            return ""
        return "nothing was done: %s is in run '%s', not in run '%s'" % (
            self._worker.robot,
            self._worker.run,
            run,
        )

    def _order(self, entry: log_entries.Ordered, seconds: float) -> OperatorAnswer:
        """Give an order to the replica, and wait until it is in the log."""
        results: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._worker.enqueue(self._worker.order, entry, results.put)
        try:
            result = get_within(results, seconds)
        except queue.Empty:
            text = (
                "the order is not in the log after %g s, but may still get there (see status)"
                % seconds
            )
            return OperatorAnswer(False, text)
        return OperatorAnswer(result.ok, result.text)

    def _answer(self, kind: OrderKind, values: Dict[str, Any]) -> OperatorAnswer:
        """Have the worker thread answer what makes no log entry."""
        answer = kind.answer
        assert answer is not None

        def look() -> Tuple[bool, Any]:
            try:
                return True, answer(self._worker, **values)
            except GspnError as error:
                return False, str(error)

        done, found = ask_worker(self._worker, look)
        return OperatorAnswer(done, found if isinstance(found, str) else json.dumps(found))


def handlers_of(host: ReplicaHost) -> Handlers:
    """The callbacks of a host for its carrier."""
    return Handlers(host.receive, Commands(host).answer)


def ask_worker(worker: ReplicaHost, question: Callable[[], AnswerT]) -> AnswerT:
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
