"""``gspn tasks``: shows the tasks that a running team has, and how the last ones ended."""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import TYPE_CHECKING, Any, Callable, List, Mapping, Optional, Sequence

from gspn_framework_package.cli.options import Argument, Arguments, repeated
from gspn_framework_package.cli.table import aligned
from gspn_framework_package.cli.team_client import TEAM_OPTIONS, team_client
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.team.ended_tasks import EndedTasks, TaskNotice, WebHook

if TYPE_CHECKING:
    from gspn_framework_package.team.operator_client import OperatorClient

OPTIONS: Arguments = {
    **TEAM_OPTIONS,
    "--follow": "report how each task ends, until Ctrl-C; with --json, one object per line",
    Argument("--post", "URL", default=""): (
        "with --follow: post each as JSON to this web address (http:// or https://)"
    ),
    repeated("--private-host", "HOST"): (
        "a host of --post that may be called although its address is private"
    ),
}

EPILOG = (
    "One robot answers, for the whole team. Attempts: how often a robot took the task. With "
    "--follow, a robot is asked once a second; a team remembers the last 100 tasks that ended, so "
    "none is missed in a pause of the network in which fewer end. Exit codes: 0 a robot answered, "
    "1 none did."
)

_ASK_EVERY = 1.0  # s
_POSTS = 3  # attempts to post a notice

_COLUMNS = ("id", "waiting since", "until", "where", "priority", "attempts", "")


def run(args: argparse.Namespace) -> int:
    """Ask a robot, and print its answer."""
    if args.post and not args.follow:
        raise UsageError("--post requires --follow")
    if args.private_host and not args.post:
        raise UsageError("--private-host requires --post")
    client = team_client(args)
    if args.follow:
        return follow(client, args.run_name, _teller(args))
    known, text = client.order("tasks", "", "", args.run_name)
    if not known:
        raise ExecutionError(text)
    print(text if args.json else "\n".join(lines(json.loads(text))))
    return 0


def follow(client: OperatorClient, run: str, tell: Callable[[TaskNotice], None]) -> int:
    """Report how each task ends from now on, until the program is interrupted.

    :raises ExecutionError: no robot answers at first.
    """
    ended, heard = EndedTasks(), False
    while True:
        try:
            known, text = client.order("tasks", "", "", run)
            if not known:
                raise ExecutionError(text)
        except ExecutionError as error:
            if not ended.begun:
                raise
            if heard:
                print("no answer: %s" % error, file=sys.stderr, flush=True)
            heard = False
        else:
            heard = True
            for notice in ended.news(json.loads(text)["ended"]):
                tell(notice)
        time.sleep(_ASK_EVERY)


def _teller(args: argparse.Namespace) -> Callable[[TaskNotice], None]:
    """The function that reports a task. :raises UsageError: the options make no sense."""
    hook = WebHook(args.post, args.private_host) if args.post else None

    def tell(notice: TaskNotice) -> None:
        print(json.dumps(notice) if args.json else _ended(notice), flush=True)
        for left in reversed(range(_POSTS if hook is not None else 0)):
            try:
                assert hook is not None
                hook.post(notice)
                return
            except ExecutionError as error:
                if not left:
                    text = "task %s was not posted: %s" % (notice["id"], error)
                    print(text, file=sys.stderr, flush=True)
                else:
                    time.sleep(_ASK_EVERY)

    return tell


def _ended(notice: TaskNotice) -> str:
    return "%s: %s (%s)" % (notice["id"], notice["outcome"], notice["why"])


def lines(reported: Mapping[str, Any]) -> List[str]:
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
        for task in reported["tasks"]
    ]
    ended = map(_ended, reported["ended"])
    return [*(aligned(rows) if reported["tasks"] else ["the team has no task"]), *ended]


def _clock(seconds: Optional[float]) -> str:
    if seconds is None:
        return ""
    there = time.localtime(seconds)
    today = there[:3] == time.localtime()[:3]
    return time.strftime("%H:%M:%S" if today else "%Y-%m-%d %H:%M:%S", there)
