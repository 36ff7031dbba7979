"""All that ``gspn check`` and the editor check: the check before a run, the source of functions,
and, in a shell that has ROS, the types of goals, messages and events. Without ROS it works too.
"""

from __future__ import annotations

import os
from typing import List, Optional

from gspn_framework_package.analysis.preflight import MARKING_LIMIT, check
from gspn_framework_package.analysis.preflight.report import (
    CheckItem,
    PreflightReport,
    Severity,
    names,
)
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.execution.actions import missing_function
from gspn_framework_package.execution.breakpoints import BreakpointFile
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.plan import Plan


def check_all(
    plan: Plan,
    *,
    limit: int = MARKING_LIMIT,
    standalone: bool = False,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> PreflightReport:
    """Check a plan, without running anything of it.

    :param plan: the plan.
    :param limit: see :func:`~gspn_framework_package.analysis.preflight.check_plan.check`, as all
        other parameters.
    :raises GspnError: as there.
    """
    report = check(plan, limit=limit, standalone=standalone, progress=progress, cancel=cancel)
    return report._replace(
        items=(
            *_name_subnets(plan),
            *_look_at_functions(plan),
            *_look_at_types(plan),
            *_look_at_events(plan),
            *_look_at_breakpoints(plan),
            *report.items,
        )
    )


def _name_subnets(plan: Plan) -> List[CheckItem]:
    """Say which parts of the net are plans of their own."""
    return [
        CheckItem(
            "subnets",
            Severity.OK,
            "%s is the plan '%s': robots enter %s and leave from %s"
            % (name, subnet.plan, subnet.entry, subnet.exit),
            {"subnet": name, **subnet.to_json()},
        )
        for name, subnet in plan.subnets.items()
    ]


def _look_at_functions(plan: Plan) -> List[CheckItem]:
    """Report missing functions, as far as the source shows without running it."""
    places = {
        action.function: place
        for place, action in plan.bindings()
        if isinstance(action, FunctionAction)
    }
    items = []
    for function, place in places.items():
        text = missing_function(plan.folder, function)
        if text:
            text = "%s in %s: %s" % (function, place, text)
            items.append(CheckItem("functions", Severity.REFUSED, text, {"place": place}))
    for transition, source in plan.events.items():
        text = missing_function(plan.folder, source.function) if source.function else ""
        if text:
            text = "%s for the event '%s': %s" % (source.function, transition, text)
            items.append(CheckItem("functions", Severity.REFUSED, text, {"transition": transition}))
    return items


def _look_at_breakpoints(plan: Plan) -> List[CheckItem]:
    """Warn of breakpoints that are kept beside the plan: they halt robots in every run."""
    file = BreakpointFile(plan)
    try:
        file.changed()
    except InputError as error:
        text = "%s; robots ignore it" % error
        return [CheckItem("breakpoints", Severity.WARNING, text, {"file": file.path})]
    if not any(file.breakpoints):
        return []
    text = "robots halt at %s in every run of this plan here: %s says so" % (
        file.breakpoints.told,
        os.path.basename(file.path),
    )
    return [CheckItem("breakpoints", Severity.WARNING, text, file.breakpoints.to_json())]


def _look_at_types(plan: Plan) -> List[CheckItem]:
    """Report goals, requests, messages and conditions of actions that do not fit their types, if
    this shell has ROS, which knows these."""
    if all(isinstance(action, (FunctionAction, type(None))) for _, action in plan.bindings()):
        return []
    try:
        from gspn_framework_package.ros.action_kinds import look_at_actions
    except ImportError:
        return []
    found = look_at_actions(plan)
    items = [
        CheckItem("goals", Severity.REFUSED, "%s: %s" % (where, text), {"where": where})
        for where, text in found.misfits.items()
    ]
    for text in sorted(set(found.unknown.values())):
        places = [where for where, said in found.unknown.items() if said == text]
        items.append(
            CheckItem(
                "goals",
                Severity.WARNING,
                "%s; its fields were not looked at (%s)" % (text, names(places)),
                {"where": places},
            )
        )
    return items


def _look_at_events(plan: Plan) -> List[CheckItem]:
    """Report topics, fields and conditions of events that do not fit their messages, if this shell
    has ROS, which knows their types."""
    if not any(source.topic for source in plan.events.values()):
        return []
    try:
        from gspn_framework_package.ros.event_sources import look_at_events
    except ImportError:
        return []
    found = look_at_events(plan)
    items = [
        CheckItem("sources", Severity.REFUSED, "event '%s': %s" % (t, text), {"transition": t})
        for t, text in found.misfits.items()
    ]
    for t, text in found.unknown.items():
        text = "event '%s': %s; its messages were not looked at" % (t, text)
        items.append(CheckItem("sources", Severity.WARNING, text, {"transition": t}))
    return items
