"""The check of a plan that a running team is to go on with."""

from __future__ import annotations

import time
from typing import Callable

from gspn_framework_package.analysis.preflight.check_plan import check
from gspn_framework_package.analysis.preflight.report import Severity
from gspn_framework_package.model.errors import CancelledError, GspnError
from gspn_framework_package.model.plan import Plan

CHECK_TIME = 3.0
"""Seconds that the check of a plan may take while the team runs. What is not decided by then does
not speak against the plan."""

CHECK_MARKINGS = 50_000
"""Markings that this check visits at most."""


def why_refused(
    plan: Plan, standalone: bool = False, clock: Callable[[], float] = time.monotonic
) -> str:
    """What the check has against a plan that begins where the team is; "" for nothing.

    :param standalone: whether this is a run without ROS, whose transitions may create and destroy
        tokens.
    """
    deadline = clock() + CHECK_TIME
    try:
        report = check(
            plan,
            standalone=standalone,
            limit=CHECK_MARKINGS,
            cancel=lambda: clock() > deadline,
        )
    except CancelledError:
        return ""
    except GspnError as error:
        return str(error)
    refused = [item.text for item in report.items if item.severity is Severity.REFUSED]
    return "; ".join(refused[:3])
