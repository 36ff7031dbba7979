"""``gspn submit``: submits a task to a running team."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any, Dict

from gspn_framework_package.cli.team_client import add_team_options, team_client
from gspn_framework_package.execution.log_entries import make_submit, new_task_id
from gspn_framework_package.formats.json_file import TOO_DEEP, is_too_deep
from gspn_framework_package.formats.source import read_text
from gspn_framework_package.model.errors import DataError, InputError, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of this verb."""
    parser.add_argument(
        "transition", metavar="TRANSITION", help="the transition that takes the task"
    )
    parser.add_argument(
        "--data",
        default="{}",
        metavar="FILE|JSON",
        help="the data of the task: a JSON object, a file that contains one, or - for "
        "standard input",
    )
    parser.add_argument(
        "--id",
        default="",
        help="id of the task; of several tasks with the same id only the first counts (default: "
        "a new id)",
    )
    add_team_options(parser)
    parser.epilog = (
        "If it is uncertain whether the team has the task (no answer in time), submit it again "
        "with the same --id: it counts only once. Exit codes: 0 the team has the task, 1 it does "
        "not, or no team was found, 2 the task or the usage is wrong."
    )


def run(args: argparse.Namespace) -> int:
    """Submit the task; return 0 if the team has it, otherwise 1."""
    task_id = args.id or new_task_id("submitted")
    task = make_submit(args.transition, task_id, read_data(args.data))
    argument = json.dumps({"transition": task.transition, "id": task.id, "data": dict(task.data)})
    done, message = team_client(args).order("submit", "", argument, args.run_name)
    if args.json:
        print(json.dumps({"order": "submit", "done": done, "message": message, "id": task_id}))
    else:
        print("%s: task %s: %s" % ("done" if done else "not done", task_id, message))
    return 0 if done else 1


def read_data(text: str) -> Dict[str, Any]:
    """Read a JSON object from an argument: the text itself, or the file that it names ("-" for
    standard input).

    :raises UsageError: it cannot be read.
    :raises DataError: the text is not a JSON object.
    """
    where = "--data"
    if text == "-":
        text = sys.stdin.read()
    elif not text.lstrip().startswith("{"):
        where = text
        try:
            text = read_text(text)
        except InputError as error:
            raise UsageError(
                error.message,
                file=where,
                hint="--data takes a JSON object, or a file that contains one",
            ) from None
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError("is not JSON: %s" % error, file=where) from None
    if is_too_deep(data):
        raise DataError(TOO_DEEP, file=where)
    if not isinstance(data, dict):
        raise DataError("is not a JSON object but %.100r" % (data,), file=where)
    return data
