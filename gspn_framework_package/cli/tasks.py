"""``gspn tasks``: shows the tasks that a running team has, and how the last ones ended."""

from __future__ import annotations

import argparse
import json
import time
from typing import Any, List, Mapping, Optional, Sequence

from gspn_framework_package.cli.options import Arguments
from gspn_framework_package.cli.table import aligned
from gspn_framework_package.cli.team_client import TEAM_OPTIONS, team_client
from gspn_framework_package.model.errors import ExecutionError

OPTIONS: Arguments = {**TEAM_OPTIONS}

EPILOG = (
    "One robot answers, for the whole team. Attempts: how often a robot took the task. Exit codes: "
    "0 a robot answered, 1 none did."
)

_COLUMNS = ("id", "waiting since", "until", "where", "priority", "attempts", "")


def run(args: argparse.Namespace) -> int:
    """Ask a robot, and print its answer."""
    known, text = team_client(args).order("tasks", "", "", args.run_name)
    if not known:
        raise ExecutionError(text)
    print(text if args.json else "\n".join(lines(json.loads(text))))
    return 0


def lines(told: Mapping[str, Any]) -> List[str]:
    """The answer of a robot as lines of text."""
    rows: List[Sequence[str]] = [_COLUMNS]
    rows += [
        (
            task["id"],
            _clock(task["since"]),
            _clock(task["until"]),
            task["where"]
            + (" in " + task["place"] if task["robot"] else "")
            + (", at " + _clock(task["at"]) if task["at"] else "")
            + (", every %d s" % task["every"] if task["every"] else "")
            + (", for " + task["to"] if task["to"] and task["to"] != task["robot"] else ""),
            str(task["priority"]),
            str(task["attempts"]),
            task["trouble"],
        )
        for task in told["tasks"]
    ]
    ended = ["%s: %s (%s)" % (e["id"], e["outcome"], e["why"]) for e in told["ended"]]
    return [*(aligned(rows) if told["tasks"] else ["the team has no task"]), *ended]


def _clock(seconds: Optional[float]) -> str:
    if seconds is None:
        return ""
    there = time.localtime(seconds)
    today = there[:3] == time.localtime()[:3]
    return time.strftime("%H:%M:%S" if today else "%Y-%m-%d %H:%M:%S", there)
