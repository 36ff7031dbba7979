"""``gspn status``: shows what every robot of a running team does and waits for."""

from __future__ import annotations

import argparse
import json
import time
from typing import Any, Dict, List, Optional, Sequence

from gspn_framework_package.cli.options import Arguments
from gspn_framework_package.cli.table import aligned
from gspn_framework_package.cli.team_client import TEAM_OPTIONS, team_client
from gspn_framework_package.execution.displayed_data import (
    SHOWN_TASKS,
    cause_text,
    order_text,
    shown,
)

_COLUMNS = ("robot", "place", "state", "visit", "log length", "last contact", "waits for")


OPTIONS: Arguments = {
    **TEAM_OPTIONS,
    "--data": "also print data, tasks and held events",
}

EPILOG = (
    "Each node reports on its own robot; the others report on a robot whose node does not "
    "answer. Exit codes: 0 every node answers and has a quorum, 1 otherwise, or no team found."
)


def run(args: argparse.Namespace) -> int:
    """Query every node and print the answers."""
    client = team_client(args)
    statuses = {
        client.line.label(at): status
        for at, status in client.statuses(args.data).items()
        if status is None or args.run_name in ("", status["run"])
    }
    if args.json:
        print(json.dumps(statuses))
    else:
        print_table(statuses)
    well = all(status is not None and status["quorum"] for status in statuses.values())
    return 0 if well and statuses else 1


def print_table(statuses: Dict[str, Optional[Dict[str, Any]]]) -> None:
    """Print a line for each robot of each run."""
    known = [status for status in statuses.values() if status is not None]
    for run_name in sorted({status["run"] for status in known}):
        of_run = [status for status in known if status["run"] == run_name]
        longest = max(of_run, key=lambda status: int(status["log_length"]))
        pause = ", paused: actions are stopped" if longest.get("stopped") else ", paused"
        paused = pause if longest["paused"] else ""
        over = ", over: %s" % longest["ended"] if longest["ended"] else ""
        row = run_name, longest["synchronisation"], paused + over
        print("run %s, %s synchronisation%s" % row)
        rows: List[Sequence[str]] = [_COLUMNS]
        for robot in longest["robots"]:
            own = next((s for s in of_run if s["robot"] == robot["robot"]), None)
            rows.append(_row(robot, own))
        named = {robot["robot"] for robot in longest["robots"]}
        rows += [_row_of_unknown(s) for s in of_run if s["robot"] not in named]
        more = [*data_lines(longest), *order_lines(of_run), *refusal_lines(of_run)]
        for line in [*aligned(rows), *more]:
            print("  " + line)
    for namespace in sorted(n for n, status in statuses.items() if status is None):
        print("the node in %s does not answer" % namespace)


def data_lines(status: Dict[str, Any]) -> List[str]:
    """Data, tasks and held events in a status, a line for each; none if the status was requested
    without."""
    lines = []
    for robot in status["robots"]:
        name, task = robot["robot"], robot.get("task")
        if task is not None:
            lines.append("%s has task %s" % (name, task[0] or "without an id"))
            lines += ["%s task.%s: %s" % (name, key, shown(v)) for key, v in task[1].items()]
        lines += [
            "%s holds %s%s" % (name, event, ": " + cause_text(cause) if cause else "")
            for event, cause in robot.get("held", {}).items()
        ]
        lines += [
            "%s robot.%s: %s" % (name, key, shown(v)) for key, v in robot.get("data", {}).items()
        ]
    reported = status.get("data", {})
    lines += ["team.%s: %s" % (key, shown(v)) for key, v in reported.get("team", {}).items()]
    for place, tasks in reported.get("queues", {}).items():
        ids = ", ".join(task[0] or "a task without an id" for task in tasks[:SHOWN_TASKS])
        more = " and %d more" % (len(tasks) - SHOWN_TASKS) if len(tasks) > SHOWN_TASKS else ""
        lines.append("queue %s: %s%s" % (place, ids or "no task", more))
    lines += [
        "%s: task %s is waiting outside" % tuple(waits) for waits in reported.get("waiting", [])
    ]
    return lines


def order_lines(statuses: Sequence[Dict[str, Any]]) -> List[str]:
    """The last orders to the robots and who gave them, a line for each."""
    given = [order for status in statuses for order in status.get("orders", ())]
    return [
        "%s  %s" % (time.strftime("%H:%M:%S", time.localtime(order["wall"])), order_text(order))
        for order in sorted(given, key=lambda order: float(order["wall"]))
    ]


def refusal_lines(statuses: Sequence[Dict[str, Any]]) -> List[str]:
    """The messages that the robots refused and their senders, a line for each kind."""
    return [
        "%s refused %d of %s: %s"
        % (status["robot"], kind["times"], kind["robot"] or "somebody", kind["why"])
        for status in sorted(statuses, key=lambda status: str(status["robot"]))
        for kind in status.get("refused", ())
    ]


def _row_of_unknown(own: Dict[str, Any]) -> Sequence[str]:
    """The row of a robot that answers but is not in any log yet."""
    return (own["robot"], "", "", "", _log_text(own, own), "now", own["waits_for"])


def _log_text(robot: Dict[str, Any], own: Optional[Dict[str, Any]]) -> str:
    """The length of a log, how much of it is on the disk, and whether it lost its end."""
    length = robot["log_length"]
    on_disk = length if own is None else own.get("synced_length", length)
    text = str(length) if on_disk >= length else "%d (%d on disk)" % (length, on_disk)
    return text + (", " + robot["log"] if robot.get("log") in ("torn", "lost") else "")


def _row(robot: Dict[str, Any], own: Optional[Dict[str, Any]]) -> Sequence[str]:
    waits_for = robot["waits_for"] if own is None else own["waits_for"]
    if own is not None:
        robot = next((r for r in own["robots"] if r["robot"] == own["robot"]), robot)
    contact = robot["last_contact"]
    return (
        robot["robot"],
        robot["place"],
        robot["state"],
        str(robot["visit"]),
        _log_text(robot, own),
        "now" if own is not None else "never" if contact is None else "%.1f s ago" % contact,
        waits_for,
    )
