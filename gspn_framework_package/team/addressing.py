"""Evaluates a team's answers for an operator's program; shared by all carriers."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Optional, TypeVar

from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.team.message_filter import json_object
from gspn_framework_package.team.orders import ORDERS

Address = TypeVar("Address")

SILENCE_PATIENCE = 2.0
"""Seconds within which a robot must answer a plain question."""

_STATUS_FIELDS = {
    "robot",
    "run",
    "plan",
    "synchronisation",
    "active",
    "quorum",
    "log_length",
    "marking",
    "paused",
    "ended",
    "finished",
    "fault",
    "waits_for",
    "robots",
}


def read_status(message: str) -> Optional[Dict[str, Any]]:
    """Parse a node's answer to the command ``status``; None if the text is not such an answer."""
    status = json_object(message)
    return status if status is not None and _STATUS_FIELDS <= set(status) else None


def robots_of_run(
    statuses: Mapping[Address, Optional[Dict[str, Any]]], run: str
) -> Dict[Address, Dict[str, Any]]:
    """The robots of one run that answered, with their status.

    :param statuses: address of a robot -> its status; None if it did not answer.
    :param run: the name of the run; "" if there is only one.
    :raises ExecutionError: no robot answered, or robots of several runs did.
    """
    there = {at: status for at, status in statuses.items() if status and run in ("", status["run"])}
    runs = sorted({status["run"] for status in there.values()})
    if not there:
        raise ExecutionError("no execution node answers%s" % (" of run '%s'" % run if run else ""))
    if len(runs) > 1:
        raise ExecutionError(
            "several runs are active: %s" % ", ".join(runs), hint="choose one with --run"
        )
    return there


def whom_to_order(there: Mapping[Address, Dict[str, Any]], command: str, robot: str) -> Address:
    """The address to send an order to: preferably the robot's own node (unless the order is
    against that robot), otherwise a node that has a vote, and of these one with the longest log:
    the others may not have heard yet of what the operator has seen."""
    own_last = ORDERS[command].against_robot
    return min(
        there,
        key=lambda at: (
            (there[at]["robot"] == robot) == own_last,
            not (there[at]["active"] or there[at].get("torn")),
            -int(there[at]["log_length"]),
            there[at]["robot"],
        ),
    )
