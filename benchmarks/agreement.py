"""Many simulated teams, each under its own seed, each verified by the history checker.

``python3 -m benchmarks.agreement --schedules 10000``

Exit codes: 0 no violation, 1 a violation (reported with the schedule that shows it), 2 wrong usage,
130 interrupted (with Ctrl-C or SIGTERM; the results so far are reported).
"""

from __future__ import annotations

import argparse
import gc
import json
import platform
import random
import sys
import time
from typing import Any, Dict, Iterator, List, Optional

from agreement.schedule import (
    KINDS,
    Schedule,
    run_schedule,
)
from agreement.world import ViolationError
from benchmarks.harness.processes import end_cleanly_on_signal
from gspn_framework_package.execution.agreement import config

SIZES = {1: 4, 2: 30, 3: 48, 4: 8, 5: 6, 8: 3, 13: 1}
"""Robots in a team, and how many of a hundred schedules have teams of that size."""

TIDY_EVERY = 25
"""Schedules after which memory is tidied; together they take less than 100 MB."""

TELL_EVERY = 30.0
"""Seconds between two lines of progress if standard error is not a terminal."""


SHARES = {
    "": 33,
    "operator": 20,
    "power": 12,
    "outage": 14,
    "trust": 6,
    "spare": 5,
    "stand-in": 2,
    "tight": 10,
    "amnesia": 6,
    "calm": 2,
    "freeze": 2,
    "link": 1,
    "sleep": 1,
    "leave": 2,
    "rivals": 2,
    "late": 1,
    "double": 2,
    "assertion": 2,
    "archive": 3,
    "react": 24,
    "react-operator": 10,
    "react-power": 8,
    "react-outage": 6,
    "react-trust": 2,
    "react-spare": 3,
    "react-tight": 6,
    "react-amnesia": 4,
    "react-calm": 3,
    "react-freeze": 2,
    "react-link": 1,
    "react-sleep": 1,
    "react-leave": 2,
    "react-rivals": 2,
    "react-late": 1,
    "react-double": 1,
    "react-assertion": 1,
    "react-archive": 2,
    "deploy": 24,
    "deploy-operator": 8,
    "deploy-power": 6,
    "deploy-outage": 4,
    "deploy-spare": 2,
    "deploy-tight": 6,
    "deploy-amnesia": 4,
    "deploy-calm": 6,
    "deploy-freeze": 2,
    "deploy-leave": 1,
    "deploy-rivals": 2,
    "deploy-archive": 2,
}
"""Kinds of schedules, and how often each is drawn."""


def draw_schedules(
    first_seed: int,
    number: int,
    sizes: Optional[List[int]] = None,
    kinds: Optional[List[str]] = None,
) -> Iterator[Schedule]:
    """Schedules with consecutive seeds from ``first_seed`` on; each seed determines the size, mode
    and kind."""
    for seed in range(first_seed, first_seed + number):
        source = random.Random(seed)
        if sizes:
            robots = source.choice(sizes)
        else:
            robots = source.choices(list(SIZES), list(SIZES.values()))[0]
        partial = source.random() < 0.5
        kind = (
            source.choice(kinds)
            if kinds
            else source.choices(list(SHARES), list(SHARES.values()))[0]
        )
        yield Schedule(seed, robots, partial, kind)


def main(arguments: Optional[List[str]] = None) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    kinds = ", ".join(kind for kind in KINDS if kind)
    parser.add_argument(
        "--schedules", type=int, default=2000, metavar="N", help="how many (default %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, metavar="S", help="the first seed (default: by the clock)"
    )
    parser.add_argument(
        "--robots", type=int, nargs="+", metavar="N", help="team sizes (default: 1 to 13)"
    )
    parser.add_argument(
        "--kinds",
        nargs="+",
        choices=list(KINDS),
        metavar="KIND",
        help="what goes wrong: %s" % kinds,
    )
    parser.add_argument(
        "--only", metavar="SEED:N:MODE", help="run just this schedule, e.g. 17:3:full:power"
    )
    parser.add_argument(
        "--small-team",
        type=int,
        metavar="N",
        help="what is done otherwise in large teams, is done in teams of more than N (default: %d)"
        % config.SMALL_TEAM,
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="stop after that time")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")
    args = parser.parse_args(arguments)
    if args.only:
        schedules: Iterator[Schedule] = iter([Schedule.parse(args.only)])
        args.schedules = 1
    else:
        first = args.seed if args.seed is not None else int(time.time()) % 10**8 * 1000
        schedules = draw_schedules(first, args.schedules, args.robots, args.kinds)
    if args.small_team is not None:
        config.SMALL_TEAM = args.small_team
    end_cleanly_on_signal()
    result = run(schedules, args.schedules, args.seconds)
    if args.json:
        print(json.dumps(result))
    else:
        tell(result)
    if result["violations"]:
        return 1
    return 130 if result["interrupted"] else 0


