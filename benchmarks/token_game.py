"""Throughput of the token game, alone and with agents on threads: ``python3 -m
benchmarks.token_game``.

It runs the net of the thesis's first experiment (``plans/tokens``) with actions that return at
once. "Token game" passes each finished action straight back to the game; "with event log" also
chains and writes the log; "standalone" runs the plan as ``gspn run`` does, with every agent on a
thread.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import sys
import tempfile
import time
import uuid
from typing import Any, Deque, Dict, List, Optional, Sequence

from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.plans import INSTANT, MODULE, tokens_plan
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.firing import Firing, StartAction
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.plan import Plan

TEAMS = (1, 3, 5, 13, 100, 1_000)

ANSWERS = {"p1": "t1", "p2": "t2", "p3": "t3", "p5": "t4", "p7": "t7"}
"""The transitions that the actions of ``plans/tokens`` name; in p6 the policy decides."""


class _Counter(Listener):
    """Counts firings."""

    firings = 0

    def on_step(
        self,
        slot: int,
        entries: Sequence[log_entries.Entry],
        firings: Sequence[Firing],
        state: TeamState,
    ) -> None:
        self.firings += len(firings)


def game_rate(plan: Plan, seconds: float) -> float:
    """Firings per second of the token game alone."""
    game = TokenGame(plan)
    state = game.new_state()
    waiting: Deque[StartAction] = collections.deque()
    step = game.reduce(state, 0, [game.start_entry("benchmark")])
    firings, slot = 0, 1
    begin = time.perf_counter()
    while True:
        waiting.extend(c for c in step.commands if isinstance(c, StartAction))
        if slot % 256 == 0 and time.perf_counter() - begin >= seconds:
            return firings / (time.perf_counter() - begin)
        goal = waiting.popleft()
        done = log_entries.Done(
            goal.robot, goal.incarnation, goal.visit, ANSWERS.get(goal.place, "")
        )
        step = game.reduce(state, slot, [done])
        firings += len(step.firings)
        slot += 1


def standalone_rate(plan: Plan, seconds: float, record: bool) -> float:
    """Firings per second of a standalone run, with or without an event log on disk."""
    with tempfile.TemporaryDirectory() as folder:
        writer = None
        if record:
            path = os.path.join(folder, "run.jsonl")
            writer = EventLogWriter(
                path, header(plan, plan.name, "", uuid.uuid4().hex, agents=True)
            )
        counter = _Counter()
        allow_modules([MODULE])
        executor = StandaloneExecutor(plan, counter, writer)
        begin = time.perf_counter()
        executor.start()
        time.sleep(seconds)
        firings, elapsed = counter.firings, time.perf_counter() - begin
        executor.stop("the end of the benchmark")
        executor.wait(30.0)
        return firings / elapsed


def measure(agents: int, seconds: float) -> Dict[str, Any]:
    """The three rates with ``agents`` agents."""
    plan = tokens_plan(INSTANT).for_robots(agents)
    return {
        "agents": agents,
        "token_game": game_rate(plan, seconds),
        "standalone": standalone_rate(plan, seconds, record=False),
        "standalone_recorded": standalone_rate(plan, seconds, record=True),
    }


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.token_game", description=__doc__.split(":")[0]
    )
    parser.add_argument("--quick", action="store_true", help="0.2 s each, up to 13 agents")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    teams: List[int] = [n for n in TEAMS if not args.quick or n <= 13]
    results = [measure(n, 0.2 if args.quick else 3.0) for n in teams]
    machine = describe_machine()
    if args.json:
        print(json.dumps({"machine": machine, "results": results}, indent=2))
        return 0
    print(
        machine_line(machine)
        + "\nFirings per second, plans/tokens with actions that return at once:\n"
    )
    head = ("agents", "token game", "standalone", "standalone, recorded")
    print(table(head, [list(result.values()) for result in results]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
