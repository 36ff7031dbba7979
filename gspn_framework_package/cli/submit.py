"""``gspn submit``: gives a task to a running team."""

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
        "transition", metavar="TRANSITION", help="the transition by which the task comes in"
    )
    parser.add_argument(
        "--data",
        default="{}",
        metavar="FILE|JSON",
        help="the data of the task: a JSON object, a file that holds one, or - for the input",
    )
    parser.add_argument(
        "--id",
        default="",
        help="what identifies the task: of several with one id, the first counts; default: a new "
        "one",
    )
    add_team_options(parser)
    parser.epilog = (
        "If it is not certain that the task came in (no answer in time), submit it again with the "
        "same --id: it comes in once. Exit codes: 0 the team has the task, 1 it has not, or no "
        "team was found, 2 the task or the usage is wrong."
    )


def run(args: argparse.Namespace) -> int:
    """Submit the task; return 0 if the team has it, else 1."""
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
    """The JSON object in an argument: itself, or in the file that it names ("-": the input).

    :raises UsageError: it cannot be read.
    :raises DataError: it is not a JSON object.
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
                hint="--data is a JSON object, or a file that holds one",
            ) from None
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError("is not JSON: %s" % error, file=where) from None
    if is_too_deep(data):
        raise DataError(TOO_DEEP, file=where)
    if not isinstance(data, dict):
        raise DataError("is not a JSON object, but %.100r" % (data,), file=where)
    return data
