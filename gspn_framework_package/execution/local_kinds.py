"""The kinds of action that need no ROS, beside Python functions: in standalone runs, and in the
execution nodes of robots."""

from __future__ import annotations

from typing import Any, Callable, Dict

from gspn_framework_package.execution.actions import ActionContext, ActionResult, load_actions
from gspn_framework_package.execution.commands import Command
from gspn_framework_package.model.action import CommandAction
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan

LocalAction = Callable[[ActionContext], ActionResult]
"""Carries an action out, on a thread of its own: returns its result, or raises ActionFailed or
DataError. It ends soon after ``is_cancelled``."""

LOCAL_KINDS: Dict[type, Callable[[Plan, Any], LocalAction]] = {
    CommandAction: lambda plan, action: Command(action, plan.folder, plan.cancel_grace),
}
"""Kind of action -> what makes an action of a plan ready to be run."""


ALLOW_IN_STANDALONE_RUN = "gspn run --allow-commands"
"""How the operator of a standalone run allows commands."""


def refuse_commands(plan: Plan, how: str) -> None:
    """Refuse a plan that runs programs.

    :param how: what the operator does to allow it.
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
