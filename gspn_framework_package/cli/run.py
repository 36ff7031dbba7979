"""``gspn run``: executes a plan without ROS, with agents on threads, and shows the run."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import threading
import time
import uuid
from dataclasses import replace
from typing import Any, Dict, List, Optional, Sequence

from gspn_framework_package.analysis.preflight.while_running import CHECK_MARKINGS, why_refused
from gspn_framework_package.cli import numbers
from gspn_framework_package.cli.interrupts import wait_for
from gspn_framework_package.cli.options import MODULES_OPTION, Argument, Arguments
from gspn_framework_package.execution.breakpoints import BreakpointFile
from gspn_framework_package.execution.control_socket import ControlSocket, DeployRequest
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.local_kinds import ALLOW_IN_STANDALONE_RUN, refuse_commands
from gspn_framework_package.execution.log_entries import Entry
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import ExecutionError, RefusedError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.verdict import obey, verdict

OPTIONS: Arguments = {
    Argument("plan", "PLAN"): "a plan file, or a folder with a plan.json",
    Argument("--agents", "N", numbers.robots): "run the plan with N agents",
    Argument("--seconds", "S", numbers.duration): "stop after S seconds",
    Argument("--firings", "N", numbers.whole(1, 2**53)): "stop after N firings",
    Argument("--seed", kind=numbers.seed): "seed of the policy's draws, instead of the plan's",
    Argument("--log", "FILE"): "record the run as an event log (a new file)",
    "--json": (
        "print a JSON object per line: firings, faults, the end; output of actions goes to "
        "standard error"
    ),
    "--allow-commands": "let the plan run programs on this computer (actions with 'command')",
    **MODULES_OPTION,
    "--quiet": "print only faults and the end",
}

EPILOG = (
    "Exit codes: 0 the run completed or reached a given limit, 1 the plan was refused or the "
    "run was stopped by a failure, 2 not a plan, 130 interrupted."
)


def run(args: argparse.Namespace) -> int:
    """Check the plan, execute it, and report how it ended."""
    plan = _plan(args)
    event_log = open_event_log(args.log, plan)
    printer = _Printer(plan, args.json, args.quiet)
    executor = StandaloneExecutor(
        plan,
        printer,
        event_log,
        firing_limit=args.firings,
        allow_commands=args.allow_commands,
    )
    executor.breakpoint_file = BreakpointFile(plan)
    if executor.breakpoint_file.changed():
        print(
            "note: breakpoints: %s" % executor.breakpoint_file.breakpoints.in_words, file=sys.stderr
        )
    # output of an action could split a JSON line
    with contextlib.redirect_stdout(sys.stderr) if args.json else contextlib.nullcontext():
        return _execute(args, executor, printer, event_log)


def _execute(
    args: argparse.Namespace,
    executor: StandaloneExecutor,
    printer: _Printer,
    event_log: Optional[EventLogWriter],
) -> int:
    started = time.monotonic()
    deadline = started + args.seconds if args.seconds is not None else None
    executor.start()
    control = _control_socket(executor)
    try:
        if not wait_for(printer.over, _left(deadline)) and not executor.over:
            executor.stop("the limit of %g seconds" % args.seconds)
        ended = executor.wait()
    except KeyboardInterrupt:
        executor.stop("interrupted")
        executor.wait(5.0)
        raise
    except ExecutionError as error:
        printer.print_end(
            error.message, executor.status()["marking"], time.monotonic() - started, broken=True
        )
        raise
    finally:
        if control is not None:
            control.close()
        if event_log is not None and executor.over:
            event_log.close()
    assert ended is not None
    fault = executor.state.fault  # neither a normal end nor a limit
    printer.print_end(ended.reason, executor.status()["marking"], time.monotonic() - started, fault)
    return 1 if fault else 0


def _control_socket(executor: StandaloneExecutor) -> Optional[ControlSocket]:
    """The socket for ``gspn deploy --standalone``; None if it cannot be created."""
    began_with = executor.plan

    def about() -> Dict[str, Any]:
        present = executor.plan
        files = [os.path.realpath(p.file) for p in (began_with, present) if p.file is not None]
        return {"plan": present.name, "files": files}

    def deploy(request: DeployRequest) -> str:
        plan = read_plan(request.plan)
        if request.folder is not None:
            plan = replace(plan, folder=request.folder or began_with.folder)
        agents = not executor.plan.keeps_robots
        obey(verdict(plan, standalone=agents, limit=CHECK_MARKINGS), plan)
        executor.deploy(plan, request.mapping, request.wait, lambda here: why_refused(here, agents))
        return "the run continues under the plan '%s'" % plan.name

    try:
        return ControlSocket(about, deploy)
    except ExecutionError as error:
        print("note: gspn deploy cannot reach this run: %s" % error, file=sys.stderr)
        return None


def _left(deadline: Optional[float]) -> Optional[float]:
    return None if deadline is None else max(0.0, deadline - time.monotonic())


def _plan(args: argparse.Namespace) -> Plan:
    plan = read_plan(args.plan)
    if args.seed is not None:
        plan = plan.with_seed(args.seed)
    if args.agents is not None:
        plan = plan.for_robots(args.agents)
    for note in plan.notes:
        print("note: %s" % note, file=sys.stderr)
    if not args.allow_commands:
        refuse_commands(plan, ALLOW_IN_STANDALONE_RUN)
    report = verdict(plan, standalone=True)
    if report.refused:
        print(report, file=sys.stderr)
        raise RefusedError("the plan was refused", file=plan.file, hint="see the report above")
    for doubt in report.doubts:
        print("warning: the plan %s: see 'gspn check --standalone'" % doubt, file=sys.stderr)
    return plan


def open_event_log(path: Optional[str], plan: Plan) -> Optional[EventLogWriter]:
    """The log of a run with agents; None without a path. :raises UsageError: the file exists."""
    if path is None:
        return None
    if os.path.exists(path):
        raise UsageError(
            "the file exists already", file=path, hint="give --log the name of a new file"
        )
    first = header(plan, plan.name, "", uuid.uuid4().hex, agents=True)
    return EventLogWriter(path, first, fsync=plan.fsync)


class _Printer(Listener):
    """Prints the events of the run; ``over`` is set when the run is over."""

    def __init__(self, plan: Plan, as_json: bool, quiet: bool) -> None:
        self.over = threading.Event()
        self._plan = plan
        self._json = as_json
        self._out = sys.stdout
        self._quiet = quiet
        self._count = 0

    def on_step(
        self, slot: int, entries: Sequence[Entry], firings: Sequence[Firing], state: TeamState
    ) -> None:
        for firing in firings:
            self._count += 1
            if self._json:
                self._print(
                    "firing",
                    slot=firing.slot,
                    index=firing.index,
                    transition=firing.transition,
                    agent=firing.robot,
                    moves=[list(m[:3]) for m in firing.moves],
                    marking=self._plan.net.named(firing.marking, zeros=False),
                )
            elif not self._quiet:
                print(
                    "%6d  %s  %s" % (self._count, firing.transition, moves_text(firing)), flush=True
                )

    def on_plan(self, plan: Plan) -> None:
        self._plan = plan
        if self._json:
            self._print("plan", plan=plan.name)
        elif not self._quiet:
            print("        continues under the plan %s" % plan.name, flush=True)

    def on_fault(self, agent: str, message: str) -> None:
        if self._json:
            self._print("fault", agent=agent, message=message)
        else:
            who = "agent %s: " % agent if agent else ""
            print("fault: %s%s" % (who, message), file=sys.stderr, flush=True)

    def on_end(self, reason: str, finished: bool) -> None:
        self.over.set()

    def on_broken(self, reason: str) -> None:
        # the end is printed by the caller, on a thread that can report a failure to print
        self.over.set()

    def print_end(
        self, reason: str, marking: Dict[str, int], seconds: float, broken: bool = False
    ) -> None:
        """Print how the run ended; ``broken`` means that an action or the executor itself
        failed."""
        if self._json:
            ended = {"reason": reason, "fault": broken, "firings": self._count}
            self._print("end", **ended, seconds=round(seconds, 3), marking=marking)
            return
        there = ", ".join("%s: %d" % item for item in marking.items() if item[1])
        print("ended: %s; %d firings in %.1f s; %s" % (reason, self._count, seconds, there))

    def _print(self, event: str, **data: Any) -> None:
        print(json.dumps({"event": event, **data}), file=self._out, flush=True)


def moves_text(firing: Firing) -> str:
    """The moves of the robots at a firing, in words."""
    parts: List[str] = []
    for move in firing.moves:
        if move.source is None:
            parts.append("%s appears in %s" % (move.robot, move.target))
        elif move.target is None:
            parts.append("%s ends in %s" % (move.robot, move.source))
        else:
            parts.append("%s: %s -> %s" % (move.robot, move.source, move.target))
    return ", ".join(parts)
