"""The command: injects faults into teams of real nodes, and checks their logs with the history
checker. Needs ROS.

``python3 -m benchmarks.faults --each-in-turn`` runs :mod:`.each_in_turn` on a
team of each size in each mode, ``--operators ROUNDS`` runs :mod:`.operators`, ``--hostile`` runs
:mod:`.hostile`, ``--deploying`` runs :mod:`.deploying`, ``--outages ROUNDS`` runs :mod:`.outages`;
``--minutes 30`` runs rounds of :mod:`.soak` with fresh teams until the time is over. The command
starts its own ROS master. Each team is finally paused, at rest, and verified.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from collections import Counter
from typing import Any, Callable, Dict, List, Optional, Sequence, Union

from benchmarks.faults.deploying import Deploying
from benchmarks.faults.each_in_turn import EachInTurn
from benchmarks.faults.hostile import Hostile
from benchmarks.faults.operators import Operators
from benchmarks.faults.outages import Outages
from benchmarks.faults.soak import Soak
from benchmarks.faults.team import FaultyTeam
from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.processes import end_cleanly_on_signal
from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.model.errors import ExecutionError, GspnError
from gspn_framework_package.model.plan import Synchronisation

Row = Dict[str, Any]
"""The result of one team."""

MOST_COLUMNS = 12
"""Most kinds of faults that get a column of their own in the table; --json lists all of them."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run a scenario; returns 0: no violation, and every team came to rest, 1: otherwise, 2: wrong
    usage, or no ROS."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.faults",
        description="Kills, cuts off, stops and restarts the processes of robot teams, and "
        "verifies their logs.",
        epilog="Exit codes: 0 all valid, 1 a violation or a team that did not go on, 2 wrong "
        "usage or no ROS.",
    )
    scenario = parser.add_mutually_exclusive_group()
    scenario.add_argument(
        "--each-in-turn", action="store_true", help="every fault to every robot, in each mode, once"
    )
    scenario.add_argument(
        "--operators",
        type=int,
        metavar="ROUNDS",
        help="evictions by force, returns with more log, lost logs, so many times each",
    )
    scenario.add_argument(
        "--hostile", action="store_true", help="malformed, forged, replayed and flooding messages"
    )
    scenario.add_argument(
        "--deploying",
        action="store_true",
        help="another plan for the running team, while each robot is killed at each step of it",
    )
    scenario.add_argument(
        "--outages",
        type=int,
        metavar="ROUNDS",
        help="all machines restarted, in order and after losses of power, so many times each",
    )
    scenario.add_argument(
        "--minutes", type=float, default=30.0, metavar="M", help="of random faults (30)"
    )
    parser.add_argument(
        "--round",
        type=float,
        default=45.0,
        metavar="S",
        help="seconds of random faults a team (45)",
    )
    parser.add_argument(
        "--robots", type=int, nargs="+", default=[2, 3, 5], metavar="N", help="sizes of the teams"
    )
    parser.add_argument(
        "--mode", choices=[m.value for m in Synchronisation], help="only this synchronisation"
    )
    parser.add_argument("--seed", type=int, default=None, help="of the faults (new)")
    parser.add_argument("--keep", action="store_true", help="keep the logs of good teams too")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    if min(args.robots) < (1 if args.outages else 2):
        parser.error("--robots: a team has at least two")
    if args.operators is not None and (args.operators < 1 or min(args.robots) < 3):
        parser.error("--operators: at least one round, with teams of three and more")
    try:
        need_ros()
        return _report(args)
    except GspnError as error:
        print("faults: error: %s" % error, file=sys.stderr)
        return error.exit_code


