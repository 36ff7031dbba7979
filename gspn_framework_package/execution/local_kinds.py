"""The kinds of action other than Python functions that need no ROS, for standalone runs and robots'
execution nodes."""

from __future__ import annotations

from typing import Any, Callable, Dict, Iterable, Tuple

from gspn_framework_package.execution.actions import ActionContext, ActionResult, load_actions
from gspn_framework_package.execution.commands import Command
from gspn_framework_package.model.action import ROS_KINDS, Action, CommandAction
from gspn_framework_package.model.errors import PlanError, RefusedError
from gspn_framework_package.model.plan import Plan

LocalAction = Callable[[ActionContext], ActionResult]
"""Carries out an action, on its own thread: returns its result, or raises ActionFailed or
DataError. Returns soon after ``is_cancelled``."""

LOCAL_KINDS: Dict[type, Callable[[Plan, Any], LocalAction]] = {
    CommandAction: lambda plan, action: Command(action, plan.folder, plan.cancel_grace),
}
"""Kind of action -> function that prepares an action of a plan."""


ALLOW_IN_STANDALONE_RUN = "gspn run --allow-commands"
"""How the operator of a standalone run allows commands."""


def refuse_ros(plan: Plan, bindings: Iterable[Tuple[str, Action]], hint: str) -> None:
    """Refuse a plan with an action that needs ROS.

    :param bindings: the places to look at, and their actions.
    :param hint: how the operator can run it.
    :raises PlanError: an action needs ROS.
    """
    for place, action in bindings:
        if isinstance(action, ROS_KINDS):
            raise PlanError(
                "its action '%s' needs ROS" % action.label,
                file=plan.file,
                element="place '%s'" % place,
                hint=hint,
            )


def refuse_commands(plan: Plan, how: str) -> None:
    """Refuse a plan that runs programs.

    :param how: how the operator can allow it.
    :raises RefusedError: an action of the plan is a command.
    """
    for place, action in plan.bindings():
        if isinstance(action, CommandAction):
            raise RefusedError(
                "its action '%s' is a command, and commands are not allowed" % action.label,
                file=plan.file,
                element="place '%s'" % place,
                hint="if you trust the plan, allow them: %s" % how,
            )


def load_local_actions(plan: Plan, robot: str) -> Dict[str, LocalAction]:
    """The actions of a robot that need no ROS, by place.

    :raises PlanError: a function is missing or broken.
    """
    loaded: Dict[str, LocalAction] = dict(load_actions(plan, robot))
    for place in plan.action_places:
        action = plan.action(robot, place)
        if type(action) in LOCAL_KINDS:
            loaded[place] = LOCAL_KINDS[type(action)](plan, action)
    return loaded
