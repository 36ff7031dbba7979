"""What the verbs of the analysis work on: a net, or a plan under its policy."""

from __future__ import annotations

import argparse
from typing import List, Tuple, Union

from gspn_framework_package.cli.net_input import add_net_arguments, read_net_argument
from gspn_framework_package.formats.plan_file import is_plan, read_plan
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan


def add_subject_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the net or plan, and the options of reading it."""
    add_net_arguments(parser)
    parser.add_argument(
        "--only-net",
        action="store_true",
        help="of a plan take the net by its weights, instead of the policy",
    )
    parser.add_argument("--robots", type=int, metavar="N", help="of a plan: for a team of N robots")


def read_subject(args: argparse.Namespace) -> Tuple[Union[Net, Plan], List[str]]:
    """The net or plan that the arguments name, and the reader's notes.

    :raises GspnError: it cannot be read, or the arguments make no sense.
    """
    if args.source_format is not None or not is_plan(args.net_file):
        if args.robots is not None:
            raise UsageError("--robots is for plans")
        return read_net_argument(args)
    if args.const or args.net is not None:
        raise UsageError("--net and --const are for nets; a plan says them itself")
    plan = read_plan(args.net_file)
    if args.robots is not None:
        plan = plan.for_robots(args.robots)
    return (plan.net if args.only_net else plan), list(plan.notes)
