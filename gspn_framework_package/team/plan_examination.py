"""Decides whether a robot may follow a plan: checks the plan before a run; during a run, also
checks that the functions of another plan load and its actions can be carried out."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Callable, Dict, List, Tuple

from gspn_framework_package.execution.plan_modules import HOW_TO_ALLOW, may_hold_functions
from gspn_framework_package.model.errors import ExecutionError, GspnError, PlanError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.own_process import in_own_process
from gspn_framework_package.team.sides import ActionSide, EventSide


def with_folder(plan: Plan, folder: str, present: Plan) -> Plan:
    """Set the folder of functions of a plan from the log.

    :param folder: the folder; "" for that of ``present``.
    :raises PlanError: the folder does not belong to the plan.
    """
    if folder and folder != present.folder:
        if not os.path.isdir(folder):
            raise PlanError("the folder %s does not exist" % folder)
        if not may_hold_functions(folder):
            raise PlanError(
                "the folder %s does not contain a plan" % folder,
                hint=HOW_TO_ALLOW % (folder, folder),
            )
    return replace(plan, folder=folder or present.folder, file=present.file)


def why_not_followed(
    staged: Callable[[], Plan],
    present: Plan,
    actions: ActionSide,
    sources: Callable[[Plan], EventSide],
) -> str:
    """Why a robot cannot follow a staged plan; "" if it can. This may take some seconds, so do not
    call it on the worker thread.

    :param staged: returns the plan, with its folder, or raises a :class:`GspnError`.
    :param present: the plan that the robot follows now.
    :param actions: the robot's action side.
    :param sources: creates the sources of a plan's events.
    """
    try:
        plan = staged()
        sources(plan).close()
        return actions.why_not(plan, present)
    except GspnError as error:
        return str(error)
    except Exception as error:  # any failure means that the robot cannot follow the plan
        return "%s: %s" % (type(error).__name__, error)


def why_refused_in_own_process(plan: Plan) -> str:
    """Why the check refuses a plan that starts from the team's present marking; "" if it does not.
    This may take some seconds, so do not call it on the worker thread."""
    try:
        return in_own_process(_why_refused, plan)
    except GspnError as error:
        return str(error)


def _why_refused(plan: Plan) -> str:
    from gspn_framework_package.analysis.preflight import while_running

    return while_running.why_refused(plan)


def check_plan(plan: Plan, warn: Callable[[str], None]) -> None:
    """Check a plan before it runs.

    :param warn: receives a warning for each kind of finding.
    :raises ExecutionError: the plan must not run.
    """
    warnings, reasons = in_own_process(_findings, plan)
    for text in warnings:
        warn("%s: %s" % (plan.name, text))
    if reasons:
        raise ExecutionError("the plan is refused: %s" % "; ".join(reasons), file=plan.file)


def _findings(plan: Plan) -> Tuple[List[str], List[str]]:
    """One warning for each kind of finding, and the reasons why the plan must not run."""
    from gspn_framework_package.analysis.preflight.report import Severity
    from gspn_framework_package.team.verdict import verdict

    report = verdict(plan)
    warnings: Dict[str, List[str]] = {}
    for item in report.items:
        if item.severity is Severity.WARNING:
            warnings.setdefault(item.check, []).append(item.text)
    more = " (and %d more of this kind: see 'gspn check')"
    shown = [
        "%s: %s%s" % (kind, texts[0], more % (len(texts) - 1) if len(texts) > 1 else "")
        for kind, texts in warnings.items()
    ]
    return shown, [i.text for i in report.items if i.severity is Severity.REFUSED]