def _report(args: argparse.Namespace) -> int:
    end_cleanly_on_signal()
    seed = args.seed if args.seed is not None else random.SystemRandom().randrange(2**32)
    _tell("seed %d" % seed)
    source = random.Random(seed)
    modes = [Synchronisation(args.mode)] if args.mode else list(Synchronisation)
    began = time.monotonic()
    rows: List[Row] = []
    chosen = {
        "each in turn": args.each_in_turn,
        "operators": args.operators,
        "hostile": args.hostile,
        "deploying": args.deploying,
        "outages": args.outages,
    }
    name = next((scenario for scenario, asked in chosen.items() if asked), "soak")
    interrupted = False
    try:
        with Master() as master:
            if name != "soak":
                for robots in args.robots:
                    for mode in modes:
                        rows.append(_scenario(master, robots, mode, source, args))
            while name == "soak" and time.monotonic() - began < args.minutes * 60:
                robots, mode = source.choice(args.robots), source.choice(modes)
                rows.append(_soak(master, robots, mode, source, args.round, args.keep))
    except KeyboardInterrupt:
        _tell("interrupted; what was done until then:")
        interrupted = True
    injected: Counter[str] = Counter()
    for row in rows:
        injected.update(row["injected"])
    bad = [row for row in rows if row["fault"]]
    report = {
        "machine": describe_machine(),
        "scenario": name,
        "seed": seed,
        "minutes": round((time.monotonic() - began) / 60, 1),
        "teams": len(rows),
        "injected": dict(injected),
        "firings": sum(r["firings"] for r in rows),
        "slots": sum(r["slots"] for r in rows),
        "bad": len(bad),
        "rows": rows,
    }
    if args.json:
        print(json.dumps(report))
    else:
        _print(report, bad)
    return 130 if interrupted else 1 if bad else 0


def _soak(
    master: Master,
    robots: int,
    mode: Synchronisation,
    source: random.Random,
    seconds: float,
    keep: bool,
) -> Row:
    soak = Soak(master, robots, mode, source)
    row = _run(soak, lambda: soak.run(seconds), keep)
    return _told({"robots": robots, "mode": mode.value, "injected": dict(soak.injected), **row})


def _scenario(
    master: Master,
    robots: int,
    mode: Synchronisation,
    source: random.Random,
    args: argparse.Namespace,
) -> Row:
    def tell(step: str) -> None:
        _tell("%d robots, %s: %s" % (robots, mode.value, step))

    scenario: Union[EachInTurn, Operators, Hostile, Deploying, Outages]
    if args.operators:
        scenario = Operators(robots, mode, args.operators, tell)
    elif args.hostile:
        scenario = Hostile(robots, mode, tell)
    elif args.deploying:
        scenario = Deploying(robots, mode, tell)
    elif args.outages:
        scenario = Outages(robots, mode, args.outages, source.randrange(2**32), tell)
    else:
        scenario = EachInTurn(master, robots, mode, source, tell)
    row = _run(scenario, scenario.run, args.keep)
    details = scenario.details() if isinstance(scenario, EachInTurn) else {}
    return _told(
        {
            "robots": robots,
            "mode": mode.value,
            "injected": dict(scenario.injected),
            **details,
            **row,
        }
    )


def _run(scenario: Any, run: Callable[[], None], keep: bool) -> Row:
    """Run a scenario and verify its team; keeps the logs of a team that failed."""
    began = time.monotonic()
    team: FaultyTeam = scenario.team
    team.keep = keep
    row: Row = {"fault": "", "firings": 0, "slots": 0, "logs": 0, "folder": team.folder}
    try:
        with team:
            run()
            team.end()
            verdict = team.verdict(settled=True)
            row.update(firings=verdict.firings, slots=verdict.slots, logs=verdict.logs)
            if verdict.violation is not None:
                raise ExecutionError("rule %d: %s" % verdict.violation)
    except GspnError as error:
        row["fault"] = str(error)
    return dict(row, seconds=round(time.monotonic() - began, 1))


def _told(row: Row) -> Row:
    faults = ", ".join("%s %d" % item for item in sorted(row["injected"].items()))
    told = row["robots"], row["mode"], faults, row["firings"], row["fault"] or "valid"
    _tell("%d robots, %s: %s; %d firings; %s" % told)
    return row


def _tell(text: str) -> None:
    print("faults: " + text, file=sys.stderr, flush=True)


def _print(report: Row, bad: List[Row]) -> None:
    faults = sorted(report["injected"])
    if len(faults) > MOST_COLUMNS:  # messages of many kinds
        faults = []
    columns = ["robots", "mode", *(faults or ["kinds", "sent"]), "firings", "logs", "verdict"]
    lines = [
        [
            r["robots"],
            r["mode"],
            *(
                [r["injected"].get(f, 0) for f in faults]
                or [len(r["injected"]), sum(r["injected"].values())]
            ),
            r["firings"],
            r["logs"],
            "bad" if r["fault"] else "valid",
        ]
        for r in report["rows"]
    ]
    print(table(columns, lines))
    print(
        "%(teams)d teams, %(firings)d firings in %(slots)d slots, %(bad)d bad, %(minutes).1f "
        "minutes" % report
    )
    for row in bad:
        print("bad: %(robots)d robots, %(mode)s: %(fault)s; logs: %(folder)s" % row)
    print(machine_line(report["machine"]))
