"""``gspn mcp``: a server for the Model Context Protocol, for programs that work with language
models. It reads requests from standard input and writes answers to standard output."""

from __future__ import annotations

import argparse
import signal
import sys

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.mcp_resources import Resources
from gspn_framework_package.cli.mcp_server import ModelContextServer
from gspn_framework_package.cli.mcp_tools import CallLimits, PlanTools
from gspn_framework_package.cli.options import MODULES_OPTION, Argument, Arguments

OPTIONS: Arguments = {
    Argument("folder", "FOLDER", default=".", nargs="?"): (
        "folder of the plans, nets and logs that may be read; nothing outside it is accessible "
        "(default: .)"
    ),
    "--allow-write": (
        "let draft_plan and optimise write new plans into the folder; they never overwrite files"
    ),
    Argument("--limit-time", "S", numbers.duration, 120.0): (
        "time limit of a call, in seconds (default: %(default)g)"
    ),
    Argument("--limit-output", "N", numbers.whole(1000, 10**9), 200_000): (
        "maximum number of characters of an answer (default: %(default)s)"
    ),
    **MODULES_OPTION,
}

EPILOG = "No tool commands robots, runs a plan or imports a plan's functions."


def run(args: argparse.Namespace) -> int:
    """Serve until the client closes the connection."""
    tools = PlanTools(args.folder, args.allow_write, CallLimits(args.limit_time, args.limit_output))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    resources = Resources(args.folder, args.limit_output)
    ModelContextServer(tools, resources, sys.stdin.buffer, sys.stdout.buffer).run()
    return 0
