"""The check of a plan to be deployed to a running team."""

from __future__ import annotations

import time

from gspn_framework_package.analysis.preflight.check_plan import check
from gspn_framework_package.model.errors import CancelledError, GspnError
from gspn_framework_package.model.plan import Plan

CHECK_TIME = 3.0
"""Seconds that the check of a plan may take while the team runs. Questions undecided by then do not
count against the plan."""

CHECK_MARKINGS = 50_000
"""Largest number of markings that this check visits."""

MARKINGS_AT_LAST = 50
"""Number of markings that it visits after the time is over, so that they and the structure can be
reported."""


def why_refused(plan: Plan, standalone: bool = False) -> str:
    """The objections of the check, within :data:`CHECK_TIME`, to a plan that starts from the team's
    present state; "" if there are none.

    :param standalone: whether transitions may create and destroy tokens, as in a run without ROS
        whose present plan does so.
    """
    deadline = time.monotonic() + CHECK_TIME
    try:
        try:
            return check(
                plan,
                standalone=standalone,
                limit=CHECK_MARKINGS,
                cancel=lambda: time.monotonic() > deadline,
                seconds=0,
            ).why
        except CancelledError:
            return check(plan, standalone=standalone, limit=MARKINGS_AT_LAST, seconds=0).why
    except GspnError as error:
        return str(error)
