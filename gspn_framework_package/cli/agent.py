"""``gspn agent``: runs a robot of a real team without ROS."""

from __future__ import annotations

import argparse
import os
import signal
import threading
import time
from types import FrameType
from typing import Optional

from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.interrupts import EXIT_INTERRUPTED, wait_for
from gspn_framework_package.cli.options import (
    MODULES_OPTION,
    Argument,
    Arguments,
    repeated,
)
from gspn_framework_package.cli.team_client import access_of, way_options
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan, Synchronisation

LEAVING_TIME = 5.0
"""Seconds within which an agent must end after a request."""

OPTIONS: Arguments = {
    Argument("plan", "PLAN"): "a plan file, or a folder with a plan.json",
    Argument("--robot", "NAME", required=True): "name of this robot in the plan",
    **way_options("a router of the team: tls/HOST:7447 with keys, tcp/HOST:7447 without"),
    repeated("--listen", "ENDPOINT"): (
        "address at which other robots reach this one without a router"
    ),
    Argument("--run", "NAME", default="run", dest="run_name"): (
        "name of the run (default: run); an agent restarted under the same name continues where it "
        "was"
    ),
    Argument("--log", "FILE"): "the robot's log (default: ~/.ros/gspn/RUN/ROBOT.jsonl)",
    Argument("--place", "PLACE", default=""): (
        "the place where a robot that is not in the plan joins the running team"
    ),
    "--stay": "keep running and answering after the end of the run",
    "--allow-commands": "let the plan run programs on this computer (actions with 'command')",
    Argument("--robots", "N", numbers.robots): (
        "size of the team at the start (default: as in the plan)"
    ),
    **MODULES_OPTION,
    "--quiet": "print only warnings and errors",
    "--json": "print a JSON object per line: messages, diagnoses, and how the robot ended",
}

EPILOG = (
    "Start one agent for each robot; they communicate through 'gspn router' and wait until it "
    "is running. Reach them with 'gspn status --connect ENDPOINT' and the orders. Exit "
    "codes: 0 the run completed, 1 the plan was refused, the run was stopped or failed, or "
    "the router refused the robot, 2 wrong input or usage, 130 interrupted: the robot is "
    "still in the team."
)


def run(args: argparse.Namespace) -> int:
    """Check the plan, and run the robot until the run is over."""
    from gspn_framework_package.team.agent import JsonReporter, PrintedReporter, make_agent
    from gspn_framework_package.team.commands import handlers_of
    from gspn_framework_package.team.host import HostOptions
    from gspn_framework_package.team.plan_examination import check_plan
    from gspn_framework_package.team.router_wait import await_router
    from gspn_framework_package.team.zenoh_carrier import ZenohCarrier
    from gspn_framework_package.team.zenoh_session import session_config, zenoh_library

    plan = _plan_of(args)
    access = access_of(args, args.robot)
    printed = JsonReporter(args.robot) if args.json else None
    reporter = printed or PrintedReporter(args.robot, args.quiet)
    check_plan(plan, reporter.warn)
    partial = plan.synchronisation is Synchronisation.PARTIAL
    options = HostOptions(args.run_name, _log_of(args), args.place, args.stay)
    signal.signal(signal.SIGTERM, _interrupt)
    zenoh_library()
    session_config(access)  # do not wait for wrong endpoints
    if not access.listen:  # otherwise the session itself connects when it can
        await_router(access.connect, reporter.warn, time.sleep)
    host = make_agent(
        plan,
        args.robot,
        options,
        reporter,
        lambda host: ZenohCarrier(args.robot, args.run_name, access, handlers_of(host), partial),
        args.allow_commands,
    )
    over = threading.Event()
    host.start(lambda robot: over.set())
    code = EXIT_INTERRUPTED
    try:
        wait_for(over)
        code = host.exit_code or 0
    finally:
        host.stop()
        host.join(LEAVING_TIME)
        if printed is not None:
            printed.write("end", exit_code=code, log=options.log_file)
    return code


def _interrupt(number: int, frame: Optional[FrameType]) -> None:
    raise KeyboardInterrupt


def _plan_of(args: argparse.Namespace) -> Plan:
    plan = read_plan(args.plan)
    if args.robots is not None:
        plan = plan.for_robots(args.robots)
    names = [robot.name for robot in plan.robots]
    if args.robot not in names + list(plan.witness) and not args.place:
        raise UsageError(
            "the plan has no robot '%s'" % args.robot,
            element="--robot",
            hint="robots of the plan: %s; a robot that joins the running team needs --place"
            % ", ".join(names),
        )
    if not args.connect and not args.listen:
        raise UsageError(
            "how can the other robots be reached?", element="--connect", hint="tcp/HOST:7447"
        )
    return plan


def _log_of(args: argparse.Namespace) -> str:
    from gspn_framework_package.team.log_file import check_run_name, log_path

    check_run_name(args.run_name, "--run")
    return os.path.abspath(args.log) if args.log else log_path("", args.run_name, args.robot)
