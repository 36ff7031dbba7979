"""``gspn trust``: has the present robots of a team continue without the others after a power loss.
Shows what that gives up, and asks for confirmation."""

from __future__ import annotations

import argparse
import sys
from typing import Any, Dict, List, Mapping

from gspn_framework_package.cli.options import Arguments, add_options
from gspn_framework_package.cli.orders import order_verbs
from gspn_framework_package.cli.status import print_table
from gspn_framework_package.cli.team_client import team_client
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.team.addressing import robots_of_run

_OPTIONS: Arguments = {
    "--yes": "do not ask for confirmation",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    order_verbs()["trust"].add_arguments(parser)
    add_options(parser, _OPTIONS)
    parser.epilog = (
        "Exit codes: 0 the order is in the log, and the team continues; 1 it was refused, or you "
        "declined; 2 wrong usage."
    )


def run(args: argparse.Namespace) -> int:
    """Show what each robot has and what is given up, ask, and give the order."""
    client = team_client(args)
    there = robots_of_run(client.statuses(), args.run_name)
    if not args.json:
        print_table({client.line.label(at): status for at, status in there.items()})
        print("\n".join(given_up(there)))
    if not args.yes:
        if args.json or not sys.stdin.isatty():
            raise UsageError(
                "this order gives something up and needs confirmation", hint="confirm it with --yes"
            )
        answer = input("Continue with what these robots know? [y/N]  ")
        if answer.strip().lower() not in ("y", "yes"):
            print("not done")
            return 1
    return order_verbs()["trust"].run(args)


def given_up(statuses: Mapping[Any, Dict[str, Any]]) -> List[str]:
    """The losses that the order accepts, one per line.

    :param statuses: the statuses of the run's robots that answer.
    """
    longest = max(statuses.values(), key=lambda status: int(status["log_length"]))
    here = {status["robot"] for status in statuses.values()}
    off = [m for m in longest.get("members", ()) if m not in here]
    torn = sorted(status["robot"] for status in statuses.values() if status.get("torn"))
    lines = ["The robots continue from the longest log here: %s slots." % longest["log_length"]]
    if torn:
        lines.append(
            "Lost in the power loss: firings, orders and tasks that are in none of these logs, "
            "from about the last second before it (torn: %s)." % ", ".join(torn)
        )
    if off:
        lines.append(
            "Given up: what only these robots know: %s. You assert that they are off, and stay "
            "off until they are evicted; later they can rejoin." % ", ".join(off)
        )
    return lines