def run(
    schedules: Iterator[Schedule], number: int, seconds: Optional[float] = None
) -> Dict[str, Any]:
    """Run the schedules; returns the sums over all of them, and every violation."""
    sums: Dict[str, Any] = {
        "schedules": 0,
        "blocked": 0,
        "slots": 0,
        "firings": 0,
        "messages": 0,
        "steps": 0,
    }
    faults: Dict[str, int] = {}
    sizes: Dict[str, int] = {}
    violations = []
    interrupted = False
    gc.freeze()
    gc.disable()  # the parts of a replica know each other: it all goes at once, later
    begin, cpu = time.perf_counter(), time.process_time()
    progress = _Progress(number)
    try:
        for schedule in schedules:
            try:
                outcome = run_schedule(schedule)
            except Exception as error:  # also that of a replica, which would end its node
                text = str(error) if isinstance(error, ViolationError) else repr(error)
                violations.append({"schedule": str(schedule), "text": text})
                outcome = None
            sums["schedules"] += 1
            kind = "%d %s" % (schedule.robots, "partial" if schedule.partial else "full")
            sizes[kind] = sizes.get(kind, 0) + 1
            if outcome is not None:
                for key in ("blocked", "slots", "firings", "messages", "steps"):
                    sums[key] += getattr(outcome, key)
                for fault, count in outcome.faults.items():
                    faults[fault] = faults.get(fault, 0) + count
            progress.tell(sums["schedules"], len(violations))
            if sums["schedules"] % TIDY_EVERY == 0:
                gc.collect()
            if seconds is not None and time.perf_counter() - begin > seconds:
                break
    except KeyboardInterrupt:
        interrupted = True
    finally:
        gc.enable()
    progress.end()
    passed = time.perf_counter() - begin
    return {
        **sums,
        "faults": faults,
        "teams": dict(sorted(sizes.items())),
        "seconds": round(passed, 1),
        "cpu_seconds": round(time.process_time() - cpu, 1),
        "schedules_per_minute": round(sums["schedules"] / passed * 60),
        "machine": "%s, Python %s" % (platform.machine(), platform.python_version()),
        "violations": violations,
        "interrupted": interrupted,
    }


class _Progress:
    """Reports the progress of a run on standard error: on a terminal one line that is rewritten,
    otherwise a new line at intervals."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._terminal = sys.stderr.isatty()
        self._begin = time.perf_counter()
        self._next = 0.2 if self._terminal else TELL_EVERY

    def tell(self, done: int, violations: int) -> None:
        passed = time.perf_counter() - self._begin
        if passed < self._next:
            return
        self._next = passed + (0.2 if self._terminal else TELL_EVERY)
        rate = done / passed * 60
        text = "%d of %d schedules, %d violations, %.0f a minute" % (
            done,
            self._number,
            violations,
            rate,
        )
        sys.stderr.write("\r" + text.ljust(78) if self._terminal else "agreement: " + text + "\n")
        sys.stderr.flush()

    def end(self) -> None:
        if self._terminal:
            sys.stderr.write("\r" + 78 * " " + "\r")
            sys.stderr.flush()


def tell(result: Dict[str, Any]) -> None:
    """Print a result as text."""
    for key in (
        "schedules",
        "violations",
        "blocked",
        "slots",
        "firings",
        "messages",
        "steps",
        "seconds",
        "cpu_seconds",
        "schedules_per_minute",
        "machine",
    ):
        value = result[key]
        print(
            "%-22s %s" % (key.replace("_", " "), len(value) if isinstance(value, list) else value)
        )
    for title in ("teams", "faults"):
        print("%-22s %s" % (title, ", ".join("%s: %d" % pair for pair in result[title].items())))
    if result["interrupted"]:
        print("interrupted")
    for violation in result["violations"][:20]:
        print("VIOLATION in %(schedule)s: %(text)s" % violation)


if __name__ == "__main__":
    sys.exit(main())
