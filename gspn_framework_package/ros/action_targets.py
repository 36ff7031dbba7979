"""Maps a plan's actions to ROS: for each place the action server, its type, and the goal."""

from __future__ import annotations

from typing import Any, Dict, Mapping, NamedTuple, Optional, Union

import genpy
import rosgraph.names
import rospy

from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.model.action import EXEC_GSPN, FunctionAction, ServerAction
from gspn_framework_package.model.data import check_values, fill, full_name
from gspn_framework_package.model.errors import DataError, ExpressionError, PlanError
from gspn_framework_package.model.message_condition import field_of, parse_field
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.goal_data import read_result_text
from gspn_framework_package.ros.message_fields import (
    check_field,
    check_fields,
    fill_message,
    message_class,
    message_to_json,
)

EXEC_GSPN_RESULT = EXEC_GSPN[: -len("Action")] + "Result"


class ActionTarget(NamedTuple):
    """An action server, and the goal that a place sends to it."""

    place: str
    server: str
    """Absolute name."""
    action_type: type
    """The class of the action, e.g. MoveBaseAction."""
    goal: Mapping[str, Any]
    outcomes: Mapping[str, str]
    """Outcome -> transition, for actions that do not name a transition themselves."""
    foreign: bool
    """Whether the server is not one of the plan's Python functions."""
    keep: Mapping[str, str] = NOTHING
    """Name of data -> field of the result that is stored there."""

    def new_goal(self, data: Mapping[str, Any] = NOTHING) -> genpy.Message:
        """A new goal message. Empty time stamps in headers stay empty ("the latest"); the word
        ``now`` in place of a stamp means the time of sending.

        :param data: the data that the goal may refer to: full name -> value.
        :raises DataError: the goal refers to data that is not there.
        :raises PlanError: the fields do not fit the goal.
        """
        goal = self._empty_goal()
        fill_message(goal, filled(self.goal, data, "goal"), "goal")
        return goal

    def check(self) -> None:
        """Check the fields of the goal and of the result.

        :raises PlanError: the goal does not fit, or the result lacks a field.
        """
        try:
            check_fields(self._empty_goal(), self.goal, "goal")
            check_kept(type(self.action_type().action_result.result), self.keep)
        except PlanError as error:
            raise error.located(element="action of '%s'" % self.place) from None

    def clash(self, published: Mapping[str, str]) -> Optional[str]:
        """What is wrong if the server is of another type; None if nothing is, or nobody serves it.

        :param published: topic -> type, of the topics that somebody publishes.
        """
        wanted = self.action_type().action_result._type
        found = published.get(self.server + "/result", wanted)
        if found in (wanted, "*"):
            return None
        return "server %s is of type %s, the plan says %s" % (
            self.server,
            found[: -len("Result")] if found.endswith("ActionResult") else found,
            wanted[: -len("Result")],
        )

    def _empty_goal(self) -> genpy.Message:
        return type(self.action_type().action_goal.goal)()

    @property
    def speaks_gspn(self) -> bool:
        """Whether the action type is ExecGSPN, which can carry data of any name."""
        return getattr(self.action_type, "_type", "") == EXEC_GSPN

    def data_of(
        self, outcome: Outcome, text: str, result: Optional[genpy.Message]
    ) -> Dict[str, Any]:
        """The data that an action wrote.

        :param text: the text of the goal's status.
        :param result: the result message, if one arrived.
        :raises DataError: it cannot be kept.
        """
        data = {} if result is None else kept(result, self.keep)
        if self.speaks_gspn and outcome == Outcome.SUCCEEDED:
            data.update(check_values(read_result_text(text)))
        return data

    def transition_of(self, outcome: Outcome, result: Optional[genpy.Message]) -> Optional[str]:
        """The transition that an outcome selects; "" to let the policy decide, None for a failure.

        :param result: the result message, if one arrived.
        """
        # a result of another type may happen to have a field of this name
        names_one = getattr(result, "_type", "") == EXEC_GSPN_RESULT
        if outcome == Outcome.SUCCEEDED and not self.outcomes and result is not None and names_one:
            return str(result.transition)
        return self.outcomes.get(outcome, "" if outcome == Outcome.SUCCEEDED else None)


def action_targets(plan: Plan, robot: str, namespace: str) -> Dict[str, ActionTarget]:
    """The targets of a robot by place; places without an action are left out.

    :param namespace: absolute namespace of the robot, to which the plan's server names are
        relative.
    :raises PlanError: an action type does not exist, a goal does not fit its type, or a server name
        is not legal in ROS.
    """
    targets = {}
    for place in plan.action_places:
        action = plan.action(robot, place)
        if not isinstance(action, (FunctionAction, ServerAction)):
            continue
        try:
            targets[place] = target(place, action, namespace)
        except PlanError as error:
            raise error.located(file=plan.file) from None
    return targets


def target(place: str, action: Union[FunctionAction, ServerAction], namespace: str) -> ActionTarget:
    """The target of a robot in a place. :raises PlanError: see :func:`action_targets`."""
    name = rospy.names.ns_join(namespace, action.server)
    if not rosgraph.names.is_legal_name(name):
        raise PlanError(
            "'%s' is not a legal name in ROS" % action.server, element="action of '%s'" % place
        )
    if isinstance(action, FunctionAction):
        return ActionTarget(
            place, name, _action_type(place, EXEC_GSPN), {"place": place}, {}, False
        )
    goal = {"place": place} if action.type == EXEC_GSPN else action.goal or {}
    target = ActionTarget(
        place, name, _action_type(place, action.type), goal, action.outcomes, True, action.keep
    )
    target.check()
    return target


def _action_type(place: str, type_name: str) -> type:
    """The class of an action type. :raises PlanError: it does not exist in this workspace."""
    try:
        action_type = message_class(type_name, "action")
        if hasattr(action_type(), "action_goal"):
            return action_type
    except PlanError as error:
        raise error.located(element="action of '%s'" % place) from None
    raise PlanError(
        "'%s' is a message, not an action type" % type_name,
        element="action of '%s'" % place,
        hint="write package/NameAction",
    )


def filled(template: Mapping[str, Any], data: Mapping[str, Any], what: str) -> Mapping[str, Any]:
    """The fields of a goal, request or message, with references replaced by data.

    :raises DataError: data is missing, or stands for all fields and is not an object.
    """
    fields = fill(template, data)
    if not isinstance(fields, Mapping):
        raise DataError("its %s is %.100r, not an object" % (what, fields))
    return fields


def check_kept(owner: type, keep: Mapping[str, str]) -> None:
    """Check whether messages have the fields to be stored as data.

    :param owner: the class of the messages.
    :param keep: name of data -> field.
    :raises PlanError: a field is missing, or a name is not a data name.
    """
    for name, field in keep.items():
        try:
            full_name(name)
            check_field(owner, parse_field(field))
        except (DataError, ExpressionError) as error:
            raise PlanError("keep.%s: %s" % (name, error.message), hint=error.hint) from None


def kept(message: genpy.Message, keep: Mapping[str, str]) -> Dict[str, Any]:
    """The fields of a message to be stored as data. :raises DataError: they cannot be stored."""
    try:
        return check_values(
            {
                name: message_to_json(field_of(message, parse_field(field)))
                for name, field in keep.items()
            }
        )
    except ExpressionError as error:
        raise DataError(error.message) from None
