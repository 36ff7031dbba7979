"""A year of a fleet's history: ``python3 -m benchmarks.history``.

First it measures how fast event logs become a history: a run in virtual time is recorded, and
ingested. Then the compiled simulation plays a year of 100 patrolling robots. Its stays go straight
into a store, because its logs would take more than 100 GB. At last each report is asked in a
separate process: its time and its largest memory are those of the whole command.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import types
import uuid
from dataclasses import replace
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from benchmarks.machine import (
    LIBRARIES,
    describe_machine,
    machine_line,
    table,
)
from gspn_framework_package.analysis.simulation import kernel, machine
from gspn_framework_package.analysis.simulation.plan_run import PlanRun
from gspn_framework_package.analysis.simulation.plan_tables import PlanTables
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.virtual_time import VirtualRun
from gspn_framework_package.fleet.database import open_database, quoted, totals_sql, write_table
from gspn_framework_package.fleet.ingest import Ingest, new_run
from gspn_framework_package.fleet.stay_follower import DAY_SECONDS
from gspn_framework_package.fleet.store import Store, file_name
from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming

BEGIN = 20_454 * DAY_SECONDS
"""The first second of 2026."""

SAVED_EVERY = 10
"""Days after which the store gets what was simulated, so that a run that is ended is of use."""

MOST_A_DAY = 3_000_000
"""Rows of stays and of failures for which there is room: a day may not have more."""


def patrol(robots: int) -> Plan:
    """The patrol with actions that take as long as those of real robots, and sometimes fail."""
    plan = read_plan(os.path.join(plans_folder(), "patrol")).for_robots(robots)
    times = {
        "Check": Duration.gamma(8.0, 20.0),
        "Alarm": Duration.lognormal(0.5, 15.0),
        "Decide": Duration.exponential(1.0),
        "Wait": Duration.exponential(12.0),
    }
    durations = {
        place: next(time for word, time in times.items() if ":" + word in place)
        for place in plan.action_places
    }
    failures = {place: 0.002 for place in plan.action_places if ":Check" in place}
    retry = FailureRule.retry(1_000_000)
    return replace(plan, durations=durations, failures=failures, on_failure={"*": retry}).validate()


# -- from a log ------------------------------------------------------------------------------------


def log_rate(plan: Plan, seconds: float, folder: str) -> Dict[str, float]:
    """How fast the log of a run in virtual time becomes a history."""
    path = os.path.join(folder, "run.jsonl")
    run = VirtualRun(plan, agents=True)
    writer = run.record_in(path, plan.name, uuid.uuid4().hex)
    run.run(seconds)
    writer.close()
    store = Store(os.path.join(folder, "store"), create=True)
    begin = time.process_time()
    with store.locked():
        (log,) = Ingest(store).read([path])
    spent = time.process_time() - begin
    assert not log.error, log.error
    return {
        "slots": log.slots,
        "slots_a_second": log.slots / spent,
        "log_bytes": os.path.getsize(path),
        "store_bytes": _size(store.folder),
    }


def _size(folder: str) -> int:
    return sum(
        os.path.getsize(os.path.join(f, n)) for f, _, names in os.walk(folder) for n in names
    )


# -- a year ----------------------------------------------------------------------------------------


class _Rows(NamedTuple):
    """Room for the stays and failures of a day, as the compiled loop fills it; ``counts`` has their
    numbers. Times are seconds of the run."""

    counts: Any
    robot: Any
    place: Any
    target: Any
    visit: Any
    began: Any
    acted: Any
    ended: Any
    arrived: Any
    failed_robot: Any
    failed_place: Any
    failed_at: Any


class _Now(NamedTuple):
    """What the robots are up to, for the compiled loop."""

    at: Any
    phase: Any
    failures: Any
    visit: Any
    began: Any
    waits_since: Any
    arrived: Any


def _record(r: Any, b: Any, s: Any, stop: float, now: Any, rows: Any) -> int:
    """Play until ``stop``, one event at a time, and note what each changes; returns why it stopped.

    Compiled by :func:`_compiled`, with ``play`` the compiled loop of the kernel.
    """
    at, phase, failures, visit, began, waits_since, arrived = now
    counts, robots, places, targets, visits, begins, acts, ends, arrivals = rows[:9]
    failed_robot, failed_place, failed_at = rows[9:]
    clocks = s[1]
    s_at, s_phase, _, s_failures, _, _, _ = s[5]
    n = counts[0]
    failed = counts[1]
    status = 0
    while status == 0:
        status = play(r, b, s, stop, 1)  # type: ignore[name-defined]  # noqa: F821
        time = clocks[0]
        for robot in range(len(at)):
            if s_failures[robot] > failures[robot]:
                failed_robot[failed] = robot
                failed_place[failed] = at[robot]
                failed_at[failed] = time
                failed += 1
            failures[robot] = s_failures[robot]
            if s_at[robot] != at[robot]:
                robots[n] = robot
                places[n] = at[robot]
                targets[n] = s_at[robot]
                visits[n] = visit[robot]
                begins[n] = began[robot]
                acts[n] = min(waits_since[robot], time)
                ends[n] = time
                arrivals[n] = arrived[robot]
                n += 1
                at[robot] = s_at[robot]
                visit[robot] += 1
                began[robot] = time
                arrived[robot] = 1
                waits_since[robot] = 1e300
                phase[robot] = 1
            if s_phase[robot] != phase[robot]:
                phase[robot] = s_phase[robot]
                waits_since[robot] = time if phase[robot] == 2 else 1e300
    counts[0] = n
    counts[1] = failed
    return status


def _compiled() -> Any:
    """The compiled form of :func:`_record`."""
    from numba import njit

    names = {**globals(), "play": machine.compiled_kernel()["play"]}
    function = types.FunctionType(_record.__code__, names, "_record")
    return njit(nogil=True)(function)


class Year:
    """Simulated days of a fleet, one after the other.

    :param plan: a validated plan in which a robot that moves comes to another place.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._run = PlanRun(PlanTables(plan, PlanTiming(plan)))
        self._run.compile()
        self._run.begin([1, 2, 3, 4])
        self._play = _compiled()
        count = len(plan.robots)
        state = self._run.state
        self._now = _Now(
            state.robots.at[:count].copy(),
            np.full(count, kernel.DOING),
            np.zeros(count, dtype=np.int64),
            np.ones(count, dtype=np.int64),
            np.zeros(count),
            np.full(count, 1e300),
            np.ones(count, dtype=np.int64),
        )
        real = ("began", "acted", "ended", "failed_at")
        self._rows = _Rows(
            np.zeros(2, dtype=np.int64),
            *(
                np.zeros(MOST_A_DAY, dtype=float if name in real else np.int64)
                for name in _Rows._fields[1:]
            ),
        )

    def day(self, number: int) -> Tuple[Dict[str, Any], Dict[str, Any]]:
        """Play a day; its stays and failures as columns. Stays that go on are cut at its end."""
        rows, now = self._rows, self._now
        rows.counts[:] = 0
        end = float((number + 1) * DAY_SECONDS)
        status = self._play(*self._run.arguments, end, tuple(now), tuple(rows))
        while status == kernel.GROW:
            self._run.go(end, 1)  # makes room
            status = self._play(*self._run.arguments, end, tuple(now), tuple(rows))
        assert status == kernel.AT_STOP, status
        n, failed = (int(count) for count in rows.counts)
        open_ones = np.arange(len(now.at))
        stays = {
            "robot": np.concatenate([rows.robot[:n], open_ones]),
            "place": np.concatenate([rows.place[:n], now.at]),
            "target": np.concatenate([rows.target[:n], np.full(len(now.at), -1)]),
            "visit": np.concatenate([rows.visit[:n], now.visit]),
            "arrived": np.concatenate([rows.arrived[:n], now.arrived]) > 0,
        }
        began = _ms(np.concatenate([rows.began[:n], now.began]))
        ended = _ms(np.concatenate([rows.ended[:n], np.full(len(now.at), end)]))
        acted = np.minimum(
            _ms(np.concatenate([rows.acted[:n], np.minimum(now.waits_since, end)])), ended
        )
        acted = np.maximum(acted, began)
        stays["began"] = (began + BEGIN * 1000).astype("datetime64[ms]")
        stays["acting_ms"] = (acted - began).astype(np.int32)
        stays["waiting_ms"] = (ended - acted).astype(np.int32)
        now.began[:] = end
        now.arrived[:] = 0
        moments = {
            "robot": rows.failed_robot[:failed].copy(),
            "place": rows.failed_place[:failed].copy(),
            "happened": (_ms(rows.failed_at[:failed]) + BEGIN * 1000).astype("datetime64[ms]"),
        }
        return stays, moments


