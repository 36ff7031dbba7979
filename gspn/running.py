"""A run of a plan on threads, whose firings are kept."""

from __future__ import annotations

import threading
import time
from typing import Any, Dict, List, Optional, Sequence

from gspn.results import RunResult
from gspn_framework_package.cli.interrupts import wait_for
from gspn_framework_package.cli.run import moves_text, open_event_log
from gspn_framework_package.execution.breakpoints import BreakpointFile
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.log_entries import Entry
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.team.verdict import obey, verdict


def run_plan(
    plan: Plan,
    seconds: Optional[float],
    firings: Optional[int],
    log: Optional[str],
    allow_commands: bool,
) -> RunResult:
    """Check a plan and run it; see ``Plan.run``."""
    obey(verdict(plan, standalone=True), plan)
    follower = _Follower()
    executor = StandaloneExecutor(
        plan, follower, firing_limit=firings, allow_commands=allow_commands
    )
    executor.breakpoint_file = BreakpointFile(plan)
    event_log = open_event_log(log, plan)
    if event_log is not None:
        executor.record_to(event_log)
    began = time.monotonic()
    executor.start()
    try:
        if not wait_for(follower.over, seconds) and not executor.over:
            executor.stop("the limit of %g seconds" % (seconds or 0))
        ended = executor.wait()
    except KeyboardInterrupt:
        executor.stop("interrupted")
        executor.wait(5.0)
        raise
    finally:
        if event_log is not None and executor.over:
            event_log.close()
    assert ended is not None
    return RunResult(
        ended.reason,
        bool(executor.state.fault),
        time.monotonic() - began,
        executor.status()["marking"],
        follower.firings,
    )


class _Follower(Listener):
    """Keeps the firings; ``over`` is set when the run is over."""

    def __init__(self) -> None:
        self.over = threading.Event()
        self.firings: List[Dict[str, Any]] = []

    def on_step(
        self, slot: int, entries: Sequence[Entry], firings: Sequence[Firing], state: TeamState
    ) -> None:
        for firing in firings:
            self.firings.append(
                {
                    "number": len(self.firings) + 1,
                    "transition": firing.transition,
                    "moves": moves_text(firing),
                }
            )

    def on_end(self, reason: str, finished: bool) -> None:
        self.over.set()

    def on_broken(self, reason: str) -> None:
        self.over.set()
