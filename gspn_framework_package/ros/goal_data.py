"""Transports data with the goals and results of ExecGSPN action servers, whose messages have no
field for it: as JSON in unused fields of the action protocol.

A goal has ``{"data": {full name: value}, "resumed_from": visit}`` in the ``frame_id`` of its
header, unless both are empty. A succeeded goal has the data that its action wrote, ``{name:
value}``, in the text of its status, unless there is none. Servers and clients that do not know
about data are not affected, and servers in any language can read and write it.
"""

from __future__ import annotations

import json
from typing import Any, Dict, Mapping, NamedTuple

from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.log_entries import NOTHING
from gspn_framework_package.team.message_filter import json_object


class GoalData(NamedTuple):
    """The data that an action may read; see :class:`StartAction`."""

    data: Mapping[str, Any] = NOTHING
    resumed_from: int = 0


def goal_text(command: StartAction) -> str:
    """The ``frame_id`` of a goal; "" if there is no data."""
    if not command.data and not command.resumed_from:
        return ""
    return json.dumps({"data": dict(command.data), "resumed_from": command.resumed_from})


def read_goal_text(text: str) -> GoalData:
    """Parse the ``frame_id`` of a goal; empty if another client wrote it."""
    found = json_object(text) or {}
    data, resumed_from = found.get("data"), found.get("resumed_from")
    return GoalData(
        data if isinstance(data, dict) else NOTHING,
        resumed_from if isinstance(resumed_from, int) else 0,
    )


def result_text(data: Mapping[str, Any]) -> str:
    """The status text of a succeeded goal; "" if its action wrote no data."""
    return json.dumps(dict(data)) if data else ""


def read_result_text(text: str) -> Dict[str, Any]:
    """Parse the data in the status text of a succeeded goal; empty if the text is for people."""
    return json_object(text) or {}