def _ms(seconds: Any) -> Any:
    return np.rint(seconds * 1000).astype(np.int64)


def fill(store: Store, year: Year, days: int) -> Dict[str, float]:
    """Simulate days into a store; how many rows there are, and how long it took."""
    plan, net = year.plan, year.plan.net
    key = "synthetic"
    run = new_run(key, header(plan, plan.name, "", key, agents=True))
    run["begin"] = float(BEGIN)
    left_by = {
        (a, b): transition.name
        for t, transition in enumerate(net.transitions)
        for a, _ in net.inputs[t]
        for b, _ in net.outputs[t]
    }
    database = open_database(store.temporary)
    for name, rows in (
        ("robots", [(i, robot.name) for i, robot in enumerate(plan.robots)]),
        ("places", [(i, place.name) for i, place in enumerate(net.places)]),
        ("transitions", [(a, b, name) for (a, b), name in left_by.items()]),
    ):
        database.execute(
            "CREATE TABLE %s (%s)"
            % (name, ", ".join(["a BIGINT", "b BIGINT"][: len(rows[0]) - 1] + ["name VARCHAR"]))
        )
        database.executemany(
            "INSERT INTO %s VALUES (%s)" % (name, ", ".join("?" * len(rows[0]))), rows
        )
    simulated = written = 0.0
    for number in range(days):
        begin = time.perf_counter()
        stays, moments = year.day(number)
        middle = time.perf_counter()
        _write_day(database, store, run, number, stays, moments)
        simulated += middle - begin
        written += time.perf_counter() - middle
        if (number + 1) % SAVED_EVERY == 0 or number + 1 == days:
            run["end"] = float(BEGIN + (number + 1) * DAY_SECONDS)
            store.commit(run)
            print("%d days, %.0f s" % (number + 1, simulated + written), file=sys.stderr)
    database.close()
    rows_written = sum(run["rows"].values())
    return {
        "days": days,
        "visits": run["rows"]["stays"],
        "rows": rows_written,
        "simulated_seconds": simulated,
        "written_seconds": written,
        "rows_a_second": rows_written / written,
        "store_bytes": _size(store.folder),
    }


