"""The orders of the page to a team."""

from __future__ import annotations

from typing import Any, Callable, Dict, FrozenSet, List, Mapping, Protocol, Tuple

from gspn_framework_package.execution.breakpoints import Breakpoints
from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.check_all import check_all
from gspn_framework_package.team.carrier import OperatorRequest
from gspn_framework_package.team.deploy_team import DeployOutcome, Votes, deploy_to_team
from gspn_framework_package.team.operator_client import OperatorClient, RobotLine, ask_robots
from gspn_framework_package.team.orders import ORDERS, PAGE, OrderKind
from gspn_framework_package.team.verdict import obey
from gspn_framework_package.visualizer.activity import Handler, RequestFields
from gspn_framework_package.visualizer.team_connection import (
    LONGEST_ORDER_TIME,
    STATUS_TIME,
    TeamConnection,
)

PageOrder = Tuple[str, str, str]
"""An order to the team: the command, the robot and the argument of the Command service."""


StatusAnswer = Tuple[str, Dict[str, Any]]
"""The address of a robot, and the status in its answer."""


class OrderedTeam(Protocol):
    """What is known about the team that gets the orders."""

    @property
    def plan(self) -> Plan:
        """The plan that it follows."""

    @property
    def run(self) -> str:
        """The name of its run."""

    @property
    def names(self) -> Mapping[str, str]:
        """Address -> robot."""

    @property
    def gone(self) -> FrozenSet[str]:
        """Robots that no longer have a token in the net."""

    def obeyed(self, order: PageOrder) -> None:
        """Called when an order is in the team's log."""

    def ask_soon(self) -> None:
        """Request the team's state soon."""

    def statuses(self, addresses: List[str], line: RobotLine) -> List[StatusAnswer]:
        """The robots' answers about the team."""


class PageOrders:
    """Passes the page's orders to a team. Every order names the run.

    :param team: the team.
    :param connection: the connection to it.
    :ivar commands: command of the page -> its handler.
    """

    def __init__(self, team: OrderedTeam, connection: TeamConnection) -> None:
        self._team, self._connection = team, connection
        self._line = connection.line(LONGEST_ORDER_TIME)
        self.commands: Dict[str, Handler] = {
            command: self._handler(command, kind)
            for command, kind in ORDERS.items()
            if kind.form is not None
        }

    def close(self) -> None:
        """Stop waiting for answers."""
        self._line.close()

    def deploy(
        self, plan: Plan, mapping: Mapping[str, str], tell: Callable[[Votes], None]
    ) -> DeployOutcome:
        """See :class:`Activity`; the robots look for its functions where those of their plan
        are."""
        obey(check_all(plan), plan)
        line = self._connection.line(STATUS_TIME)

        def order(command: str, text: str) -> Tuple[bool, str]:
            try:
                return True, str(self._order((command, "", text))["message"])
            except RefusedError as error:
                return False, str(error)

        def statuses() -> List[Dict[str, Any]]:
            return list(self._answering(line).values())

        try:
            return deploy_to_team(order, statuses, stage_of(plan, mapping), tell=tell)
        finally:
            line.close()

    def _handler(self, command: str, kind: OrderKind) -> Handler:
        """The function that carries out an order with the page's fields."""

        def run(fields: RequestFields) -> Dict[str, Any]:
            values = kind.checked(fields, PAGE, self._team.plan)
            if kind.entry is None:
                return self._set_breakpoints(values["names"])
            return self._order((command, values.get("robot", ""), kind.argument(values)))

        return run

    def _order(self, order: PageOrder) -> Dict[str, Any]:
        """Send an order to a robot of the run that answers.

        :raises RefusedError: the order was not carried out, or nobody knows whether it was.
        """
        # asked twice, since a busy team may answer too late the first time
        there = self._answering(self._line) or self._answering(self._line)
        if not there:
            raise RefusedError(
                "no robot of run '%s' answers" % self._team.run
                if self._team.names
                else "no robot of the run has been heard from yet"
            )
        at, answer = OperatorClient(self._line).order_one(there, *order)
        if answer is None:
            raise RefusedError(
                "%s was given the order and has not answered" % there[at]["robot"],
                hint="see whether the team has carried it out before you repeat it",
            )
        if not answer.success:
            raise RefusedError(answer.message)
        self._team.obeyed(order)
        return {"message": answer.message}

    def _answering(self, line: RobotLine) -> Dict[str, Dict[str, Any]]:
        """The robots of the run that answer: address -> status."""
        found = self._team.statuses(sorted(self._team.names), line)
        return {at: status for at, status in found if status["run"] == self._team.run}

    def _set_breakpoints(self, names: List[str]) -> Dict[str, Any]:
        """Make every robot of the run stop at these places and transitions.

        :raises RefusedError: a robot did not accept them.
        """
        found = Breakpoints.of_names(names, self._team.plan)
        argument = ORDERS["breakpoints"].argument({"names": [*found.places, *found.transitions]})
        request = OperatorRequest("breakpoints", "", argument, self._team.run)
        there = {n: name for n, name in self._team.names.items() if name not in self._team.gone}
        answers = ask_robots(self._line, there, request, LONGEST_ORDER_TIME + 0.2)
        label = self._connection.label
        shown = [(label(n), answer) for n, answer in sorted(answers.items())]
        refusals = ["%s: %s" % (n, a.message) for n, a in shown if a is not None and not a.success]
        refusals += ["%s does not answer" % n for n, answer in shown if answer is None]
        self._team.ask_soon()
        if refusals or not there:
            raise RefusedError("; ".join(refusals) or "no robot of the run has been heard from yet")
        return {"message": "robots stop at: %s" % found.in_words}
