"""A task that a viewer submits: reads the form of the page."""

from __future__ import annotations

from gspn_framework_package.execution.log_entries import Submit, make_submit, new_task_id
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.activity import RequestFields, text_field


def submission(plan: Plan, fields: RequestFields) -> Submit:
    """The task in the fields ``transition``, ``id`` (made up if it is empty) and ``data``.

    :raises RefusedError: no tasks come in by that transition.
    :raises UsageError, DataError: a field is missing, or the id or the data cannot be taken.
    """
    transition = text_field(fields, "transition")
    if transition not in plan.submissions:
        raise RefusedError(
            "no tasks come in by '%s'" % transition[:80],
            hint="possible: %s" % (", ".join(plan.submissions) or "nothing"),
        )
    task = text_field(fields, "id", "").strip() or new_task_id("page")
    return make_submit(transition, task, fields.get("data", {}))