def _write_day(
    database: Any,
    store: Store,
    run: Dict[str, Any],
    number: int,
    stays: Dict[str, Any],
    moments: Dict[str, Any],
) -> None:
    """Write the columns of a day as the files of a store."""
    day = str(np.datetime64(BEGIN // DAY_SECONDS + number, "D"))
    database.register("stay_columns", stays)
    database.register("moment_columns", moments)
    names = "%s AS run, {time}, robots.name AS robot, places.name AS place" % quoted(run["key"])
    joins = "JOIN robots ON robots.a = c.robot JOIN places ON places.a = c.place"
    database.execute(
        "CREATE OR REPLACE TEMP TABLE day_stays AS SELECT %s, visit, visit - 1 AS slot, arrived, "
        "acting_ms, waiting_ms, 0 AS paused_ms, 0 AS failed_ms, 0 AS resting_ms, "
        "coalesce(transitions.name, '') AS left_by FROM stay_columns c %s "
        "LEFT JOIN transitions ON transitions.a = c.place AND transitions.b = c.target"
        % (names.format(time="c.began"), joins)
    )
    database.execute(
        "CREATE OR REPLACE TEMP TABLE day_moments AS SELECT %s, 0::BIGINT AS slot, "
        "'failure' AS kind, 'aborted' AS detail FROM moment_columns c %s"
        % (names.format(time="c.happened"), joins)
    )
    for name, sql in (
        ("stays", "FROM day_stays ORDER BY robot, began"),
        ("moments", "FROM day_moments ORDER BY happened"),
        ("totals", totals_sql("day_stays", "day_moments")),
    ):
        path = file_name(name, day, run["key"], "1-1")
        os.makedirs(os.path.dirname(os.path.join(store.folder, path)), exist_ok=True)
        write_table(database, sql, os.path.join(store.folder, path))
        run["files"][name].append(path)
    run["rows"]["stays"] += len(stays["robot"])
    run["rows"]["moments"] += len(moments["robot"])


# -- reports ---------------------------------------------------------------------------------------

QUESTIONS: Sequence[Tuple[str, Sequence[str]]] = (
    ("by robot", ("report", "--by", "robot")),
    ("by place", ("report", "--by", "place")),
    ("by day", ("report", "--by", "day")),
    ("by day and robot", ("report", "--by", "day,robot", "--csv")),
    ("by day, robot and place", ("report", "--by", "day,robot,place", "--csv")),
    (
        "one robot, a month",
        ("report", "--by", "day", "--robot", "1", "--since", "2026-01-01", "--until", "2026-01-31"),
    ),
    (
        "SQL: mean wait of each place",
        ("sql", "SELECT place, avg(waiting_ms) FROM stays GROUP BY place"),
    ),
    (
        "SQL: 99 % quantile of the waits in a place",
        ("sql", "SELECT approx_quantile(waiting_ms, 0.99) FROM stays WHERE place LIKE '%Wait_L1'"),
    ),
    (
        "SQL: visits by hour",
        ("sql", "SELECT hour(began) AS h, count(*) FROM stays GROUP BY h ORDER BY h"),
    ),
)


_ASK = """
import re, sys, time
from gspn_framework_package.cli.main import main
code = main(sys.argv[1:])
with open("/proc/self/status") as file:  # getrusage would count the memory of the benchmark too
    peak = re.search(r"VmHWM:\\s+(\\d+)", file.read()).group(1)
print(code, peak, time.process_time(), file=sys.stderr)
"""


def ask_all(store: Store, robot: str) -> List[Dict[str, Any]]:
    """Ask each question in a separate process: its wall and processor time (s), and its largest
    memory (bytes)."""
    found = []
    for name, words in QUESTIONS:
        asked = [robot if word == "1" else word for word in words]
        begin = time.perf_counter()
        told = subprocess.run(
            [sys.executable, "-c", _ASK, "history", *asked, "--store", store.folder],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            check=True,
        )
        seconds = time.perf_counter() - begin
        code, peak, processor = told.stderr.split()[-3:]
        found.append(
            {
                "question": name,
                "seconds": seconds,
                "processor_seconds": float(processor),
                "memory_bytes": int(peak) * 1024,
                "failed": code != "0",
            }
        )
    return found


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(prog="benchmarks.history", description=__doc__.split(":")[0])
    parser.add_argument("--robots", type=int, default=100, help="default: 100")
    parser.add_argument("--days", type=int, default=365, help="default: 365")
    parser.add_argument("--log-seconds", type=float, default=20_000.0, help="length of the log")
    parser.add_argument("--store", help="keep the store here, in a new folder")
    parser.add_argument("--quick", action="store_true", help="2 days of 5 robots, a short log")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    if args.quick:
        args.robots, args.days, args.log_seconds = 5, 2, 1000.0
    plan = patrol(args.robots)
    result: Dict[str, Any] = {"machine": describe_machine((*LIBRARIES, "duckdb"))}
    result["load"] = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        result["log"] = log_rate(plan, args.log_seconds, folder)
    with tempfile.TemporaryDirectory() as folder:
        store = Store(args.store or os.path.join(folder, "store"), create=True)
        with store.locked():
            result["year"] = fill(store, Year(plan), args.days)
        result["questions"] = ask_all(store, plan.robots[0].name)
    result["load_after"] = os.getloadavg()[0]
    if args.json:
        print(json.dumps(result, indent=2))
        return 0
    log, year = result["log"], result["year"]
    print(machine_line(result["machine"]))
    print("Load of the machine: %.1f before, %.1f after\n" % (result["load"], result["load_after"]))
    print(
        "From a log: %s slots, %s a second of processor time; %.0f bytes a slot in the log, "
        "%.1f in the store"
        % (
            format(log["slots"], ","),
            format(round(log["slots_a_second"]), ","),
            log["log_bytes"] / log["slots"],
            log["store_bytes"] / log["slots"],
        )
    )
    print(
        "%d robots, %d days: %s visits; simulated in %.0f s, written in %.0f s (%s rows a second); "
        "%.2f GB\n"
        % (
            args.robots,
            args.days,
            format(year["visits"], ","),
            year["simulated_seconds"],
            year["written_seconds"],
            format(round(year["rows_a_second"]), ","),
            year["store_bytes"] / 1e9,
        )
    )
    rows = [
        [q["question"], q["seconds"], q["processor_seconds"], round(q["memory_bytes"] / 1e6)]
        for q in result["questions"]
    ]
    print(table(("question", "s", "processor s", "MB"), rows))
    return 1 if any(q["failed"] for q in result["questions"]) else 0


if __name__ == "__main__":
    sys.exit(main())
