"""Policy look-up beside a linear scan, from 10 rows to 1,000,000: ``python3 -m
benchmarks.policy``.

The table of ``n`` rows decides in one place of a net with twelve places: most rows are exact, one
in ten has a wildcard or two, and markings are drawn from those that some row matches. Both methods
must give the same row, or the benchmark fails.

``--plan`` measures instead what a whole plan with so many rows takes: to read, check, start, run,
log, verify, replay, simulate, show and draw it.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import random
import statistics
import sys
import tempfile
import threading
import time
import uuid
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from benchmarks.machine import describe_machine, machine_line, table
from benchmarks.plans import INSTANT, MODULE
from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import header, read_log
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.log_writer import EventLogWriter
from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.execution.replayer import replay
from gspn_framework_package.execution.standalone import Listener, StandaloneExecutor
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.formats.dot import net_graph
from gspn_framework_package.formats.plan_file import read_net_or_plan, read_plan
from gspn_framework_package.formats.plan_json import plan_to_json
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.visualizer.scene import scene_to_json

SIZES = (10, 100, 1_000, 10_000, 100_000, 1_000_000)
PLACES = 12
CHOICES = ((("left", 0.25), ("right", 0.75)), (("left", 0.5), ("right", 0.5)))


def decision_net() -> Net:
    """A place ``decide`` with two immediate transitions, and places that the policy reads."""
    net = NetBuilder("decision").place("decide", tokens=1)
    for number in range(1, PLACES):
        net.place("p%d" % number)
    net.immediate("left", inputs="decide", outputs="p1")
    net.immediate("right", inputs="decide", outputs="p2")
    return net.build()


def random_policy(net: Net, rows: int, source: random.Random) -> Policy:
    """A policy of ``rows`` different rows; one in ten has one or two wildcards."""
    names = [place.name for place in net.places]
    tokens = 2 + int(rows ** (1 / (PLACES - 3)))
    seen = set()
    made: List[PolicyRow] = []
    while len(made) < rows:
        counts: List[Optional[int]] = [source.randrange(tokens) for _ in names]
        counts[0] = 1
        if len(made) % 10 == 9:
            for column in source.sample(range(PLACES - 3, PLACES), source.choice((1, 2))):
                counts[column] = None
        key = tuple(counts)
        if key not in seen:
            seen.add(key)
            made.append(PolicyRow(key, source.choice(CHOICES)))
    return Policy(names, made)


def scan(policy: Policy, marking: Sequence[int]) -> Optional[int]:
    """Number of the row for ``marking``, found by scanning all rows: fewest wildcards, then file
    order."""
    best, best_wildcards = None, len(marking) + 1
    for number, row in enumerate(policy.rows):
        wildcards = 0
        for count, tokens in zip(row.counts, marking):
            if count is None:
                wildcards += 1
            elif count != tokens:
                break
        else:
            if wildcards < best_wildcards:
                best, best_wildcards = number, wildcards
    return best


def measure(rows: int, budget: float) -> Dict[str, Any]:
    """Times for a policy of ``rows`` rows.

    :param budget: time (s) for the scans; at least three are made.
    :raises AssertionError: look-up and scan disagree.
    """
    net = decision_net()
    policy = random_policy(net, rows, random.Random(rows))
    begin = time.perf_counter()
    bound = policy.bind(net)
    markings = _markings(policy, random.Random(rows + 1))
    bound.distribution(markings[0], 0)
    build = time.perf_counter() - begin
    scanned: List[Tuple[Tuple[int, ...], Optional[int]]] = []
    times: List[float] = []
    end = time.perf_counter() + budget
    for marking in markings:
        begin = time.perf_counter()
        scanned.append((marking, scan(policy, marking)))
        times.append(time.perf_counter() - begin)
        if len(times) >= 3 and time.perf_counter() >= end:
            break
    for marking, number in scanned:
        found = bound.distribution(marking, 0)
        assert found is not None and found.row == number, "look-up and scan disagree"
    lookup = min(_round(bound, markings) for _ in range(5))
    scanning = statistics.median(times)
    return {
        "rows": rows,
        "prepare_s": build,
        "lookup_us": lookup * 1e6,
        "scan_us": scanning * 1e6,
        "ratio": scanning / lookup,
        "scans": len(times),
    }


def _markings(policy: Policy, source: random.Random) -> List[Tuple[int, ...]]:
    """Markings that rows of the policy match, sampled from the whole table."""
    rows = [policy.rows[source.randrange(len(policy.rows))] for _ in range(1_000)]
    return [
        tuple(c if isinstance(c, int) else source.randrange(3) for c in row.counts) for row in rows
    ]


def _round(bound: Any, markings: Sequence[Sequence[int]]) -> float:
    begin = time.perf_counter()
    for marking in markings:
        bound.distribution(marking, 0)
    return (time.perf_counter() - begin) / len(markings)


class _Runs(Listener):
    """Notes when the first transition fired, and stops after some firings."""

    def __init__(self, firings: int) -> None:
        self.first = 0.0
        self.firings = 0
        self.over = threading.Event()
        self._most = firings

    def on_step(
        self,
        slot: int,
        entries: Sequence[log_entries.Entry],
        firings: Sequence[Firing],
        state: TeamState,
    ) -> None:
        if firings and not self.firings:
            self.first = time.process_time()
        self.firings += len(firings)
        if self.firings >= self._most:
            self.over.set()


def policy_plan(rows: int) -> Plan:
    """Two robots that choose again and again, under a policy of ``rows`` rows without wildcards."""
    builder = NetBuilder("decision").place("decide", tokens=2)
    names = ["decide"] + ["p%d" % number for number in range(1, PLACES)]
    for name in names[1:]:
        builder.place(name)
    builder.immediate("left", inputs="decide", outputs="p1")
    builder.immediate("right", inputs="decide", outputs="p2")
    for name in ("p1", "p2"):
        builder.exponential("back_" + name, inputs=name, outputs="decide", servers=None)
    kept = [
        PolicyRow((robots, left, 2 - robots - left, *[0] * (PLACES - 3)), CHOICES[0])
        for robots in (1, 2)
        for left in range(3 - robots)
    ]
    policy = random_policy(builder.build(), max(2 * rows, 100), random.Random(rows))
    kept += [row for row in policy.rows if None not in row.counts and sum(row.counts[3:]) > 0]  # type: ignore[arg-type]
    return Plan(
        net=builder.build(),
        name="decision",
        policy=Policy(names, kept[:rows]),
        actions={name: FunctionAction(INSTANT, name) for name in names[:3]},
        resource_places=frozenset(names[3:]),
        robots=(RobotSpec("1", "decide"), RobotSpec("2", "decide")),
    ).validate()


def measure_plan(rows: int, firings: int) -> Dict[str, Any]:
    """What a plan with ``rows`` rows takes, from its file to the picture: processor seconds and
    bytes."""
    found: Dict[str, Any] = {"rows": rows}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        begin = time.process_time()
        result = work()
        found[name] = time.process_time() - begin
        return result

    with tempfile.TemporaryDirectory() as folder:
        file = os.path.join(folder, "plan.json")
        with open(file, "w", encoding="utf-8") as out:
            json.dump(plan_to_json(policy_plan(rows)), out)
        log = os.path.join(folder, "run.jsonl")
        plan = timed("read_s", lambda: read_plan(file))
        assert not timed("check_s", lambda: check(plan, standalone=True)).refused
        counter = _Runs(firings)
        begin = time.process_time()
        writer = EventLogWriter(log, header(plan, "run", "", uuid.uuid4().hex, agents=True))
        allow_modules([MODULE])
        executor = StandaloneExecutor(plan, counter, writer)
        executor.start()
        counter.over.wait()
        found["start_s"] = counter.first - begin
        found["firing_s"] = (time.process_time() - counter.first) / counter.firings
        executor.stop("the end of the benchmark")
        executor.wait()
        writer.close()
        with open(log, "rb") as lines:
            found["header_bytes"] = len(lines.readline())
        read = timed("read_log_s", lambda: read_log(log))
        timed("log_plan_s", lambda: read.plan)
        assert timed("verify_s", lambda: verify([read])).violation is None
        timed("replay_s", lambda: collections.deque(replay(read), 0))
        timed("simulate_s", lambda: simulate(plan, time=100.0, replications=2))
        scene = timed("scene_s", lambda: json.dumps(scene_to_json(plan.net, plan)))
        found["scene_bytes"] = len(scene)
        timed("draw_s", lambda: net_graph(read_net_or_plan(file).net).text())
    return found


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(prog="benchmarks.policy", description=__doc__.split(":")[0])
    parser.add_argument("--quick", action="store_true", help="up to 10,000 rows")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--plan", action="store_true", help="measure whole plans")
    args = parser.parse_args(arguments)
    if args.plan:
        return _plans(args.quick, args.json)
    sizes = [n for n in SIZES if not args.quick or n <= 10_000]
    results = []
    for rows in sizes:
        if sys.stderr.isatty():
            print("%d rows ..." % rows, file=sys.stderr)
        results.append(measure(rows, budget=0.2 if args.quick else 2.0))
    machine = describe_machine()
    if args.json:
        print(json.dumps({"machine": machine, "results": results}, indent=2))
        return 0
    print(machine_line(machine) + "\n")
    head = ("rows", "preparing [s]", "look-up [us]", "linear scan [us]", "scan / look-up")
    keys = ("rows", "prepare_s", "lookup_us", "scan_us", "ratio")
    print(table(head, [[r[k] for k in keys] for r in results]))
    return 0


def _plans(quick: bool, as_json: bool) -> int:
    results = [
        measure_plan(rows, 100 if quick else 1_000) for rows in (10, 1_000 if quick else 58_000)
    ]
    machine = describe_machine()
    if as_json:
        print(json.dumps({"machine": machine, "results": results}, indent=2))
        return 0
    print(machine_line(machine) + "\n")
    head = ["", *("%s rows" % format(r["rows"], ",") for r in results)]
    names = [name for name in results[0] if name != "rows"]
    print(table(head, [[name, *(r[name] for r in results)] for name in names]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
