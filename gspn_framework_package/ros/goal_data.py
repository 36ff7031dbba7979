"""How data travels with the goals and results of ExecGSPN action servers, whose messages have no
field for it: as JSON in fields of the action protocol that are free there.

A goal has ``{"data": {full name: value}, "resumed_from": visit}`` in the ``frame_id`` of its
header, unless both are empty. A goal that succeeded has the data that its action wrote,
``{name: value}``, in the text of its status, unless there is none. Servers and clients that do not
know of data are not disturbed by that, and servers in any language can read and write it.
"""

from __future__ import annotations

import json
from typing import Any, Dict, Mapping, NamedTuple

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.team.message_filter import json_object


class GoalData(NamedTuple):
    """What an action may read; see :class:`StartAction`."""

    data: Mapping[str, Any] = NOTHING
    resumed_from: int = 0


def goal_text(command: StartAction) -> str:
    """The ``frame_id`` of a goal; "" if there is nothing to read."""
    if not command.data and not command.resumed_from:
        return ""
    return json.dumps({"data": dict(command.data), "resumed_from": command.resumed_from})


def read_goal_text(text: str) -> GoalData:
    """What the ``frame_id`` of a goal says; nothing if another client wrote it."""
    found = json_object(text) or {}
    data, resumed_from = found.get("data"), found.get("resumed_from")
    return GoalData(
        data if isinstance(data, dict) else NOTHING,
        resumed_from if isinstance(resumed_from, int) else 0,
    )


def result_text(data: Mapping[str, Any]) -> str:
    """The text of a goal that succeeded; "" if its action wrote no data."""
    return json.dumps(dict(data)) if data else ""


def read_result_text(text: str) -> Dict[str, Any]:
    """The data in the text of a goal that succeeded; none if it is a text for people."""
    return json_object(text) or {}
