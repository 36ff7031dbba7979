"""The whole check of a plan: the :mod:`~gspn_framework_package.team.verdict` on it and, in a shell
that has ROS, the types of its goals, messages and events. Also works without ROS.
"""

from __future__ import annotations

from typing import Any, List

from gspn_framework_package.analysis.preflight.report import (
    CheckItem,
    PreflightReport,
    Severity,
    name_list,
)
from gspn_framework_package.model.action import ROS_KINDS
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.verdict import verdict


def check_all(plan: Plan, **options: Any) -> PreflightReport:
    """Check a plan, without running any of its code.

    :param options: see :func:`~gspn_framework_package.team.verdict.verdict`.
    :raises GspnError: as there.
    """
    report = verdict(plan, **options)
    return report._replace(items=(*_look_at_types(plan), *_look_at_events(plan), *report.items))


def _look_at_types(plan: Plan) -> List[CheckItem]:
    """Report goals, requests, messages and conditions of actions that do not fit their types, if
    this shell has ROS."""
    if not any(isinstance(action, ROS_KINDS) for _, action in plan.bindings()):
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
                "%s; its fields were not checked (%s)" % (text, name_list(places)),
                {"where": places},
            )
        )
    return items


def _look_at_events(plan: Plan) -> List[CheckItem]:
    """Report topics, fields and conditions of events that do not fit their messages, if this shell
    has ROS."""
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
        text = "event '%s': %s; its messages were not checked" % (t, text)
        items.append(CheckItem("sources", Severity.WARNING, text, {"transition": t}))
    return items
