"""Whether a robot's node can follow another plan: its functions load, its actions fit their types,
and the check finds nothing against it."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Dict, Optional, Set, Tuple

from gspn_framework_package.analysis.preflight.while_running import why_refused as why_refused
from gspn_framework_package.execution.local_kinds import refuse_commands
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import ExecutionError, GspnError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.action_kinds import Job, jobs, live_types
from gspn_framework_package.ros.action_targets import action_targets
from gspn_framework_package.ros.event_sources import EventSources, Host
from gspn_framework_package.ros.options import NodeOptions
from gspn_framework_package.ros.place_servers import PlaceServers

ALLOW = "~allow_commands, allow_commands:=true"


def with_folder(plan: Plan, folder: str, present: Plan) -> Plan:
    """A plan from the log, with the folder of its functions.

    :param folder: where they are; "": where those of ``present`` are.
    """
    return replace(plan, folder=folder or present.folder, file=present.file)


def jobs_of(plan: Plan, robot: str, namespace: str, options: NodeOptions) -> Dict[str, Job]:
    """The actions of a robot that are no action servers, by place.

    :raises GspnError: one does not fit its type, or the ROS graph, or is not allowed.
    """
    if not options.allow_commands:
        refuse_commands(plan, ALLOW)
    found = jobs(plan, robot, namespace)
    types = live_types() if found and options.check else {}
    for place, job in found.items():
        clash = job.clash(types) if options.check else None
        if clash:
            raise ExecutionError(clash, file=plan.file, element="action of '%s'" % place)
    return found


def why_not_followed(
    plan: Plan,
    present: Plan,
    robot: str,
    namespace: str,
    options: NodeOptions,
    servers: Optional[PlaceServers],
    host: Host,
) -> str:
    """Why a robot cannot follow ``plan``; "" if it can. Servers for functions of the plan are
    started. It may take some seconds: do not call this on the worker thread.

    :param plan: the staged plan, with its folder.
    :param present: the plan that the robot follows now.
    :param servers: the place servers in this process, if it has them.
    """
    if plan.folder and plan.folder != present.folder and not os.path.isdir(plan.folder):
        return "there is no folder %s" % plan.folder
    try:
        action_targets(plan, robot, namespace)
        jobs_of(plan, robot, namespace, options)
        EventSources(plan, robot, namespace, False, host).close()
        if servers is not None:
            servers.prepare(plan)
        else:
            new = sorted(_functions(plan, robot) - _functions(present, robot))
            if new:
                return (
                    "'%s' runs in place servers of another process, which keep to their plan"
                    % new[0][1]
                )
    except GspnError as error:
        return str(error)
    return ""


def _functions(plan: Plan, robot: str) -> Set[Tuple[str, str]]:
    """(place, function) of every Python action of a robot."""
    bound = ((place, plan.action(robot, place)) for place in plan.action_places)
    return {(place, a.function) for place, a in bound if isinstance(a, FunctionAction)}
