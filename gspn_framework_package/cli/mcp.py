"""``gspn mcp``: a server for the Model Context Protocol, for programs that work with language
models. It reads requests from standard input and writes answers to standard output."""

from __future__ import annotations

import argparse
import signal
import sys

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.mcp_server import ModelContextServer
from gspn_framework_package.cli.mcp_tools import CallLimits, PlanTools
from gspn_framework_package.cli.modules import add_modules


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    parser.add_argument(
        "folder",
        nargs="?",
        default=".",
        metavar="FOLDER",
        help="folder of the plans, nets and logs that may be read; nothing outside it is "
        "accessible (default: .)",
    )
    parser.add_argument(
        "--allow-write",
        action="store_true",
        help="let draft_plan and optimise write new plans into the folder; they never "
        "overwrite files",
    )
    parser.add_argument(
        "--limit-time",
        type=numbers.duration,
        default=120.0,
        metavar="S",
        help="time limit of a call, in seconds (default: %(default)g)",
    )
    parser.add_argument(
        "--limit-output",
        type=numbers.whole(1000, 10**9),
        default=200_000,
        metavar="N",
        help="maximum number of characters of an answer (default: %(default)s)",
    )
    add_modules(parser)
    parser.epilog = "No tool commands robots, runs a plan or imports a plan's functions."


def run(args: argparse.Namespace) -> int:
    """Serve until the client closes the connection."""
    tools = PlanTools(args.folder, args.allow_write, CallLimits(args.limit_time, args.limit_output))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    ModelContextServer(tools, sys.stdin.buffer, sys.stdout.buffer).run()
    return 0
