"""Maps a plan's actions to ROS: for each place the action server, its type, and the goal."""

from __future__ import annotations

from typing import Any, Dict, Mapping, NamedTuple, Optional, Union

import genpy
import rosgraph.names
import roslib.message
import rospy

from gspn_framework_package.model.action import EXEC_GSPN, FunctionAction, ServerAction
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.plan import Plan

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

    def new_goal(self) -> genpy.Message:
        """A new goal message. Empty time stamps in headers stay empty ("the latest"); the word
        ``now`` in place of a stamp means the time of sending.

        :raises PlanError: the plan's fields do not fit the goal.
        """
        goal = type(self.action_type().action_goal.goal)()
        try:
            if self.goal:
                now = rospy.get_rostime() if rospy.core.is_initialized() else genpy.Time()
                genpy.message.fill_message_args(goal, [dict(self.goal)], keys={"now": now})
                goal._check_types()
        except (genpy.MessageException, genpy.SerializationError, TypeError, ValueError) as error:
            raise PlanError(
                "its goal does not fit %s: %s" % (goal._type, error),
                element="action of '%s'" % self.place,
            ) from None
        return goal

    def transition_of(self, outcome: str, result: Optional[genpy.Message]) -> Optional[str]:
        """The transition that an outcome stands for, "" to let the policy decide; None for a
        failure.

        :param outcome: the name of the outcome, e.g. "succeeded".
        :param result: the result message, if one arrived.
        """
        # a result of another type may happen to have a field of this name
        names_one = getattr(result, "_type", "") == EXEC_GSPN_RESULT
        if outcome == "succeeded" and not self.outcomes and result is not None and names_one:
            return str(result.transition)
        return self.outcomes.get(outcome, "" if outcome == "succeeded" else None)


def action_targets(plan: Plan, robot: str, namespace: str) -> Dict[str, ActionTarget]:
    """The targets of a robot by place; places without an action are left out.

    :param plan: the plan.
    :param robot: name of the robot.
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
            targets[place] = _target(place, action, namespace)
        except PlanError as error:
            raise error.located(file=plan.file) from None
    return targets


def _target(
    place: str, action: Union[FunctionAction, ServerAction], namespace: str
) -> ActionTarget:
    name = rospy.names.ns_join(namespace, action.server)
    if not rosgraph.names.is_legal_name(name):
        raise PlanError(
            "'%s' is not a legal name in ROS" % action.server, element="action of '%s'" % place
        )
    if isinstance(action, FunctionAction) or action.type == EXEC_GSPN:
        from gspn_framework_package.msg import ExecGSPNAction

        foreign = isinstance(action, ServerAction)
        outcomes = action.outcomes if isinstance(action, ServerAction) else {}
        return ActionTarget(place, name, ExecGSPNAction, {"place": place}, outcomes, foreign)
    action_type = _action_type(place, action.type)
    target = ActionTarget(place, name, action_type, action.goal or {}, action.outcomes, True)
    target.new_goal()
    return target


def _action_type(place: str, type_name: str) -> type:
    """The class of an action type. :raises PlanError: it cannot be found in this workspace."""
    try:
        action_type = roslib.message.get_message_class(type_name)
    except Exception as error:  # importing a foreign package may raise anything
        raise PlanError(
            "cannot load the action type '%s': %s" % (type_name, error),
            element="action of '%s'" % place,
        ) from None
    if action_type is None or not hasattr(action_type(), "action_goal"):
        raise PlanError(
            "there is no action type '%s'" % type_name,
            element="action of '%s'" % place,
            hint="write package/NameAction; is the package in this workspace?",
        )
    return action_type


class GoalFindings(NamedTuple):
    """Findings about the goals of a plan: messages by "ROBOT in PLACE"."""

    misfits: Dict[str, str]
    """Goals that do not fit their type."""
    unknown: Dict[str, str]
    """Goals that were not checked because their type is unknown in this shell."""


def look_at_goals(plan: Plan) -> GoalFindings:
    """Check whether the goals of the plan's foreign action servers fit their types. This needs
    neither a node nor a master."""
    found = GoalFindings({}, {})
    for robot in plan.robots:
        for place in plan.action_places:
            action = plan.action(robot.name, place)
            if not isinstance(action, ServerAction):
                continue
            where = "%s in %s" % (robot.name, place)
            try:
                action_type = _action_type(place, action.type)
            except PlanError as error:
                found.unknown[where] = error.message
                continue
            try:
                ActionTarget(
                    place, action.server, action_type, action.goal or {}, action.outcomes, True
                ).new_goal()
            except PlanError as error:
                found.misfits[where] = error.message
    return found
