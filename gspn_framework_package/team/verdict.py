"""The verdict on a plan before it runs: the result of the check, and of examining the files that
belong to the plan.

Everything that starts, deploys or shows a plan uses this, so that all agree; with ROS,
``ros.check_all`` also checks the types of messages.
"""

from __future__ import annotations

import os
from typing import Any, Dict, List

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.preflight.report import CheckItem, PreflightReport, Severity
from gspn_framework_package.execution.actions import PythonAction
from gspn_framework_package.execution.breakpoints import BreakpointFile
from gspn_framework_package.execution.function_source import why_not_callable
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.errors import InputError, RefusedError
from gspn_framework_package.model.plan import Plan


def verdict(plan: Plan, **options: Any) -> PreflightReport:
    """Check a plan, without running any of its code.

    :param options: see :func:`~gspn_framework_package.analysis.preflight.check_plan.check`.
    :raises GspnError: as there.
    """
    report = check(plan, **options)
    return report._replace(
        items=(
            *_name_subnets(plan),
            *_look_at_functions(plan),
            *_look_at_breakpoints(plan),
            *report.items,
        )
    )


def obey(report: PreflightReport, plan: Plan) -> None:
    """Raise the refusal, if any. :raises RefusedError: the plan must not run."""
    if report.refused:
        raise RefusedError("the check refuses the plan: %s" % report.why, file=plan.file)


def _name_subnets(plan: Plan) -> List[CheckItem]:
    """Report which parts of the net are plans themselves."""
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
    """Report functions that are missing or cannot take their settings, as far as their source shows
    without running it."""
    found: Dict[str, CheckItem] = {}
    for place, action in plan.bindings():
        if not isinstance(action, FunctionAction):
            continue
        why = why_not_callable(plan.folder, action.function, action.settings, PythonAction)
        if why:
            text = "%s in %s: %s" % (action.function, place, why)
            found.setdefault(action.function + why, _function_item(text, place=place))
    for transition, source in plan.events.items():
        if not source.function:
            continue
        from gspn_framework_package.execution.event_functions import EventFunction

        why = why_not_callable(plan.folder, source.function, source.settings, EventFunction)
        if why:
            text = "%s for the event '%s': %s" % (source.function, transition, why)
            found[transition] = _function_item(text, transition=transition)
    return list(found.values())


def _function_item(text: str, **details: str) -> CheckItem:
    return CheckItem("functions", Severity.REFUSED, text, details)


def _look_at_breakpoints(plan: Plan) -> List[CheckItem]:
    """Warn about a breakpoint file next to the plan, which stops robots in every run."""
    file = BreakpointFile(plan)
    try:
        file.changed()
    except InputError as error:
        text = "%s; robots ignore it" % error
        return [CheckItem("breakpoints", Severity.WARNING, text, {"file": file.path})]
    if not any(file.breakpoints):
        return []
    text = "robots stop at %s in every run of this plan on this machine, because of %s" % (
        file.breakpoints.in_words,
        os.path.basename(file.path),
    )
    return [CheckItem("breakpoints", Severity.WARNING, text, file.breakpoints.to_json())]
